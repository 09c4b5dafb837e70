"""Single readings far off their neighbours, judged run by run, with steps and reversals left alone.

A reading is an outlier if it differs from the median of its neighbours by many times the scatter of such
residuals, off the readings before it *and* off those after it (so the first reading after a step is none), and
where its own neighbours do not depart with it (so a decaying spike, which is physics, is none). Beside a
simulated twin the mismatch is judged, which has less shape of its own.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from errpipe.cleaning._base import SENSORS, Action, Rule, resolution, rows_of_runs
from errpipe.cleaning._exchanged import partner
from errpipe.domain import components
from errpipe.domain.recording import Recording
from errpipe.kernels.events import stretches
from errpipe.yamlfile import quantity

SIDE = 4  # readings on either side: the median of 8 is robust to 3 other outliers
MIN_READINGS = 3 * SIDE  # readings of a run; fewer give no scatter
BLOCK = 50  # readings over which a local scatter is taken, so that a rough stretch is judged by its own roughness
MAX_CONSECUTIVE = 2  # readings side by side that can be outliers; three are an event
PAUSE = 5.0  # times the usual time between rows: a longer pause lets everything change, and ends a part
EXTRAPOLATION = 1.25  # from the middle of one side's readings to the middle of the other's, in sides
NEIGHBOUR_SHARE = 0.3  # a neighbour that departs the same way by this share of the departure makes it an event
STEPS_AT_END = 2.7  # times the largest step elsewhere: e, as of a body whose time constant is that between two readings
NORMAL = 1.4826  # from median absolute deviation to the standard deviation of a normal distribution
REVERSAL = 3  # readings on either side of a reversal that are not judged
MOVING = 0.1  # of the readings: fewer that differ from the one before may all be wrong ones
RARE_REVERSALS = 0.1  # where more rows than this are near a reversal (a to-and-fro test), reversals are no evidence


class Outliers(Rule):
    """Blank single outliers of responses and sensors that differ strongly from their neighbours."""

    rule: Literal["outliers"] = "outliers"
    threshold: float = quantity(
        "1", "Multiple of the robust standard deviation; 5 is reached by chance in large clean recordings.", 6.0, ge=3
    )
    most: float = quantity(
        "1", "Refuse to blank more than this share of a column's cells, and more than one.", 0.02, gt=0, le=1
    )

    def find(self, recording: Recording) -> list[Action]:
        """Cells to blank. Raises DataError beyond the stated share."""
        protected = _near_reversals(recording)
        actions = []
        for role in ("error", *SENSORS):
            for name in recording.names(role):
                action = self._column(recording, name, role, protected)
                if action is not None:
                    actions.append(action)
        return actions

    def _column(self, recording: Recording, name: str, role: str, protected: np.ndarray) -> Action | None:
        values = recording.array(name)
        judged, note = _mismatch(recording, name, values) if role == "error" else (values, "")
        step = max(resolution(values), _usual_step(judged))
        position = _own_position(recording, name) if role == "error" else None
        rows = outlying(judged, recording.run_codes(), recording.time(), self.threshold, step, position)
        if role == "error":
            rows = rows[~protected[rows]]
        if not rows.size:
            return None
        if rows.size > 1:  # one of twenty readings is 5 %, and no more than one
            cells, why = int(np.isfinite(values).sum()), lambda: partner(recording, name)
            self.refuse_beyond(self.most, rows, cells, f"cells of {name}", recording, why)
        reason = f"more than {self.threshold:g} times the run's scatter off the readings before and after it{note}"
        return Action("blank cells", reason, column=name, rows=rows)


def outlying(
    values: np.ndarray,
    run: np.ndarray,
    t: np.ndarray,
    threshold: float,
    step: float = 0.0,
    position: np.ndarray | None = None,
) -> np.ndarray:
    """Rows of single readings far off their neighbours, ascending. NaN is passed over.

    values, run, t, position: shape (rows,). step: display step of the values; the scatter is at least half of it.
    position: of the axis whose deviation is judged, or none.
    """
    far_off = []
    for run_rows in rows_of_runs(run):
        rows = run_rows[np.isfinite(values[run_rows])]
        if rows.size >= MIN_READINGS:
            level = values[rows] if position is None else _without_slope(values[rows], position[rows])
            far_off.append(rows[_outliers_of_run(level, _parts(t[rows]), threshold, step)])
    found = np.concatenate(far_off) if far_off else np.zeros(0, dtype=np.int64)
    if position is None or not found.size:
        return found
    return np.asarray(found[~_repeated(values, position, found, threshold, step)])


def _usual_step(values: np.ndarray) -> float:
    """Median change of a column of which most readings repeat the one before; 0 of any other.

    An instrument of coarse steps whose converter adds small ones has no common display step, nor scatter between steps.
    """
    change = np.abs(np.diff(values[np.isfinite(values)]))
    moving = change[change > 0.0]
    return float(np.median(moving)) if MOVING * change.size <= moving.size < 0.5 * change.size else 0.0


def _without_slope(values: np.ndarray, position: np.ndarray) -> np.ndarray:
    """The values of a run without their median slope over position, shape (rows,).

    The error of a scale goes back with the axis: its last target, which may lie further off than the others, would have
    no equal next to it. Each slope is taken over half of the places; a fifth of the readings may be wrong ones.
    """
    order = np.argsort(position, kind="stable")
    half = order.size // 2
    way = position[order[half:]] - position[order[: order.size - half]]
    if not np.isfinite(way).all() or (way <= 0).all():
        return values
    change = values[order[half:]] - values[order[: order.size - half]]
    return np.asarray(values - np.median(change[way > 0] / way[way > 0]) * (position - position[order[0]]))


def _repeated(values: np.ndarray, position: np.ndarray, rows: np.ndarray, threshold: float, step: float) -> np.ndarray:
    """Which rows agree with the other visits of their place, shape as rows: the curve itself stands off there.

    The end of a stroke whose error rises steeply is the commonest. Judged by the scatter between successive visits, so
    that a drift does not count; at least two other visits are needed.
    """
    place = np.unique(np.round(position, 3), return_inverse=True)[1].reshape(-1)  # 1 um (0.001 deg): one target
    order = np.lexsort((np.arange(place.size), place))
    order = order[np.isfinite(values[order]) & np.isfinite(position[order])]
    change = np.abs(np.diff(values[order]))[np.diff(place[order]) == 0]
    if not change.size:
        return np.zeros(rows.size, dtype=bool)
    limit = threshold * max(NORMAL * float(np.median(change)) / np.sqrt(2.0), step / 2, 1e-12)
    out = np.zeros(rows.size, dtype=bool)
    for i, row in enumerate(rows):
        visits = order[place[order] == place[row]]
        other = visits[np.argsort(np.abs(visits - row), kind="stable")][1 : 1 + SIDE]
        out[i] = other.size >= 2 and abs(values[row] - np.median(values[other])) <= limit
    return out


def _parts(t: np.ndarray) -> np.ndarray:
    """Number of the part each row belongs to: a pause much longer than usual ends a part."""
    pause = np.diff(t)
    return np.r_[0, np.cumsum(pause > PAUSE * np.median(pause))]


def _outliers_of_run(y: np.ndarray, part: np.ndarray, threshold: float, step: float) -> np.ndarray:
    residual = np.nan_to_num(y - _median(_windows(y, part, np.arange(y.size), (-SIDE, SIDE))))
    limit = threshold * _scatter(residual, step)
    rows = np.flatnonzero(np.abs(residual) > limit)  # few: only these are looked at closer
    before, after = _windows(y, part, rows, (-SIDE, -1)), _windows(y, part, rows, (1, SIDE))
    far_before, far_after = (
        _median(_windows(y, part, rows, reach)) for reach in ((-2 * SIDE, -SIDE - 1), (SIDE + 1, 2 * SIDE))
    )
    left, right = _median_of_side(before), _median_of_side(after)
    at_end = np.zeros(y.size, dtype=bool)
    at_end[rows] = np.isnan(left) | np.isnan(right)
    # At either end of a part the missing side is the other side, drawn on as a line.
    left = np.where(np.isnan(left), right + EXTRAPOLATION * (right - far_after), left)
    right = np.where(np.isnan(right), left + EXTRAPOLATION * (left - far_before), right)
    # Beyond both sides, on the same side: a reading between them lies on a ramp or at a step.
    here, far = y[rows], limit[rows]
    off, base = np.zeros(y.size, dtype=bool), np.zeros(y.size)
    off[rows] = (here > np.maximum(left, right) + far) | (here < np.minimum(left, right) - far)
    base[rows] = np.where(residual[rows] > 0, np.maximum(left, right), np.minimum(left, right))
    for start, end in zip(*stretches(off), strict=True):
        at_a_step = at_end[start:end].any() and _larger_steps_elsewhere(y, base, part, start, end)
        if end - start > MAX_CONSECUTIVE or at_a_step or _neighbour_departs_too(y, base, start, end):
            off[start:end] = False
    return np.flatnonzero(off)


def _windows(y: np.ndarray, part: np.ndarray, rows: np.ndarray, reach: tuple[int, int]) -> np.ndarray:
    """Readings from so many rows on to so many rows on, the row itself left out; NaN where another part begins."""
    offsets = np.array([k for k in range(reach[0], reach[1] + 1) if k])
    edge = np.full(2 * SIDE, np.nan)
    at = rows[:, None] + (offsets + edge.size)
    windows = np.r_[edge, y, edge][at]
    if part[0] != part[-1]:
        windows[np.r_[edge, part, edge][at] != part[rows][:, None]] = np.nan
    return np.asarray(windows)


def _median_of_side(windows: np.ndarray) -> np.ndarray:
    """Median of one side; NaN where fewer than 3 readings are there, which one outlier could turn."""
    return np.where(np.isfinite(windows).sum(axis=1) >= 3, _median(windows), np.nan)


def _median(windows: np.ndarray) -> np.ndarray:
    """Median of each row of windows, NaN passed over; NaN where there is nothing."""
    ordered, width = np.sort(windows, axis=1), windows.shape[1]  # NaN last; several times as fast as nanmedian
    middle = (ordered[:, (width - 1) // 2] + ordered[:, width // 2]) / 2
    rows = np.flatnonzero(np.isnan(ordered[:, -1]))
    known = np.isfinite(windows[rows]).sum(axis=1)
    of_known = (ordered[rows, np.maximum(known - 1, 0) // 2] + ordered[rows, known // 2]) / 2
    middle[rows] = np.where(known > 0, of_known, np.nan)
    return np.asarray(middle)


def _scatter(residual: np.ndarray, step: float) -> np.ndarray:
    """Robust standard deviation of the residuals: the run's, or a rough stretch's own where that is larger."""
    size = np.abs(residual)
    whole = NORMAL * np.median(size)
    whole_blocks = size.size // BLOCK * BLOCK
    blocks = NORMAL * np.median(size[:whole_blocks].reshape(-1, BLOCK), axis=1)
    if not blocks.size or size.size - whole_blocks > BLOCK // 2:
        blocks = np.r_[blocks, NORMAL * np.median(size[whole_blocks:])]
    local = np.repeat(blocks, BLOCK)
    local = np.r_[local, np.full(max(residual.size - local.size, 0), local[-1])][: residual.size]
    return np.maximum(np.maximum(whole, local), max(step / 2, 1e-12))


def _larger_steps_elsewhere(y: np.ndarray, base: np.ndarray, part: np.ndarray, start: int, end: int) -> bool:
    """True where readings at the end of a part may be the start of something, such as a machine that is switched on.

    No reading beyond the end shows whether they come back, so they must stand off further than what moves elsewhere.
    """
    step = np.where(part[1:] == part[:-1], np.abs(np.diff(y)), 0.0)
    step[max(start - 1, 0) : end] = 0.0  # their own
    return bool(np.abs(y[start:end] - base[start:end]).min() < STEPS_AT_END * step.max())


def _neighbour_departs_too(y: np.ndarray, base: np.ndarray, start: int, end: int) -> bool:
    """True where a reading beside the stretch departs the same way: a spike that builds up or decays."""
    for edge, neighbour in ((start, start - 1), (end - 1, end)):
        if 0 <= neighbour < y.size and (y[neighbour] - base[edge]) / (y[edge] - base[edge]) > NEIGHBOUR_SHARE:
            return True
    return False


def _mismatch(recording: Recording, name: str, values: np.ndarray) -> tuple[np.ndarray, str]:
    twin = recording.name("simulated", component=recording.manifest.columns[name].component)
    if twin is None:
        return values, ""
    return values - recording.array(twin), ", in the difference from the simulated twin"


def _own_position(recording: Recording, name: str) -> np.ndarray | None:
    """Position of the axis whose deviation a column holds, shape (rows,); None where it is not recorded."""
    axis = components.parse(str(recording.manifest.columns[name].component)).axis
    column = recording.name("command", axis=axis) or recording.name("position", axis=axis) if axis else None
    return recording.array(column) if column else None


def _near_reversals(recording: Recording) -> np.ndarray:
    """Rows close to a reversal of any axis, where short spikes are physics; none where reversals are common."""
    near = np.zeros(len(recording), dtype=bool)
    run = recording.run_codes()
    for name in (*recording.names("direction"), *recording.names("velocity")):
        side = np.sign(recording.array(name))
        turns = np.flatnonzero((side[1:] * side[:-1] < 0) & (run[1:] == run[:-1])) + 1
        close = np.zeros(near.size, dtype=bool)
        for shift in range(-REVERSAL, REVERSAL + 1):
            close[np.clip(turns + shift, 0, near.size - 1)] = True
        if close.mean() <= RARE_REVERSALS:
            near |= close
    return near
