"""Readers: the recording of a test, identified by its manifest, as observations of a machine.

The manifest's constants name the protocol and the set-up (mm; `name@run` for one run, `name` for all):

    protocol                     one of `domain.protocols.PROTOCOLS`
    tool_length, tool_offset_X   from the spindle nose to the ball or probe (the machine file's tool where left out)
    centre_X                     centre of a circle, the origin of its positions
    socket_X                     fixed end of a bar, or a tracker station, in the workpiece frame
    beam_X                       direction of a laser beam (any length)
    seconds                      measuring time

A part is one run: a row per feature at its nominal place, with what the feature has (`parts`): a bore E_X, E_Y and, if
milled, its diameter E_D; a face its offset and the turns E_A, E_B, E_C of its normal. Columns of role size (mm) and of
role uncertainty (standard uncertainty, component by component) go with it; `cutter_diameter` (mm) is the tool's.

Columns: `run`, a position for each axis (left out: 0, or the centre), and the error: E_R along a bar or beam,
E_X E_Y E_Z at the tool point, E_A E_B E_C for a level or autocollimator.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from errpipe.domain.protocols import DIRECTIONS, protocol_of
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.kinematics import observations as o
from errpipe.kinematics import parts as features
from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain

BAR_RANGE = 2.5  # mm: measuring range of a ball bar (Renishaw QC20-W: +-1.25 mm)


class _Run:
    """One run of a recording: its rows and its set-up."""

    def __init__(self, chain: Chain, recording: Recording, label: str, rows: np.ndarray):
        self.chain, self.label = chain, label
        self._recording, self._rows = recording, rows
        self.centre = np.array([self.constant(f"centre_{a}", 0.0) for a in chain.axes])
        self.q = np.column_stack([self._axis(i, a) for i, a in enumerate(chain.axes)])
        tool = chain.machine.tool
        length = self.constant("tool_length", tool.length)
        x, y, z = (self.constant(f"tool_offset_{d}", tool.offset[i]) for i, d in enumerate("XYZ"))
        self.tip = chain.tip(length, (x, y, z))
        self.seconds = self.constant("seconds", 0.0)

    def constant(self, name: str, default: float | None) -> float:
        constants = self._recording.manifest.constants
        constant = constants.get(f"{name}@{self.label}", constants.get(name))
        if constant is None or constant.value is None:
            if default is None:
                raise DataError(f"run {self.label}: the manifest's constants need {name} (or {name}@{self.label})")
            return default
        return float(constant.value)

    def _axis(self, number: int, axis: str) -> np.ndarray:
        name = self._recording.name("command", axis=axis) or self._recording.name("position", axis=axis)
        shown = 0.0 if name is None else self._recording.array(name)[self._rows]
        return self.centre[number] + np.broadcast_to(shown, (len(self._rows),))

    def vector(self, name: str) -> np.ndarray:
        return np.array([self.constant(f"{name}_{d}", None) for d in "XYZ"])

    def has(self, name: str) -> bool:
        constants = self._recording.manifest.constants
        return f"{name}@{self.label}" in constants or name in constants

    def value(self, component: str) -> np.ndarray | None:
        return self.of_role("error", component)

    def of_role(self, role: str, component: str | None = None) -> np.ndarray | None:
        name = self._recording.name(role, component=component)
        return None if name is None else self._recording.array(name)[self._rows]

    def radial(self) -> np.ndarray:
        reading = self.value("E_R")
        if reading is None:
            raise DataError("the recording has no error column of component E_R (deviation along the bar or beam)")
        return reading


def _bar(run: _Run) -> o.Observations:
    if run.has("socket_X"):
        socket = run.vector("socket")
    else:
        socket = synthesis.ideal_pose(run.chain, run.centre, run.tip)[0, 0]
    return o.distance(run.chain, run.q, run.tip, socket, run.radial(), run.label, run.seconds)


def _circle(run: _Run) -> o.Observations:
    rows = _bar(run)
    length = np.linalg.norm(synthesis.ideal_pose(run.chain, run.q, run.tip)[:, 0] - rows.socket, axis=1)
    if np.ptp(length) > BAR_RANGE:
        raise DataError(
            f"run {run.label}: from the centre to the ball it is {length.min():.4g} to {length.max():.4g} mm, which no "
            "bar spans: positions of a circle count from its centre (of positions from the machine's zero, leave "
            "centre_X ... out and state socket_X, socket_Y, socket_Z)"
        )
    return rows


def _beam(run: _Run) -> o.Observations:
    if run.has("beam_X"):
        beam = run.vector("beam")
    else:
        pose = synthesis.ideal_pose(run.chain, run.q, run.tip)[:, 0]
        beam = pose[-1] - pose[0]
    return o.along(run.chain, run.q, run.tip, beam, run.radial(), run.label, run.seconds)


def _points(pose: str) -> Callable[[_Run], o.Observations]:
    def build(run: _Run) -> o.Observations:
        read = {d[2]: run.value(d) for d in DIRECTIONS[:3]}
        values = {d: v for d, v in read.items() if v is not None}
        directions = "".join(values)
        if not directions:
            raise DataError("the recording has no error column of component E_X, E_Y or E_Z")
        value = np.column_stack([values[d] for d in directions])
        return o.points(run.chain, run.q, run.tip, value, directions, run.label, pose, seconds=run.seconds)

    return build


def _level(run: _Run) -> o.Observations:
    parts = []
    for i, name in enumerate(DIRECTIONS[3:]):
        value = run.value(name)
        if value is not None:
            about = np.eye(3)[i]
            parts.append(o.angle(run.chain, run.q, run.tip, about, value, f"{run.label} {name}", run.seconds))
    if not parts:
        raise DataError("the recording has no error column of component E_A, E_B or E_C")
    return o.concatenate(parts)


def _part(run: _Run) -> o.Observations:
    named = {d: (run.value(d), run.of_role("uncertainty", d)) for d in (*DIRECTIONS, "E_D")}
    value = {d: v for d, (v, _) in named.items() if v is not None}
    stated = {d: u for d, (v, u) in named.items() if v is not None and u is not None}
    size = run.of_role("size")
    size = np.full(len(run.q), np.nan) if size is None else size
    cutter = run.constant("cutter_diameter", 0.0)
    return features.features(run.chain, run.q, run.tip, value, stated, size, run.label, cutter, run.seconds)


READERS: dict[str, Callable[[_Run], o.Observations]] = {
    "ballbar_circle": _circle,
    "telescoping_bar": _bar,
    "multilateration": _bar,
    "rotary_ballbar": _bar,
    "diagonal": _beam,
    "step_diagonal": _beam,
    "laser": _beam,
    "level": _level,
    "r_test": _points("XYZ"),
    "point_cloud": _points("XYZABC"),
    "ball_plate": _points("XYZABC"),
    "ball_array": _points("XYZABC"),
    "hole_pattern": _points("XYZABC"),  # E_Z, too, counts from the plane that the holes were measured from
    "part": _part,
}


def observations(chain: Chain, recording: Recording) -> o.Observations:
    """Every run of a recording as observations; rows without a reading are left out.

    Raises DataError for an unknown protocol or a missing constant.
    """
    build = READERS[protocol_of(recording)]
    codes = recording.run_codes()
    parts = []
    for number, label in enumerate(recording.run_labels()):
        part = build(_Run(chain, recording, label, np.flatnonzero(codes == number)))
        parts.append(part.take(np.flatnonzero(np.isfinite(part.value))))
    return o.concatenate(parts)
