"""How an axis moved, from the columns of a recording: positions, directions, travel."""

from __future__ import annotations

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import hold, sessions
from errpipe.errors import MissingColumn
from errpipe.kernels import responses

AT_REST = 5.0  # noise rms of a velocity that an axis at rest does not pass (Gaussian: once in two million readings)
UNDER_WAY = 0.1  # of a run's largest step from row to row: its first step, beyond which it begins under way
RESOLVED = 0.1  # of the highest speed: where that many rms are more, rows do not follow the motion from one to the next


def axes(recording: Recording, kind: str = "linear") -> tuple[str, ...]:
    """Axes whose position (or command) is recorded, in manifest order."""
    out: list[str] = []
    for name in (*recording.names("position"), *recording.names("command")):
        letter = str(recording.manifest.columns[name].axis)
        if letter not in out and is_rotary(recording, letter) == (kind == "rotary"):
            out.append(letter)
    return tuple(out)


def is_rotary(recording: Recording, axis: str) -> bool:
    """Does an axis turn: as the manifest states, else where its positions are in degrees?"""
    known = recording.manifest.axis(axis)
    if known is not None and known.kind is not None:
        return known.kind == "rotary"
    name = recording.name("position", axis=axis) or recording.name("command", axis=axis)
    return name is not None and recording.manifest.columns[name].unit == "deg"


def direction_column(recording: Recording, axis: str) -> str:
    """Name of the column with an axis' direction of travel: its direction, else velocity, else position column."""
    for role in ("direction", "velocity", "position", "command"):
        name = recording.name(role, axis=axis)
        if name is not None:
            return name
    known = ", ".join(sorted({c.axis for c in recording.manifest.columns.values() if c.axis})) or "none"
    raise MissingColumn(f"no column of the recording gives the direction of axis {axis} (axes with a column: {known})")


def position(recording: Recording, axis: str) -> np.ndarray:
    """Position of an axis in mm or deg, shape (rows,); the command where no position is recorded."""
    name = recording.name("position", axis=axis) or recording.name("command", axis=axis)
    if name is None:
        raise MissingColumn(f"the recording has no position of axis {axis}")
    return recording.array(name)


def direction(recording: Recording, axis: str, threshold: float = 0.001, start: int = 1) -> np.ndarray:
    """Side an axis was last moved from, +1 or -1: its direction column, else its velocity's sign, else its travel."""
    name = recording.name("direction", axis=axis)
    if name is not None:
        return recording.array(name)
    name = recording.name("velocity", axis=axis)
    if name is not None:
        way = moving(recording, name)
        held = hold(recording.run_codes(), np.where(way == 0, np.nan, way))
        return np.where(np.isnan(held), float(start), held)
    return sides(sessions(recording), position(recording, axis), threshold, start)


def sides(session: np.ndarray, x: np.ndarray, threshold: float, start: int = 1) -> np.ndarray:
    """Side that the axis was last moved from, +1 or -1, shape (rows,): from the order of its positions.

    Twice the usual readings in succession where the axis turns are two visits: a bidirectional test overruns the last
    target and approaches it again, from the other side (ISO 230-2, standard test cycle).
    """
    side = responses.direction_of_travel(session, x, threshold, start)
    first = np.flatnonzero(np.r_[True, ~(np.abs(np.diff(x)) <= threshold)])
    readings = np.diff(np.r_[first, x.size])
    for i in np.flatnonzero(readings[:-1] == 2 * np.median(readings)):
        if i and side[first[i] - 1] != side[first[i + 1]] and side[first[i]] != side[first[i + 1]]:
            side[first[i] + readings[i] // 2 : first[i + 1]] = side[first[i + 1]]
    return side


def moving(recording: Recording, column: str) -> np.ndarray:
    """Sign of a velocity, shape (rows,); 0 where the axis rests, also where noise then changes the sign.

    Rows of one sign in succession are a move where one of them exceeds `AT_REST` times the noise. That noise is the
    median of the fourth differences, to which even fast moves add next to nothing.
    """
    if ("moving", column) not in recording.derived:
        recording.derived["moving", column] = _moving(recording.array(column), recording.run_codes())
    return recording.derived["moving", column]


def _moving(v: np.ndarray, run: np.ndarray) -> np.ndarray:
    sign = np.sign(v)
    speed = np.abs(np.nan_to_num(v))
    rough = np.abs(np.diff(v, 4)) if v.size > 4 else np.zeros(1)
    limit = AT_REST * float(np.nanmedian(rough)) / (0.6745 * np.sqrt(70.0)) if np.isfinite(rough).any() else 0.0
    if not 0 < limit < RESOLVED * speed.max(initial=0.0):
        return sign
    start = np.flatnonzero(np.r_[True, (sign[1:] != sign[:-1]) | (run[1:] != run[:-1])])
    fastest = np.repeat(np.maximum.reduceat(speed, start), np.diff(np.r_[start, v.size]))
    return np.where(fastest > limit, sign, 0.0)


def motion_sessions(recording: Recording) -> np.ndarray:
    """Integer per row, shape (rows,): sessions, cut where a run begins under way.

    What led up to such a run no row shows (the feed-in of a circular test, ISO 230-4): an axis then comes from the side
    that it moves away from. A run that begins at rest continues from where the one before it stopped.
    """
    if "unbroken" not in recording.derived:
        run, session = recording.run_codes(), sessions(recording)
        names = recording.names("position") or recording.names("command")
        cut = np.r_[True, session[1:] != session[:-1]]
        first = np.flatnonzero(np.r_[True, run[1:] != run[:-1]])
        steps = sum((np.abs(np.nan_to_num(np.diff(recording.array(n)))) for n in names), np.zeros(run.size - 1))
        for start, end in zip(first, [*first[1:], run.size], strict=True):
            own = steps[start : end - 1]  # from row to row of this run
            cut[start] |= own.size > 0 and own[0] > UNDER_WAY * own.max()
        recording.derived["unbroken"] = np.cumsum(cut)
    return recording.derived["unbroken"]


def position_name(recording: Recording, axis: str) -> str:
    """Name of the column with an axis' position, else its command."""
    name = recording.name("position", axis=axis) or recording.name("command", axis=axis)
    if name is None:
        raise MissingColumn(f"the recording has no position of axis {axis}")
    return name


def path_name(recording: Recording, axis: str) -> str:
    """Name of the column with where an axis was sent: its command, else its position, which comes late already."""
    return recording.name("command", axis=axis) or position_name(recording, axis)


def travel(recording: Recording, axis: str) -> tuple[float, float]:
    """Travel of an axis in mm (deg): from the constants, else the range its positions cover."""
    known = recording.manifest.axis(axis)
    if known is not None and known.travel is not None:
        return known.travel
    x = position(recording, axis)
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    return (low, high) if high > low else (low, low + 1.0)


def response_share(recording: Recording, axis: str, radial: bool) -> np.ndarray:
    """How much of an axis' own deviation shows in the response: 1, shape (1,), or pos/R in a circular test, (rows,)."""
    if not radial:
        return np.ones(1)
    circle = axes(recording)[:2]
    radius = np.hypot(*(position(recording, a) for a in circle))
    return position(recording, axis) / np.where(radius > 0, radius, np.nan)
