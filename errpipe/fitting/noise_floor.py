"""The noise floor, which no model can remove, estimated without a model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.solve import MAD

MIN_PAIRS = 20  # pairs; fewer give no estimate
SAME = 1e-6  # share of the range of readings below which two are the same
OFF_STEP = 1e-3  # of a display's step: readings further off are not rounded to it
RELATIVE_STEP = 1e-4  # positions closer than this share of their range are the same target
WINDOWS = (0.7, 1.0, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0)  # smoothing widths tried, in rows
# Second differences of the mismatch on those of a simulation's noise have a slope of -1: upper limit, standard
# errors and correlation required (repetitions of five real machines -0.82 to -1.33, beyond 0.26; chosen on them)
DILUTED, SHOWN, MATTERS = -0.7, 4.0, 0.15
# Rows without the steps and spikes of a signal, which an effect missing there imitates: second differences of the
# simulation within so many robust standard deviations, where slope and correlation must reach these limits. Twins of
# a spindle, two gantries and six inductive probes reach -0.64 and 0.17, two simulated axes with play -0.17 and 0.05
TYPICAL, DILUTED_TOO = 3.0, -0.5


def noise_floor(
    recording: Recording, rows: np.ndarray, values: np.ndarray, readings: np.ndarray | None = None
) -> float | None:
    """Standard deviation of the noise in `values`, in their unit; None with too few pairs.

    rows: row numbers, (n,); values: the response there or a residual of it, (n,); readings: the response as recorded,
    (n,), whose display adds its rounding. From consecutive repeats of one target (same
    run, direction and positions) if there are any, so that a slow drift is excluded;
    else the smaller of two figures, each an upper bound: repeats of one target in successive runs (including
    changes between the runs), and second differences along each run (including the shape between neighbours). Noise
    with a memory of several rows appears only in repeats. A coarse display hides noise in repeats, which are then
    equal: the floor is at least its rounding. Never above the rms of `values`, which includes it.
    """
    if values.size < 3:
        return None
    floor = _of_pairs(recording, rows, values)
    if floor is None or readings is None:
        return floor
    return min(max(floor, rounding(readings)), _rms(values))


def rounding(readings: np.ndarray) -> float:
    """Standard deviation that a display adds to readings (n,) by rounding, step / sqrt(12); 0 without steps.

    Source: ISO/IEC Guide 98-3 (GUM), F.2.2.1: rounding is uniform over one step.
    """
    values = np.sort(readings[np.isfinite(readings)])
    steps = np.diff(values)
    steps = steps[steps > SAME * (values[-1] - values[0])] if steps.size >= MIN_PAIRS else steps[:0]
    if not steps.size:
        return 0.0
    counts = steps / steps.min()
    return float(steps.min() / np.sqrt(12.0)) if np.abs(counts - np.round(counts)).max() < OFF_STEP else 0.0


def with_steps(y: np.ndarray, columns: np.ndarray, most: int) -> Iterator[np.ndarray]:
    """Residuals of y (rows,) after columns (rows, k) and 1, 2, ... `most` steps at a row, selected one by one."""
    basis, rows = np.linalg.qr(columns)[0], y.size
    for _ in range(most):
        known = np.column_stack([basis, y - basis @ (basis.T @ y)])
        picked = np.cumsum(known[::-1], axis=0)[::-1]  # by a step from each row on
        power = np.arange(rows, 0.0, -1.0) - np.sum(picked[:, :-1] ** 2, axis=1)
        gain = np.where(power > 1.0, picked[:, -1] ** 2 / np.maximum(power, 1.0), 0.0)
        basis = np.linalg.qr(np.column_stack([basis, np.arange(rows) >= np.argmax(gain)]))[0]
        yield y - basis @ (basis.T @ y)


def noise_of_twin(simulated: np.ndarray, mismatch: np.ndarray, run: np.ndarray) -> np.ndarray | None:
    """Noise of a simulated signal that is itself a measurement, shape (rows,); None if it has none.

    Recorded minus simulated contains such noise with a gain of -1, which pulls the gain of the whole below 1
    (regression dilution: errors in variables, Fuller 1987): second differences of the two then have nearly that slope.
    """
    noise = simulated - smooth(simulated, run)
    same = (run[2:] == run[1:-1]) & (run[1:-1] == run[:-2])
    own, other = (np.diff(v, 2)[same] for v in (noise, mismatch))
    spread = float(own @ own)
    if same.sum() < MIN_PAIRS or spread <= 0 or own @ other > DILUTED * spread:
        return None
    certain = max(SHOWN / np.sqrt(same.sum() / 3.0), MATTERS)  # second differences overlap
    if -(own @ other) <= certain * np.sqrt(spread * float(other @ other)):
        return None
    usual = np.abs(own) <= TYPICAL * MAD * np.median(np.abs(own))
    own, other = own[usual], other[usual]
    slow = own @ other < DILUTED_TOO * float(own @ own)
    return noise if slow and -(own @ other) > MATTERS * np.sqrt(float(own @ own) * float(other @ other)) else None


def smooth(values: np.ndarray, run: np.ndarray) -> np.ndarray:
    """A sensor's reading smoothed by a kernel; its width by leave-one-out cross-validation."""
    best = (np.inf, values)
    stretches = [np.flatnonzero(run == r) for r in np.unique(run)]
    for width in WINDOWS:
        out, left_out = np.empty_like(values), np.empty_like(values)
        for rows in stretches:
            out[rows], left_out[rows] = _kernel_smooth(values[rows], width)
        score = float(np.mean((values - left_out) ** 2))
        if score < best[0] * 0.995:
            best = (score, out)
    return best[1]


def _kernel_smooth(values: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Local linear (symmetric kernel) smooth, and the same with each row left out of its own estimate."""
    reach = min(int(3 * width) + 1, max(values.size - 1, 0))
    if values.size < 4 or reach < 1:
        return values.copy(), np.full_like(values, np.mean(values))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    # ends reflected through the end value, so that a slope stays a slope
    head = 2 * values[0] - values[1 : reach + 1][::-1]
    tail = 2 * values[-1] - values[-reach - 1 : -1][::-1]
    padded = np.r_[head, values, tail]
    total = np.convolve(padded, weights, mode="valid")
    centre = weights[reach]
    own = centre * values
    return total / weights.sum(), (total - own) / (weights.sum() - centre)


def _of_pairs(recording: Recording, rows: np.ndarray, values: np.ndarray) -> float | None:
    repeated = _repeats(recording, rows, values, within_runs=True)
    if repeated.size >= MIN_PAIRS:
        return _at_most_rms(values, [_spread(repeated, 2.0**0.5)])
    run = recording.run_codes()[rows]
    bends = values[:-2] - 2.0 * values[1:-1] + values[2:]
    bends = bends[(run[2:] == run[:-2]) & np.isfinite(bends)]
    across = _repeats(recording, rows, values, within_runs=False)
    figures = ((across, 2.0**0.5), (bends, 6.0**0.5))
    return _at_most_rms(values, [_spread(d, root) for d, root in figures if d.size >= MIN_PAIRS])


def _at_most_rms(values: np.ndarray, figures: list[float]) -> float | None:
    return min(*figures, _rms(values)) if figures else None


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _repeats(recording: Recording, rows: np.ndarray, values: np.ndarray, *, within_runs: bool) -> np.ndarray:
    """Differences of successive visits to the same target, of the same run or of the next one."""
    targets = recording.names("command") or recording.names("position")
    if not targets:
        return np.empty(0)
    keys: list[np.ndarray] = [recording.run_codes()[rows].astype(float)] if within_runs else []
    for name in targets:
        x = recording.array(name)[rows]
        step = max(float(np.nanmax(x) - np.nanmin(x)) * RELATIVE_STEP, 1e-9) if np.isfinite(x).any() else 1.0
        keys.append(np.round(x / step))
    keys += [recording.array(name)[rows] for name in recording.names("direction")]
    order = np.lexsort([np.arange(rows.size), *keys[::-1]])
    same = np.ones(rows.size - 1, dtype=bool)
    for key in keys:
        same &= key[order][1:] == key[order][:-1]
    separate = np.abs(np.diff(rows[order])) > 1  # a log at rest at one place is not a repeated approach
    differences = np.diff(values[order])[same & separate]
    return differences[np.isfinite(differences)]


def _spread(differences: np.ndarray, root: float) -> float:
    robust = MAD * float(np.median(np.abs(differences)))
    # A quantised display gives differences of exactly zero: then the root mean square is used.
    return float((robust if robust > 0 else np.sqrt(np.mean(differences**2))) / root)
