"""A lasting change between two runs of a test over a position, such as a collision: the runs are of two machines.

Held-out residuals are averaged in cells of position and direction, one curve per run. The change point is that of the
generalised likelihood ratio (Csorgo and Horvath 1997): the largest part of the scatter between runs that two levels
explain. Runs are no independent samples: a machine that warms up drifts, and a random walk has a large likelihood
ratio, too. So the threshold is of the difference of the two neighbouring runs against those of all other neighbours, an
F ratio. One degree of freedom is assumed, as if all cells changed alike: more would only lower the threshold.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from errpipe.domain.recording import Recording
from errpipe.fitting.judging import HeldOut
from errpipe.fitting.statistics import rms

FALSE_ALARM = 0.001  # probability in a recording without a change: any of its pairs of neighbouring runs
FEWEST = 2  # runs on either side: a single one is an outlier, not a change
MIN_RUNS = 5  # of them; with fewer, three other differences, the threshold is beyond any real change
CELLS = {1: 24, 2: 6, 3: 4}  # per position column; a cell of a larger test averages several targets
COMMON = 0.5  # share of the cells that all runs must have measured
EXPLAINED = 0.5  # of the scatter between runs: less, and the runs before and after do not agree either
DRIFT = 0.5  # the same for a drift
PERMUTATIONS = 4000  # of the runs, for the probability of a drift: a p-value of 0.001 within 0.0005


def changed_from(recording: Recording, folds: Sequence[HeldOut]) -> dict[str, Any]:
    """What differs between runs, in the component's unit: kind (`step`, `drift`), run, size (rms), worst, at.

    A step: the first run after it; a drift: the last run against the first. Empty without one, without a position and
    with fewer than `MIN_RUNS` runs.
    """
    rows = np.concatenate([fold.rows for fold in folds])
    recorded = recording.names("position") or recording.names("command")
    columns = {name: recording.array(name)[rows] for name in recorded}
    names = [name for name, column in columns.items() if np.unique(column[np.isfinite(column)]).size > 1]
    run, labels = recording.run_codes(), recording.run_labels()
    codes = np.unique(run[rows])
    if not 1 <= len(names) <= len(CELLS) or codes.size < MIN_RUNS:
        return {}
    curves, places = _curves(recording, names, codes, rows, np.concatenate([fold.after for fold in folds]))
    if curves.shape[1] == 0:
        return {}
    group = {code: k for k, fold in enumerate(folds) for code in np.unique(run[fold.rows])}
    k = _change_point(curves)
    apart = _differences(curves, [group[c] for c in codes], len(folds))
    if _explained(curves, k) > EXPLAINED and _at_once(apart, k):
        kind, change, after = "step", curves[k:].mean(axis=0) - curves[:k].mean(axis=0), k
    elif _drifts(curves):
        kind, after = "drift", codes.size - 1
        change = np.polyfit(np.arange(codes.size), curves, 1)[0] * after
    else:
        return {}
    change *= 1.0 - 1.0 / len(folds)  # a residual of rows left out is that much larger than of rows fitted
    worst = int(np.argmax(np.abs(change)))
    where = {name: float(value) for name, value in zip(names, places[worst], strict=True)}
    return {"kind": kind, "run": labels[codes[after]], "size": rms(change), "worst": float(change[worst]), "at": where}


def _curves(
    recording: Recording, names: Sequence[str], codes: np.ndarray, rows: np.ndarray, after: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean residual of each run in the cells that all have, (runs, cells), and the cells' mean position, (cells, axes).

    Runs of one direction each share no cell of it: both directions are one cell then.
    """
    place = np.column_stack([recording.array(n)[rows] for n in names])
    directions = [recording.array(n)[rows] for n in recording.names("direction")]
    good = np.isfinite(after) & np.isfinite(place).all(axis=1)
    row = np.searchsorted(codes, recording.run_codes()[rows])[good]
    low, span = place[good].min(axis=0), np.ptp(place[good], axis=0) + 1e-9
    bins = np.minimum((CELLS[len(names)] * (place[good] - low) / span).astype(int), CELLS[len(names)] - 1)
    for keys in ([bins, *(np.sign(d[good])[:, None] for d in directions)], [bins]):
        cell = np.unique(np.hstack(keys), axis=0, return_inverse=True)[1].reshape(-1)
        shape = (codes.size, int(cell.max()) + 1)
        at = np.ravel_multi_index((row, cell), shape)
        count = np.bincount(at, minlength=shape[0] * shape[1]).reshape(shape)
        common = (count > 0).all(axis=0)
        if common.mean() >= COMMON:
            total = np.bincount(at, after[good], shape[0] * shape[1]).reshape(shape)
            middle = [np.bincount(cell, p)[common] / count.sum(axis=0)[common] for p in place[good].T]
            return (total[:, common] / count[:, common]), np.column_stack(middle)
    return np.zeros((codes.size, 0)), np.zeros((0, len(names)))


def _change_point(curves: np.ndarray) -> int:
    """Number of runs before the most likely change of the mean curve."""
    candidates = range(FEWEST, len(curves) - FEWEST + 1)
    return max(candidates, key=lambda k: _explained(curves, k))


def _explained(curves: np.ndarray, k: int) -> float:
    """Share of the scatter between runs that two mean curves explain, of the first k runs and of the others."""
    n, change = len(curves), curves[k:].mean(axis=0) - curves[:k].mean(axis=0)
    scatter = np.sum((curves - curves.mean(axis=0)) ** 2)
    return float(k * (n - k) / n * np.sum(change**2) / scatter) if scatter > 0.0 else 0.0


def _differences(curves: np.ndarray, group: Sequence[int], groups: int) -> np.ndarray:
    """Mean square of the differences of neighbouring runs, (runs - 1,).

    Two groups are held out of different models: their difference is too large by 1 / (groups - 1).
    """
    share = np.where(np.diff(group) != 0, 1.0 - 1.0 / groups, 1.0)
    return share**2 * np.mean(np.diff(curves, axis=0) ** 2, axis=1)


def _at_once(apart: np.ndarray, k: int) -> bool:
    """Whether neighbours k - 1 and k differ by more than all others do, at the stated probability of a false alarm."""
    others = np.delete(apart, k - 1)
    ratio = apart[k - 1] / max(float(others.mean()), 1e-12)
    return bool(apart.size * stats.f.sf(ratio, 1, others.size) < FALSE_ALARM)


def _drifts(curves: np.ndarray) -> bool:
    """Whether the runs change in their order, by more than half of their scatter and not by chance.

    Von Neumann's ratio (1941) of neighbouring differences to the scatter, against random orders of the same runs.
    """
    order = np.arange(len(curves)) - (len(curves) - 1) / 2
    centred = curves - curves.mean(axis=0)
    if np.sum((order @ centred) ** 2) / np.sum(order**2) <= DRIFT * np.sum(centred**2):
        return False
    rng, product = np.random.default_rng(1), centred @ centred.T  # neighbours' products: small where they differ
    own = np.trace(product, 1)
    shuffled = [rng.permutation(len(curves)) for _ in range(PERMUTATIONS)]
    return float(np.mean([product[p[:-1], p[1:]].sum() >= own for p in shuffled])) < FALSE_ALARM


def in_words(figures: Mapping[str, Any], before: str = "") -> str:
    """What was found in a component (its figures of `validation.json`), and what to do; "" if there is nothing."""
    found, unit = figures.get("between_runs"), figures["unit"]
    if not found:
        return ""
    where = ", ".join(f"{name} = {value:.4g}" for name, value in found["at"].items())
    much = f"{found['size']:.3g} {unit} rms (most, {found['worst']:+.3g} {unit}, at {where})"
    name = f"{before}{figures['component']}"
    if found["kind"] == "drift":
        return (
            f"{name} drifts from run to run, by {much} from the first to run {found['run']}, which no input of the "
            "model explains: is it the temperature? Measure it, or let the machine settle"
        )
    return (
        f"{name} differs from run {found['run']} on by {much} from the runs before (false alarms: {FALSE_ALARM:g}), "
        "which no input of the model explains: a collision, a repair, another set-up or temperature? The model is "
        f'between the two. To fit only the later runs, add to the stage ingest:  since_run: "{found["run"]}"'
    )
