"""Test design: bar sockets, tools and positions that show every component in the least time.

Blocks of measurement (one socket and one tool, a short path of ball positions) are added one after the other,
each the one with the largest information gain per minute, including set-up times, until every combination of
components is observed. Unobservable combinations are listed in the plan's `open`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.errors import DataError
from errpipe.kinematics import observability, synthesis
from errpipe.kinematics import observations as o
from errpipe.kinematics.chain import Chain, combinations
from errpipe.kinematics.clearance import Clearance

SHOWN = 20.0  # nats for a newly observed combination: observing all has priority over precision
MAX_BLOCKS = 24  # of a plan (by judgement)
MIN_SHARE = 0.5  # of the positions of a block that permitted moves reach (by judgement)
MIN_GAIN = 1e-3  # nats per second below which a block is not worth its time


@dataclass(frozen=True)
class Equipment:
    """Equipment: a telescoping bar's reach (mm), tools, and durations (s; mm/min)."""

    reach: tuple[float, float] = (150.0, 1200.0)
    tools: tuple[tuple[float, tuple[float, float, float]], ...] = ((100.0, (0.0, 0.0, 0.0)), (200.0, (0.0, 0.0, 0.0)))
    noise: float = 0.7
    socket_change: float = 180.0
    tool_change: float = 120.0
    dwell: float = 1.5
    feed: float = 5000.0
    approach_feed: float = 2000.0  # a single axis, bar detached: slow enough to be stopped by hand (by judgement)
    attach: float = 60.0  # per block, with approach and retraction (by judgement)


@dataclass(frozen=True)
class Block:
    """One socket, one tool, positions in measuring order q (n, axes)."""

    socket: tuple[float, float, float]
    length: float
    offset: tuple[float, float, float]
    q: np.ndarray
    observations: o.Observations
    clearance: Clearance


@dataclass(frozen=True)
class Plan:
    """Blocks in order, total minutes, and unobserved combinations."""

    chain: Chain
    blocks: tuple[Block, ...]
    minutes: float
    open: tuple[observability.Unobserved, ...]
    equipment: Equipment

    def observations(self) -> o.Observations:
        """All blocks as one test without readings."""
        return o.concatenate([b.observations for b in self.blocks])


def propose(
    chain: Chain, *, equipment: Equipment | None = None, without: tuple[str, ...] = (), positions: int = 40
) -> Plan:
    """A measuring plan for a telescoping bar.

    without: components not to be identified (growth). Raises DataError if the bar reaches no position, or if no linear
    axis can retract the tool.
    """
    if not any(axis.kind == "linear" for axis in chain.machine.axes.values()):
        raise DataError(f"{chain.machine.name} has no linear axis that retracts the tool from the bar")
    equipment = equipment or Equipment(tools=default_tools(chain))
    rng = np.random.default_rng(0)
    blocks = []
    for socket in default_sockets(chain):
        for length, offset in equipment.tools:
            blocks += _blocks(chain, np.asarray(socket, dtype=float), length, offset, equipment, positions, rng)
    if not blocks:
        raise DataError(
            f"a bar of {equipment.reach[0]:g}..{equipment.reach[1]:g} mm reaches no position from these sockets"
        )
    model = observability.coarse(chain, without)
    gains = [observability.information(model, b.observations, equipment.noise)[0] for b in blocks]
    chosen = _greedy(gains, blocks, equipment)
    order = sorted(chosen, key=lambda i: (blocks[i].socket, blocks[i].length, blocks[i].offset, i))
    picked = tuple(blocks[i] for i in order)
    minutes = _seconds(picked, equipment) / 60.0
    test = o.concatenate([b.observations for b in picked])
    result = observability.analyse(chain, test, noise=equipment.noise, without=without)
    return Plan(chain, picked, minutes, result.unobserved, equipment)


def default_tools(chain: Chain) -> tuple[tuple[float, tuple[float, float, float]], ...]:
    """Two lengths along the spindle and one ball next to it: three points that are not collinear."""
    direction = np.asarray(chain.machine.tool.direction)
    side = np.linalg.svd(direction[None])[2][1] * 80.0
    first = max(60.0, chain.machine.tool.length)
    return ((first, (0.0, 0.0, 0.0)), (first + 120.0, (0.0, 0.0, 0.0)), (first + 50.0, _triple(side)))


def default_sockets(chain: Chain) -> list[np.ndarray]:
    """Three sockets well apart on the workpiece's side, just outside the reach of the tool."""
    corners = combinations(_box(chain))
    pose = synthesis.ideal_pose(chain, corners)[:, 0]
    low, high = pose.min(axis=0), pose.max(axis=0)
    tool = np.asarray(chain.machine.tool.direction)
    down = (low + high) / 2 + 0.62 * (high - low) * tool
    size = high - low
    across = np.linalg.svd(tool[None])[2][1:]
    steps = [(-0.4, -0.4), (0.4, -0.35), (0.05, 0.42)]
    return [down + size * (a * across[0] + b * across[1]) for a, b in steps]


def _box(chain: Chain) -> np.ndarray:
    """Travel to be used: whole linear axes; rotary axes at most a turn."""
    travel = chain.travel.copy()
    for i, a in enumerate(chain.axes):
        if chain.machine.axes[a].kind == "rotary":
            middle = travel[i].mean()
            half = min(np.ptp(travel[i]) / 2, 180.0)
            travel[i] = middle - half, middle + half
    return travel


def _blocks(chain, socket, length, offset, equipment: Equipment, positions: int, rng) -> list[Block]:
    """Blocks within the bar's reach of one socket with one tool: two independent random samples of the volume."""
    box, tip = _box(chain), chain.tip(length, offset)
    q = rng.uniform(box[:, 0], box[:, 1], (positions * 60, len(chain.axes)))
    edge = rng.random(q.shape) < 0.25
    q = np.where(edge, np.where(rng.random(q.shape) < 0.5, box[:, 0], box[:, 1]), q)
    clearance = Clearance(chain, socket, length, _triple(offset), equipment.reach)
    q = q[clearance.is_measurable(q)]
    q = q[np.sort(np.unique(q, axis=0, return_index=True)[1])]
    blocks = []
    for _ in range(2):
        if len(q) < positions:
            break
        path, q = _short_path(q[:positions], box, clearance), q[positions:]
        if len(path) < MIN_SHARE * positions:
            continue
        name = f"socket {'/'.join(f'{v:.0f}' for v in socket)} tool {length:g}"
        test = o.distance(chain, path, tip, socket, label=name)
        blocks.append(Block(_triple(socket), length, _triple(offset), path, test, clearance))
    return blocks


def _short_path(q: np.ndarray, box: np.ndarray, clearance: Clearance) -> np.ndarray:
    """Nearest-neighbour tour from the lowest corner, distances scaled by the travel, of moves with the bar attached.

    It begins and ends where the tool can be retracted. Positions that no permitted move reaches are left out.
    """
    scaled = (q - box[:, 0]) / np.ptp(box, axis=1)
    first = next((int(i) for i in np.argsort(scaled.sum(axis=1)) if clearance.can_retract(q[i])), None)
    if first is None:
        return q[:0]
    unvisited, order = set(range(len(q))) - {first}, [first]
    while unvisited:
        at, candidates = order[-1], sorted(unvisited)
        distance = np.linalg.norm(scaled[candidates] - scaled[at], axis=1)
        nearest = (candidates[int(k)] for k in np.argsort(distance, kind="stable"))
        found = next((j for j in nearest if clearance.is_measurable(clearance.move(q[at], q[j])).all()), None)
        if found is None:
            break
        order.append(found)
        unvisited.discard(found)
    while not clearance.can_retract(q[order[-1]]):
        order.pop()
    return q[order]


def _greedy(gains: list[np.ndarray], blocks: list[Block], equipment: Equipment) -> list[int]:
    """Greedy selection by information gain per second until all is observed or no block reaches MIN_GAIN."""
    p = len(gains[0])
    known = np.eye(p)
    chosen: list[int] = []
    while len(chosen) < MAX_BLOCKS:
        variances = np.linalg.eigvalsh(np.linalg.inv(known))
        if variances.max() <= observability.UNOBSERVED:
            break
        before = np.linalg.slogdet(known)[1]
        best, best_rate = -1, MIN_GAIN
        for i, gain in enumerate(gains):
            if i in chosen:
                continue
            after = np.linalg.eigvalsh(np.linalg.inv(known + gain))
            shown = int((variances > observability.UNOBSERVED).sum() - (after > observability.UNOBSERVED).sum())
            score = np.linalg.slogdet(known + gain)[1] - before + SHOWN * shown
            score_per_second = score / _more_seconds(blocks, chosen, i, equipment)
            if score_per_second > best_rate:
                best, best_rate = i, score_per_second
        if best < 0:
            break
        chosen.append(best)
        known = known + gains[best]
    return _pruned(chosen, gains, blocks, equipment)


def _pruned(chosen: list[int], gains: list[np.ndarray], blocks: list[Block], equipment: Equipment) -> list[int]:
    """The selection without redundant blocks (all observed combinations are kept), the slowest dropped first."""

    def unobserved(rows: list[int]) -> int:
        known = np.eye(len(gains[0])) + sum(gains[i] for i in rows)
        return int((np.linalg.eigvalsh(np.linalg.inv(known)) > observability.UNOBSERVED).sum())

    kept, unobserved_with_all = list(chosen), unobserved(chosen) if chosen else 0
    for i in sorted(chosen, key=lambda i: -_path_seconds(blocks[i], equipment)):
        others = [j for j in kept if j != i]
        if others and unobserved(others) <= unobserved_with_all:
            kept = others
    return kept


def _more_seconds(blocks: list[Block], chosen: list[int], i: int, equipment: Equipment) -> float:
    new = blocks[i]
    socket = not any(blocks[j].socket == new.socket for j in chosen)
    tool = not any(
        blocks[j].socket == new.socket and (blocks[j].length, blocks[j].offset) == (new.length, new.offset)
        for j in chosen
    )
    return _path_seconds(new, equipment) + socket * equipment.socket_change + tool * equipment.tool_change


def _path_seconds(block: Block, equipment: Equipment) -> float:
    way = sum(move_length(block, i) for i in range(1, len(block.q)))
    return way / equipment.feed * 60.0 + equipment.dwell * len(block.q) + equipment.attach


def move_length(block: Block, i: int) -> float:
    """What the feed counts of the move to position i: the ball's way, mm, or the largest turn, deg, if that is more."""
    start, end = block.q[i - 1], block.q[i]
    return max(block.clearance.ball_path(start, end), float(np.abs(end - start).max()))


def _seconds(blocks: Sequence[Block], equipment: Equipment) -> float:
    total = sum(_path_seconds(b, equipment) for b in blocks)
    before = None
    for b in blocks:
        if before is None or b.socket != before.socket:
            total += equipment.socket_change
        if before is None or (b.socket, b.length, b.offset) != (before.socket, before.length, before.offset):
            total += equipment.tool_change
        before = b
    return total


def _triple(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
