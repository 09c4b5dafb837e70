"""Names of error components after ISO 230-1:2012: what each one is, its unit, and how many a machine has.

    EXX EYX EBX    error motions: E, direction of the deviation (X Y Z, A B C), axis that moves (clause 3.4)
    C0Y X0C C0C    axis location errors: direction, 0, axis (C0Y is the squareness of Y to X; C0C the zero of C)
    X0X Y0X        drift of the origin of a linear axis' frame; X0S A0S: growth and tilt of the spindle
    E_X E_Y E_Z    deviation of the tool point along a direction; E_A E_B E_C its orientation
    E_R E_D        radial deviation in a circular test; deviation of a workpiece's diameter
    F_X F_C        drive force of a linear axis; drive torque of a rotary axis (N m, or N at a stated radius)

Location errors are also written EC0Y, E_C0Y, E_{C0Y}; error motions E_XX, E_{XX}. `parse` accepts them all.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations
from typing import Literal

from errpipe.domain.recording import FrozenModel
from errpipe.errors import did_you_mean

ABOUT = {"A": "X", "B": "Y", "C": "Z"}  # ISO 841: A, B, C turn about X, Y, Z
_LINEAR_AXES = "XYZUVWPQR"
_ROTARY_AXES = "ABCDES"
_PARALLEL = {"U": "X", "V": "Y", "W": "Z", "P": "X", "Q": "Y", "R": "Z", "S": "C"}
_MOTION = re.compile(rf"^E_?\{{?([XYZABC])([{_LINEAR_AXES}{_ROTARY_AXES}]\d?)\}}?$")
_LOCATION = re.compile(rf"^(?:E_?)?\{{?([XYZABC])0([{_LINEAR_AXES}{_ROTARY_AXES}]\d?)\}}?$")
_TOOL_POINT = re.compile(r"^E_([XYZABCUVWRD])$")
_FORCE = re.compile(rf"^F_([{_LINEAR_AXES}{_ROTARY_AXES}]\d?)$")

Kind = Literal[
    "positioning",
    "straightness",
    "roll",
    "tilt",
    "radial",
    "axial",
    "angular positioning",
    "squareness",
    "axis offset",
    "zero position",
    "drift",
    "tool point",
    "tool orientation",
    "circular",
    "diameter",
    "force",
]
STRAIGHTNESS: Kind = "straightness"
SQUARENESS: Kind = "squareness"


class Component(FrozenModel):
    """One component. name: canonical spelling; direction: of the deviation; axis: the axis it belongs to, if any."""

    name: str
    kind: Kind
    direction: str
    axis: str | None = None
    unit: Literal["um", "urad", "N", "N m"]

    @property
    def is_straightness(self) -> bool:
        """Whether a linear axis deviates across its own direction."""
        return self.kind == STRAIGHTNESS


def is_rotary(axis: str) -> bool:
    """Whether the name of an axis, such as X or C2, is that of a rotary one (ISO 841: A B C, D E; S: the spindle)."""
    return axis[0] in _ROTARY_AXES


def parse(name: str) -> Component:
    """The component of a name. Raises ValueError naming the nearest component."""
    if match := _MOTION.match(name):
        return _motion(*match.groups())
    if match := _LOCATION.match(name):
        direction, axis = match.groups()
        kind = _location_kind(direction, axis)
        return Component(name=f"{direction}0{axis}", kind=kind, direction=direction, axis=axis, unit=_unit(direction))
    if match := _TOOL_POINT.match(name):
        direction = match.group(1)
        at_tool: Kind = "tool orientation" if direction in ABOUT else "tool point"
        of_tool: Kind = "circular" if direction == "R" else "diameter" if direction == "D" else at_tool
        return Component(name=name, kind=of_tool, direction=direction, unit=_unit(direction))
    if match := _FORCE.match(name):
        axis = match.group(1)
        own_unit: Literal["N", "N m"] = "N" if axis[0] in _LINEAR_AXES else "N m"
        return Component(name=name, kind="force", direction=axis, axis=axis, unit=own_unit)
    along = re.match(r"^E_?([UVWPQR])(\w+)$", name)  # the direction of a deviation is that of X, Y or Z
    meant = f"E{_PARALLEL[along[1]]}{along[2]}" if along else ""
    hint = f" Did you mean {meant}?" if _MOTION.match(meant) else did_you_mean(name.upper(), _COMMON)
    raise ValueError(f"{name!r} is not an ISO 230-1 component (such as EXX, EBX, C0Y, E_Z, E_R, E_D, F_X).{hint}")


def unit(name: str) -> str:
    """Canonical unit of a component: um, urad, N or N m. Raises ValueError."""
    return parse(name).unit


def allowed_units(name: str) -> tuple[str, ...]:
    """Canonical units in which a component may stand: its own, and of a rotary axis' torque also N. Raises ValueError.

    A torque is often recorded as the force that it makes at some radius.
    """
    own = unit(name)
    return (own, "N") if own == "N m" else (own,)


_PHRASES = {
    "positioning": "positioning deviation of {axis}",
    STRAIGHTNESS: "straightness of {axis} in the {direction} direction",
    "roll": "roll of {axis} (about {about})",
    "tilt": "tilt of {axis} about {about}",
    "radial": "radial error motion of {axis} in the {direction} direction",
    "axial": "axial error motion of {axis} in the {direction} direction",
    "angular positioning": "angular positioning deviation of {axis}",
    SQUARENESS: "squareness of {axis}: its direction, turned about {about}",
    "squareness of a rotary axis": "squareness of the axis line of {axis}: tilted about {about}",
    "axis offset": "offset of the axis line of {axis} in the {direction} direction",
    "zero position": "zero position of {axis}: turned about its own line where it reads 0",
    "drift": "drift of the origin of {axis}'s frame in the {direction} direction",
    "tilt of the spindle": "tilt of the spindle about {about}",
    "growth of the spindle": "growth of the spindle in the {direction} direction",
    "tool point": "deviation of the tool point in the {direction} direction",
    "tool orientation": "deviation of the tool's orientation about {about}",
    "circular": "radial deviation in a circular test",
    "diameter": "deviation of the workpiece diameter",
    "force": "drive force of {axis}",
    "torque": "drive torque of {axis}",
}


def describe(name: str) -> str:
    """One phrase for a person: 'straightness of X in the Y direction'. Raises ValueError."""
    c = parse(name)
    kind: str = c.kind
    if kind == SQUARENESS and not _is_linear(str(c.axis)):
        kind = "squareness of a rotary axis"
    elif kind == "drift" and c.axis == "S":
        kind = "tilt of the spindle" if c.direction in ABOUT else "growth of the spindle"
    elif kind == "force" and c.unit != "N":
        kind = "torque"
    return _PHRASES[kind].format(axis=c.axis, direction=c.direction, about=ABOUT.get(c.direction, ""))


def positioning(axis: str) -> str:
    """The positioning deviation of an axis: EXX of X, EXU of U (parallel to X), ECC of C."""
    return f"E{_PARALLEL.get(axis[0], axis[0])}{axis}"


def of_machine(linear: Sequence[str] = ("X", "Y", "Z"), rotary: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of all rigid-body components of a machine, error motions first: what `kinematics.chain` finds in a chain.

    linear: in the order squareness refers to, the datum axis first. Six error motions an axis; one squareness for
    each pair of linear axes (the later one tilts); five location errors for each rotary axis: two offsets and two
    tilts across its own line, and its zero position. 21 for three linear axes, 43 for five axes. Along a rotary
    axis' own line an offset does nothing; the zero of a linear axis is the workpiece's datum, and is not counted.
    """
    motions = [f"E{d}{axis}" for axis in (*linear, *rotary) for d in "XYZABC"]
    return (*motions, *map(_squareness, combinations(linear, 2)), *(e for axis in rotary for e in _location(axis)))


def _unit(direction: str) -> Literal["um", "urad"]:
    return "urad" if direction in ABOUT else "um"


def _motion(direction: str, axis: str) -> Component:
    letter = _PARALLEL.get(axis[0], axis[0])
    if letter in "XYZ":
        if direction in ABOUT:
            kind = "roll" if ABOUT[direction] == letter else "tilt"
        else:
            kind = "positioning" if direction == letter else STRAIGHTNESS
    elif direction in ABOUT:
        kind = "angular positioning" if direction == letter else "tilt"
    else:
        kind = "axial" if direction == ABOUT.get(letter) else "radial"
    return Component(name=f"E{direction}{axis}", kind=kind, direction=direction, axis=axis, unit=_unit(direction))


def _squareness(pair: tuple[str, str]) -> str:
    first, second = (_PARALLEL.get(a[0], a[0]) for a in pair)
    about = next(d for d, line in ABOUT.items() if line not in (first, second))
    return f"{about}0{pair[1]}"


def _location(axis: str) -> list[str]:
    line = ABOUT.get(_principal(axis), "Z")
    return [f"{d}0{axis}" for d in "XYZABC" if d != line]


def _principal(axis: str) -> str:
    return _PARALLEL.get(axis[0], axis[0])


def _is_linear(axis: str) -> bool:
    return _principal(axis) in "XYZ"


def _location_kind(direction: str, axis: str) -> Kind:
    """Of the spindle and of a linear frame's origin a drift, else where and how an axis' line lies."""
    if axis == "S" or (_is_linear(axis) and direction not in ABOUT):
        return "drift"
    if not _is_linear(axis) and direction == _principal(axis):
        return "zero position"
    return SQUARENESS if direction in ABOUT else "axis offset"


_COMMON = (*of_machine(rotary=("A", "B", "C")), "E_X", "E_Y", "E_Z", "E_R", "E_D", "F_X", "F_Y", "F_Z")


def is_deviation(name: str) -> bool:
    """Whether a recorded component is a deviation (EXX, EBX, E_X, E_R), not a drive force."""
    return name.startswith("E")


def is_force(name: str) -> bool:
    """Whether a component is the drive force or torque of an axis (F_X)."""
    return name.startswith("F_")


def is_at_tool(name: str) -> bool:
    """Whether a component is read at the tool point (E_X, E_A, E_R), not of one axis alone."""
    return name.startswith("E_")


def is_error_motion(component: str) -> bool:
    """Whether a component is an error motion of one axis, such as EXX, EYX or EBX."""
    parsed = parse(component)
    return parsed.axis is not None and is_deviation(parsed.name)
