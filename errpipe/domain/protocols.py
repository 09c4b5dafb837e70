"""Tests of a machine as a whole: what each reads, the columns and constants that its recording needs."""

from __future__ import annotations

from dataclasses import dataclass

from errpipe.domain.recording import Recording
from errpipe.errors import DataError, did_you_mean

DIRECTIONS = ("E_X", "E_Y", "E_Z", "E_A", "E_B", "E_C")


@dataclass(frozen=True)
class Protocol:
    """A test of a machine. Further columns besides `run` and positions, further constants besides the tool, mm."""

    measures: str
    errors: tuple[str, ...]
    constants: str = ""


_BAR = "deviation along the bar, positive where it is too long"
_POINTS = "deviation of the tool point from the workpiece's nominal points"
_SET = "set-up of the artefact is solved for"

PROTOCOLS: dict[str, Protocol] = {
    "ballbar_circle": Protocol(f"ISO 230-4: {_BAR}", ("E_R",), "centre_X, centre_Y, centre_Z"),
    "telescoping_bar": Protocol(_BAR, ("E_R",), "socket_X, socket_Y, socket_Z of each run"),
    "multilateration": Protocol("tracker: deviation of a distance", ("E_R",), "socket_X ... : the station"),
    "rotary_ballbar": Protocol(f"ISO 230-7, socket on the table: {_BAR}", ("E_R",), "socket_X ..."),
    "diagonal": Protocol("ISO 230-6: deviation along the beam", ("E_R",), "beam_X, beam_Y, beam_Z, if known"),
    "step_diagonal": Protocol("deviation along the beam, one axis a step", ("E_R",), "beam_X ..., if known"),
    "laser": Protocol("ISO 230-2: deviation along the beam", ("E_R",), "beam_X ..., if known"),
    "level": Protocol("rotation of the tool relative to the workpiece", DIRECTIONS[3:]),
    "r_test": Protocol(f"ISO 230-7, rotary axes turned: {_POINTS}", DIRECTIONS[:3]),
    "point_cloud": Protocol(f"{_POINTS}; its shift and turn are solved for", DIRECTIONS[:3]),
    "ball_plate": Protocol(f"{_POINTS}; {_SET}", DIRECTIONS[:3]),
    "ball_array": Protocol(f"{_POINTS}; {_SET}", DIRECTIONS[:3]),
    "hole_pattern": Protocol(f"drilled holes, measured: {_POINTS}", DIRECTIONS[:3]),
    "part": Protocol("bores and faces that a CMM measured", (*DIRECTIONS, "E_D"), "cutter_diameter"),
}


def protocol_of(recording: Recording) -> str:
    """Name of the test that the manifest states. Raises DataError for none, or one that is not known."""
    named = recording.manifest.constants.get("protocol")
    protocol = "" if named is None or named.value is None else str(named.value)
    if protocol not in PROTOCOLS:
        what = "the recording does not state which test it is" if not protocol else f"{protocol!r} is not a test"
        hint = did_you_mean(protocol, PROTOCOLS)
        raise DataError(
            f"constants.protocol: {what} (allowed: {', '.join(PROTOCOLS)}). Write it into recording.yaml, under "
            f"constants, as `protocol: {{value: point_cloud}}`; docs/recordings.md describes each.{hint}"
        )
    return protocol


def missing_readings(recording: Recording) -> str | None:
    """What keeps a recording from being read as the test that it states; None where its columns suffice.

    Raises DataError if it states none.
    """
    protocol = protocol_of(recording)
    wanted = PROTOCOLS[protocol].errors
    if set(wanted) & set(recording.components()):
        return None
    have = ", ".join(recording.components()) or "none"
    return f"a {protocol} needs an error column of component {' or '.join(wanted)} (the recording has: {have})"
