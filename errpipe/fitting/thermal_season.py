"""A thermal model meant to survive the season: physics that carries, a correction that knows where it was learnt.

    deviation since the start of the run = clip( share x core + gate x correction )

core         causes of known sign (`thermal_causes`), gains by averaged signed networks (`thermal_network`)
correction   ridge on lagged differences to the room, fitted to what the core leaves, most by runs that started about
             as warm (`thermal_local`). It is worth micrometres
             where it was learnt and ruins a season that it never saw, so `gate` scales it by what it earned on
             runs left out that started about as warm, and takes it back to nothing where a run starts outside
             the temperatures seen
share        1 inside; outside it fades to the slope that the core had on environments left out (at most 1)
clip         causes stay within twice the span seen, the sum within a quarter span beyond the deviations seen

Every part is an expression of driver operations, so a table gives the same figures. The datum is the start of
the run: a temperature cannot know where the probe was zeroed, so each run's first rows are a nuisance of the
fit and the prediction starts at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from errpipe import __version__
from errpipe.domain import driver as d
from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedParameter, FittedTerm, Validity
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout, thermal_causes, thermal_local, thermal_network
from errpipe.fitting.design import response_name
from errpipe.fitting.season_options import SeasonOptions
from errpipe.fitting.thermal_arithmetic import (
    centred,
    conformal_half_width,
    inner_groups,
    limits,
    rms,
    since_start,
    slope,
)
from errpipe.fitting.validity import box, distance
from errpipe.terms import ProfileDriver
from errpipe.terms._base import drive, plain

CAUSE_BEYOND = 1.0  # of the span seen of each cause
WORTH_WIDTH = 0.5  # K: runs whose starts differ by less vouch for each other's correction
WORTH_PRIOR = 1.0  # um2: a correction that moved less than 1 um on the runs left out has proved nothing
WORTH_STEPS = 16
LEAST_OUTSIDE = 0.01  # margins: rows nearer to the box tell nothing of how errors grow outside of it
DOUBLED = 12.0  # K summed over sensors: this far outside the interval is at least twice as wide (2 K on each of six)
MARGIN = 50.0  # K: the drivers fade by themselves, so a table's own fade has next to nothing left to do


@dataclass(frozen=True)
class Intervals:
    """Half width in um: `inside` the box of what was seen, wider by `widening` per margin outside of it."""

    inside: float
    widening: float


@dataclass(frozen=True)
class Prediction:
    """Per row, um: deviation since the start of the run, interval; outside is True where nothing like it was seen."""

    predicted: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    outside: np.ndarray


@dataclass(frozen=True)
class SeasonModel:
    """A fitted model. `terms` is what a table compiles: their sum is the deviation since the start of the run.

    parts: the same, cause by cause and without the limit, for a person to read. fade: K, see the options.
    datum: mean and standard deviation of the runs' zeros, um: how far the start of a new run is unknown.
    """

    component: str
    options: SeasonOptions
    parts: tuple[tuple[str, float, d.Driver], ...]
    terms: tuple[tuple[float, d.Driver], ...]
    intervals: Intervals
    validity: Validity
    fade: float
    limit: tuple[float, float]
    datum: tuple[float, float]
    report: dict[str, Any] = field(default_factory=dict)

    def values(self, recording: Recording) -> np.ndarray:
        """Deviation since the start of the run, um, shape (rows,); causal."""
        return sum((gain * drive(node, recording) for gain, node in self.terms), np.zeros(len(recording)))

    def predict(self, recording: Recording) -> Prediction:
        """Deviation since the start of each run with its interval, um; row k uses rows up to k of its run."""
        value = self.values(recording)
        away = distance(self.validity, recording)
        half = self.intervals.inside + self.intervals.widening * away
        return Prediction(value, value - half, value + half, away > 0.0)

    def component_model(self) -> ComponentModel:
        """As an error model's component: one term per driver, with the figures of the report."""
        terms = tuple(
            FittedTerm(
                term=plain(ProfileDriver(driver=(node,))),
                parameters=(FittedParameter(name="gain", value=gain, unit="um"),),
            )
            for gain, node in self.terms
        )
        return ComponentModel(
            component=self.component,
            terms=terms,
            rows=self.report["rows"],
            rms_before=self.report["rms_before"],
            rms_after=self.report["rms_after"],
            half_width90=self.intervals.inside,
            widening90=self.intervals.widening,
            limit=max(abs(self.limit[0]), abs(self.limit[1])),
        )

    def error_model(self, recording: Recording) -> ErrorModel:
        """As an error model of one component; `recording` gives machine, title and the columns' entries."""
        manifest = recording.manifest
        columns = {n: manifest.columns[n].model_dump(mode="json", exclude_none=True) for n in self.validity.ranges}
        notes = (
            "counts from the start of each run: temperatures do not tell where the probe was zeroed "
            f"(zeros seen: {self.datum[0]:.1f} um, standard deviation {self.datum[1]:.1f} um)",
        )
        return ErrorModel(
            machine=manifest.machine, title=manifest.title, version=__version__, columns=columns,
            components=(self.component_model(),), validity=self.validity, datum="run_start", notes=notes,
        )  # fmt: skip


def fit(
    recording: Recording,
    component: str,
    options: SeasonOptions | None = None,
    rows: np.ndarray | None = None,
) -> SeasonModel:
    """Fit on the rows of a mask (all where not given). Nothing outside the mask is looked at, the datum apart.

    Raises DataError where the response is missing or no sensor sits on the machine.
    """
    options = options or SeasonOptions()
    problem = _Problem(recording, component, options, rows)
    problem.orient()
    return problem.model()


@dataclass(frozen=True)
class _Gains:
    """What one set of groups teaches: gains, correction, its slope, and the box of starts it saw."""

    core: np.ndarray
    correction: thermal_local.Local | None
    low: np.ndarray
    high: np.ndarray


class _Problem:
    """Design columns of all rows, and the triangles of the groups that may be used."""

    def __init__(self, recording: Recording, component: str, options: SeasonOptions, rows: np.ndarray | None):
        self.recording, self.component, self.options = recording, component, options
        self.found = thermal_causes.sensors(
            recording, room=options.room, spindle=options.spindle, bed=options.bed, use=options.sensors
        )
        self.causes = thermal_causes.causes(recording, self.found, options.late, options.slow)
        self.further = _correction_drivers(recording, self.found, options) if options.correction else ()
        self.core = thermal_causes.columns(recording, [c.driver for c in self.causes])
        self.extra = thermal_causes.columns(recording, self.further)
        names = self.found.all()
        self.starts = thermal_causes.columns(recording, [_start(n) for n in names])
        deviation = recording.array(response_name(recording, component))
        run = recording.run_codes()
        self.response, self.zero = since_start(deviation, run, options.datum_rows)
        core = centred(self.core, run, options.datum_rows)
        extra = centred(self.extra, run, options.datum_rows)
        good = np.isfinite(self.response) & np.isfinite(core).all(axis=1) & np.isfinite(extra).all(axis=1)
        if rows is not None:
            good &= rows
        if not good.any():
            raise DataError(f"thermal model of {component}: no row has a deviation and all temperatures")
        self.rows = good
        self.group = inner_groups(run, good)
        self.groups = [int(g) for g in np.unique(self.group[good])]
        self.count = {g: int(np.count_nonzero(good & (self.group == g))) for g in self.groups}
        design = np.column_stack([core, extra])[good]
        self.triangles = thermal_network.triangles(design, self.response[good], self.group[good])
        self.signs = np.array([c.sign for c in self.causes])
        self.members = thermal_network.networks([c.kind for c in self.causes], [c.start for c in self.causes])
        self.core_centred, self.extra_centred = core, extra

    def orient(self) -> None:
        """Turn all signs round where runs left out say so: a response may count the other way."""
        turned = -self.signs
        errors = []
        for signs in (self.signs, turned):
            self.signs = signs
            core = self.left_out([[g] for g in self.groups], corrected=False)["core"]
            seen = self.rows & np.isfinite(core)
            errors.append(rms((self.response - core)[seen]))
        self.signs = turned if errors[1] < errors[0] else -turned

    def solve(self, groups: Sequence[int], corrected: bool = True) -> _Gains:
        """Gains from some of the groups. corrected: also those of the correction."""
        triangle = thermal_network.stack(self.triangles, groups)
        rows = sum(self.count[g] for g in groups)
        width = len(self.causes)
        core_part = np.column_stack([triangle[:, :width], triangle[:, -1]])
        core = thermal_network.signed_gains(core_part, rows, self.members, self.signs, self.options.penalty)
        correction = self._local(groups, core) if self.further and corrected else None
        mask = self.rows & np.isin(self.group, list(groups))
        return _Gains(core, correction, np.nanmin(self.starts[mask], axis=0), np.nanmax(self.starts[mask], axis=0))

    def _local(self, groups: Sequence[int], core: np.ndarray) -> thermal_local.Local:
        warmth = self.warmth()
        warm = {g: float(warmth[self.rows & (self.group == g)][0]) for g in groups}
        parts = {g: self.triangles[g] for g in groups}
        return thermal_local.fit(
            parts, self.count, warm, core, self.options.correction_width, self.options.correction_penalty
        )

    def start_distance(self, gains: _Gains) -> np.ndarray:
        """How far outside the seen starts each row's run began, mean over sensors, K."""
        outside = np.maximum(gains.low - self.starts, 0.0) + np.maximum(self.starts - gains.high, 0.0)
        return np.nan_to_num(outside).mean(axis=1)

    def left_out(self, folds: Sequence[Sequence[int]], corrected: bool = True) -> dict[str, np.ndarray]:
        """Core and gated correction of every used row by gains that never saw its fold; also the distance."""
        out = {k: np.full(self.rows.size, np.nan) for k in ("core", "correction", "outside")}
        warmth = self.warmth()
        for fold in folds:
            rest = [g for g in self.groups if g not in fold]
            if not rest:
                continue
            gains = self.solve(rest, corrected)
            rows = self.rows & np.isin(self.group, list(fold))
            away = self.start_distance(gains)[rows]
            out["core"][rows] = self.core_centred[rows] @ gains.core
            gate = np.clip(1.0 - away / self.options.fade, 0.0, 1.0)
            out["correction"][rows] = 0.0
            if gains.correction is not None:
                out["correction"][rows] = gate * gains.correction.values(warmth[rows], self.extra_centred[rows])
            seen = self.seen_box(self.rows & np.isin(self.group, rest))
            out["outside"][rows] = distance(seen, self.recording)[rows]
        return out

    def seen_box(self, rows: np.ndarray) -> Validity:
        """The temperatures of the rows of a mask."""
        found = box(self.recording, self.found.all(), rows)
        return found.model_copy(update={"margins": dict.fromkeys(found.ranges, MARGIN)})

    def environments(self) -> list[list[int]]:
        """Groups by their surroundings: the labelled ones, else runs that started cold and runs that started warm."""
        try:
            labels = holdout.labels(self.recording, self.options.environment)
        except DataError:
            labels = np.full(self.rows.size, "")
        per_group = {g: labels[np.flatnonzero(self.rows & (self.group == g))[0]] for g in self.groups}
        kinds = list(dict.fromkeys(per_group.values()))
        if len(kinds) > 1:
            return [[g for g in self.groups if per_group[g] == k] for k in kinds]
        warmth = {g: float(np.nanmean(self.starts[self.rows & (self.group == g)])) for g in self.groups}
        order = sorted(self.groups, key=lambda g: (warmth[g], g))
        half = len(order) // 2
        return [order[:half], order[half:]] if half else []

    def warmth(self) -> np.ndarray:
        """Mean start temperature of each row's run, degC."""
        return self.starts.mean(axis=1)

    def worth(self, runs: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Warmth of a start (grid, degC) -> the share of the correction that earned its keep on runs left out."""
        warm = np.array([self.warmth()[self.group == g][0] for g in self.groups])
        grid = np.linspace(warm.min(), max(warm.max(), warm.min() + 1e-3), WORTH_STEPS + 1)
        if not self.further:
            return grid, np.zeros(grid.size)
        left, gain = self.response - runs["core"], runs["correction"]
        above, below = np.zeros(warm.size), np.zeros(warm.size)
        for k, g in enumerate(self.groups):
            mine = self.rows & (self.group == g) & np.isfinite(gain)
            above[k] = np.sum(left[mine] * gain[mine])
            below[k] = np.sum(gain[mine] ** 2) + WORTH_PRIOR * np.count_nonzero(mine)
        near = np.exp(-0.5 * ((grid[:, None] - warm) / WORTH_WIDTH) ** 2)
        return grid, np.clip((near @ above) / np.maximum(near @ below, 1e-12), 0.0, 1.0)

    def model(self) -> SeasonModel:
        """The final model: gains from all groups, its scales from groups left out."""
        y = self.response
        runs = self.left_out([[g] for g in self.groups])
        seen = self.rows & np.isfinite(runs["core"])
        worth = self.worth(runs)
        runs["correction"] *= np.interp(self.warmth(), *worth)
        afar = self.left_out(self.environments(), corrected=False)
        far = self.rows & np.isfinite(afar["core"])
        share = self._share(afar["core"], far) if far.any() else 1.0
        gains = self.solve(self.groups)
        near = np.abs(y - runs["core"] - runs["correction"])
        intervals = self._intervals(near, seen, np.abs(y - afar["core"]), far, afar["outside"])
        limit = limits(y[self.rows])
        parts = self._parts(gains, worth, share)
        total = d.Affine(weights=tuple(g for _, g, _ in parts), of=tuple(node for _, _, node in parts))
        terms = ((1.0, d.Clip(of=total, low=limit[0], high=limit[1])),)
        seen_box = self.seen_box(self.rows)
        model = SeasonModel(
            self.component, self.options, parts, terms, intervals, seen_box,
            self.options.fade, limit, self._datum(),
        )  # fmt: skip
        after = y - model.values(self.recording)
        report = {
            "rows": int(np.count_nonzero(self.rows)),
            "groups": len(self.groups),
            "networks": len(self.members),
            "causes": {c.name: float(g) for c, g in zip(self.causes, gains.core, strict=True) if abs(g) > 1e-9},
            "correction_worth": {f"{t:.2f}": float(w) for t, w in zip(*worth, strict=True)},
            "core_share_outside": share,
            "rms_before": rms(y[self.rows]),
            "rms_after": rms(after[self.rows]),
            "rms_runs_left_out": rms((y - runs["core"] - runs["correction"])[seen]) if seen.any() else None,
            "rms_core_runs_left_out": rms((y - runs["core"])[seen]) if seen.any() else None,
            "rms_core_environments_left_out": rms((y - afar["core"])[far]) if far.any() else None,
        }
        return SeasonModel(**(model.__dict__ | {"report": report}))

    def _share(self, core: np.ndarray, rows: np.ndarray) -> float:
        """Slope of the deviation on the core over environments left out, one standard error in its favour, 0..1.

        The standard error is a jackknife over groups: rows of one run are one witness.
        """
        whole = slope(self.response, core, rows, 0.0, np.inf)
        each = [slope(self.response, core, rows & (self.group != g), 0.0, np.inf) for g in self.groups]
        spread = float(np.sqrt((len(each) - 1) / len(each) * np.sum((np.array(each) - np.mean(each)) ** 2)))
        return float(np.clip(whole + spread, 0.0, 1.0))

    def _intervals(self, near, seen, afar, far, outside) -> Intervals:
        """Half widths from rows left out; inside the box a new run counts as likely of a new season as of a known one.

        Temperatures inside the box do not prove that the season is known (a cold morning in spring), so errors of
        runs left out and errors inside the box of environments left out weigh the same.
        """
        level = self.options.coverage
        runs = np.unique(self.recording.run_codes()[self.rows]).size
        inside = conformal_half_width(near[seen], self.group[seen], level, runs)
        unseen = far & (outside <= 0.0)
        if unseen.any():
            errors = np.r_[near[seen], afar[unseen]]
            groups = np.r_[self.group[seen], -1 - self.group[unseen]]
            inside = max(inside, conformal_half_width(errors, groups, level, runs))
        beyond = far & (outside > LEAST_OUTSIDE)
        least = inside * MARGIN / DOUBLED
        if np.count_nonzero(beyond) < 50:
            return Intervals(inside, least)
        needed = np.maximum(afar[beyond] - inside, 0.0) / outside[beyond]
        return Intervals(inside, max(least, conformal_half_width(needed, self.group[beyond], level)))

    def _parts(self, gains: _Gains, worth, share: float) -> tuple[tuple[str, float, d.Driver], ...]:
        away = self._distance_driver(gains)
        outside = d.Clip(of=d.Affine(weights=(1.0 / self.options.fade,), of=(away,)), low=0.0, high=1.0)
        values = self.core[self.rows]
        low, high = values.min(axis=0), values.max(axis=0)
        span = CAUSE_BEYOND * (high - low)
        core = [
            (c.name, float(g), d.Clip(of=c.driver, low=float(a), high=float(b)))
            for c, g, a, b in zip(self.causes, gains.core, low - span, high + span, strict=True)
            if abs(g) > 1e-9
        ]
        if share < 1.0:
            keep = d.Affine(offset=1.0, weights=(share - 1.0,), of=(outside,))
            core = [(name, g, d.Product(of=(keep, node))) for name, g, node in core]
        grid, shares = worth
        if gains.correction is None or not shares.any():
            return tuple(core)
        inside = d.Affine(offset=1.0, weights=(-1.0,), of=(outside,))
        names = self.found.all()
        warmth = d.Affine(weights=(1.0 / len(names),) * len(names), of=tuple(_start(n) for n in names))
        earned = d.Lookup(
            of=warmth, start=float(grid[0]), step=float(grid[1] - grid[0]), values=tuple(float(w) for w in shares)
        )
        learnt = gains.correction.driver(warmth, self.further)
        return (*core, ("correction where it was learnt", 1.0, d.Product(of=(inside, earned, learnt))))

    def _distance_driver(self, gains: _Gains) -> d.Driver:
        most = 1e3
        nodes: list[d.Driver] = []
        for name, low, high in zip(self.found.all(), gains.low, gains.high, strict=True):
            start = _start(name)
            nodes.append(d.Clip(of=d.Affine(offset=float(low), weights=(-1.0,), of=(start,)), low=0.0, high=most))
            nodes.append(d.Clip(of=d.Affine(offset=-float(high), weights=(1.0,), of=(start,)), low=0.0, high=most))
        return d.Affine(weights=(1.0 / len(self.found.all()),) * len(nodes), of=tuple(nodes))

    def _datum(self) -> tuple[float, float]:
        run = self.recording.run_codes()
        levels = [self.zero[np.flatnonzero(self.rows & (run == r))[0]] for r in np.unique(run[self.rows])]
        return float(np.mean(levels)), float(np.std(levels))


def _start(name: str) -> d.First:
    return d.First(of=d.Input(name=name))


def _correction_drivers(
    recording: Recording, found: thermal_causes.Sensors, options: SeasonOptions
) -> tuple[d.Driver, ...]:
    nodes: list[d.Driver] = [d.rise(n) for n in found.all()]
    reference = found.room or found.bodies[0]
    others = [n for n in found.all() if n != reference]
    nodes += [thermal_causes.lagged_difference(n, reference, tau) for n in others for tau in options.correction_lags]
    state = thermal_causes.running(recording, found)
    if state is not None:
        nodes += [d.Lag(of=state, tau_up=tau, tau_down=tau, start="zero") for tau in options.correction_lags[:2]]
    return tuple(nodes)
