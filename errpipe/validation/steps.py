"""Steps of a drift that no input of the model explains: a probe that was knocked, a datum that was set anew.

Generalised likelihood ratio of a step, on held-out residuals: the difference of the levels of `SIDE` readings before
and after a row, which are medians, so that a single wrong reading makes no step. What a model leaves is no white noise,
so the threshold is the recording's own: the largest difference of every two hours, extrapolated to the stated rate by
Gumbel's law. Of a difference only as much counts as happens between two readings: a body that warms up takes longer.
On simulated residuals (white, coloured, a random walk; 200 recordings of 32 to 180 h each) 0.1 to 1 alarms in 1000 h.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.judging import HeldOut
from errpipe.guard.rows import BLOCK_S, return_level

SIDE, PAUSE = 4, 5.0  # readings; times the usual time between them, as for a jump (`errpipe.cleaning.sensor_jumps`)
FALSE_ALARMS = 1.0  # expected per 1000 hours of a recording without steps
MIN_BLOCKS = 4  # of two hours: fewer do not show how far a residual moves
GUMBEL = 1e-6  # shape of the extreme-value law: noise has no largest value, and few hours would suggest one
MIN_STEP = 2.0  # um or urad: a smaller step is not worth a run
SPOILT = 0.3  # of the largest step: models fitted to it leave smaller ones elsewhere (knocks of 30 um: up to 0.23)
MOST = 5  # steps of one component; a model that fails more often has another cause


def unexplained_steps(recording: Recording, component: str, folds: Sequence[HeldOut]) -> list[dict[str, Any]]:
    """Steps of the held-out residuals of a drift, the largest first: run, time in s, row, size in the component's unit.

    Empty for deviations over a position, which may step, and where the recording holds no times or less than 8 hours.
    """
    if recording.names("position") or recording.names("command") or recording.name("time") is None:
        return []
    rows, step = np.concatenate([_differences(recording, fold) for fold in folds], axis=1)
    found: list[dict[str, Any]] = []
    rows, size = rows.astype(int), np.abs(step)
    t, run = recording.time()[rows], recording.run_codes()[rows]
    block = np.unique(np.column_stack([run, t // BLOCK_S]), axis=0, return_inverse=True)[1].reshape(-1)
    while np.unique(block[size >= 0]).size > MIN_BLOCKS and len(found) < MOST:
        k = int(np.argmax(size))
        near = (run == run[k]) & (np.abs(t - t[k]) <= BLOCK_S / 2)
        largest = np.full(block.max() + 1, -1.0)
        np.maximum.at(largest, block[~near], size[~near])
        level = return_level(largest[largest >= 0], FALSE_ALARMS / 1000 * BLOCK_S / 3600, GUMBEL)
        if size[k] <= max(level, MIN_STEP, SPOILT * abs(found[0]["step"]) if found else 0.0):
            return found
        label = recording.run_labels()[run[k]]
        found.append({"run": label, "t": float(t[k]), "row": int(rows[k]), "step": float(step[k])})
        size[near] = -1.0
    return found if len(found) < MOST else []


def _differences(recording: Recording, fold: HeldOut) -> np.ndarray:
    """Rows of one group with `SIDE` readings on either side, and the step there that is at once and lasts, (2, n)."""
    order = np.argsort(fold.rows)
    rows, y = fold.rows[order], fold.after[order]
    if rows.size < 2 * SIDE:
        return np.zeros((2, 0))
    wait, run = np.diff(recording.time()[rows]), recording.run_codes()[rows]
    part = np.r_[0, np.cumsum((np.diff(run) != 0) | (wait < 0) | (wait > PAUSE * np.median(wait)))]
    window = np.lib.stride_tricks.sliding_window_view(y, 2 * SIDE)
    lasting = np.median(window[:, SIDE:], axis=1) - np.median(window[:, :SIDE], axis=1)
    at_once = window[:, SIDE] - window[:, SIDE - 1]
    step = np.sign(lasting) * np.clip(np.sign(lasting) * at_once, 0.0, np.abs(lasting))
    whole = part[: len(window)] == part[2 * SIDE - 1 :]
    return np.array([rows[SIDE : SIDE + len(window)], step])[:, whole]


def in_words(figures: Mapping[str, Any], before: str = "") -> str:
    """What was found in a component (its figures of `validation.json`), and what to do; "" if there is nothing."""
    unit, found = figures["unit"], figures.get("steps", ())
    places = (f"{s['step']:+.3g} {unit} in run {s['run']} at t = {s['t']:.8g} s (row {s['row']})" for s in found)
    words = (
        f"{before}{figures['component']} steps by {', '.join(places)}, which no input of the model explains (false "
        f"alarms: {FALSE_ALARMS:g} in 1000 h): was a probe moved or its zero set? Measure that run again, or end it"
    )
    return words if found else ""
