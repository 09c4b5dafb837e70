"""Number and places of temperature sensors, from readings at candidate positions and the error."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe import files
from errpipe.domain.operations import LARGEST_NUMBER
from errpipe.errors import DataError, did_you_mean
from errpipe.fitting import placement
from errpipe.fitting.placement import SensorPlacement
from errpipe.simulation import spindle_bar

# Standard errors over duty cycles by which a set must beat no compensation (false-alarm rate 2 to 10 %)
MIN_STANDARD_ERRORS = 2.0
MOST = 20  # of --most
MAX_NAMED = 12  # columns of a file in a message
OUTLIER_RATIO = 5.0  # times the rms of the other duty cycles: beyond, one of them decides alone, and is named
SPEED = re.compile(r"(?:^|[^a-z])(?:rpm|speed)(?:[^a-z]|$)")  # in a column's name: a spindle speed has no place
IGNORE = "to fit these alone: give every other sensor of recording.yaml the role ignore, as {name}: {{role: ignore}}"
BAR_FLUXES = 3  # duty cycles of the simulated bar: one warm-up and two random ones


def place(file: Path, error: str, group: str | None, time: str | None, limit: int) -> tuple[dict[str, Any], list[str]]:
    """The document and its lines of a CSV file: one row a time, a column per candidate place, the error, duty cycles.

    Raises DataError naming the column that is missing or holds no numbers.
    """
    frame = _table(file, error, group, time)
    remaining = [n for n in frame.columns if n not in (error, group, time)]
    names = [n for n in remaining if pd.api.types.is_numeric_dtype(frame[n])]  # labels such as a date are no places
    if not pd.api.types.is_numeric_dtype(frame[error]) or not names:
        text = next((v for v in frame[error] if isinstance(v, str)), "")
        wrong = f"column {error!r} holds no numbers (found {text[:20]!r})" if names else "no candidate place"
        raise DataError(f"{file}: {wrong}")
    _refuse_gaps(file, frame, [error, *names], group)
    labels = frame[group].astype(str).to_numpy(dtype=object) if group else np.full(len(frame), "all")
    clocks = [n for n in names if _is_clock(frame[n].to_numpy(float), labels)]
    if not (names := [n for n in names if n not in clocks]):
        raise DataError(
            f"{file}: no candidate sensor position except {', '.join(clocks)}, which is a clock (equal steps)"
        )
    speeds = [n for n in names if SPEED.search(n.lower())]
    if not (names := [n for n in names if n not in speeds]):
        raise DataError(f"{file}: no candidate sensor position except {', '.join(speeds)}, which is a speed (its name)")
    document, lines = cross_validate(names, frame[names].to_numpy(float), frame[error].to_numpy(float), labels, limit)
    notes = [f"not a sensor position but a clock: {', '.join(clocks)} (equal steps)"] if clocks else []
    notes += [f"not a sensor position but a speed: {', '.join(speeds)} (its name)"] if speeds else []
    others = [n for n in names if n not in document["chosen"]]
    if document["chosen"] and others:
        lines.append(IGNORE.format(name=others[0]))
    found = {"candidates": names, "clocks": clocks, "speeds": speeds}
    return document | found, [f"candidates: {', '.join(names)}", *notes, *lines]


def _table(file: Path, error: str, group: str | None, time: str | None) -> pd.DataFrame:
    """The file's rows. Raises DataError if it is no table or lacks a column that is named."""
    try:
        with files.open_regular(file) as stream:
            frame = pd.read_csv(stream)
    except OSError as err:
        raise DataError(f"{file}: {files.why(err)}") from None
    except (ValueError, MemoryError) as err:
        raise DataError(f"{file}: not a CSV table ({err})") from None
    for name in (error, *(n for n in (group, time) if n)):
        if name not in frame.columns:
            hint = did_you_mean(name, list(frame.columns))
            option = {error: "--error names the column of the error", group: "--group names the column of duty cycles"}
            hint = hint or (f" ({option[name]})" if name in option else "")
            found = ", ".join(map(str, frame.columns[:MAX_NAMED]))
            raise DataError(f"{file}: no column {name!r}{hint}; between commas stand: {found}")
    return frame


def _refuse_gaps(file: Path, frame: pd.DataFrame, names: Sequence[str], group: str | None) -> None:
    """Raises DataError at the first cell that is empty, or a number that is none of a machine."""
    for name in names:
        values = frame[name].to_numpy(float)
        for row in np.flatnonzero(np.isnan(values))[:1]:
            raise DataError(f"{file}:{row + 2}  {name}: is empty (allowed: a number; leave out the row or the column)")
        for row in np.flatnonzero(np.abs(values) > LARGEST_NUMBER)[:1]:
            raise DataError(f"{file}:{row + 2}  {name}: found {values[row]:g} (allowed: up to {LARGEST_NUMBER:g})")
    for row in np.flatnonzero(frame[group].isna())[:1] if group else ():
        raise DataError(f"{file}:{row + 2}  {group}: is empty (allowed: the label of the row's duty cycle)")


def _is_clock(values: np.ndarray, labels: np.ndarray) -> bool:
    """Whether a column rises by equal steps in every duty cycle, as a clock or a number of rows does."""
    for label in np.unique(labels):
        steps = np.diff(values[labels == label])
        if steps.size < 2 or not steps[0] > 0.0 or np.ptp(steps) > 1e-6 * steps[0]:
            return False
    return True


def bar(loss: float, limit: int) -> tuple[dict[str, Any], list[str]]:
    """The same for the heated spindle of Ni (1997, Fig. 7): a bar with heat at its base, simulated."""
    body, rows, errors, labels = spindle_bar.Bar(loss), [], [], []
    for k in range(BAR_FLUXES):
        if k == 0:
            times, flux = np.linspace(0.0, 0.5, 201)[1:], np.ones(200)
        else:
            times, flux = spindle_bar.random_duty(20, 10, k)
        theta = body.respond(times, flux)
        rows.append(theta[:, ::10])
        errors.append(spindle_bar.growth(theta))
        labels += [f"duty {k}"] * len(times)
    names = [f"{x:.2f} L" for x in body.places[::10]]
    document, lines = cross_validate(names, np.vstack(rows), np.concatenate(errors), np.array(labels), limit)
    free = placement.lag_free_place(loss)
    document["lag_free_place"] = free
    return document, [*lines, f"a reading at {free:.3f} L lags as the growth does (the paper finds about 0.35 L)"]


def cross_validate(
    names: list[str], readings: Any, error: Any, labels: Any, limit: int
) -> tuple[dict[str, Any], list[str]]:
    """Rises over the start of each duty cycle, judged by leave-one-duty-cycle-out."""
    readings, error = readings.copy(), error.copy()
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        readings[rows] -= readings[rows[0]]
        error[rows] -= error[rows[0]]
    nothing, sets = placement.choose(readings, error, labels, limit)
    degrees = placement.by_degree(readings, error, labels)
    best = min(s.rms_left_out for s in sets)
    smallest = next(s for s in sets if s.rms_left_out <= best * placement.ENOUGH)
    gain = np.array([np.mean(error[labels == n] ** 2) - smallest.groups[str(n)] ** 2 for n in np.unique(labels)])
    significant = gain.mean() > MIN_STANDARD_ERRORS * gain.std(ddof=1) / np.sqrt(gain.size)
    chosen = [names[k] for k in smallest.places] if significant else []
    document: dict[str, Any] = {
        "place": 1,
        "duty_cycles": int(np.unique(labels).size),
        "rms_of_nothing": nothing,
        "chosen": chosen,
        "by_number": [
            {"sensors": [names[k] for k in s.places], "rms_left_out": s.rms_left_out, "duty_cycles": s.groups}
            for s in sets
        ],
        "alone": [
            {"place": n, "line": row[0], "parabola": row[1], "cubic": row[2]}
            for n, row in zip(names, degrees.tolist(), strict=True)
        ],
    }
    lines = [f"rms on held-out duty cycles, in the unit of the error; uncompensated {nothing:.4g}"]
    for s in sets:
        count = "1 sensor" if len(s.places) == 1 else f"{len(s.places)} sensors"
        lines.append(f"{count}: {s.rms_left_out:.4g} ({', '.join(names[k] for k in s.places)})")
    for j, what in enumerate(("line", "parabola", "cubic")):
        k = int(np.argmin(degrees[:, j]))
        lines.append(f"one sensor and a {what}: best at {names[k]}, {degrees[k, j]:.4g}")
    lines.append(f"choose {len(chosen)}: {', '.join(chosen)}" if chosen else _why_none(smallest, nothing, gain.size))
    if len(chosen) == limit < min(len(names), MOST):
        more = min(2 * limit, MOST, len(names))
        lines.append(f"{limit} is the maximum that was tried: whether more are better is not known (--most {more})")
    return document, lines


def _why_none(best: SensorPlacement, nothing: float, cycles: int) -> str:
    """Why no set is chosen: none is better (one duty cycle may be why), or too few duty cycles show it."""
    if best.rms_left_out >= nothing:
        worst = max(best.groups, key=lambda name: best.groups[name])
        others = float(np.sqrt(np.mean([v**2 for name, v in best.groups.items() if name != worst])))
        if not best.groups[worst] > OUTLIER_RATIO * others:
            return "no sensor is better than no compensation"
        return (
            f"no sensor is better than no compensation: duty cycle {worst} alone is missed by "
            f"{best.groups[worst]:.4g}, the others by {others:.4g}; does a sensor jump there?"
        )
    return (
        f"choose none: {cycles} duty cycles are too few or too unlike to show that {best.rms_left_out:.4g} "
        f"instead of {nothing:.4g} is more than chance (a gain of {MIN_STANDARD_ERRORS:g} standard errors is asked for)"
    )
