"""Checks of one error column: slope, size, sign, unit, steps, order and reversal of its deviations."""

from __future__ import annotations

import numpy as np

from errpipe.validation.plausibility_finding import (
    Check,
    Finding,
    Response,
    group_means,
    has_fine_resolution,
    is_rearranged,
    level_of_rearranged,
    means_at,
    noise_of_difference,
)

ABSOLUTE_SLOPE = 0.1  # of the position: no axis has an error of 10 %; a belt with a wrong pulley reaches 3 %
FILLED_SHARE, FEWEST_FILLED = 0.3, 10  # of the rows; a run zeroed at one target has fewer equal ones
# Of the travel, offsets of runs and directions removed: a belt with a wrong pulley reaches 3 %
MAX_SHARE_OF_TRAVEL = 0.03
MIN_SCATTER_UM, SMALLEST_SHARE = 0.05, 1e-6  # um; of the travel: 1 ppm is the effect of 1 degC of air on a laser
QUIETEST = 5e-9  # of the travel: half the repeatability of the best interferometer in air
# rms of the residual from a line, of its range: no measured screw is as straight as computed numbers
STRAIGHT = 3e-4
UNIT_RATIO = 0.02  # a step within 2 % of 1 mm or 1 inch is that step
MIN_STEPS = 8  # neighbours or readings of a direction; fewer do not show the usual size
MAX_EXPANSION = 60.0  # um/m/K: aluminium has 23, the plastics of light frames up to 100 (allowed by name)
EXPANSION = (-26.0, -5.0)  # um/m/K: minus the expansion of glass (8), steel (11.5), aluminium (23)
ROUNDING = 1e-12  # of a position: a smaller variation of a difference of positions is rounding
COMMON_SLOPES = (
    (1.0, "error = reading - commanded (these are absolute readings, not deviations)"),
    (-1.0, "another reading (this one is empty, in m with commands in mm, or absolute with reversed sign)"),
    (-2.0, "a reading of opposite sign: error = -reading - commanded"),
    (1 / 25.4 - 1, "readings in inch with commands in mm: convert before subtracting"),
    (24.4, "commands in inch with readings in mm: convert before subtracting"),
    (999.0, "readings in um with commands in mm: convert before subtracting"),
    (-0.5, "a radius for a diameter"),
)
# Ratios to the unit in which the deviations may have been.
UNITS = ((1e-3, "1000 times smaller"), (1 / 25.4, "25.4 times smaller"), (1e-3 / 25.4, "25400 times smaller"))


def absolute_readings(r: Response) -> Finding | None:
    """A slope near +1 or -1 (or a unit ratio) over the own position: readings, not deviations."""
    if r.per_unit is None or r.position is None or r.span == 0:
        return None
    slope, residual = _line(r)
    share = slope / r.per_unit
    reach = abs(slope) * r.span
    percent = f"the deviation changes by {100 * share:.3g} % of the position it is measured at"
    if abs(share) >= ABSOLUTE_SLOPE and residual < 0.2 * reach:
        nearest = min(COMMON_SLOPES, key=lambda s: abs(s[0] - share) / abs(s[0]))
        meant = nearest[1] if abs(nearest[0] - share) < 0.03 * abs(nearest[0]) else COMMON_SLOPES[0][1]
        return Finding("absolute-readings", r.column, percent, meant)
    for ratio, words in UNITS:
        if abs(abs(share) / ratio - 1) < 1e-3 and residual < STRAIGHT * reach:
            what = f"{percent}, {words} than the position and otherwise without structure"
            return Finding("absolute-readings", r.column, what, "absolute readings whose unit is wrong as well")
    return None


def as_large_as_travel(r: Response) -> Finding | None:
    """A change beyond 3 % of the travel: exchanged columns, or a position in a larger unit."""
    if r.per_unit is None or r.position is None or absolute_readings(r) is not None:
        return None
    shape = r.deviation - group_means(r.deviation, r.run * 2 + (r.side() > 0))
    size = float(np.percentile(shape, 97.5) - np.percentile(shape, 2.5))
    if r.span == 0 or size <= MAX_SHARE_OF_TRAVEL * r.span * r.per_unit:
        return None
    evidence = f"the deviation spans {size:.4g} {r.component.unit} over a travel of {r.span:.4g}"
    if _regular(r.deviation) and not _regular(r.position):
        meant = "exchanged columns of position and deviation (the deviation has equal steps)"
    elif size > 0.5 * r.span * r.per_unit:
        meant = "exchanged columns of position and deviation, or um declared as mm"
    else:
        meant = "a position in m or inch that was declared as mm, or um declared as mm for the deviation"
    return Finding("as-large-as-travel", r.column, evidence, meant)


OF_ITS_ZERO = 0.2  # largest range of the readings, as share of their distance from 0: the rest is a constant
OTHER_ZERO_UM = 500.0  # um: as the limit of a correction


def other_zero(r: Response) -> Finding | None:
    """Readings that count from another zero than the positions, such as a laser's from the first target."""
    if r.position is None or r.component.kind != "positioning":
        return None
    middle, spread = float(np.median(r.deviation)), float(np.ptp(r.deviation))
    if abs(middle) <= OTHER_ZERO_UM or spread > OF_ITS_ZERO * abs(middle):
        return None
    evidence = f"the deviation is {middle:.6g} um everywhere and varies by {spread:.3g} um"
    meant = "readings that count from another zero than the positions: subtract the reading at the reference position"
    return Finding("other-zero", r.column, evidence, meant)


def too_small(r: Response) -> Finding | None:
    """Deviations below an instrument's resolution: millimetres declared as micrometres."""
    if r.component.unit != "um" or r.per_unit is None or r.span < 1.0:
        return None
    largest, least = float(np.abs(r.deviation).max()), max(MIN_SCATTER_UM, SMALLEST_SHARE * 1e3 * r.span)
    if largest == 0.0 or largest >= least or (largest >= MIN_SCATTER_UM and _noise(r) > QUIETEST * 1e3 * r.span):
        return None
    evidence = (
        f"no deviation exceeds {largest:.3g} um over {r.span:.4g} mm of travel, finer than a laser can read in air"
    )
    return Finding("too-small", r.column, evidence, "readings in mm that were declared as um (or um declared as nm)")


def constant(r: Response) -> Finding | None:
    """A deviation that never changes, or one precise reading repeated in many rows: a fill value."""
    values, counts = np.unique(r.deviation, return_counts=True)
    most = counts.max()
    if values.size == 1:
        evidence, meant = f"every reading is {values[0]:.6g}", "another column, or a reading not logged"
    elif most < FILLED_SHARE * r.deviation.size or most < FEWEST_FILLED or not has_fine_resolution(r.deviation):
        return None
    else:
        evidence = f"{int(most)} of {r.deviation.size} readings are {values[np.argmax(counts)]:.6g}"
        meant = "a fill value, or a stuck instrument"
    return Finding("constant-deviation", r.column, evidence, meant)


def jump(r: Response) -> Finding | None:
    """A step of one turn of a dial (1 mm) or one inch between neighbours."""
    if r.component.unit != "um":
        return None
    steps = np.diff(r.deviation)[np.diff(r.run) == 0]
    if steps.size < MIN_STEPS:
        return None
    usual = 1.4826 * float(np.median(np.abs(steps - np.median(steps))))
    for size, name in ((1000.0, "1 mm, one turn of a dial gauge"), (25400.0, "one inch"), (2540.0, "0.1 inch")):
        hit = np.abs(np.abs(steps) - size) < max(UNIT_RATIO * size, 3 * usual)
        if hit.any() and usual < 0.02 * size and hit.mean() < 0.2:
            evidence = f"a step of {size:g} um between row {r.rows[int(np.argmax(hit))] + 1} and the next"
            return Finding("jump", r.column, evidence, f"a reading that lost {name}: add it to the rows after")
    return None


def mixed_units(r: Response) -> Finding | None:
    """Runs or directions with the same curve, 25.4 or 1000 times larger than the others."""
    if r.position is None or r.component.kind == "force":
        return None
    for what, key in r.groupings():
        labels = np.unique(key)
        if labels.size < 2:
            continue
        size = np.array([_scatter(r.deviation[key == k]) for k in labels])
        middle = float(np.median(size)) if labels.size > 2 else float(size.min())
        for label, ratio in zip(labels, size / middle if middle > 0 else size * 0, strict=True):
            for factor in (25.4, 1000.0, 1 / 25.4, 1e-3):
                if 0.4 < ratio / factor < 2.5 and _has_shape_of_others(r, key, label):
                    larger = f"is {ratio:.4g} times as large as the others, with the same shape"
                    meant = "another unit there (25.4: inch and mm; 1000: mm and um)"
                    return Finding("mixed-units", r.column, f"{what} {r.label_of(what, label)} {larger}", meant)
    return None


def reversed_sign(r: Response) -> Finding | None:
    """An error column that is commanded minus actual, if both are in the recording."""
    rec, axis = r.recording, r.component.axis
    if r.component.kind not in ("positioning", "angular positioning") or axis is None or r.per_unit is None:
        return None
    command = rec.name("command", axis=axis)
    actual = rec.name("actual", axis=axis) or rec.name("position", axis=axis)
    if actual is None or command is None:
        return None
    true = r.per_unit * (rec.array(actual) - rec.array(command))[r.rows]
    good = np.isfinite(true)
    rounding = ROUNDING * r.per_unit * float(np.abs(rec.array(command)[r.rows][good]).max(initial=0.0))
    if good.sum() < MIN_STEPS or min(np.ptp(true[good]), np.ptp(r.deviation[good])) <= rounding:
        return None
    match = float(np.corrcoef(true[good], r.deviation[good])[0, 1])
    slope = _slope(true[good], r.deviation[good])
    if match < -0.9:
        evidence = f"it is minus the difference of {actual} and {command} (correlation {match:.2f})"
        return Finding("reversed-sign", r.column, evidence, "error = actual - commanded: change the sign")
    if match > 0.99 and not 0.9 < slope < 1.1:
        evidence = f"it is {slope:.4g} times {actual} minus {command}"
        return Finding("reversed-sign", r.column, evidence, "another unit of the error, or of one of the positions")
    return None


def expansion_of_no_material(r: Response) -> Finding | None:
    """A slope that decreases in every warm run, so that the sign is reversed; or exceeds any material's expansion."""
    rates = _expansion_rates(r)
    if rates and all(match < -0.9 and EXPANSION[0] <= rate <= EXPANSION[1] for match, rate in rates):
        evidence = f"the axis gets {-min(rates)[1]:.3g} um/m shorter for each kelvin of warmth"
        meant = "error = actual - commanded: change the sign (steel, iron and glass get longer)"
        return Finding("shrinks-when-warm", r.column, evidence, meant)
    if rates and all(match > 0.9 and rate > MAX_EXPANSION for match, rate in rates):
        least = min(rate for _, rate in rates)
        evidence = f"the axis gets {least:.3g} um/m longer for each kelvin of warmth (steel: 11.5)"
        meant = "an error in 0.1 um that was declared as um, or the temperature of something else"
        return Finding("expands-too-much", r.column, evidence, meant)
    return None


def _expansion_rates(r: Response) -> list[tuple[float, float]]:
    """(correlation, um/m/K) of the slope over position with each temperature, run by run; empty if unknown."""
    warm = r.recording.names("temperature")
    runs = np.unique(r.run)
    if r.component.kind != "positioning" or not warm or runs.size < 3 or r.position is None:
        return []
    wide = [k for k in runs if np.ptp(r.position[r.run == k]) > 0.3 * r.span and (r.run == k).sum() >= MIN_STEPS]
    if len(wide) < 3:
        return []
    slopes = np.array([_slope(r.position[r.run == k], r.deviation[r.run == k]) for k in wide]) * 1e3  # um/m
    rates = []
    for name in warm:
        t = r.recording.array(name)[r.rows]
        if not all(np.isfinite(t[r.run == k]).any() for k in wide):
            continue
        mean = np.array([np.nanmean(t[r.run == k]) for k in wide])
        if np.ptp(mean) >= 2.0 and np.ptp(slopes) > 0:  # K: less does not move a scale by more than its noise
            rates.append((float(np.corrcoef(mean, slopes)[0, 1]), _slope(mean, slopes)))
    return rates


def worse_with_compensation(r: Response) -> Finding | None:
    """Runs with the compensation on whose error is twice that of those with it off."""
    rec = r.recording
    for name in rec.names("group"):
        if rec.manifest.columns[name].of != "compensation" or r.position is None:
            continue
        label = rec.frame[name].astype(str).str.lower().to_numpy()[r.rows]
        on, off = np.isin(label, ("on", "after", "1")), np.isin(label, ("off", "before", "0"))
        if on.sum() < MIN_STEPS or off.sum() < MIN_STEPS:
            continue
        before, after = (float(np.sqrt(np.mean(r.deviation[k] ** 2))) for k in (off, on))
        what = "with the compensation on the deviation is"
        if after > 1.3 * before:
            evidence = f"{what} {after:.3g} {r.component.unit} rms, without it {before:.3g}"
            meant = "the other sign, here or in the parameter of the controller"
            return Finding("worse-with-compensation", r.column, evidence, meant)
        turned = _slope_ratio(r, on, off)
        if turned is not None and abs(turned + 1.0) < OVER:
            evidence = f"{what} {turned:.2f} times that without it"
            meant = "an error declared twice as large as it is (a radius for a diameter, a double pass of a laser)"
            return Finding("worse-with-compensation", r.column, evidence, meant)
    return None


OVER = 0.15  # tolerance about -1, the residual if twice the error was compensated


def _slope_ratio(r: Response, on: np.ndarray, off: np.ndarray) -> float | None:
    """Slope of the mean curve with a compensation over that without it; None if their shapes differ."""
    place = r.cells()
    shared = np.intersect1d(place[on], place[off])
    if shared.size < MIN_STEPS:
        return None
    a, b = (np.array([r.deviation[k & (place == p)].mean() for p in shared]) for k in (off, on))
    if np.ptp(a) == 0 or np.ptp(b) == 0 or abs(np.corrcoef(a, b)[0, 1]) < 0.9:
        return None
    return _slope(a, b)


MAX_SHIFT_ROWS = 3  # largest shift of values in rows: header lines (name, unit, a blank one)


def shifted_rows(r: Response) -> Finding | None:
    """Both directions agree only if each is moved by some targets: the deviations are shifted by as many rows."""
    if r.direction is None or r.position is None:
        return None
    up, down = _curve(r, 1.0), _curve(r, -1.0)
    shared = np.intersect1d(list(up), list(down))
    if shared.size < 9:
        return None
    a, b = (np.array([c[x] for x in shared]) for c in (up, down))
    far = min(MAX_SHIFT_ROWS, (a.size - 7) // 2)
    gaps = {k: _scatter(a[far + k : a.size - far + k] - b[far - k : b.size - far - k]) for k in range(-far, far + 1)}
    best = min(gaps, key=lambda k: gaps[k])
    if best == 0 or not is_rearranged(r, gaps[0] ** 2, gaps[best] ** 2, a.size - 2 * far, noise_of_difference(r)):
        return None
    rows = "row" if abs(best) == 1 else f"{abs(best)} rows"
    better, which = gaps[0] / max(gaps[best], 1e-12), f"the {rows} {'before' if best > 0 else 'after'}"
    evidence = f"both directions agree {better:.3g} times better with each value {'a ' * (abs(best) == 1)}{rows} away"
    meant = f"deviations that belong to {which} (headers counted as rows, or values logged late)"
    level = level_of_rearranged(r, gaps[0] ** 2, gaps[best] ** 2)
    return Finding("shifted-rows", r.column, evidence, meant, level)


MIN_SHARED = 5  # targets approached from both sides: of an axis up to 2 m (ISO 230-2, 5.3.2)
SHOWN = 1.0  # um: reporting threshold; an axis with a scale may have a smaller value of either sign


def reversal_of_the_other_sign(r: Response) -> Finding | None:
    """Lost motion stops an axis short; the opposite sign is possible (a scale, an overcompensated control) but rare."""
    if r.direction is None or r.component.kind != "positioning":
        return None
    up, down = r.deviation[r.direction > 0], r.deviation[r.direction < 0]
    if min(up.size, down.size) < MIN_STEPS:
        return None
    lost = _at_shared_targets(r)
    if lost.size >= MIN_SHARED:
        step, samples = float(np.median(lost)), [lost]
    else:  # the curve of the axis counts as scatter
        step, samples = float(np.median(up) - np.median(down)), [up, down]
    spread = 1.4826 * max(float(np.median(np.abs(v - np.median(v)))) for v in samples)
    if step < max(SHOWN, spread):
        return None
    evidence = f"approached from below the axis stands {step:.3g} um further than from above"
    meant = "the same with the sign or the direction reversed, unless the control already corrects backlash too much"
    return Finding("reversal-sign", r.column, evidence, meant, "ask", of_sign=True)


def _at_shared_targets(r: Response) -> np.ndarray:
    """Mean from below minus mean from above, um, at each target approached from both sides: (targets,)."""
    if r.position is None or r.direction is None:
        return np.empty(0)
    _, target = np.unique(np.round(r.position, 3), return_inverse=True)
    means = []
    for rows in (r.direction > 0, r.direction < 0):
        count = np.bincount(target[rows], minlength=target.max() + 1)
        total = np.bincount(target[rows], r.deviation[rows], minlength=target.max() + 1)
        means.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
    lost = means[0] - means[1]
    return np.asarray(lost[np.isfinite(lost)])


# ---------------------------------------------------------------- arithmetic


def _line(r: Response) -> tuple[float, float]:
    """Slope of the deviation over the position, and rms residual from the line (each direction about its own mean)."""
    position, side = np.asarray(r.position), r.side()
    x, y = position - group_means(position, side), r.deviation - group_means(r.deviation, side)
    slope = float(x @ y) / max(float(x @ x), 1e-300)
    return slope, float(np.sqrt(np.mean((y - slope * x) ** 2)))


def _noise(r: Response) -> float:
    """Noise of the deviation: the smaller scatter of repeats or of neighbours, or the resolution."""
    variance, freedom = r.repeats()
    scatter = [float(np.sqrt(variance))] if freedom else []
    if r.deviation.size > 2:
        scatter.append(1.4826 * float(np.median(np.abs(np.diff(r.deviation, 2)))) / float(np.sqrt(6)))
    steps = np.diff(np.unique(r.deviation))
    resolution = float(steps[steps > 1e-9 * np.ptp(r.deviation)].min()) if steps.size else 0.0
    return max(min(scatter, default=0.0), resolution / float(np.sqrt(12)))


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    x = x - x.mean()
    return float(x @ y) / max(float(x @ x), 1e-300)


def _scatter(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean((values - values.mean()) ** 2))) if values.size else 0.0


def _regular(values: np.ndarray) -> bool:
    """Whether values repeat on a grid of equal steps, like targets."""
    levels = np.unique(np.round(values, 6))
    if levels.size < 4 or levels.size > values.size / 2:
        return False
    steps = np.diff(levels)
    return float(np.ptp(steps)) < 0.05 * float(steps.mean())


def _has_shape_of_others(r: Response, key: np.ndarray, label: float) -> bool:
    """Whether one group's curve over position has the shape of the others'."""
    in_group, outside_group = key == label, key != label
    levels = np.round(np.asarray(r.position), 3)
    shared = np.intersect1d(levels[in_group], levels[outside_group])
    if shared.size < 5:
        return False
    a, b = (means_at(levels[rows], r.deviation[rows], shared) for rows in (in_group, outside_group))
    return np.ptp(a) > 0 and np.ptp(b) > 0 and float(np.corrcoef(a, b)[0, 1]) > 0.8


def _curve(r: Response, side: float) -> dict[float, float]:
    rows = r.direction == side
    places = np.round(np.asarray(r.position)[rows], 3)
    run_free = r.deviation[rows] - group_means(r.deviation[rows], r.run[rows])
    return dict(zip(places.tolist(), group_means(run_free, places).tolist(), strict=True))


CHECKS: tuple[Check, ...] = (
    *(constant, absolute_readings, as_large_as_travel, other_zero, too_small, jump, mixed_units),
    *(reversed_sign, expansion_of_no_material, worse_with_compensation, shifted_rows, reversal_of_the_other_sign),
)
