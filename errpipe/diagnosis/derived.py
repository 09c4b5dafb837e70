"""Columns derived from a recording: approach direction of an axis, and speed of an axis recorded in motion."""

from __future__ import annotations

import dataclasses

import numpy as np

from errpipe.diagnosis.prepare import derivative
from errpipe.domain.diagnosis import Diagnosis, ResponseDiagnosis
from errpipe.domain.recording import Column, Recording
from errpipe.drivers.motion import axes, sides
from errpipe.drivers.sessions import sessions

FAST = 0.1  # s between rows, below which the axis is recorded in motion
STILL = 4.0  # times the scatter of a position, from which it has moved
BOTH_WAYS = 0.05  # share of the rows in either direction; fewer are returns to the start of another pass
RETURN = 0.5  # share of the travel: if all moves in one direction are longer, and than the others, they are that, too
OFTEN = 0.5  # distinct positions over rows: fewer are targets that a test approaches repeatedly
LEAST_MOVE = 0.001  # mm or deg; as in the reader that derives directions from positions


def with_responses(recording: Recording) -> Recording:
    """The recording with a drive force that has a simulated counterpart as the response of its component."""
    known = {recording.manifest.columns[n].component for n in recording.names("error")}
    twins = {recording.manifest.columns[n].component for n in recording.names("simulated")} - known
    forces = {n: recording.manifest.columns[n] for role in ("force", "torque") for n in recording.names(role)}
    forces = {n: c for n, c in forces.items() if c.component in twins}
    called = {n: Column(role="error", component=c.component, unit=c.unit) for n, c in forces.items()}
    if not called:
        return recording
    manifest = recording.manifest.model_copy(update={"columns": recording.manifest.columns | called})
    return dataclasses.replace(recording, manifest=manifest)


def at_targets(recording: Recording) -> Recording:
    """The recording of a test with its commanded positions, if both commanded and actual ones are recorded.

    The actual position contains the deviation: a wave with the target spacing as period would reveal it.
    """
    values = {}
    for axis in (*axes(recording), *axes(recording, "rotary")):
        command, place = recording.name("command", axis=axis), recording.name("position", axis=axis)
        if command is not None and place is not None:
            x = recording.array(command)
            if np.unique(x[np.isfinite(x)]).size < OFTEN * np.isfinite(x).sum():
                values[place] = np.where(np.isfinite(x), x, recording.array(place))
    return dataclasses.replace(recording, frame=recording.frame.assign(**values)) if values else recording


def with_motion(recording: Recording) -> tuple[Recording, dict[str, str]]:
    """The recording with the motion of axes that is not recorded beside positions; and the source of each added column.

    A direction if rows are single readings of one axis (with several axes, the order of rows does not show from where
    each target was approached); velocity and acceleration (of a recorded velocity) if axes are recorded in motion.
    """
    recording = at_targets(recording)
    moving = [*axes(recording), *axes(recording, "rotary")]
    columns: dict[str, Column] = {}
    values: dict[str, np.ndarray] = {}
    source: dict[str, str] = {}
    for axis in moving:
        recorded = [r for r in ("direction", "velocity", "acceleration") if recording.names(r, axis=axis)]
        name = recording.name("command", axis=axis) or recording.name("position", axis=axis)
        if "direction" in recorded or name is None or not np.isfinite(recording.array(name)).all():
            continue
        for role, unit, made in _motion(recording, axis, name):
            if role not in recorded and (role != "direction" or (len(moving) == 1 and not recorded)):
                label = f"{role} of {axis}"
                columns[label], values[label] = Column(role=role, axis=axis, unit=unit), made
                source[label] = recording.name("velocity", axis=axis) or name
    if not columns:
        return recording, {}
    manifest = recording.manifest.model_copy(update={"columns": recording.manifest.columns | columns})
    return dataclasses.replace(recording, manifest=manifest, frame=recording.frame.assign(**values)), source


def _motion(recording: Recording, axis: str, name: str):
    """(role, unit, values) that the positions of an axis imply; nothing if it moves in one direction only."""
    x, t, run = recording.array(name), recording.time(), recording.run_codes()
    same = (run[2:] == run[1:-1]) & (run[1:-1] == run[:-2])
    step = np.diff(t)
    under_way = recording.names("error", component="E_R") or (step.size and np.median(step) < FAST)  # as on a circle
    fast = recording.name("time") is not None and step.size > 50 and bool(under_way)
    bend = np.abs(np.diff(x, 2)[same]) if fast else np.zeros(1)
    scatter = 1.4826 * float(np.median(bend)) / np.sqrt(6.0) if bend.size else 0.0
    side = sides(sessions(recording), x, max(STILL * scatter, LEAST_MOVE))
    if min(np.mean(side > 0), np.mean(side < 0)) < BOTH_WAYS:
        return
    if not fast:
        ways = ([way * m for m in np.diff(x) if way * m > LEAST_MOVE] for way in (1, -1))
        short, long = sorted(ways, key=lambda moves: min(moves, default=np.inf))
        if min(long, default=np.inf) <= max(RETURN * np.ptp(x), *short):
            yield "direction", None, side
        return
    length = "deg" if axis in axes(recording, "rotary") else "mm"
    speed = recording.name("velocity", axis=axis)
    yield "velocity", f"{length}/s", derivative(t, x, run)
    change = derivative(t, recording.array(speed), run) if speed else derivative(t, x, run, 2)
    yield "acceleration", f"{length}/s2", change


def named_by_source(diagnosis: Diagnosis, source: dict[str, str]) -> Diagnosis:
    """The diagnosis with derived columns named after the recorded column they come from."""

    def called(r: ResponseDiagnosis) -> ResponseDiagnosis:
        drivers = [tuple(dict.fromkeys(source.get(d, d) for d in f.drivers)) for f in r.findings]
        findings = [f.model_copy(update={"drivers": d}) for f, d in zip(r.findings, drivers, strict=True)]
        return r.model_copy(update={"findings": tuple(findings)})

    return diagnosis.model_copy(update={"responses": tuple(map(called, diagnosis.responses))}) if source else diagnosis
