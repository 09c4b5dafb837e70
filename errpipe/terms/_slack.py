"""Departures from a textbook form: slack columns added to a term's columns, each with its scale.

A lead error is not quite straight, a wall has more than one time constant, the loop rings before a spike is gone.
A freedom is the prior standard deviation of the column's coefficient relative to the size of the textbook form.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import direction, motion_sessions, position
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms._lines import MIN_REPEATED_TURNS, MULTIPLES
from errpipe.terms._search import resolved_lengths, resolved_times

Slack = Iterator["tuple[np.ndarray, float]"]  # column, shape (rows,), and its freedom

BENT = 0.07  # freedom of each smooth deformation along an axis; chosen on both trial generators
DEGREES = range(1, 8)  # Chebyshev degrees of these deformations
# Of friction, the force held at rest: a loop with an integrator keeps any force that friction bears
AT_STANDSTILL = 1.0
MANY_STARTS = 5  # sessions from which start states share one column, whole sessions are held out, each may have a datum


def unit_interval(x: np.ndarray) -> np.ndarray:
    """x scaled to -1..1 over its own range, shape of x; zeros where it never changes."""
    low, high = np.nanmin(x), np.nanmax(x)
    return (2 * x - low - high) / (high - low) if high > low else np.zeros_like(x)


def chebyshev(x: np.ndarray, degree: int) -> np.ndarray:
    """Chebyshev polynomials of degrees 0..degree over the range of x, shape (rows, degree + 1)."""
    return np.polynomial.chebyshev.chebvander(unit_interval(x), degree)


def bent(column: np.ndarray, x: np.ndarray) -> Slack:
    """A column bent smoothly along x."""
    polynomials = chebyshev(x, DEGREES[-1])
    for k in DEGREES:
        yield column * polynomials[:, k], BENT


def uneven_waves(waves: np.ndarray, x: np.ndarray) -> Slack:
    """Waves (rows, k) stronger here than there, or of a slightly different length."""
    polynomials = chebyshev(x, 2)
    for wave in waves.T:
        yield wave * polynomials[:, 1], 0.15
        yield wave * polynomials[:, 2], 0.15


def higher_harmonics(x: np.ndarray, period: float) -> Slack:
    """Multiples of a wave along x: a wave that is no sine is one finding."""
    for k in MULTIPLES if np.ptp(x) > MIN_REPEATED_TURNS * period else ():
        angle = 2 * np.pi * k / period * x
        yield np.sin(angle), 0.2
        yield np.cos(angle), 0.2


def difference_of_shape(column: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Difference of two columns of unit size: it changes the shape, not the size."""
    return column / max(float(np.std(column)), 1e-12) - base / max(float(np.std(base)), 1e-12)


def start_states(recording: Recording, tau: float, first: float, later: float, way: np.ndarray | None = None) -> Slack:
    """Decay of an unknown state at the start of each session, time constant tau in s.

    Of many sessions only what they have in common: a state for each would absorb all differences between sessions.
    first, later: freedom in the first and in each further session. way: travelled, in place of time (tau in its unit).
    """
    session, t = sessions(recording), recording.time() if way is None else way
    codes, start, inside = np.unique(session, return_index=True, return_inverse=True)
    decay = np.exp(-np.maximum(t - t[start][inside], 0.0) / tau)
    if codes.size >= MANY_STARTS:
        yield decay, 1.0
        return
    for k in range(codes.size):
        yield np.where(inside == k, decay, 0.0), first if k == 0 else later


def lagged(recording: Recording, values: np.ndarray, tau: float, max_share: float = 1.0) -> np.ndarray:
    """First-order lag of values with time constant tau in s, started at the input, shape (rows,).

    most: share of the longest session that tau may reach; what follows far later than that does not follow at all, and
    less the values it would be their negative, the textbook form itself.
    """
    tau = min(tau, max_share * resolved_times(recording)[1])
    return responses.lag(sessions(recording), recording.time(), values, tau, tau, True)


def of_reversal(column: np.ndarray, recording: Recording, axis: str, radial: bool) -> Slack:
    """A step between the directions of an axis that is closed within a few rows of a turn, and differs along the axis.

    What is closed later is no gap: it would play `friction_hysteresis`.
    """
    if recording.name("direction", axis=axis) is None:  # no contact changes sides at once
        yield from gradual_reversal(column, recording, axis, first_travel(recording, axis))
    if not radial:
        yield from bent(column, position(recording, axis))


def first_travel(recording: Recording, axis: str) -> float:
    """Usual travel of an axis to the first row after a turn, in mm (deg); from row to row where it never turns."""
    side, way = direction(recording, axis), np.abs(np.diff(position(recording, axis)))
    turned = (np.diff(side) != 0) & (np.diff(motion_sessions(recording)) == 0) & (way > 0)
    return float(np.median(way[turned])) if turned.any() else resolved_lengths(recording, axis)[0]


def gradual_reversal(step: np.ndarray, recording: Recording, axis: str, move: float | None = None) -> Slack:
    """A step between the directions of an axis that is closed over some travel after each reversal.

    move: that of a row in mm (deg); none: the usual one.
    """
    side, x = direction(recording, axis), position(recording, axis)
    move = resolved_lengths(recording, axis)[0] if move is None else move
    for length in (0.25 * move, move, 4.0 * move):  # closed at once, as seen, or over a few rows
        lagging = responses.approach(motion_sessions(recording), x, side, length) - side
        yield step * side * lagging, 0.6
