"""Starts of a run while the machine is warm, where all fitted runs start after a night.

A rise counts from the start of a run, so a fit to runs that start cold knows nothing of the bodies that are still warm
at a later start. In a linear machine, what they add since then is, with their excess x_k at the start,

    sum over k of gain_k x x_k x (exp(-t / tau_k) - 1)

The sensors tell of x_k twice: by their differences at the start, and by how they then cool. Runs continued from later
starts (rises and deviation counted from there) show both, so ridge gains are fitted, on these alone, to what the
mixture leaves there, of

    differences of the sensors at the start, beyond those of the fitted runs' starts, through lags
    amount of these (0 to 1) x rises and lagged rises

A difference counts as far as the other sensors confirm it. All are zero at the starts that were recorded, whose
prediction therefore remains as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.shared import drive_all
from errpipe.thermal.arithmetic import (
    FEWEST_RUNS,
    centred,
    conformal_half_width,
    predicted_since_start,
    ridge_gains,
    since_start,
)
from errpipe.thermal.competition import RUN, Groups, Outcome, groupings, paired_p_value
from errpipe.thermal.interval import Intervals
from errpipe.thermal.linear import ZERO_SHARE, LinearProblem, ridge_path, summed, time_constants
from errpipe.thermal.network import stack, triangles

# Chosen on seeds 8811 and 7401 of `trials.thermal`, 12 machines each, the judged season from 15 to 65 % of a run on.
STARTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)  # of a run's rows: later starts
LAGS = (1 / 3, 2 / 3, 1.0)  # the recording's time constants used, as shares of their number
BEYOND = 1.0  # of the range of the fitted starts' differences: nearer ones are none
WHOLE = 0.5  # of the median difference of later starts: from there on the amount is 1
RIDGE = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # on columns of unit rms
# K: standard uncertainty of a sensor at the start, for it may be off that day: the tolerance of a class B platinum
# sensor at 20 degC (IEC 60751). Without it one that was 1 K off cost all of a correction (seed 7401, machine 4).
OFF = 0.4
MOST = 1e3  # K: limit of a difference
ROUNDING = 1e-6  # K: no sensor resolves it, and a table's weights cannot hold its inverse
WITNESSES = 16  # sensors that confirm a difference at most: a table holds 4096 operands in all
# Times the largest difference of the later starts: further ones count as this one, and from here to twice this the
# correction fades, because only a faulty sensor differs so much. Chosen on seeds 21, 31, 41 of `days` of the tests: a
# sensor 40 K off cost four times the uncompensated deviation without it; days of 1.5 times the heat are as before.
KNOWN = 1.5
# Least reduction, as a share of the mean square of held-out runs (by judgement: far above rounding, far below noise). A
# mixture without lags predicts the same from any start except for rounding, to which gains of 1e-17 um/K were fitted.
LEAST_GAIN = 1e-9
# p over held-out runs (paired t test, one-sided) from which the mixture stays as it is. Chosen on seed 77401 of
# `trials.thermal` and nine machines of an independent generator: a spindle of four temperatures no longer gets worse
# (2.2 to 4.3 um), a mill is not improved (2.9 to 2.1). Unseen, seeds 77404 and 77405, 24 machines: equal on average.
LEVEL = 0.05
FEW_ROWS = 100_000  # of a recording: of more, only every second or third start is used, because they take memory


class WarmStart(NamedTuple):
    """added: to the mixture, um (None: no gain on held-out runs); wider: to the factor of its interval, 0 at recorded
    starts; left: rms at later starts of held-out runs without and with it, um.
    """

    added: d.Driver | None
    wider: d.Driver
    left: tuple[float, float]


class _Later(NamedTuple):
    """Runs continued from later starts; arrays of (rows,), um.

    group: run of each row; code: run and start; measured: whether it has a deviation and a held-out prediction;
    predicted: by fits without its group; left: what these leave; shown: what they lack of the same fits from the run's
    own start.
    """

    recording: Recording
    group: np.ndarray
    code: np.ndarray
    measured: np.ndarray
    left: np.ndarray
    predicted: np.ndarray
    shown: np.ndarray


def fitted(
    problem: LinearProblem, outcome: Outcome, factor: d.Driver, intervals: Intervals, coverage: float
) -> WarmStart | None:
    """None for blocks of too few runs, or if the recorded starts cover the later ones.

    A held-out run is left out from its own start and from every later one. factor, intervals, coverage: of the mixture.
    """
    names, lags = problem.recording.names("temperature"), _lags(problem)
    if problem.blocks or len(names) < 2 or not lags or not outcome.weights or RUN not in outcome.predictions:
        return None
    folds = groupings(problem.recording, problem.group, problem.groups, "")[0].folds
    later = _later(problem, outcome, folds)
    beyond, alone = _beyond(problem, names, later.recording)
    share = [1.0 / len(names)] * (2 * len(names))
    extent, own = summed(share, [node for pair in beyond for node in pair]), summed(share, alone)
    relax = [d.lag(d.ONE, tau) for tau in lags]
    stated, away, unconfirmed, *relaxing = drive_all([factor, extent, own, *relax], later.recording).T
    starts = away[np.unique(later.code, return_index=True)[1]]
    size = WHOLE * float(np.median(starts[np.isfinite(starts)])) if np.isfinite(starts).any() else 0.0
    if size <= ROUNDING:
        return None
    amount = d.Clip(of=d.Affine(weights=(1.0 / size,), of=(extent,)), low=0.0, high=1.0)
    limit = KNOWN * float(np.nanmax(unconfirmed))
    trust = d.Clip(of=d.Affine(offset=2.0, weights=(-1.0 / limit,), of=(own,)), low=0.0, high=1.0)
    nodes = _nodes(names, _within(beyond, later.recording), lags)
    values = drive_all(nodes, later.recording)
    values[:, len(names) * len(lags) :] *= np.clip(away / size, 0.0, 1.0)[:, None]
    values = centred(values, later.code, problem.datum_rows, later.measured, 1.0)
    good = np.isfinite(values).all(axis=1) & np.isfinite(later.left + later.shown + away)
    far = good & (away > 0.0)
    if np.unique(later.group[far]).size < FEWEST_RUNS:
        return None
    off = OFF * np.kron(np.linalg.qr(np.array(relaxing).T[good], mode="r"), np.eye(len(names))) / np.sqrt(good.sum())
    gains, left, without = _chosen(problem.groups, folds, later, values, good, off)
    predicted = later.predicted + later.left - left
    half, unit = (intervals.half_width(predicted, f, np.zeros(away.size))[far] for f in (stated, np.ones(away.size)))
    needed = np.maximum(np.abs(left[far]) - half, 0.0) / unit if intervals.unknown > 0.0 else 0.0 * half
    wider, most = conformal_half_width(needed, later.group[far], coverage), float(away[far].max())
    near = d.Clip(of=extent, low=0.0, high=OFF)
    further = d.Clip(of=d.Affine(offset=-most, weights=(1.0,), of=(extent,)), low=0.0, high=MOST)
    return WarmStart(
        d.Product(of=(trust, _sum(gains, nodes, amount, lags))) if gains.any() else None,
        d.Affine(weights=(wider / OFF, (1.0 + wider) / most), of=(near, further)),
        (without, float(np.sqrt(np.mean(left[good] ** 2)))),
    )


def _later(problem: LinearProblem, outcome: Outcome, folds: Sequence[Groups]) -> _Later:
    """Every run from every later start, with the mixture fitted without the run's fold."""
    run, labels = problem.recording.run_codes(), problem.recording.run_labels()
    step = int(np.clip(np.ceil(problem.own / FEW_ROWS), 1, 3))
    parts = [
        (rows[int(share * rows.size) :], f"{labels[g]} from {share:g}")
        for g in problem.groups
        for rows in [np.flatnonzero(run == g)]
        for share in STARTS[step // 2 :: step]
    ]
    at = np.concatenate([rows for rows, _ in parts])
    name = np.repeat(np.array([label for _, label in parts], dtype=object), [rows.size for rows, _ in parts])
    recording = problem.recording.take(at)
    recording = recording.with_columns({str(recording.name("run")): name}, {}).each_run_alone()
    code, group = recording.run_codes(), run[at]
    whole = outcome.predictions[RUN][at]
    measured = np.isfinite(problem.response[at]) & np.isfinite(whole)
    predicted = np.full(at.size, np.nan)
    for fold in folds:
        rows = np.isin(group, fold)
        predicted[rows] = _mixture(outcome, tuple(g for g in problem.groups if g not in fold), recording.take(rows))
    predicted = predicted_since_start(predicted, code, problem.datum_rows, measured)
    since, of_whole = (
        since_start(np.where(measured, values, np.nan), code, problem.datum_rows)[0]
        for values in (problem.response[at], whole)
    )
    return _Later(recording, group, code, measured, since - predicted, predicted, of_whole - predicted)


def _mixture(outcome: Outcome, groups: Groups, recording: Recording) -> np.ndarray:
    """The mixture fitted to groups, on the rows of a recording, um."""
    parts = [(weight * gain, node) for e, weight in outcome.weights for _, gain, node in e.parts(groups)]
    return drive_all([node for _, node in parts], recording) @ np.array([gain for gain, _ in parts])


def _beyond(
    problem: LinearProblem, names: Sequence[str], later: Recording
) -> tuple[list[tuple[d.Driver, d.Driver]], list[d.Driver]]:
    """Per sensor: how far its difference to the mean of the others at the start is above, and below, those recorded, K.

    First as far only as the others confirm: one that is mounted anew, or in the sun, is no warm machine. Then its own.
    """
    pairs, alone = [], []
    for k in range(len(names)):
        pair = _differences(problem, names, later, k)
        (above, own_above), (below, own_below) = (_confirmed(problem, pair, sign) for sign in (1.0, -1.0))
        pairs.append((above, below))
        alone += [own_above, own_below]
    return pairs, alone


def _confirmed(problem: LinearProblem, pair: tuple[d.Driver, d.Driver], sign: float) -> tuple[d.Driver, d.Driver]:
    """How far a difference is above (sign 1) or below (-1) those recorded, K: at most its estimate; of any estimate."""
    values = sign * drive_all(pair, problem.recording)[problem.rows]
    high = np.nanmax(values, axis=0)
    high += np.maximum(BEYOND * (high - np.nanmin(values, axis=0)), OFF)
    own, estimate = (
        d.Clip(of=d.Affine(offset=-float(end), weights=(sign,), of=(x,)), low=0.0, high=MOST)
        for x, end in zip(pair, high, strict=True)
    )
    more = d.Clip(of=d.Affine(weights=(1.0, -1.0), of=(own, estimate)), low=0.0, high=MOST)
    return d.Affine(weights=(1.0, -1.0), of=(own, more)), own


def _differences(problem: LinearProblem, names: Sequence[str], later: Recording, k: int) -> tuple[d.Driver, d.Driver]:
    """Sensor k minus the mean of the others at the start of a run, and its estimate from the others' differences, K.

    Least squares at the later starts, from the mean of the recorded ones, with `OFF` as the error of every reading
    (errors in variables). Of two sensors, neither can confirm the other: the estimate is the difference itself.
    """
    start = tuple(d.at_start(n) for n in names)
    mean, whole = summed([1.0 / len(names)] * len(names), start), len(names) / (len(names) - 1)
    gaps = [d.Affine(weights=(whole, -whole), of=(one, mean)) for one in start]
    if len(names) < 3:
        return gaps[k], gaps[k]
    centre = np.nanmean(drive_all(gaps, problem.recording)[problem.rows], axis=0)
    values = drive_all(gaps, later)[np.unique(later.run_codes(), return_index=True)[1]] - centre
    values = values[np.isfinite(values).all(axis=1)]
    alike = np.abs(values.T @ values[:, k]) / np.maximum(np.linalg.norm(values, axis=0), 1e-9)
    others = np.sort([j for j in np.argsort(-alike, kind="stable") if j != k][:WITNESSES])
    inside = (values[:, others] - values[:, others].mean(axis=1, keepdims=True)) / whole
    gains = ridge_gains(inside, values[:, k], float(len(values)), OFF**2, np.ones(others.size))
    gains -= gains.mean()
    offset = float(centre[k] - gains @ centre[others] / whole)
    return gaps[k], d.Affine(offset=offset, weights=tuple(map(float, gains)), of=tuple(start[j] for j in others))


def _within(beyond: Sequence[tuple[d.Driver, d.Driver]], recording: Recording) -> list[d.Driver]:
    """Each sensor's difference beyond those recorded, to `KNOWN` times those of the later starts, K."""
    signed = [d.Affine(weights=(1.0, -1.0), of=pair) for pair in beyond]
    values = np.nan_to_num(drive_all(signed, recording))
    low, high = values.min(axis=0, initial=0.0), values.max(axis=0, initial=0.0)
    return [
        d.Clip(of=of, low=KNOWN * float(a), high=KNOWN * float(b)) for of, a, b in zip(signed, low, high, strict=True)
    ]


def _lags(problem: LinearProblem) -> list[float]:
    """Time constants, s; none if the recording resolves none."""
    taus = time_constants(problem.recording, problem.plain)
    return [taus[max(round(share * len(taus)) - 1, 0)] for share in LAGS] if taus else []


def _nodes(names: Sequence[str], differences: Sequence[d.Driver], lags: Sequence[float]) -> list[d.Driver]:
    """The differences through each lag, then the rises, then these through each lag, K."""
    rises = [d.rise(name) for name in names]
    return [
        *(d.lag(x, tau) for tau in lags for x in differences),
        *rises,
        *(d.lag(x, tau) for tau in lags for x in rises),
    ]


def _chosen(
    groups: Sequence[int], folds: Sequence[Groups], later: _Later, values: np.ndarray, good: np.ndarray, off: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Gains of the columns, what they leave of held-out runs, um, (rows,), and rms without them, um.

    Gains are zero if no ridge leaves less of these runs than no correction, beyond rounding and chance (`LEVEL`).
    off: triangle of the first columns that represents sensors which are off at the start (errors in variables), per
    row.
    """
    parts = triangles(values[good], later.shown[good], later.code[good], ZERO_SHARE)
    of = {code: int(later.group[later.code == code][0]) for code in parts}

    def path(kept: Sequence[int]) -> np.ndarray:
        codes = [code for code, g in of.items() if g in kept]
        whole = stack(parts, codes)
        rows = float(np.isin(later.code[good], codes).sum())
        wrong = np.zeros((len(off), values.shape[1]))
        wrong[:, : len(off)] = np.sqrt(rows) * off
        return ridge_path(np.vstack([whole[:, :-1], wrong]), np.r_[whole[:, -1], np.zeros(len(off))], rows, RIDGE)

    left = np.tile(later.left, (len(RIDGE) + 1, 1))
    for fold in folds:
        rest = [g for g in groups if g not in fold and g in of.values()]
        rows = good & np.isin(later.group, fold)
        left[1:, rows] -= path(rest) @ values[rows].T
    squares = np.array([[np.mean(row[good & (later.group == g)] ** 2) for g in set(of.values())] for row in left])
    mean = squares.mean(axis=1)
    best = int(np.argmin(mean)) if mean.min() < (1.0 - LEAST_GAIN) * mean[0] else 0
    best = best if paired_p_value(squares[0] - squares[best]) < LEVEL else 0
    gains = path(groups)[best - 1] if best else np.zeros(values.shape[1])
    return gains, left[best], float(np.sqrt(np.mean(left[0][good] ** 2)))


def _sum(gains: np.ndarray, nodes: Sequence[d.Driver], amount: d.Driver, lags: Sequence[float]) -> d.Driver:
    """Gains times columns, with one lag per time constant of the differences, and one product, um."""
    differences = len(nodes) * len(lags) // (2 * len(lags) + 1)
    inside = [node.of for node in nodes[:differences] if isinstance(node, d.Lag)]
    of_lag = np.split(np.arange(differences), len(lags))
    relaxing = [d.lag(summed(gains[k], [inside[i] for i in k]), tau) for k, tau in zip(of_lag, lags, strict=True)]
    changed = d.Product(of=(amount, summed(gains[differences:], nodes[differences:])))
    return d.Affine(weights=(1.0,) * (len(lags) + 1), of=(*relaxing, changed))
