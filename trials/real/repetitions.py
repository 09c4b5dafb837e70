"""Find repetitions in a real recording, and let one stand in for the simulation of another.

Three kinds of repetition are looked for, each only by what the columns say:

    periods      an axis that runs the same trajectory again: each row is paired with the row one period later
    runs         runs that visit the same places from the same side: each run is paired with the next
    interleaved  readings that follow each other faster than anything changes: every other row is paired with the
                 straight line between its neighbours; only where that line is much closer to a cubic through four
                 neighbours than the readings scatter, so that nothing but scatter is left

In a twin nothing is missing: what a diagnosis then says is missing is a false alarm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from trials.folder import Array, Sheet

SAME_PATH = 0.1  # of the stroke: rms difference of positions one period apart, before they are aligned
SAME_STATE = 0.03  # of stroke and range of speed, once they are aligned
SAME_PLACE = 0.05  # of the median distance between places
LEAST_ROWS = 40
MOST_STEPS = 2_000_000  # of the median step in a run: a run with longer gaps is no trajectory
LEAST_AGAIN = 0.2  # of a run's rows: how many must come again in the same state
SMOOTH = 0.3  # of the scatter: how far line and cubic between neighbours may differ
LEAST_MATCHED = 0.8  # of a run's rows


@dataclass
class Twin:
    """A sheet whose `simulated` column of `component` is another repetition of the same recording."""

    source: str
    kind: str
    component: str
    sheet: Sheet

    def gap(self) -> Array:
        """Recorded minus simulated."""
        error, simulated = self.sheet.responses()[self.component]
        return self.sheet.values(error) - self.sheet.values(str(simulated))


def twins(source: str, sheet: Sheet) -> list[Twin]:
    """Every twin that a recording allows, whole; draws take windows of them."""
    out = []
    for component, (error, _) in sheet.responses().items():
        for kind, make in (("periods", by_period), ("runs", by_runs), ("interleaved", interleaved)):
            out += [Twin(source, kind, component, twin) for twin in make(sheet, component, error)]
    return out


def _paired(sheet: Sheet, component: str, error: str, rows: Array, simulated: Array) -> Sheet:
    """The rows with `simulated` beside them; other responses are left out."""
    spec = sheet.columns[error]
    keep = {n: s for n, s in sheet.columns.items() if s["role"] not in ("error", "simulated", "ignore")}
    table = sheet.table.iloc[rows][list(keep)].reset_index(drop=True)
    table[component], table[f"{component}_sim"] = sheet.values(error)[rows], simulated
    own = {"component": component, "unit": spec["unit"]}
    columns = {**keep, component: {"role": "error", **own}, f"{component}_sim": {"role": "simulated", **own}}
    good = table[[component, f"{component}_sim"]].notna().all(axis=1)
    return replace(sheet, table=table[good].reset_index(drop=True), columns=columns)


# ---------------------------------------------------------------- periods
def by_period(sheet: Sheet, component: str, error: str) -> Iterator[Sheet]:
    """Each run of a moving axis whose trajectory comes again, paired one period apart."""
    moving = sheet.names("velocity") and (sheet.names("command") or sheet.names("position"))
    if not moving or not sheet.names("time"):
        return
    path, t, y, runs = sheet.values(moving[0]), sheet.values(sheet.names("time")[0]), sheet.values(error), sheet.runs()
    for run in pd.unique(runs):
        rows = np.flatnonzero((runs == run) & np.isfinite(path) & np.isfinite(t) & np.isfinite(y))
        if rows.size < LEAST_ROWS or np.any(np.diff(t[rows]) < 0):
            continue
        period = trajectory_period(t[rows], path[rows]) if _resolved(t[rows], path[rows]) else None
        if period is None:
            continue
        ahead, same = _same_state(t[rows], path[rows], period)
        if same.sum() >= max(LEAST_ROWS, LEAST_AGAIN * rows.size):
            simulated = np.interp(ahead, t[rows], y[rows])
            yield _paired(sheet, component, error, rows[same], simulated[same])


def _resolved(t: Array, x: Array) -> bool:
    """Whether the rows follow the motion: nearly all lie on the line between their neighbours.

    A step from one row to the next may have been anywhere between them, and its repetition elsewhere.
    """
    share = (t[1:-1] - t[:-2]) / np.maximum(t[2:] - t[:-2], 1e-12)
    off = np.abs(x[1:-1] - x[:-2] - (x[2:] - x[:-2]) * share)
    return bool(np.quantile(off, 0.99) < SAME_STATE * np.ptp(x))


def _same_state(t: Array, x: Array, period: float) -> tuple[Array, Array]:
    """When the axis is at the same place with the same speed about one period later (before, in the last period).

    Returns that time, and whether place and speed do agree there (in the first strokes of a vibrator they do not).
    No drive repeats its period to the millisecond: place and speed say when, to a fraction of a row.
    """
    v = np.gradient(x, t)
    goal = np.where(t + period <= t[-1], t + period, t - period)
    scale = np.array([np.ptp(x), np.ptp(v), 4 * period])  # time counts little: it only keeps to the neighbouring period
    _, near = cKDTree(np.column_stack([x, v, t]) / scale).query(np.column_stack([x, v, goal]) / scale)
    step = float(np.median(np.diff(t)))
    late = (x - x[near]) / np.where(np.abs(v[near]) > 0.02 * np.ptp(v), v[near], np.inf)
    when = t[near] + np.clip(late, -step, step)
    place = np.abs(np.interp(when, t, x) - x) < SAME_STATE * np.ptp(x)
    return when, place & (np.abs(np.interp(when, t, v) - v) < SAME_STATE * np.ptp(v))


def trajectory_period(t: Array, x: Array) -> float | None:
    """Time after which the trajectory comes again, at most half of the run; None where it does not."""
    step = float(np.median(np.diff(t)))
    if step <= 0 or (t[-1] - t[0]) / step > MOST_STEPS:
        return None
    grid = np.arange(t[0], t[-1], step)
    path = np.interp(grid, t, x)
    stroke = float(np.ptp(path))
    if stroke <= 0 or grid.size < LEAST_ROWS:
        return None
    lags = np.unique(np.geomspace(10, grid.size // 2, 1200).astype(int))
    apart = np.array([np.sqrt(np.mean((path[k:] - path[:-k]) ** 2)) for k in lags]) / stroke
    far = np.flatnonzero(apart > 0.3)  # the axis has left before it comes again
    again = [i for i in np.flatnonzero(apart < 1.5 * SAME_PATH) if far.size and i > far[0]]
    if not again:
        return None
    i = again[0]
    near = np.arange(max(lags[i] - lags[i] // 10, 10), min(lags[i] + lags[i] // 10, grid.size // 2))
    apart = np.array([np.sqrt(np.mean((path[k:] - path[:-k]) ** 2)) for k in near]) / stroke
    best = int(np.argmin(apart))
    return float(near[best] * step) if apart[best] < SAME_PATH else None


# ---------------------------------------------------------------- runs
def by_runs(sheet: Sheet, component: str, error: str) -> Iterator[Sheet]:
    """Runs over the same places from the same side, each paired with the next that has them."""
    places, sides = sheet.names("position"), sheet.names("direction")
    if not places or sheet.names("velocity") or sheet.names("temperature"):
        return
    runs, y = _cycles(sheet), sheet.values(error)
    x = np.column_stack([sheet.values(p) for p in places])
    seen = np.all(np.isfinite(x), axis=1)
    side = np.column_stack([sheet.values(s) for s in sides]) if sides else np.zeros((len(x), 1))
    labels = list(pd.unique(runs))
    out_rows, out_sim = [], []
    for i, run in enumerate(labels):
        rows = np.flatnonzero(seen & (runs == run))
        for other in labels[i + 1 :] + labels[:i]:
            paired = _matched(x, side, rows, np.flatnonzero(seen & (runs == other)))
            if paired is not None:
                simulated = _set_up(x, y, *paired)
                out_rows.append(paired[0])
                out_sim.append(simulated)
                break
    if out_rows and sum(r.size for r in out_rows) >= LEAST_ROWS:
        rows = np.concatenate(out_rows)
        order = np.argsort(rows, kind="stable")
        yield _paired(sheet, component, error, rows[order], np.concatenate(out_sim)[order])


def _cycles(sheet: Sheet) -> Array:
    """The run of each row; a run that visits a place twice from the same side is cut into its visits."""
    places, sides = sheet.names("position"), sheet.names("direction")
    runs = sheet.runs()
    if len(pd.unique(runs)) > 1:
        return runs
    where = sheet.table[places + sides].round(3)
    return where.groupby(places + sides).cumcount().astype(str).to_numpy()


def _matched(x: Array, side: Array, rows: Array, others: Array) -> tuple[Array, Array] | None:
    """Rows and their partners at the same places from the same side; None where most have none."""
    if others.size < 3 or rows.size < 3:
        return None
    near, _ = cKDTree(x[rows]).query(x[rows], k=2)
    pitch = np.median(near[:, 1]) or np.ptp(x[rows]) / rows.size
    scaled = np.hstack([x / max(pitch, 1e-12), 10 * side])
    distance, partner = cKDTree(scaled[others]).query(scaled[rows])
    good = distance < SAME_PLACE
    return (rows[good], others[partner[good]]) if good.mean() >= LEAST_MATCHED else None


def _set_up(x: Array, y: Array, rows: Array, partner: Array) -> Array:
    """The partner's readings, set up as the rows were.

    A plate is clamped anew for each run, at another temperature: shift, rotation and scale are its own.
    """
    simulated = y[partner]
    if x.shape[1] < 2:
        return simulated
    design = np.column_stack([np.ones(rows.size), x[rows]])
    gap = y[rows] - simulated
    good = np.isfinite(gap)
    return simulated + design @ np.linalg.lstsq(design[good], gap[good], rcond=None)[0]


# ---------------------------------------------------------------- interleaved
def interleaved(sheet: Sheet, component: str, error: str) -> Iterator[Sheet]:
    """Every other row paired with the straight line between its neighbours, run by run."""
    if not sheet.names("time") or sheet.names("velocity"):
        return
    t, y, runs = sheet.values(sheet.names("time")[0]), sheet.values(error), sheet.runs()
    rows, line, bend, noise = [], [], [], []
    for run in pd.unique(runs):
        own = np.flatnonzero((runs == run) & np.isfinite(y) & np.isfinite(t))
        own = own[np.r_[True, np.diff(t[own]) > 0]]
        middle = np.arange(3, own.size - 3, 2)
        if middle.size < 10:
            continue
        straight, bent = _weights(t, own, middle)
        near = y[own[middle[:, None] + np.array([-3, -1, 1, 3])]]
        line.append((straight * near).sum(axis=1))
        bend.append(((bent - straight) * near).sum(axis=1))
        noise.append(((bent - straight) ** 2).sum(axis=1) / (1 + (straight**2).sum(axis=1)))
        rows.append(own[middle])
    if not rows:
        return
    rows, line, bend, noise = map(np.concatenate, (rows, line, bend, noise))
    scatter = _middle_rms(y[rows] - line)
    # what line and cubic differ by, less what the readings' own scatter makes of it
    curved = _middle_rms(bend) ** 2 - scatter**2 * float(np.mean(noise))
    if rows.size >= LEAST_ROWS and scatter > 0 and curved < (SMOOTH * scatter) ** 2:
        yield _paired(sheet, component, error, rows, line)


def _weights(t: Array, own: Array, middle: Array) -> tuple[Array, Array]:
    """Weights of the rows -3, -1, +1, +3 around each in the straight line through two and the cubic through four."""
    near = t[own[middle[:, None] + np.array([-3, -1, 1, 3])]] - t[own[middle]][:, None]
    straight = np.zeros_like(near)
    straight[:, 1] = near[:, 2] / (near[:, 2] - near[:, 1])
    straight[:, 2] = 1 - straight[:, 1]
    bent = np.ones_like(near)
    for j in range(4):
        for k in range(4):
            if k != j:
                bent[:, j] *= -near[:, k] / (near[:, j] - near[:, k])
    return straight, bent


def _middle_rms(values: Array) -> float:
    """Rms of the middle 98 %, so that single jumps do not count."""
    low, high = np.quantile(values, [0.01, 0.99])
    return float(np.std(np.clip(values, low, high)))


def window(rng: np.random.Generator, twin: Twin) -> Twin:
    """A part of a twin: some of its runs, a stretch of its rows, or rows thinned; at least LEAST_ROWS rows."""
    runs = twin.sheet.runs()
    labels = pd.unique(runs)
    keep = np.ones(runs.size, bool)
    if labels.size > 2 and rng.random() < 0.6:
        chosen = rng.choice(labels, size=int(rng.integers(max(2, labels.size // 3), labels.size + 1)), replace=False)
        keep = np.isin(runs, chosen)
    elif runs.size > 400 and twin.kind != "runs" and rng.random() < 0.6:
        share = rng.uniform(0.45, 0.95)
        start = int(rng.uniform(0, 1 - share) * runs.size)
        keep = np.zeros(runs.size, bool)
        keep[start : start + int(share * runs.size)] = True
    rows = np.flatnonzero(keep)
    if twin.kind == "periods" or rows.size > 6000:
        rows = rows[:: max(int(rng.integers(1, 4)), -(-rows.size // 6000))]
    if rows.size < LEAST_ROWS:
        rows = np.arange(runs.size)
    table = twin.sheet.table.iloc[rows].reset_index(drop=True)
    return replace(twin, sheet=replace(twin.sheet, table=table))
