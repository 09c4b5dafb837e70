"""Every test of a machine in one form: rows of poses, weights on the deviation there, and a reading.

    reading = weights . deviation(q, tip) + nuisance @ setup + noise            [um; urad for angular readings]

A distance row reads the change of length between a socket and the tool, |tool - socket|, whose weight is the
unit vector from one to the other; it is solved with the true length, not with its slope. Set-up errors (position of
the socket or artefact, bar length, pose of a plate) are nuisance columns with wide priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain

SHIFT = 1000.0  # um, prior sd like all below: a socket or artefact is placed within a few millimetres
TURN = 3000.0  # urad
SCALE = 200.0  # um/m: an artefact some degrees away from 20 degC
LENGTH = 200.0  # um
BALL = 4.0  # um: run-out of the ball in the spindle, averaged over two spindle orientations (ISO 230-7)


@dataclass(frozen=True)
class Observations:
    """Rows of one or several tests.

    q (n, axes) mm, deg; tip (n, 3) mm; weights (n, 6) on the deviation; value (n,); nuisance (n, m) in um per
    unit of each set-up parameter; socket (n, 3) mm in the workpiece frame, NaN if the row is not a distance;
    noise: relative size of each row's noise (n,); label: the run of each row; seconds: measuring time. own
    (n, components): weights on the components themselves, for records of single components; NaN where a row reads
    the tool. None: every row does. path (n, k, axes), path_weights (n, k, 6): places that a row is a sum over and
    their weights on the deviation there, for features that the tool traversed; None: every row reads at q alone.
    """

    q: np.ndarray
    tip: np.ndarray
    weights: np.ndarray
    value: np.ndarray
    nuisance: np.ndarray
    nuisance_names: tuple[str, ...]
    nuisance_spread: np.ndarray
    socket: np.ndarray
    noise: np.ndarray
    label: np.ndarray
    seconds: float = 0.0
    own: np.ndarray | None = None
    path: np.ndarray | None = None
    path_weights: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.value)

    def take(self, rows: np.ndarray) -> Observations:
        """Some of the rows; set-up columns are kept."""
        names: tuple[str, ...] = ("q", "tip", "weights", "value", "nuisance", "socket", "noise", "label")
        names += tuple(n for n in ("own", "path", "path_weights") if getattr(self, n) is not None)
        return replace(self, **{n: getattr(self, n)[rows] for n in names})

    def places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Poses (n, axes) and weights (n, 6) that the rows are sums over."""
        if self.path is None or self.path_weights is None:
            return [(self.q, self.weights)]
        return [(self.path[:, k], self.path_weights[:, k]) for k in range(self.path.shape[1])]

    def on_components(self, chain: Chain) -> list[tuple[np.ndarray, np.ndarray]]:
        """Poses (n, axes), and d(reading)/d(component there) (n, components), that the rows are sums over."""
        if self.own is not None and not np.isnan(self.own).any():
            return [(self.q, self.own)]
        out = []
        for number, (q, weights) in enumerate(self.places()):
            through_tool = np.einsum("nk,nkc->nc", weights, synthesis.jacobian(chain, q, self.tip))
            if self.own is not None:
                through_tool = np.where(np.isnan(self.own), through_tool, 0.0 if number else self.own)
            out.append((q, through_tool))
        return out


def _build(q, tip, weights, value, columns, label, socket=None, seconds=0.0) -> Observations:
    """columns: list of (name, spread, column)."""
    n = len(q)
    value = np.full(n, np.nan) if value is None else np.asarray(value, dtype=float)
    return Observations(
        np.asarray(q, dtype=float),
        np.broadcast_to(tip, (n, 3)).copy(),
        weights,
        value,
        np.column_stack([c for *_, c in columns]) if columns else np.zeros((n, 0)),
        tuple(name for name, *_ in columns),
        np.array([s for _, s, _ in columns], dtype=float),
        np.full((n, 3), np.nan) if socket is None else np.broadcast_to(socket, (n, 3)).copy(),
        np.ones(n),
        np.full(n, label, dtype=object),
        seconds,
    )


def distance(
    chain: Chain,
    q: np.ndarray,
    tip: np.ndarray,
    socket: Sequence[float] | np.ndarray,
    value: np.ndarray | None = None,
    label: str = "1",
    seconds: float = 0.0,
) -> Observations:
    """Length of a bar (or beam) from a socket on the workpiece to the tool: ball bar, telescoping bar, tracker range.

    value: measured minus nominal length, um. Set-up: position of the socket (3), the bar's length offset (1),
    and where the tool's ball sits in the spindle, for machines whose rotary axes turn it against the socket.
    """
    pose = synthesis.ideal_pose(chain, q, tip)
    ray = pose[:, 0] - np.asarray(socket, dtype=float)
    unit = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    columns = [(f"{label}: socket {d}", SHIFT, -unit[:, i]) for i, d in enumerate("XYZ")]
    columns.append((f"{label}: bar length", LENGTH, np.ones(len(q))))
    columns += _ball_columns(chain, pose, unit[:, None, :], label)
    return _build(q, tip, np.hstack([unit, np.zeros_like(unit)]), value, columns, label, socket, seconds)


def along(
    chain: Chain,
    q: np.ndarray,
    tip: np.ndarray,
    beam: Sequence[float] | np.ndarray,
    value: np.ndarray | None = None,
    label: str = "1",
    seconds: float = 0.0,
) -> Observations:
    """Displacement along a fixed beam (laser along an axis or a diagonal). value: measured minus nominal, um.

    Set-up: zero of the reading, and two angles of the beam against its nominal direction.
    """
    unit = np.asarray(beam, dtype=float) / np.linalg.norm(beam)
    pose = synthesis.ideal_pose(chain, q, tip)
    path = pose[:, 0] - pose[:, 0].mean(axis=0)
    columns = [(f"{label}: zero", SHIFT, np.ones(len(q)))]
    for i in range(2):
        side = np.linalg.svd(unit[None])[2][1 + i]
        across = path @ side
        if np.ptp(across) > 1e-6:
            columns.append((f"{label}: beam angle {i + 1}", TURN, across * 1e-3))
    weights = np.tile(np.r_[unit, np.zeros(3)], (len(q), 1))
    return _build(q, tip, weights, value, columns, label, seconds=seconds)


def angle(
    chain: Chain,
    q: np.ndarray,
    tip: np.ndarray,
    about: Sequence[float],
    value: np.ndarray | None = None,
    label: str = "1",
    seconds: float = 0.0,
) -> Observations:
    """Rotation of the tool's side against the workpiece about a direction (level), urad; its zero is set-up."""
    unit = np.asarray(about, dtype=float) / np.linalg.norm(about)
    weights = np.tile(np.r_[np.zeros(3), unit], (len(q), 1))
    return _build(q, tip, weights, value, [(f"{label}: zero", TURN, np.ones(len(q)))], label, seconds=seconds)


def points(
    chain: Chain,
    q: np.ndarray,
    tip: np.ndarray,
    value: np.ndarray | None = None,
    directions: str = "XYZ",
    label: str = "1",
    pose: str = "XYZABC",
    seconds: float = 0.0,
    scale: bool = False,
) -> Observations:
    """Deviation of the tool point along some directions: tracker clouds, probed plates, R-test, hole patterns.

    value (n, len(directions)), um, in the workpiece frame. Rows come direction by direction. Set-up: the pose
    of the artefact or tracker (`pose` names its shifts and turns), its scale, and the ball's place in the spindle.
    """
    ideal = synthesis.ideal_pose(chain, q, tip)
    centred = ideal[:, 0] - ideal[:, 0].mean(axis=0)
    parts = []
    for i, d in enumerate(directions):
        unit = np.zeros(3)
        unit["XYZ".index(d)] = 1.0
        columns = [(f"{label}: shift {s}", SHIFT, np.full(len(q), float(s == d))) for s in "XYZ" if s in pose]
        for s, about in (("A", "X"), ("B", "Y"), ("C", "Z")):
            if s in pose:
                turn = np.zeros(3)
                turn["XYZ".index(about)] = 1.0
                columns.append((f"{label}: turn {s}", TURN, np.cross(turn, centred) @ unit * 1e-3))
        if scale:
            columns.append((f"{label}: scale", SCALE, centred @ unit * 1e-3))
        columns += _ball_columns(chain, ideal, np.tile(unit, (len(q), 1))[:, None, :], label)
        weights = np.tile(np.r_[unit, np.zeros(3)], (len(q), 1))
        column = None if value is None else np.asarray(value, dtype=float)[:, i]
        parts.append(_build(q, tip, weights, column, columns, label, seconds=seconds / len(directions)))
    return concatenate(parts, shared=True)


def _ball_columns(chain: Chain, pose: np.ndarray, unit: np.ndarray, label: str) -> list[tuple[str, float, np.ndarray]]:
    """Run-out of the ball in the spindle: a shift fixed to the tool, if rotary axes rotate it in the workpiece frame.

    It is equivalent to an offset of a rotary axis' line; the accuracy of a rotary test is that of its ball's centring.
    """
    if not chain.machine.rotary_axes():
        return []
    columns = []
    for i, d in enumerate("XYZ"):
        column = np.einsum("nj,nj->n", pose[:, 1 + i], unit[:, 0])
        columns.append((f"{label}: ball {d}", BALL, column))
    return columns


def concatenate(parts: Sequence[Observations], shared: bool = False) -> Observations:
    """Rows of several tests together. shared: set-up parameters of equal name are one, else separate."""
    names: list[str] = []
    spread: list[float] = []
    column_numbers = []
    for number, part in enumerate(parts):
        numbers = []
        for name, size in zip(part.nuisance_names, part.nuisance_spread, strict=True):
            if not shared and name in names:
                name = f"{name} ({number + 1})"
            if name not in names:
                names.append(name)
                spread.append(float(size))
            numbers.append(names.index(name))
        column_numbers.append(numbers)
    nuisance = np.zeros((sum(map(len, parts)), len(names)))
    row = 0
    for part, numbers in zip(parts, column_numbers, strict=True):
        nuisance[row : row + len(part), numbers] = part.nuisance
        row += len(part)
    joined = {
        n: np.concatenate([getattr(p, n) for p in parts])
        for n in ("q", "tip", "weights", "value", "socket", "noise", "label")
    }
    return Observations(
        **joined,
        nuisance=nuisance,
        nuisance_names=tuple(names),
        nuisance_spread=np.array(spread),
        seconds=sum(p.seconds for p in parts),
        own=_component_weights(parts),
        **_paths(parts),
    )


def _paths(parts: Sequence[Observations]) -> dict[str, np.ndarray]:
    """Places and weights of all parts, padded with places of zero weight; nothing if no part has any."""
    most = max((p.path.shape[1] for p in parts if p.path is not None), default=0)
    if not most:
        return {}
    path = np.concatenate([np.repeat(p.q[:, None, :], most, axis=1) for p in parts])
    weights = np.zeros((len(path), most, 6))
    row = 0
    for part in parts:
        rows = slice(row, row + len(part))
        for k, (q, share) in enumerate(part.places()):
            path[rows, k], weights[rows, k] = q, share
        row += len(part)
    return {"path": path, "path_weights": weights}


def _component_weights(parts: Sequence[Observations]) -> np.ndarray | None:
    """Weights on components of all parts; NaN rows for parts that read the tool."""
    count = next((p.own.shape[1] for p in parts if p.own is not None), 0)
    if not count:
        return None
    return np.concatenate([np.full((len(p), count), np.nan) if p.own is None else p.own for p in parts])


def reading(chain: Chain, obs: Observations, deviation: np.ndarray, setup: np.ndarray) -> np.ndarray:
    """Readings of the rows for a deviation (n, 6) of the tool and set-up parameters (m,), um or urad.

    Distances are true lengths; everything else is linear.
    """
    linear = np.einsum("nk,nk->n", obs.weights, deviation) + obs.nuisance @ setup
    rows = ~np.isnan(obs.socket[:, 0])
    if rows.any():
        nominal = synthesis.ideal_pose(chain, obs.q[rows], obs.tip[rows])[:, 0] - obs.socket[rows]
        unit = obs.weights[rows, :3]
        along_bar = linear[rows]
        across = deviation[rows, :3] - np.einsum("nk,nk->n", unit, deviation[rows, :3])[:, None] * unit
        across = across + _socket_across(obs, setup, rows)
        span = np.linalg.norm(nominal, axis=1)
        length = np.hypot(span + along_bar * 1e-3, np.linalg.norm(across, axis=1) * 1e-3)
        linear[rows] = (length - span) * 1e3
    return linear


def _socket_across(obs: Observations, setup: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Part of the socket's shift across the bar, um, shape (rows, 3)."""
    shift = np.zeros((int(rows.sum()), 3))
    for i, d in enumerate("XYZ"):
        for j, name in enumerate(obs.nuisance_names):
            if f": socket {d}" in name:
                shift[:, i] -= (obs.nuisance[rows, j] != 0.0) * setup[j]
    unit = obs.weights[rows, :3]
    return shift - np.einsum("nk,nk->n", unit, shift)[:, None] * unit
