"""Steps of a drift that no input of the model explains: a probe that was knocked, a datum that was set anew.

Generalised likelihood ratio of a step, on held-out residuals: the difference of the levels of `SIDE` readings before
and after a row, which are medians, so that a single wrong reading makes no step. What a model leaves is no white noise,
so the threshold is the recording's own: the largest difference of every two hours, extrapolated to the stated rate by
Gumbel's law. Of a difference only as much counts as happens between two readings: a body that warms up takes longer.
On simulated residuals (white, coloured, a random walk; 200 recordings of 32 to 180 h each) 0.1 to 1 alarms in 1000 h.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.judging import HeldOut
from errpipe.guard.rows import BLOCK_S, return_level

SIDE = 4  # readings on either side, as of a jump of a temperature (`errpipe.cleaning.sensor_jumps`)
PAUSE = 5.0  # times the usual time between readings: a longer pause lets everything change
FALSE_ALARMS = 1.0  # expected per 1000 hours of a recording without steps
MIN_BLOCKS = 4  # of two hours: fewer do not show how far a residual moves
GUMBEL = 1e-6  # shape of the extreme-value law: noise has no largest value, and few hours would suggest one
MIN_STEP = 2.0  # um or urad: a smaller step is not worth a run
MOST = 5  # steps of one component; a model that fails more often has another cause


def unexplained_steps(recording: Recording, component: str, folds: Sequence[HeldOut]) -> list[dict[str, Any]]:
    """Steps of the held-out residuals of a drift, the largest first: run, time in s, row, size in the component's unit.

    Empty for deviations over a position, which may step, and where the recording holds no times or less than 8 hours.
    """
    over_place = any(recording.names(role) for role in ("position", "command"))
    if over_place or recording.name("time") is None:
        return []
    parts = [_differences(recording, fold) for fold in folds]
    rows, step = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
    t, run = recording.time()[rows], recording.run_codes()[rows]
    block = np.unique(np.column_stack([run, t // BLOCK_S]), axis=0, return_inverse=True)[1].reshape(-1)
    size, found = np.abs(step), []
    while np.unique(block[size >= 0]).size > MIN_BLOCKS and len(found) < MOST:
        k = int(np.argmax(size))
        near = (run == run[k]) & (np.abs(t - t[k]) <= BLOCK_S / 2)
        rest = ~near & (size >= 0)
        largest = np.full(block.max() + 1, -1.0)
        np.maximum.at(largest, block[rest], size[rest])
        level = return_level(largest[largest >= 0], FALSE_ALARMS / 1000 * BLOCK_S / 3600, GUMBEL)
        if size[k] <= max(level, MIN_STEP):
            break
        found.append(
            {"run": recording.run_labels()[run[k]], "t": float(t[k]), "row": int(rows[k]), "step": float(step[k])}
        )
        size[near] = -1.0
    return found if len(found) < MOST else []


def _differences(recording: Recording, fold: HeldOut) -> tuple[np.ndarray, np.ndarray]:
    """Rows of one group with `SIDE` readings on either side, and the step there: what is at once and lasts."""
    rows = np.sort(fold.rows)
    y, t, run = fold.after[np.argsort(fold.rows)], recording.time()[rows], recording.run_codes()[rows]
    if rows.size < 2 * SIDE:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    wait = np.diff(t)
    breaks = np.r_[0, np.cumsum((np.diff(run) != 0) | (wait < 0) | (wait > PAUSE * np.median(wait)))]
    window = np.lib.stride_tricks.sliding_window_view(y, 2 * SIDE)
    whole = breaks[: len(window)] == breaks[2 * SIDE - 1 :]
    lasting = np.median(window[:, SIDE:], axis=1) - np.median(window[:, :SIDE], axis=1)
    at_once = window[:, SIDE] - window[:, SIDE - 1]
    step = np.where(lasting * at_once > 0, np.sign(lasting) * np.minimum(np.abs(lasting), np.abs(at_once)), 0.0)
    return rows[SIDE : SIDE + len(window)][whole], step[whole]


def in_words(figures: Mapping[str, Any], before: str = "") -> str:
    """What was found in a component (its figures of `validation.json`), and what to do; "" if there is nothing."""
    unit, found = figures["unit"], figures.get("steps", ())
    if not found:
        return ""
    places = ", ".join(
        f"{s['step']:+.3g} {unit} in run {s['run']} at t = {s['t']:.8g} s (row {s['row']})" for s in found
    )
    return (
        f"{before}{figures['component']} steps by {places}, which no input of the model explains (false alarms: "
        f"{FALSE_ALARMS:g} in 1000 h): was a probe moved or its zero set? Measure that run again, or end it there"
    )
