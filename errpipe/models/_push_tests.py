"""Static push tests read from a recording: compliance of each part of the chain between gauges, and of the whole.

One error column of the component is the deviation between tool and work. Several are gauges, each with its
`location`: tool_post, spindle, workpiece. Every gauge has the sign of the component (positive if the gap opens), and
reads only its own part: the workpiece against the spindle, unless `gauge_datum` states that all read against the bed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import position
from errpipe.errors import DataError
from errpipe.fitting.design import response_name
from errpipe.models._force_options import ForceOptions

GAUGES = ("tool_post", "spindle", "workpiece")
WHOLE = "structure"  # the part if no gauge distinguishes parts
# Powers of the lever in structure(z), simplest first: a rigid spindle on springs has the square, and also the lever
# if the centre of its springs is not at the chuck's face.
POWERS = ((0,), (0, 2), (0, 1, 2))
NAMES = ("level", "per_m", "per_m2")


@dataclass(frozen=True)
class PushTests:
    """Rows of push tests: force (N), lever (m), by part its deviation minus its run's zero (um), all (rows,).

    known: by part the computed compliance of the bodies of the tests, um/N (rows,).
    """

    force: np.ndarray
    lever: np.ndarray
    deviation: Mapping[str, np.ndarray]
    known: Mapping[str, np.ndarray]

    @property
    def whole(self) -> np.ndarray:
        """Deviation between tool and work, um; NaN if a gauge has no reading."""
        return np.sum(list(self.deviation.values()), axis=0)

    @property
    def all_known(self) -> np.ndarray:
        """Computed compliance of all bodies of the tests, um/N."""
        return np.sum(list(self.known.values()), axis=0)


@dataclass(frozen=True)
class Structure:
    """Coefficients of structure(z), um/N per power 0 to 2 of the lever in m; their standard errors; noise, um."""

    values: np.ndarray
    errors: np.ndarray
    noise: float


def whole(parts: Mapping[str, Structure]) -> Structure:
    """The chain: compliances of its parts add, and so do the squares of their standard errors and noise."""
    values = np.sum([p.values for p in parts.values()], axis=0)
    errors = np.sqrt(np.sum([p.errors**2 for p in parts.values()], axis=0))
    return Structure(values, errors, float(np.sqrt(sum(p.noise**2 for p in parts.values()))))


def read(options: ForceOptions, recording: Recording) -> PushTests:
    """The rows of a recording. Raises DataError for a missing force, gauge or position.

    A run's zero is its reading at zero force, from its own regression line over the force.
    """
    if lacking := options.missing_input(recording):
        raise DataError(lacking)
    force = recording.array(options.force)
    place = np.zeros(len(force)) if options.axis is None else position(recording, options.axis)
    away = options.outwards * (place - options.chuck_face)
    columns = _gauges(options, recording)
    pushes = np.column_stack([force * (away * 1e-3) ** k for k in range(len(NAMES))])
    raw = {part: recording.array(column) for part, column in columns.items()}
    if options.gauge_datum == "bed" and {"spindle", "workpiece"} <= set(raw):
        raw["workpiece"] = raw["workpiece"] - raw["spindle"]
    run = recording.run_codes()
    deviation = {part: _minus_zero(pushes, value, run) for part, value in raw.items()}
    known = {part: np.zeros(len(force)) for part in raw}
    work = "workpiece" if WHOLE not in raw else WHOLE
    if options.pushed_workpiece is not None and work in known:
        known[work] = known[work] + options.pushed_workpiece.at(away)
    if options.pushed_tool is not None:
        known[WHOLE] = known[WHOLE] + options.pushed_tool.at()
    return PushTests(force, away * 1e-3, deviation, known)


def _gauges(options: ForceOptions, recording: Recording) -> dict[str, str]:
    """Part -> its error column. Raises DataError if the columns' locations are ambiguous."""
    names = recording.names("error", component=options.component)
    places = {n: recording.manifest.columns[n].location for n in names}
    if len(names) <= 1 and not set(places.values()) & set(GAUGES):
        return {WHOLE: response_name(recording, options.component)}
    for name, place in places.items():
        if place not in GAUGES:
            raise DataError(
                f"push tests: {len(names)} columns are {options.component}; columns.{name}.location: {place!r} is "
                f"not a gauge (allowed: {', '.join(GAUGES)}). Give a column that is their sum the role ignore."
            )
    if len(set(places.values())) < len(places):
        raise DataError(
            f"push tests: two columns of {options.component} have the same location (allowed: one column for each of "
            f"{', '.join(GAUGES)})"
        )
    if options.pushed_tool is not None:
        raise DataError("push tests: gauges do not read the tool that was pushed: omit pushed_tool")
    return {g: n for g in GAUGES for n, place in places.items() if place == g}


def _minus_zero(pushes: np.ndarray, value: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Readings minus the reading of each run at zero force, um (rows,)."""
    value = value.copy()
    design = np.column_stack([np.ones(len(value)), pushes])
    known = np.isfinite(design).all(axis=1) & np.isfinite(value)
    for code in np.unique(run):
        rows = (run == code) & known
        value[run == code] -= np.linalg.lstsq(design[rows], value[rows], rcond=None)[0][0] if rows.any() else 0.0
    return value


def diameter_factor(options: ForceOptions) -> float:
    """2 for a diameter, 1 for a displacement."""
    return 2.0 if components.parse(options.component).kind == "diameter" else 1.0


def solve(options: ForceOptions, recording: Recording, rows: np.ndarray) -> dict[str, Structure]:
    """Structure of each part from the rows of a mask (rows,). Raises DataError if there are too few."""
    pushes = read(options, recording)
    return {part: _part(options, pushes, part, rows) for part in pushes.deviation}


def _part(options: ForceOptions, pushes: PushTests, part: str, rows: np.ndarray) -> Structure:
    """Least squares of the residual of the pushed bodies over force times powers of the lever, selected by BIC."""
    force, lever, deviation = pushes.force, pushes.lever, pushes.deviation[part]
    use = rows & np.isfinite(force) & np.isfinite(lever) & np.isfinite(deviation)
    if use.sum() < 4 or np.ptp(force[use]) <= 0:
        raise DataError(
            f"push tests: at least 4 readings of the {part} at different forces are needed (found {int(use.sum())})"
        )
    left = (options.sign * deviation / diameter_factor(options) - force * pushes.known[part])[use]
    best: tuple[float, Structure] | None = None
    places = np.unique(np.round(lever[use], 4)).size
    for powers in (p for p in POWERS if len(p) <= places):
        design = lever[use][:, None] ** np.array(powers) * force[use][:, None]
        values, *_ = np.linalg.lstsq(design, left, rcond=None)
        residual = left - design @ values
        noise = float(np.sqrt(residual @ residual / max(len(left) - len(powers), 1)))
        score = len(left) * np.log(max(residual @ residual, 1e-18) / len(left)) + len(powers) * np.log(len(left))
        if best is None or score < best[0]:
            every, errors = np.zeros(len(NAMES)), np.zeros(len(NAMES))
            every[list(powers)] = values
            errors[list(powers)] = noise * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
            best = (float(score), Structure(every, errors, noise))
    assert best is not None  # at least the constant was tried
    return best[1]
