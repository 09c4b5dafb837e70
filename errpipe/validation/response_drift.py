"""Drift of a response from the prediction of a model: its level, its size or its rms, and the first affected run.

The level of a run is the mean residual, its size the slope of the measured deviations on the predicted ones (least
squares, each about its mean), its rms that of the residual (as the logarithm of the mean square, which is nearly
normal): lost motion or a worn stretch changes neither mean nor slope. Each enters a CUSUM against the runs of the
model's fit (`cusum`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.validation.cusum import level_drift

WEAKEST_RUN = 0.25  # of the median rms of the prediction: a run with less motion does not determine the size
NO_RESPONSE = 0.3  # of the prediction: compensated machines have less than a third, worn ones more
MIN_RUNS = 3  # runs of a group before and since a change, needed for a mean and a scatter
NO_GROUPS: Mapping[str, Mapping[int, str]] = {}
TINY = 1e-12  # um2: smallest mean square whose logarithm is taken
HALF = 0.5  # of a change of the mean: least change of the median of the same runs
UNITS = {1000.0: "1000", 25.4: "25.4", 1.0 / 25.4: "1/25.4", 0.001: "1/1000"}  # um for mm, inch for mm and back
QUIETER = 0.3  # of the noise before: readings with so little noise are in the previous unit, whatever their size
UNIT_TOLERANCE = 0.2  # of the factor
SIGN_TOLERANCE = 0.3  # about -1: with reversed sign, the same machine has the same size within this (by judgement)


def drifts(
    recording: Recording, reference: np.ndarray, predictions: Mapping[str, np.ndarray]
) -> dict[str, list[dict[str, Any]]]:
    """Responses whose mean residual moved (`residuals`), whose size changed (`sizes`), whose residual grew (`rms`).

    reference: rows of the model's own runs.
    """
    groups, run, labels = _groups(recording), recording.run_codes(), recording.run_labels()
    out: dict[str, list[dict[str, Any]]] = {"residuals": [], "sizes": [], "rms": []}
    for component, prediction in predictions.items():
        name = recording.name("error", component=component)
        if name is None:
            continue
        measured = recording.array(name)
        found = {
            "residuals": _level(measured, prediction, reference, run, groups),
            "sizes": _size(measured, prediction, reference, run),
            "rms": _rms_left(measured, prediction, reference, run, groups),
        }
        for kind, moved in found.items():
            if moved is not None:
                since, facts = moved
                out[kind].append({"component": component, "since": labels[since], **facts})
    return out


Moved = tuple[int, dict[str, Any]] | None  # first run of the change, and the change


def _level(measured: np.ndarray, prediction: np.ndarray, reference: np.ndarray, run: np.ndarray, groups: Any) -> Moved:
    """Shift of the mean residual, um."""
    figures = _of_runs(measured - prediction, run)
    moved = _moved(figures, reference, run, groups=groups)
    if moved is None:
        return None
    since, before, after = moved
    return since, {"size_um": after - before, "regime": _regime(groups, figures, reference, run, since)}


def _rms_left(
    measured: np.ndarray, prediction: np.ndarray, reference: np.ndarray, run: np.ndarray, groups: Any
) -> Moved:
    """The rms of the residual before and after, um, if it grew."""
    squares = _of_runs((measured - prediction) ** 2, run)
    figures = {c: float(np.log(max(square, TINY))) for c, square in squares.items()}
    moved = _moved(figures, reference, run, groups=groups)
    if moved is None or moved[2] <= moved[1]:
        return None
    since, *both = moved
    before, after = np.exp(0.5 * np.array(both)).tolist()
    regime = _regime(groups, figures, reference, run, since)
    return since, {"before_um": before, "after_um": after, "regime": regime}


def _size(measured: np.ndarray, prediction: np.ndarray, reference: np.ndarray, run: np.ndarray) -> Moved:
    """The factor by which the measured size of a prediction changed, and its meaning."""
    slopes, strength = _slopes(measured, prediction, run)
    moved = _moved(slopes, reference, run, strength)
    if moved is None:
        return None
    since, before, after = moved
    factor = after / before if abs(before) > NO_RESPONSE else after
    now, then = (_noise(measured, prediction, rows) for rows in (run == max(slopes), reference))
    as_noisy = now > QUIETER * then
    return since, {"factor": factor, "meaning": meaning(0.0 if as_noisy and abs(factor) < NO_RESPONSE else factor)}


def _groups(recording: Recording) -> dict[str, dict[int, str]]:
    """Name of a grouping (duty_cycle, season, day, its column's name) -> code of each run -> its label."""
    run, out = recording.run_codes(), {}
    for name in recording.names("group"):
        labels = recording.frame[name].astype(str).to_numpy()
        kind = recording.manifest.columns[name].of or name
        out[kind] = {c: labels[np.argmax(run == c)] for c in dict.fromkeys(run.tolist())}
    return out


def _sides(
    figures: Mapping[int, float], codes: Mapping[int, str], label: str, old: set[int], since: int
) -> list[list[float]]:
    """Figures of a group's runs among the old ones, and since a run; [] if fewer than MIN_RUNS are on a side."""
    own = [c for c in figures if codes[c] == label]
    sides = [[figures[c] for c in own if c in old], [figures[c] for c in own if c not in old and c >= since]]
    return sides if min(map(len, sides)) >= MIN_RUNS else []


def _regime(groups, figures: Mapping[int, float], reference: np.ndarray, run: np.ndarray, since: int) -> str:
    """The only group of runs that moved, such as 'duty_cycle TM'; '' if others did, too, or if there are too few runs.

    figures: one per run, by its code. A group's shift is the mean of its runs since then minus that of its own before;
    the others did not move if each shifted by less than half of it, and by less than it by three standard errors.
    """
    old = {c for c in figures if reference[run == c].any()}
    for kind, codes in groups.items():
        moved: list[tuple[float, float, str]] = []
        for label in sorted(set(codes.values())):
            if sides := _sides(figures, codes, label, old, since):
                error = np.sqrt(sum(np.var(side, ddof=1) / len(side) for side in sides))
                moved.append((float(np.mean(sides[1]) - np.mean(sides[0])), float(error), label))
        moved.sort(key=lambda m: -abs(m[0]))
        if len(moved) > 1 and all(
            abs(m[0]) < HALF * abs(moved[0][0]) and abs(moved[0][0] - m[0]) > 3.0 * np.hypot(moved[0][1], m[1])
            for m in moved[1:]
        ):
            return f"{kind} {moved[0][2]}"
    return ""


def meaning(factor: float) -> str:
    """Probable meaning of readings of another size that must not be fitted; empty if the machine changed."""
    if abs(factor + 1.0) < SIGN_TOLERANCE:
        return "their sign is reversed"
    if factor < -NO_RESPONSE:
        return "they fall where it rises: of another machine, or measured elsewhere?"
    unit = next((text for size, text in UNITS.items() if abs(factor / size - 1.0) < UNIT_TOLERANCE), None)
    if unit is not None:
        return f"they are in another unit, {unit} of the one before"
    if abs(factor) < NO_RESPONSE:
        return "they were measured with compensation switched on (`compensated_by` of ingest takes such runs)"
    return ""


def _noise(measured: np.ndarray, prediction: np.ndarray, rows: np.ndarray) -> float:
    """rms about the regression line on the prediction: readings in a larger unit also have less of it."""
    known = rows & np.isfinite(measured) & np.isfinite(prediction)
    design = np.column_stack([np.ones(known.sum()), prediction[known]])
    solved = np.linalg.lstsq(design, measured[known])[0]
    return float(np.sqrt(np.mean((measured[known] - design @ solved) ** 2)))


def _of_runs(values: np.ndarray, run: np.ndarray) -> dict[int, float]:
    """Mean of the known values of each run, in order of appearance."""
    known = np.isfinite(values)
    return {c: float(np.mean(values[known & (run == c)])) for c in dict.fromkeys(run[known].tolist())}


def _slopes(measured: np.ndarray, prediction: np.ndarray, run: np.ndarray) -> tuple[dict[int, float], dict[int, float]]:
    """Slope of measured on predicted deviations in each run whose prediction varies, and rms of the variation, um."""
    known = np.isfinite(measured) & np.isfinite(prediction)
    centred = {}
    for code in dict.fromkeys(run[known].tolist()):
        rows = known & (run == code)
        centred[code] = measured[rows] - np.mean(measured[rows]), prediction[rows] - np.mean(prediction[rows])
    strength = {code: float(np.sqrt(np.mean(p**2))) for code, (_, p) in centred.items()}
    least = WEAKEST_RUN * float(np.median([*strength.values()])) if strength else 0.0
    strong = {code: pair for code, pair in centred.items() if strength[code] > max(least, 1e-9)}
    return {code: float(m @ p / (p @ p)) for code, (m, p) in strong.items()}, strength


def _moved(
    figures: Mapping[int, float],
    reference: np.ndarray,
    run: np.ndarray,
    strength: Mapping[int, float] | None = None,
    groups: Mapping[str, Mapping[int, str]] = NO_GROUPS,
) -> tuple[int, float, float] | None:
    """The first run with another level of a figure, and its means before and after; None if there is no change.

    strength: inverse of a figure's relative standard error, if that differs between runs. If most
    runs are unchanged and those of a group are not, the means are that group's.
    """
    old = [c for c in figures if reference[run == c].any()]
    new = [c for c in figures if c not in old]
    if not old or not new:
        return None
    before, even = float(np.mean([figures[c] for c in old])), figures
    if strength is not None:
        usual = float(np.median([strength[c] for c in old]))
        even = {c: before + (figures[c] - before) * strength[c] / usual for c in figures}
    drift = level_drift([even[c] for c in old], [even[c] for c in new])
    if drift is None:
        return None
    later = [figures[c] for c in new[drift[1] :]]
    after = float(np.median(later))
    least = HALF * abs(float(np.mean(later)) - before)
    if abs(after - before) >= least:
        return new[drift[1]], before, after
    for codes in groups.values():
        for label in sorted(set(codes.values())):
            if sides := _sides(figures, codes, label, set(old), new[drift[1]]):
                before, after = float(np.mean(sides[0])), float(np.median(sides[1]))
                if abs(after - before) >= least:
                    return new[drift[1]], before, after
    return None  # a single outlying run, such as a night of exchanged sensors
