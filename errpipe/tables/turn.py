"""A curve over a rotary axis that turns on: closed, so that it repeats with every turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from errpipe.errors import GateError
from errpipe.tables.gridding import SAMPLES

TURN = 360.0  # deg
SAME_STEP = 1e-6  # of the span: steps that differ by less are one step, written with few digits
# deg: ends of travel that lie so close to a whole turn, or to a whole degree, are there. Positions that were measured
# differ by the axis' own error, which is below 0.02 deg (72 arcsec) on any axis worth compensating (by judgement).
WHOLE = 0.02
SMOOTH = 30.0  # deg beyond what was measured of a turn within which its slope ends: a step between usual targets
MAX_TURN_DIFFERENCE = 0.1  # of a curve's peak to valley: turns that differ by less repeat (by judgement)

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Turn:
    """One turn of a curve from `start`, deg. change: largest difference from the curve over what was measured."""

    curve: Curve
    nodes: tuple[float, ...]
    start: float
    change: float


def is_whole(low: float, high: float) -> bool:
    """Whether low to high is one turn."""
    return abs(high - low - TURN) <= WHOLE


def start(low: float) -> int:
    """Where the turn of a curve begins that was measured from low on, deg."""
    return math.floor(low + WHOLE)


def close(bare: Curve, axis: str, low: float, high: float, nodes: tuple[float, ...]) -> Turn:
    """The curve, measured from low to high, as one that repeats. nodes: between which it is straight, or none.

    Where less than a turn was measured the rest is bridged. What the ends of a whole turn differ is spread evenly over
    it, as the division of a circle is closed. Raises GateError if further turns differ from the first.
    """
    change = _between_turns(bare, axis, low, high)
    high = min(high, low + TURN)
    ends = bare(np.array([low, high]))
    near = 1e-3 * (high - low)
    slopes = (bare(np.array([low + near, high])) - bare(np.array([low, high - near]))) / near
    slopes = np.zeros(2) if nodes else slopes

    def curve(x: np.ndarray) -> np.ndarray:
        at = low + np.mod(x - low, TURN)
        if not is_whole(low, high):
            rest = _bridge(at - high, low + TURN - high, ends[::-1], slopes[::-1], straight=bool(nodes))
            return np.where(at <= high, bare(np.minimum(at, high)), rest)
        return bare(np.minimum(at, high)) - (ends[1] - ends[0]) * ((at - low) / TURN - 0.5)

    if nodes and abs(nodes[-1] - nodes[0] - TURN) > SAME_STEP * TURN:
        nodes = () if is_whole(nodes[0], nodes[-1]) else (*nodes, nodes[0] + TURN)
    if is_whole(low, high):
        change += 0.5 * abs(float(ends[1] - ends[0]))
    return Turn(curve, nodes, start(low), change)


def _between_turns(bare: Curve, axis: str, low: float, high: float) -> float:
    """Largest difference of further turns from the first one. Raises GateError if they do not repeat it."""
    if high - low <= TURN + WHOLE:
        return 0.0
    at = np.linspace(low + TURN, high, SAMPLES)
    differs = float(np.abs(bare(at) - bare(low + np.mod(at - low, TURN))).max())
    if differs > MAX_TURN_DIFFERENCE * float(np.ptp(bare(np.linspace(low, high, SAMPLES)))):
        raise GateError(
            f"{axis} was measured from {low:g} to {high:g} deg and turns on: a table repeats with every turn, this "
            f"curve over {axis} differs by up to {differs:.3g} from its first one. Give its positions within one turn, "
            "or a term that repeats (harmonics of 360 deg)"
        )
    return differs


def _bridge(x: np.ndarray, length: float, ends: np.ndarray, slopes: np.ndarray, *, straight: bool) -> np.ndarray:
    """From one end to the other over x = 0 to `length`: straight, or going on with the slopes for a while."""
    u = np.clip(x / length, 0.0, 1.0)
    along = u if straight else u * u * (3.0 - 2.0 * u)
    room = min(length, SMOOTH)
    p, q = (np.clip(v / room, 0.0, 1.0) for v in (x, length - x))
    return ends[0] + (ends[1] - ends[0]) * along + room * (slopes[0] * p * (1 - p) ** 2 - slopes[1] * q * (1 - q) ** 2)
