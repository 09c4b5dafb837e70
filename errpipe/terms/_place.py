"""The place of a response: which axis it belongs to, and how an axis' own deviation shows in it.

A positioning deviation (`EXX`) or a tool-point deviation (`E_X`) holds an axis' deviation in full; the
radial deviation of a circular test (`E_R`) holds x/R of it, counted from the circle's centre.
"""

from __future__ import annotations

from collections.abc import Iterator

from errpipe.domain.components import is_deviation, is_force, positioning
from errpipe.domain.recording import Constant, Recording
from errpipe.drivers.motion import axes

LINEAR = tuple("XYZUVWPQR")  # ISO 841: U, V, W and P, Q, R are parallel to X, Y, Z


def own_axis(component: str) -> str | None:
    """The axis a component belongs to: X of EXX, EYX, EAX; None for tool-point, radial and size components."""
    if len(component) == 3 and is_deviation(component) and component[1] != "_" and component[2].isalpha():
        return component[2]
    return None


def direction_of(component: str) -> str | None:
    """The direction a linear deviation points in: Y of EYX, X of E_X; None for angles, E_R, E_D and forces.

    The positioning deviation of an axis points along that axis: U of EXU, though U is parallel to X.
    """
    if len(component) == 3 and is_deviation(component):
        own = own_axis(component)
        if own is not None and own in LINEAR and component == positioning(own):
            return own
        letter = component[2] if component[1] == "_" else component[1]
        return letter if letter in "XYZUVW" else None
    return None


def as_positioning(component: str) -> str:
    """The positioning deviation of the axis that a component belongs to (EXX of EYX), else the component.

    Errors periodic with the screw, and reversal errors, also act sideways.
    """
    own = own_axis(component)
    return component if own is None else f"E{own}{own}"


def is_radial(component: str) -> bool:
    """Is it the radial deviation of a circular test?"""
    return component == "E_R"


def linear_axes_acting(recording: Recording, component: str) -> tuple[str, ...]:
    """As `axes_acting`, linear axes only: a rotary one has no metres that a screw or scale could grow by."""
    return tuple(axis for axis in axes_acting(recording, component) if axis in axes(recording))


def driven_axes(recording: Recording, component: str) -> tuple[str, ...]:
    """Axes that a drive force (F_X) belongs to: its own where that is recorded, else every one that is."""
    present = axes(recording) + axes(recording, "rotary")
    if not is_force(component):
        return ()
    return (component[2:],) if component[2:] in present else present


def velocities(recording: Recording, component: str) -> Iterator[tuple[str, str]]:
    """(axis, column) of each velocity of the axes that a drive force belongs to, recorded or not."""
    for axis in driven_axes(recording, component) or (component[2:],) * is_force(component):
        yield from ((axis, column) for column in recording.names("velocity", axis=axis))


def axes_acting(recording: Recording, component: str) -> tuple[str, ...]:
    """Axes whose positioning deviation acts on a component: X in EXX and E_X, all of the circle in E_R."""
    present = axes(recording) + axes(recording, "rotary")
    if is_radial(component):
        return axes(recording)[:2]
    if is_deviation(component) and len(component) == 3:
        own = own_axis(component) or component[2]
        if direction_of(component) in (own, None):
            return (own,) if own in present else ()
    return ()


def drive_periods(known: Constant | None) -> tuple[float, ...]:
    """Lengths along an axis after which its drive repeats, as the manifest states them, the longest first.

    One turn of screw, pulley, pinion or table; a tooth of belt, rack or wheel; one turn of the motor behind a gear.
    """
    if known is None:
        return ()
    turn = _turn(known)
    out = [known.screw_lead, known.tooth_pitch, None if known.kind == "rotary" else turn]
    if known.kind == "rotary" and known.teeth:
        out.append(360.0 / known.teeth)
    if turn and known.gear_ratio:
        out.append(turn / known.gear_ratio)
    return tuple(sorted({float(p) for p in out if p}, reverse=True))


def _turn(known: Constant) -> float | None:
    """Travel of an axis in one turn of its table, pulley, pinion or screw."""
    if known.kind == "rotary":
        return 360.0
    return known.tooth_pitch * known.teeth if known.tooth_pitch and known.teeth else known.screw_lead


def pole_periods(known: Constant | None) -> tuple[float, ...]:
    """Length along an axis of one pole pair of its motor, where the manifest states it."""
    if known is None:
        return ()
    if known.magnet_period:
        return (known.magnet_period,)
    turn = _turn(known)
    return (turn / (known.gear_ratio or 1.0) / known.pole_pairs,) if turn and known.pole_pairs else ()
