"""Thermal models that are a sum of gains times drivers: temperature rises, lagged rises, heat of the spindle.

Deviations count from the start of each run, so every driver is zero there and no constant is fitted. Runs are reduced
once to a triangle each (QR of [drivers, deviation]); any hold-out then costs a stack of triangles.

Lags are first-order responses. Their time constants are a geometric grid from a few samples to the length of a run:
shorter ones are indistinguishable from none, longer ones from a straight line (`time_constants`).
If the spindle speed is recorded, its heat (speed and its square) through the same lags is added: it warms parts
without a sensor. Without a temperature it is the only input. If coolant flow is recorded, so is the heat
that it removes (`coolant_heat`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Column, Recording
from errpipe.fitting.design import response_name
from errpipe.fitting.parallel import no_warnings
from errpipe.fitting.solve import one_thread
from errpipe.thermal.arithmetic import BLOCKS, FEWEST_RUNS, centred, inner_groups, no_usable_row, since_start
from errpipe.thermal.causes import columns
from errpipe.thermal.interval import DAY, independent_runs
from errpipe.thermal.network import stack, triangles

# Blocks of a run (one a day), and the number of blocks for which a start is followed. Chosen on logs of 5, 8 and 21
# days of six simulated gantries, the next two weeks judged: rms over uncompensated 0.39, 0.21, 0.29 without later
# starts, 0.13, 0.16, 0.11 with these; five blocks followed to the end 0.17, 0.15, 0.16; ten for three 0.14, 0.13, 0.11.
MOST_STARTS = 10
FOLLOWED = 2


class LaterStarts(NamedTuple):
    """recording: its own rows first, then those of each later start; rows: mask of the usable ones; group: of
    each row, the same for one block of time in all runs; run_count: number of independent runs.
    """

    recording: Recording
    rows: np.ndarray
    group: np.ndarray
    run_count: int


def started(recording: Recording, rows: np.ndarray) -> LaterStarts:
    """The rows of a mask, and again from every block on if too few runs contain several days."""
    run, run_count, time = recording.run_codes(), independent_runs(recording, rows), recording.time()
    used_runs = np.unique(run[rows])
    days = sum(round(float(np.ptp(time[rows & (run == code)])) / DAY) for code in used_runs)
    if used_runs.size >= FEWEST_RUNS or days < FEWEST_RUNS:
        return LaterStarts(recording, rows, inner_groups(run, rows), run_count)
    group = inner_groups(run, rows, int(np.clip(days, BLOCKS, MOST_STARTS)))
    labels = recording.run_labels()
    parts, names = [np.arange(run.size)], [np.array(labels, dtype=object)[run]]
    for code in used_runs:
        used = np.flatnonzero(rows & (run == code))
        blocks = np.unique(group[used])
        for number in range(1, blocks.size):
            first, last = used[np.isin(group[used], blocks[number : number + FOLLOWED])][[0, -1]]
            own = np.flatnonzero(run == code)
            parts.append(own[(own >= first) & (own <= last)])
            names.append(np.full(parts[-1].size, f"{labels[code]} from {number + 1}", dtype=object))
    at = np.concatenate(parts)
    name = recording.name("run") or "run"
    again = recording.take(at).with_columns({name: np.concatenate(names)}, {name: Column(role="run")})
    return LaterStarts(again, rows[at], group[at], run_count)


SAMPLES = 1.0  # shortest time constant in sampling steps: a faster lag has settled before the next reading
# Ratio of neighbouring time constants. Chosen on seeds 1 to 3 of `trials.thermal`: 2.5 has 2 % more residual, 4 8 %.
RATIO = 1.8
MOST_LAGS = 12  # time constants of each sensor
SPEED_UNIT = 1e-3  # 1/rpm: scales thousands of rpm to the size of kelvins
# Window of a rate, as a share of a run, and at least so many shortest time constants. 300 to 1800 s of runs of 6 to 9 h
# are within 1 % of each other on seed 7301 of `trials.thermal` (18 machines).
RATE_WINDOW, LEAST_WINDOW = 0.02, 2.0
# Share of a run's mean that is removed before a fit. A run's zero is the mean of a few noisy readings, and its error is
# in every row of the run (a random effect): generalised least squares removes such a share. Chosen on seeds 7301 and
# 7302 of `trials.thermal` (24 machines each): 0.5 has 1.4 and 1.9 % less residual (ridge on lagged rises), 2.7, 2.2 %
# (bilinear); 0.3 to 0.7 and shares from each recording's own noise are equal, 1 (a constant per run) has 5 % more.
# Judged on seed 8811 (24 machines): 1.3 and 4.9 % less, the mixture of all families 3 % less.
ZERO_SHARE = 0.5
MOST_OPERANDS = 48  # of one sum; a table allows 64
MOST_DRIVERS = 120  # of all sensors together: a table has at most 1024 operations, each lag costs two


@dataclass(frozen=True)
class LinearProblem:
    """Drivers on every row, and the triangles of the usable groups (runs).

    drivers: the rises first (`plain` of them), then the lagged rises, sensor by sensor, then `heat` of spindle and
    coolant, on the same lags; values: (rows, drivers), K, counted from the first rows of each run as the response is;
    response: deviation since the start of the run, um; group: run of each row; rows: mask of usable rows; datum_rows:
    first rows of a run whose mean is its zero. own: number of the recording's rows, after which the same rows may
    be repeated from later starts (`started`); run_count: number of independent runs.
    """

    recording: Recording
    drivers: tuple[d.Driver, ...]
    plain: int
    values: np.ndarray
    response: np.ndarray
    rows: np.ndarray
    group: np.ndarray
    triangle: dict[int, np.ndarray]
    count: dict[int, int]
    heat: int
    datum_rows: int
    own: int
    run_count: int

    @property
    def groups(self) -> list[int]:
        """Numbers of the usable groups."""
        return sorted(self.triangle)

    @property
    def one_run(self) -> bool:
        """Whether the groups are neighbouring blocks of runs too few for leave-one-run-out."""
        return np.unique(self.recording.run_codes()[self.rows]).size < len(self.triangle)

    @property
    def blocks(self) -> bool:
        """Whether the groups are blocks of runs too few for leave-one-run-out, from one start or from several."""
        return self.one_run or len(self.recording) > self.own

    @property
    def within_one_day(self) -> bool:
        """Whether these blocks do not even hold different days."""
        return self.one_run and self.run_count < FEWEST_RUNS

    def stacked(self, groups: Sequence[int], width: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Triangle of the first `width` drivers, of the response, and the number of rows of some groups."""
        whole = stack(self.triangle, list(groups))
        return whole[:, :width], whole[:, -1], float(sum(self.count[g] for g in groups))


def problem(recording: Recording, component: str, rows: np.ndarray | None, datum_rows: int) -> LinearProblem:
    """The problem of the rows of a mask. Raises DataError if no row is complete."""
    names = recording.names("temperature")
    own, response = len(recording), response_name(recording, component)
    measured = np.isfinite(sum((recording.array(n) for n in names), recording.array(response)))
    recording, again, group, run_count = started(recording, measured if rows is None else measured & rows)
    run = recording.run_codes()
    nodes: list[d.Driver] = [d.rise(n) for n in names]
    taus = time_constants(recording, len(names))
    nodes += [d.lag(d.rise(n), tau) for n in names for tau in taus]
    heat = [*spindle_heat(recording, taus), *coolant_heat(recording, taus)]
    nodes += heat
    values = columns(recording, nodes)
    read = np.isfinite(values).all(axis=1)  # a sensor that is late: its run counts from the first row that has all
    deviation, _ = since_start(np.where(read, recording.array(response), np.nan), run, datum_rows)
    values = centred(values, run, datum_rows, np.isfinite(deviation), 1.0)
    good = again & np.isfinite(deviation) & np.isfinite(values).all(axis=1)
    if not good.any():
        raise no_usable_row(recording, component)
    group = group if len(recording) > own else inner_groups(run, good)
    parts = _triangles(values, deviation, good, group, run)
    count = {g: int(np.count_nonzero(good & (group == g))) for g in parts}
    return LinearProblem(
        recording=recording,
        drivers=tuple(nodes),
        plain=len(names),
        values=values,
        response=deviation,
        rows=good,
        group=group,
        triangle=parts,
        count=count,
        heat=len(heat),
        datum_rows=datum_rows,
        own=own,
        run_count=run_count,
    )


def extended(problem: LinearProblem, nodes: Sequence[d.Driver]) -> LinearProblem:
    """The same problem with additional drivers of the same sensors."""
    rows, group = problem.rows, problem.group
    run, measured = problem.recording.run_codes(), np.isfinite(problem.response)
    further = centred(columns(problem.recording, nodes), run, problem.datum_rows, measured, 1.0)
    values = np.column_stack([problem.values, further])
    parts = _triangles(values, problem.response, rows, group, run)
    return replace(problem, drivers=(*problem.drivers, *nodes), values=values, triangle=parts)


def _triangles(
    values: np.ndarray, response: np.ndarray, rows: np.ndarray, group: np.ndarray, run: np.ndarray
) -> dict[int, np.ndarray]:
    """Triangles of the groups of usable rows; the zero common to blocks of one run is not removed."""
    whole_runs = np.array_equal(group[rows], run[rows])
    return triangles(values[rows], response[rows], group[rows], ZERO_SHARE if whole_runs else 0.0)


def summed(gains: Sequence[float] | np.ndarray, nodes: Sequence[d.Driver]) -> d.Driver:
    """Gains times drivers as one driver, in sums of at most `MOST_OPERANDS`."""
    parts = list(zip(map(float, gains), nodes, strict=True))
    sums = [
        d.Affine(weights=tuple(g for g, _ in some), of=tuple(n for _, n in some))
        for some in (parts[k : k + MOST_OPERANDS] for k in range(0, len(parts), MOST_OPERANDS))
    ]
    return sums[0] if len(sums) == 1 else d.Affine(weights=(1.0,) * len(sums), of=tuple(sums))


def rates(problem: LinearProblem) -> tuple[d.Driver, ...]:
    """Warming of each sensor within a window, K; none if no lag can be resolved."""
    names = problem.recording.names("temperature")
    taus = time_constants(problem.recording, len(names))
    if not taus:
        return ()
    least = max(RATE_WINDOW * taus[-1], LEAST_WINDOW * taus[0])
    window = min(taus, key=lambda tau: abs(tau - least))  # from the grid, because the table contains that lag anyway
    slow = (d.lag(d.rise(n), window) for n in names)
    return tuple(d.Affine(weights=(1.0, -1.0), of=(d.rise(n), late)) for n, late in zip(names, slow, strict=True))


def spindle_heat(recording: Recording, taus: Sequence[float]) -> list[d.Driver]:
    """Speed (either direction of rotation) and its square through lags, 1000 rpm; none without a speed."""
    name = recording.name("spindle_speed")
    if name is None:
        return []
    speed = d.Affine(weights=(SPEED_UNIT,), of=(d.Input(name=name),))
    square = d.Product(of=(speed, speed))
    size = d.Power(of=square, exponent=0.5)
    return [d.lag(of, tau) for of in (size, square) for tau in taus]


def coolant_heat(recording: Recording, taus: Sequence[float]) -> list[d.Driver]:
    """While coolant flows: each temperature minus the mean of all at the start of the run, through lags, K.

    Newton's law of cooling with a switched film: the flow removes heat in proportion to its temperature difference from
    the parts (which start at the mean of the sensors), not to its change since. None without a coolant column.
    Four simulated screws with a chiller, a third season: residual 0.45 to 0.30 of the deviation instead of 1.47 to 0.6;
    an irrelevant column costs 6 % (two columns of a machine in finite differences).
    """
    flow = recording.name("coolant")
    if flow is None:
        return []
    products = [d.Product(of=(d.Input(name=flow), gap)) for gap in gaps(recording)]
    return [d.lag(of, tau) for of in products for tau in taus]


def gaps(recording: Recording) -> tuple[d.Driver, ...]:
    """Each temperature minus the mean of all of them at the start of the run, K."""
    names = recording.names("temperature")
    first = tuple(d.First(of=d.Input(name=n)) for n in names)
    share = (-1.0 / max(len(names), 1),) * len(names)
    return tuple(d.Affine(weights=(1.0, *share), of=(d.Input(name=n), *first)) for n in names)


def time_constants(recording: Recording, sensors: int = 1) -> tuple[float, ...]:
    """A geometric grid of time constants that the recording can resolve, s; coarser for many sensors."""
    time, run = recording.time(), recording.run_codes()
    lengths = [float(np.ptp(time[run == code])) for code in np.unique(run)]
    steps = np.diff(time)[np.diff(run) == 0]
    steps = steps[steps > 0]
    if not steps.size or max(lengths) <= 0:
        return ()
    low, high = SAMPLES * float(np.median(steps)), float(np.median(lengths))
    most = int(np.clip(MOST_DRIVERS // max(sensors, 1) - 1, 2, MOST_LAGS))
    span = np.log(max(high / low, 1.0))
    number = int(np.clip(np.floor(span / np.log(RATIO)) + 1, 1, most))
    ratio = max(RATIO, float(np.exp(span / max(number - 1, 1)))) if number == most else RATIO
    return tuple(float(f"{high / ratio**k:.3g}") for k in range(number))[::-1]


def ridge_path(
    design: np.ndarray, response: np.ndarray, rows: float, strengths: Sequence[float], scale: np.ndarray | float = 1.0
) -> np.ndarray:
    """Ridge gains of a triangle for each strength (above 0), (strengths, p); one singular value decomposition.

    scale: 1, (p,); a column of unit rms is penalised by the strength times its square.
    """
    size = np.sqrt(np.sum(design**2, axis=0) / rows)
    size = np.where(size > 0, size, 1.0) * scale
    with one_thread():
        left, values, right = np.linalg.svd(design / size, full_matrices=False)
    shown = left.T @ response
    kept = [values / (values**2 + strength * rows) * shown for strength in strengths]
    return np.asarray(np.array(kept) @ right / size)


def mean_of_sensors(design: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Mean of the regressions on each driver alone, (p,), um/K.

    Complete subset regression with one driver (Elliott, Gargano and Timmermann 2013, J. Econometrics 177:357).
    """
    square = np.sum(design**2, axis=0)
    return np.where(square > 0, design.T @ response / np.where(square > 0, square, 1.0), 0.0) / square.size


def common_gains(parts: Sequence[tuple[np.ndarray, np.ndarray, float]], strength: float, freedom: float) -> np.ndarray:
    """Gains common to groups, each of which deviates from them (random effects), (p,), um/K.

    parts: triangle, response and rows of each group. freedom: variance of a group's deviation over that of the
    noise per row, columns of unit rms: the larger, the less weight a group with many rows has.
    Each group's information G = X'X becomes G - G (G + m I)^-1 G, m = rows / freedom (Henderson's equations).
    """
    size = np.sqrt(sum(np.sum(x**2, axis=0) for x, _, _ in parts) / sum(n for *_, n in parts))
    size = np.where(size > 0, size, 1.0)
    normal_matrix, right = np.zeros((size.size, size.size)), np.zeros(size.size)
    rows = float(np.mean([n for *_, n in parts]))
    own = rows / freedom * np.eye(size.size)
    with one_thread():
        for x, y, _ in parts:
            z = x / size
            gram, cross = z.T @ z, z.T @ y
            inner = np.linalg.solve(gram + own, np.column_stack([gram, cross]))
            normal_matrix += gram - gram @ inner[:, :-1]
            right += cross - gram @ inner[:, -1]
        if not normal_matrix.any():  # no sensor changed
            return np.zeros(size.size)
        total = normal_matrix + strength * np.trace(normal_matrix) / size.size * np.eye(size.size)
        return np.linalg.solve(total, right) / size


def lasso_path(design: np.ndarray, response: np.ndarray, rows: float, strengths: Sequence[float]) -> np.ndarray:
    """Lasso gains for each strength (share of the one with all gains zero), shape (strengths, p), um/K."""
    from sklearn.linear_model import lasso_path as path

    size = np.sqrt(np.sum(design**2, axis=0) / rows)
    size = np.where(size > 0, size, 1.0)
    scaled = design / size
    most = float(np.abs(scaled.T @ response).max()) / design.shape[0]
    if most == 0.0:
        return np.zeros((len(strengths), size.size))
    order = np.argsort(strengths)[::-1]
    with one_thread(), no_warnings():  # at its weakest penalties the path may not converge
        _, gains, _ = path(
            np.asfortranarray(scaled), response, alphas=[most * strengths[k] for k in order], max_iter=2000, tol=1e-4
        )
    out = np.empty((len(strengths), size.size))
    out[order] = gains.T / size
    return out
