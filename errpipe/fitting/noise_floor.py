"""The noise floor: what no model can take away, estimated without believing one."""

from __future__ import annotations

import numpy as np

from errpipe.domain.recording import Recording

MAD = 1.4826
FEWEST = 20  # pairs; fewer do not make a figure
RELATIVE_STEP = 1e-4  # positions closer than this share of their range are the same target


def noise_floor(recording: Recording, rows: np.ndarray, values: np.ndarray) -> float | None:
    """Standard deviation of the noise in `values`, in their unit; None where too few rows tell.

    rows: row numbers, (n,); values: the response there or a residual of it, (n,). From repeats of one target (same
    run, direction and positions) where a recording has them, one after the other, so that a slow drift stays out;
    else from second differences along each run. Noise with a memory of several rows shows in repeats alone.
    """
    repeated = _repeats(recording, rows, values)
    if repeated.size >= FEWEST:
        return _spread(repeated, 2.0**0.5)
    run = recording.run_codes()[rows]
    if values.size < 3:
        return None
    bends = values[:-2] - 2.0 * values[1:-1] + values[2:]
    inside = (run[2:] == run[:-2]) & np.isfinite(bends)
    return _spread(bends[inside], 6.0**0.5) if np.count_nonzero(inside) >= FEWEST else None


def _repeats(recording: Recording, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Differences of successive visits to the same target of the same run."""
    targets = recording.names("command") or recording.names("position")
    if not targets:
        return np.empty(0)
    keys = [recording.run_codes()[rows].astype(float)]
    for name in targets:
        x = recording.array(name)[rows]
        step = max(float(np.nanmax(x) - np.nanmin(x)) * RELATIVE_STEP, 1e-9) if np.isfinite(x).any() else 1.0
        keys.append(np.round(x / step))
    keys += [recording.array(name)[rows] for name in recording.names("direction")]
    order = np.lexsort([np.arange(rows.size), *keys[::-1]])
    same = np.ones(rows.size - 1, dtype=bool)
    for key in keys:
        same &= key[order][1:] == key[order][:-1]
    apart = np.abs(np.diff(rows[order])) > 1  # a log standing still at one place is no repeated approach
    return np.diff(values[order])[same & apart]


def _spread(differences: np.ndarray, root: float) -> float:
    robust = MAD * float(np.median(np.abs(differences)))
    # A quantised display gives differences of exactly zero: then the root mean square speaks.
    return float((robust if robust > 0 else np.sqrt(np.mean(differences**2))) / root)
