"""Where a machine may stand and move with one ball bar: length within its reach, ball and nose clear of the socket.

A machine file has no shapes of table, fixture or column: only bar, socket, ball and spindle nose are checked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain

STEP = 2.0  # mm or deg between checked points of a move
MARGIN = 2.0  # mm of the bar's reach at both ends: its length between points changes by less (2 deg at 1 m: 1 mm)
MIN_DISTANCE = 50.0  # mm of a ball without bar from the socket (by judgement: some diameters of a ball)
MIN_HEIGHT = 20.0  # mm of ball and nose above the plane through the socket (by judgement: half a socket's height)
MIN_ANGLE = np.cos(np.radians(60.0))  # between bar and tool: less, and the bar meets the shank (by judgement)


@dataclass(frozen=True)
class Clearance:
    """One socket (in the workpiece frame) and tool. reach: shortest and longest bar, mm."""

    chain: Chain
    socket: np.ndarray
    length: float
    offset: tuple[float, float, float]
    reach: tuple[float, float]

    def bar(self, q: np.ndarray) -> np.ndarray:
        """Vector from ball to socket, mm, shape (n, 3)."""
        return self.socket - self._pose(q)[:, 0]

    def is_clear(self, q: np.ndarray) -> np.ndarray:
        """Whether ball and nose are on the tool's side of the socket, and the ball is not close to it."""
        plane = np.asarray(self.chain.machine.tool.direction)
        nose = self.socket - synthesis.ideal_pose(self.chain, q, self.chain.tip(0.0, (0.0, 0.0, 0.0)))[:, 0]
        bar = self.bar(q)
        away = np.linalg.norm(bar, axis=1) >= MIN_DISTANCE
        return away & (bar @ plane >= MIN_HEIGHT) & (nose @ plane >= MIN_HEIGHT)

    def is_measurable(self, q: np.ndarray) -> np.ndarray:
        """Whether the bar may be attached: clear, within its reach, and not along the tool's shank."""
        pose = self._pose(q)
        bar = self.socket - pose[:, 0]
        size = np.linalg.norm(bar, axis=1)
        tool = np.einsum("d,ndk->nk", np.asarray(self.chain.machine.tool.direction), pose[:, 1:])
        free = np.einsum("nk,nk->n", bar, tool) >= -MIN_ANGLE * size
        within = (size >= self.reach[0] + MARGIN) & (size <= self.reach[1] - MARGIN)
        return self.is_clear(q) & within & free

    def move(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Points of a straight move, its ends among them, shape (n, axes)."""
        count = int(np.ceil(np.abs(end - start).max() / STEP)) + 1
        return np.linspace(start, end, max(count, 2))

    def ball_path(self, start: np.ndarray, end: np.ndarray) -> float:
        """Way of the ball in the workpiece frame during a move, mm."""
        return float(np.linalg.norm(np.diff(self.bar(self.move(start, end)), axis=0), axis=1).sum())

    def retracted(self, q: np.ndarray) -> np.ndarray:
        """The position with the axis of retraction at its end."""
        axis, end = retraction(self.chain)
        out = q.copy()
        out[axis] = end
        return out

    def can_retract(self, q: np.ndarray) -> bool:
        """Whether all of the way from a position to its retracted one is clear."""
        return bool(self.is_clear(self.move(q, self.retracted(q))).all())

    def _pose(self, q: np.ndarray) -> np.ndarray:
        return synthesis.ideal_pose(self.chain, q, self.chain.tip(self.length, self.offset))


def retraction(chain: Chain) -> tuple[int, float]:
    """Column of `q` and end of travel of the linear axis that moves the tool most directly away from the workpiece."""
    q = chain.travel.mean(axis=1)
    columns = [i for i, a in enumerate(chain.axes) if chain.machine.axes[a].kind == "linear"]
    moved = synthesis.ideal_pose(chain, q + np.eye(len(q))[columns])[:, 0] - synthesis.ideal_pose(chain, q[None])[:, 0]
    along = moved @ np.asarray(chain.machine.tool.direction)
    best = int(np.argmax(np.abs(along)))
    axis = columns[best]
    return axis, float(chain.travel[axis, 0 if along[best] > 0 else 1])


def approach(chain: Chain, start: np.ndarray, end: np.ndarray) -> list[tuple[int, float]]:
    """Moves of one axis each (column, position) from a retracted position to a measuring one: rotary axes first."""
    last, _ = retraction(chain)
    rotary = [i for i, a in enumerate(chain.axes) if chain.machine.axes[a].kind == "rotary"]
    others = [i for i in range(len(chain.axes)) if i not in rotary and i != last]
    return [(i, float(end[i])) for i in [*rotary, *others, last] if start[i] != end[i]]
