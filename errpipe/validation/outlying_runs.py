"""New runs that do not fit the machine, with an identified cause: exchanged sensors, another unit, another sign.

One such run is no drift: the runs after it are normal, and a test of later changes ignores it, while every
later challenger is fitted on it. So each new run is tested separately, as long as it is in the recording. A cause
is reported only if correcting it reduces the residual to that of the champion's runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.statistics import rms
from errpipe.validation.cusum import MIN_REFERENCE_RUNS
from errpipe.validation.input_drift import MIN_SD, SCALES, old_and_new
from errpipe.validation.response_drift import UNITS, meaning

OUTLIER_RATIO = 4.0  # root of an F ratio: by chance once in years of nights, and then without a cause
SOUND = (
    3.0  # root of an F ratio of a normal run; and the factor by which the correction reduces that of an outlying one
)
LASTING, FEWEST_LASTING = 0.8, 3  # of the outlying runs, and runs: that one cause must explain
AS_BEFORE = 2.0  # times the largest rms residual of the champion in its own runs: a run that fits
UNLIKE = 5.0  # times that: a run that does not fit
LIKELY = 2.0  # times the largest prediction of the champion's runs: beyond it the prediction is doubtful
MIN_NOISE_SHARE = 0.1  # of the usual rms: a compensated machine is measured with at least the previous noise


@dataclass(frozen=True)
class OutlyingRun:
    """what: the columns or the component; says: description. wrong: the readings are wrong, not the machine."""

    run: str
    what: str
    says: str
    wrong: bool = True


def outliers_of_sensors(recording: Recording, reference: np.ndarray) -> list[OutlyingRun]:
    """New runs in which two temperatures are exchanged, or one is in another unit.

    reference: rows fitted by the champion, (rows,). Empty if there are too few sensors or reference runs.
    """
    labels, (as_read, causes) = recording.run_labels(), _causes(recording, reference, SOUND)
    new = list(as_read)
    found = [(c, cause) for c, cause in causes.items() if cause is not None and _stands_alone(new, c, as_read, causes)]
    return [OutlyingRun(labels[c], *cause) for c, cause in found]


def outliers_from_a_run_on(recording: Recording, reference: np.ndarray) -> list[OutlyingRun]:
    """The runs outside the reference rows, (rows,), that one cause explains, if it explains nearly all outlying ones.

    Corrected readings may differ from the reference, because a machine continues to warm up, but less.
    """
    labels, (_, causes) = recording.run_labels(), _causes(recording, reference, np.inf)
    usual = max(causes.values(), key=list(causes.values()).count, default=None)
    runs = [c for c, cause in causes.items() if cause == usual]
    if usual is None or len(runs) < max(FEWEST_LASTING, LASTING * len(causes)):
        return []
    return [OutlyingRun(labels[c], *usual) for c in runs]


def _causes(
    recording: Recording, reference: np.ndarray, sound: float
) -> tuple[dict[int, float], dict[int, tuple[str, str] | None]]:
    """Distance of every new run from the reference, and of outlying ones the cause whose correction makes them normal.

    Both by code; empty if there are too few sensors or reference runs.
    """
    names, run = recording.names("temperature"), recording.run_codes()
    old, new = old_and_new(run, reference)
    if len(names) < 2 or len(old) < MIN_REFERENCE_RUNS or not new:
        return {}, {}
    readings = np.column_stack([recording.array(n) for n in names])
    good = np.isfinite(readings).all(axis=1)
    means = {c: readings[good & (run == c)].mean(axis=0) for c in (*old, *new) if (good & (run == c)).any()}
    old, new = [c for c in old if c in means], [c for c in new if c in means]
    if len(old) < len(names) + MIN_REFERENCE_RUNS:
        return {}, {}
    distance = _distance(np.array([means[c] for c in old]))
    as_read = {c: distance(means[c]) for c in new}
    causes: dict[int, tuple[str, str] | None] = {}
    for code in [c for c in new if as_read[c] > OUTLIER_RATIO]:
        tried = [(distance(mean), what, says) for what, says, mean in _put_right(means[code], names)]
        left, *cause = min(tried)
        causes[code] = (cause[0], cause[1]) if left < min(sound, as_read[code] / SOUND) else None
    return as_read, causes


def _distance(reference: np.ndarray) -> Callable[[np.ndarray], float]:
    """Hotelling's distance of a run's mean temperatures, (sensors,), from those of reference runs, (runs, sensors).

    As the root of an F ratio: about 1 for a run of the same kind. Unlike a residual over its standard error it does not
    decrease for readings far outside the reference, such as those of sensors wrongly assumed to be exchanged.
    """
    count, sensors = reference.shape
    middle = reference.mean(axis=0)
    spread = np.cov(reference, rowvar=False) + MIN_SD**2 * np.eye(sensors)
    share = count * (count - sensors) / ((count**2 - 1) * sensors)

    def distance(mean: np.ndarray) -> float:
        gap = mean - middle
        return float(np.sqrt(share * gap @ np.linalg.solve(spread, gap)))

    return distance


def _stands_alone(
    new: Sequence[int], code: int, as_read: Mapping[int, float], causes: Mapping[int, tuple[str, str] | None]
) -> bool:
    """Whether all outlying runs next to a run have its cause: a drifting sensor temporarily looks like an exchange."""
    at = new.index(code)
    for side in (new[at + 1 :], new[:at][::-1]):
        for other in side:
            if as_read[other] <= OUTLIER_RATIO:
                break
            if causes[other] != causes[code]:
                return False
    return True


def _put_right(mean: np.ndarray, names: Sequence[str]) -> Iterator[tuple[str, str, np.ndarray]]:
    """(columns, what is wrong with them, the corrected means)."""
    for a, b in combinations(range(len(names)), 2):
        values = mean.copy()
        values[[a, b]] = mean[[b, a]]
        yield f"{names[a]} and {names[b]}", "read exchanged", values
    for k, name in enumerate(names):
        for scale, back in SCALES.items():
            values = mean.copy()
            values[k] = back(mean[k])
            yield name, f"reads as if in {scale}", values


def outliers_of_responses(
    recording: Recording, reference: np.ndarray, predictions: Mapping[str, np.ndarray], wrong: Sequence[str] = ()
) -> list[OutlyingRun]:
    """New runs whose deviations are the champion's with another sign, in another unit or compensated, or unlike any.

    Only if most new runs are normal. wrong: labels of runs with wrong temperatures, and therefore wrong
    predictions. `Unlike any`, which is no proof of an error, is a single run, or a few in a row, with a far larger
    residual than all others.
    """
    run, labels = recording.run_codes(), recording.run_labels()
    out = []
    for component, prediction in predictions.items():
        measured = recording.array(str(recording.name("error", component=component)))
        known = np.isfinite(measured) & np.isfinite(prediction)
        codes = [c for c in dict.fromkeys(run[known].tolist()) if labels[c] not in wrong]
        rows = {c: np.flatnonzero(known & (run == c)) for c in codes}
        pairs = {c: (measured[r], prediction[r]) for c, r in rows.items()}
        old = [c for c in codes if reference[rows[c][0]]]
        for code, says, is_wrong in _outliers_of_one_response(pairs, old):
            out.append(OutlyingRun(labels[code], component, says, is_wrong))
    return out


def _outliers_of_one_response(
    pairs: Mapping[int, tuple[np.ndarray, np.ndarray]], old: Sequence[int]
) -> Iterator[tuple[int, str, bool]]:
    """Odd runs of one response: code, description, whether the readings are wrong (not the machine).

    pairs: code -> measured and predicted deviations of a run, um; old: codes of the reference runs.
    """
    left = {c: rms(measured - predicted) for c, (measured, predicted) in pairs.items()}
    new = [c for c in pairs if c not in old]
    usual = max((left[c] for c in old), default=0.0)
    largest = LIKELY * max((rms(pairs[c][1]) for c in old), default=0.0)
    unlike = [c for c in new if left[c] > UNLIKE * usual > 0.0 and rms(pairs[c][1]) < largest]
    sound = [left[c] for c in new if c not in unlike]
    if not sound or np.median(sound) > AS_BEFORE * usual:
        return  # the machine itself changed, or all new runs are outlying: a lasting change explains more
    factors = {c: _factor(*pairs[c], usual) for c in unlike}
    yield from ((c, meaning(f), True) for c, f in factors.items() if f is not None)
    alone = [c for c in unlike if factors[c] is None]
    if alone and _few_in_a_row([new.index(c) for c in alone], len(new)) and max(sound) <= AS_BEFORE * usual:
        says = f"at most {max(sound):.3g} um of other new runs: of another machine, or a fault in measuring?"
        yield from ((c, f"{left[c]:.3g} um rms of it remain, {says}", False) for c in alone)


def _factor(measured: np.ndarray, predicted: np.ndarray, usual: float) -> float | None:
    """The scale factor of a run, if dividing by it gives the residual of other runs; else None.

    A prediction no larger than the residual does not determine a factor: with 1000 any run would fit.
    """
    if rms(predicted) <= AS_BEFORE * usual:
        return None
    for factor in (-1.0, *UNITS):
        if rms(measured - factor * predicted) <= AS_BEFORE * usual * abs(factor):
            return factor
    return 0.0 if MIN_NOISE_SHARE * usual < rms(measured) <= AS_BEFORE * usual else None


def _few_in_a_row(places: Sequence[int], count: int) -> bool:
    """Whether places among `count` are consecutive, with at least as many others after them."""
    return places[-1] - places[0] == len(places) - 1 and count - 1 - places[-1] >= len(places)
