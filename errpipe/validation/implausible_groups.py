"""Checks of runs and directions against each other: an inconsistent sign, a return pass in the wrong order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from errpipe.drivers import motion
from errpipe.validation.plausibility_finding import (
    MIN_FINITE_ROWS,
    Check,
    Finding,
    Response,
    has_fine_resolution,
    is_rearranged,
    level_of_rearranged,
    means_at,
    noise_of_difference,
    numbered,
)

MIN_TARGETS = 10  # common targets; by chance a correlation on ten reaches -0.8 once in 200 tries
OPPOSITE = -0.8  # correlation of a curve with the mean of the others
MIN_CORRELATION = 0.6  # correlation of the others with each other
MIN_SCATTER_UM = 1.0  # um (urad): scatter of a curve about its line below which its sign is undetermined


def mixed_sign(r: Response) -> Finding | None:
    """One run, or one direction, whose curve has the opposite sign to the others."""
    if r.position is None or r.component.kind == "force":
        return None
    for what, key in r.groupings():
        labels = np.unique(key)
        curves = _curves(r, [key == k for k in labels])
        if labels.size < 2 or curves is None:
            continue
        match = np.corrcoef(curves)
        for minority in _of_the_other_sign(match):
            rest = np.setdiff1d(np.arange(labels.size), minority)
            names = [r.label_of(what, k) for k in labels[minority]]
            evidence = f"{what} {', '.join(names)} has the shape of the others with the other sign"
            evidence += f" (correlation {match[np.ix_(minority, rest)].mean():.2f})"
            meant = "its deviations are commanded minus actual: change their sign"
            if what == "direction":  # a screw worn in the middle looks the same
                return Finding("mixed-sign", r.column, evidence, f"{meant}, or lost motion along a worn screw", "ask")
            return Finding("mixed-sign", r.column, evidence, meant)
    return None


def _of_the_other_sign(match: np.ndarray) -> list[np.ndarray]:
    """The smaller group of curves, if two groups agree internally and oppose each other; match: correlations."""
    group = match[0] > 0
    if group.all():
        return []
    opposite = match[np.ix_(group, ~group)].max() < OPPOSITE
    alike = min(match[np.ix_(g, g)].min() for g in (group, ~group)) > MIN_CORRELATION
    return [np.flatnonzero(~group if 2 * group.sum() >= group.size else group)] if opposite and alike else []


def repeated_run(r: Response) -> Finding | None:
    """A run that repeats another one to the last digit, with readings too fine for chance.

    If several runs are all equal they were computed, not measured: nothing is reported.
    """
    labels = np.unique(r.run)
    bytes_of = {int(k): r.deviation[r.run == k].tobytes() for k in labels}
    if r.position is None or not has_fine_resolution(r.deviation) or len(set(bytes_of.values())) == 1 < labels.size - 1:
        return None
    seen: dict[bytes, int] = {}
    for k in labels:
        rows = r.run == k
        first = seen.setdefault(bytes_of[int(k)], int(k))
        if first != k and rows.sum() >= MIN_TARGETS:
            a, b = (r.recording.run_labels()[int(i)] for i in (first, k))
            evidence = f"run {b} repeats run {a} to the last digit in all {int(rows.sum())} readings"
            level: Literal["refuse", "ask"] = "refuse" if labels.size > 2 else "ask"
            return Finding(
                "copy-of-column", r.column, evidence, "a file that was imported twice, or copied rows", level
            )
    return None


FACTORS = {25.4: "inch with mm", 1000.0: "m, mm and um mixed", 2.0: "a radius for a diameter"}


def mixed_positions(r: Response) -> Finding | None:
    """One run whose targets are those of the others in another unit."""
    labels = np.unique(r.run)
    if r.position is None or labels.size < 2:
        return None
    targets = {k: np.unique(np.round(r.position[r.run == k], 3)) for k in labels}
    for k in labels:
        others = np.unique(np.concatenate([targets[j] for j in labels if j != k]))
        own = targets[k]
        if own.size < MIN_FINITE_ROWS or others.size != own.size or not np.ptp(own) or not np.ptp(others):
            continue
        ratio = float(np.ptp(others) / np.ptp(own))
        for factor, meant in FACTORS.items():
            for f in (factor, 1 / factor):
                if abs(ratio / f - 1) < 1e-3 and np.allclose(own * f, others, rtol=0, atol=2e-3 * np.ptp(others)):
                    name = r.recording.run_labels()[int(k)]
                    evidence = f"the targets of run {name} are those of the others divided by {f:.4g}"
                    return Finding("mixed-units", r.column, evidence, f"positions in {meant}")
    return None


def mirrored_rows(r: Response) -> Finding | None:
    """The return pass agrees with the forward pass only if its readings are taken in the opposite order."""
    if r.position is None or r.direction is None:
        return None
    curves = _curves(r, [r.direction > 0, r.direction < 0])
    if curves is None:
        return None
    straight = float(np.std(curves[0] - curves[1]))
    mirrored = float(np.std(curves[0] - curves[1][::-1]))
    if not is_rearranged(r, straight**2, mirrored**2, curves.shape[1], noise_of_difference(r)):
        return None
    evidence = f"both directions agree {straight / max(mirrored, 1e-12):.3g} times better if one is reversed"
    meant = "readings of the return pass listed in the order of the targets, not of the measurement (or the reverse)"
    return Finding("mirrored-rows", r.column, evidence, meant, level_of_rearranged(r, straight**2, mirrored**2))


UNLIKE, SMOOTH, JAGGED = 0.5, 0.7, 1.3  # correlation; von Neumann ratio: 2 for values in a random order


def shuffled_rows(r: Response) -> Finding | None:
    """One run with another shape than the others, which are smooth and similar, and as jagged as rows in random order.

    If all runs are shuffled, this cannot be detected: a fit then predicts little more than their mean.
    """
    labels = np.unique(r.run)
    if r.position is None or r.component.kind == "force" or labels.size < 4:
        return None
    sides = [np.ones(r.run.size, dtype=bool)]
    if r.direction is not None and np.unique(r.direction).size == 2:
        sides = [r.direction > 0, r.direction < 0]
    for side in sides:
        curves = _curves(r, [side & (r.run == k) for k in labels])
        if curves is None:
            continue
        ratio = np.mean(np.diff(curves, axis=1) ** 2, axis=1) / np.var(curves, axis=1)
        match = np.corrcoef(curves)
        for k in np.flatnonzero(ratio > JAGGED):
            rest = np.arange(labels.size) != k
            alike = np.min(match[np.ix_(rest, rest)]) > MIN_CORRELATION and np.max(ratio[rest]) < SMOOTH
            as_large = curves[k].std() > 0.5 * np.median(curves[rest].std(axis=1))
            if alike and as_large and np.max(match[k][rest]) < UNLIKE:
                name = r.recording.run_labels()[int(labels[k])]
                evidence = f"run {name} does not have the shape of the others and jumps from target to target"
                return Finding("shuffled-rows", r.column, evidence, "its rows in another order, or a run that failed")
    return None


MIN_STEPS = 10  # from run to run: fewer do not show the usual size
NEW_ZERO = 8.0  # times the usual step (1.4826 times the median size); normal noise: once in 1e15
BEYOND_OTHERS = 3.0  # times the largest other step
MIN_ZERO_SHIFT_UM = 3.0  # um (urad): repeatability of homing, not worth a report
FLAT = 0.2  # of a step: scatter of the targets about their line, beyond which the shape changed as well


def new_zero(r: Response) -> Finding | None:
    """Steps from run to run that are equal at every target, far beyond the others; heat also changes the slope.

    The thermal shift is proportional to the change of slope, about the point where the scale is held: it is removed.
    """
    codes = list(dict.fromkeys(r.run.tolist()))
    if r.position is None or r.component.kind == "force" or len(codes) <= MIN_STEPS:
        return None
    levels = np.round(np.asarray(r.position), 3)
    shared = levels
    for k in codes:
        shared = np.intersect1d(shared, levels[r.run == k])
    if shared.size < MIN_FINITE_ROWS or not np.ptp(shared):
        return None
    means = np.array([means_at(levels[r.run == k], r.deviation[r.run == k], shared) for k in codes])
    slope, shift = np.polyfit(shared - shared.mean(), np.diff(means, axis=0).T, 1)
    line = np.outer(shared - shared.mean(), slope) + shift
    rough = (np.diff(means, axis=0).T - line).std(axis=0)
    place = 0.0  # position without thermal shift, mm from the middle
    for _ in range(20):
        weight = 1.0 / np.maximum(np.abs(shift - place * slope), 1e-3)
        place = float(np.sum(weight * shift * slope) / max(np.sum(weight * slope**2), 1e-12))
    step = shift - place * slope
    usual = 1.4826 * float(np.median(np.abs(step)))
    large = np.flatnonzero((np.abs(step) > max(NEW_ZERO * usual, MIN_ZERO_SHIFT_UM)) & (rough < FLAT * np.abs(step)))
    rest = np.abs(np.delete(step, large)).max(initial=0.0)
    if not 0 < large.size <= max(1, step.size // 10) or np.abs(step[large]).min() < BEYOND_OTHERS * rest:
        return None
    at = ", ".join(f"run {r.recording.run_labels()[codes[k + 1]]} by {step[k]:+.3g}" for k in large[:3])
    evidence = f"every target shifts at once, from {at} {r.component.unit} (other runs by {rest:.2g} at most)"
    meant = "the instrument was zeroed again (subtract the shift from the readings after it), or the axis was homed"
    return Finding("new-zero", r.column, evidence, meant, "ask")


NEAR = 3  # rows on each side of a step: their median is not a single reading
SHARP = 0.7  # of a step between two neighbours when a zero is set; heat and wear take longer
TURN = 0.001  # mm (deg) back from the furthest position: the axis has turned, where no column states its direction
MIN_RUNS = 3  # whose median is the shape of the axis


def zero_within_run(r: Response) -> Finding | None:
    """Steps within a run that other runs do not have, far beyond its scatter, and not at a reversal."""
    run = r.run
    if r.position is None or r.component.kind == "force" or np.unique(run).size < MIN_RUNS or run.size < 4 * NEAR:
        return None
    side = r.side() if r.direction is not None else motion.sides(run, r.position, TURN)
    rest = r.deviation - _group_medians(r.deviation, run)
    rest -= _group_medians(rest, numbered(np.round(r.position, 3), side))
    windows = np.lib.stride_tricks.sliding_window_view(rest, NEAR)
    local = np.median(windows[NEAR:], axis=1) - np.median(windows[:-NEAR], axis=1)  # of the step before row i + NEAR
    rows = np.arange(NEAR, run.size - NEAR + 1)
    within = run[rows - NEAR] == run[rows + NEAR - 1]
    if not within.any():
        return None
    least = max(NEW_ZERO * 1.4826 * float(np.median(np.abs(local[within]))), MIN_ZERO_SHIFT_UM)
    within &= (np.abs(local) > least) & (np.abs(np.diff(rest)[rows - 1]) > SHARP * np.abs(local))
    steps = rows[within & (side[rows] == side[rows - 1])]
    shifted = []
    for k in dict.fromkeys(run[steps].tolist()):
        own, at = np.flatnonzero(run == k), steps[run[steps] == k]
        if np.diff(at).min(initial=run.size) < 2 * NEAR:  # a gauge that stuck or was touched, and returned
            continue
        terms = np.column_stack([np.ones(own.size), r.position[own], *(own >= i for i in at)])
        size, *_ = np.linalg.lstsq(terms, rest[own], rcond=None)
        if (rest[own] - terms @ size).std() < FLAT * np.abs(size[2:]).min():
            where = [
                f"{s:+.3g} {r.component.unit} after row {r.rows[i - 1] + 1}" for i, s in zip(at, size[2:], strict=True)
            ]
            shifted.append(f"run {r.recording.run_labels()[int(k)]}: {', '.join(where)}")
    if not shifted:
        return None
    meant = (
        "the zero of the instrument was changed: subtract each step from the readings that follow it in its run, and "
        "from the runs after it that did not return"
    )
    return Finding(
        "new-zero", r.column, f"within a run all readings shift at once ({'; '.join(shifted[:3])})", meant, "ask"
    )


def _group_medians(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Median of each row's group, shape (n,)."""
    order = np.lexsort((values, group))
    first = np.flatnonzero(np.r_[True, np.diff(group[order]) != 0])
    size = np.diff(np.r_[first, group.size])
    medians = 0.5 * (values[order[first + (size - 1) // 2]] + values[order[first + size // 2]])
    out = np.empty(group.size)
    out[order] = np.repeat(medians, size)
    return out


def _curves(r: Response, groups: Sequence[np.ndarray]) -> np.ndarray | None:
    """Mean deviation of each group at the common targets, minus its own line; None if undetermined."""
    levels = np.round(np.asarray(r.position), 3)
    shared = levels[groups[0]] if groups else levels
    for rows in groups:
        shared = np.intersect1d(shared, levels[rows])
    if shared.size < MIN_TARGETS:
        return None
    out = []
    for rows in groups:
        mean = means_at(levels[rows], r.deviation[rows], shared)
        out.append(mean - np.polyval(np.polyfit(shared, mean, 1), shared))
    curves = np.array(out)
    return curves if curves.std(axis=1).min() > MIN_SCATTER_UM else None


CHECKS: tuple[Check, ...] = (
    *(mixed_sign, repeated_run, mixed_positions, mirrored_rows, shuffled_rows, new_zero, zero_within_run),
)
