"""Names of error components after ISO 230-1:2012: what each one is, its unit, and how many a machine has.

    EXX EYX EBX    error motions: E, direction of the deviation (X Y Z, A B C), axis that moves (clause 3.4)
    C0Y X0C        axis location errors: direction, 0, axis (C0Y is the squareness of Y to X)
    E_X E_Y E_Z    deviation of the tool point along a direction; E_A E_B E_C its orientation
    E_R E_D        radial deviation in a circular test; deviation of a workpiece's diameter
    F_X            drive force of an axis

Location errors are also written EC0Y, E_C0Y, E_{C0Y}; error motions E_XX, E_{XX}. `parse` takes them all.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations
from typing import Literal

from errpipe.domain.recording import Frozen
from errpipe.errors import did_you_mean

ABOUT = {"A": "X", "B": "Y", "C": "Z"}  # ISO 841: A, B, C turn about X, Y, Z
_LINEAR_AXES = "XYZUVWPQR"
_ROTARY_AXES = "ABCDES"
_PARALLEL = {"U": "X", "V": "Y", "W": "Z", "P": "X", "Q": "Y", "R": "Z", "S": "C"}
_MOTION = re.compile(rf"^E_?\{{?([XYZABC])([{_LINEAR_AXES}{_ROTARY_AXES}]\d?)\}}?$")
_LOCATION = re.compile(rf"^(?:E_?)?\{{?([XYZABC])0([{_LINEAR_AXES}{_ROTARY_AXES}]\d?)\}}?$")
_TOOL_POINT = re.compile(r"^E_([XYZABCUVWRD])$")
_FORCE = re.compile(rf"^F_([{_LINEAR_AXES}]\d?)$")

Kind = Literal[
    "positioning", "straightness", "roll", "tilt", "radial", "axial", "angular positioning",
    "squareness", "axis offset", "tool point", "tool orientation", "circular", "diameter", "force",
]  # fmt: skip


class Component(Frozen):
    """One component. name: canonical spelling; direction: of the deviation; axis: the axis it belongs to, if any."""

    name: str
    kind: Kind
    direction: str
    axis: str | None = None
    unit: Literal["um", "urad", "N"]


def parse(name: str) -> Component:
    """The component a name stands for. Raises ValueError naming the nearest component."""
    if found := _MOTION.match(name):
        return _motion(*found.groups())
    if found := _LOCATION.match(name):
        direction, axis = found.groups()
        kind = "squareness" if direction in ABOUT else "axis offset"
        return Component(name=f"{direction}0{axis}", kind=kind, direction=direction, axis=axis, unit=_unit(direction))
    if found := _TOOL_POINT.match(name):
        direction = found.group(1)
        kind = {"R": "circular", "D": "diameter"}.get(direction) or (
            "tool orientation" if direction in ABOUT else "tool point"
        )
        return Component(name=name, kind=kind, direction=direction, unit=_unit(direction))
    if found := _FORCE.match(name):
        return Component(name=name, kind="force", direction=found.group(1), axis=found.group(1), unit="N")
    raise ValueError(
        f"{name!r} is not an ISO 230-1 component (such as EXX, EBX, C0Y, E_Z, E_R, E_D, F_X)."
        + did_you_mean(name.upper(), _COMMON)
    )


def unit(name: str) -> str:
    """Canonical unit of a component: um, urad or N. Raises ValueError."""
    return parse(name).unit


def describe(name: str) -> str:
    """One phrase for a person: 'straightness of X in the Y direction'. Raises ValueError."""
    c = parse(name)
    match c.kind:
        case "positioning":
            return f"positioning deviation of {c.axis}"
        case "straightness":
            return f"straightness of {c.axis} in the {c.direction} direction"
        case "roll":
            return f"roll of {c.axis} (about {ABOUT[c.direction]})"
        case "tilt":
            return f"tilt of {c.axis} about {ABOUT[c.direction]}"
        case "radial" | "axial":
            return f"{c.kind} error motion of {c.axis} in the {c.direction} direction"
        case "angular positioning":
            return f"angular positioning deviation of {c.axis}"
        case "squareness":
            return f"squareness of {c.axis}: its direction, turned about {ABOUT[c.direction]}"
        case "axis offset":
            return f"offset of the axis {c.axis} in the {c.direction} direction"
        case "tool point":
            return f"deviation of the tool point in the {c.direction} direction"
        case "tool orientation":
            return f"deviation of the tool's orientation about {ABOUT[c.direction]}"
        case "circular":
            return "radial deviation in a circular test"
        case "diameter":
            return "deviation of the workpiece diameter"
    return f"drive force of {c.axis}"


def positioning(axis: str) -> str:
    """The positioning deviation of an axis: EXX of X, EXU of U (parallel to X), ECC of C."""
    return f"E{_PARALLEL.get(axis[0], axis[0])}{axis}"


def of_machine(linear: Sequence[str] = ("X", "Y", "Z"), rotary: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of all independent rigid-body components of a machine, error motions first.

    Six error motions an axis; one squareness for each pair of linear axes (the later one tilts); four
    location errors for each rotary axis: two offsets and two tilts across its own line. 21 for three linear
    axes, 41 for five axes. An offset along the axis itself and zero positions only shift the coordinates.
    """
    motions = [f"E{d}{axis}" for axis in (*linear, *rotary) for d in "XYZABC"]
    return (*motions, *map(_squareness, combinations(linear, 2)), *(e for axis in rotary for e in _location(axis)))


def count(linear: int = 3, rotary: int = 0) -> int:
    """Number of components of `of_machine`: 21 for three linear axes, 41 for five axes."""
    return 6 * (linear + rotary) + linear * (linear - 1) // 2 + 4 * rotary


def thermal_and_geometric(linear: Sequence[str] = ("X", "Y", "Z")) -> tuple[str, ...]:
    """The 32 of a three-axis machine with a warm spindle (Ni 1997, after Yang 1996).

    21 rigid-body components; spindle drift along three directions and tilt about two; drift of the origin
    of each moving frame in the two directions across its axis.
    """
    drifts = [f"drift of the origin of {a} along {d}" for a in linear for d in "XYZ" if d != a]
    return (*of_machine(linear), "E_X", "E_Y", "E_Z", "E_A", "E_B", *drifts)


def _unit(direction: str) -> Literal["um", "urad"]:
    return "urad" if direction in ABOUT else "um"


def _motion(direction: str, axis: str) -> Component:
    letter = _PARALLEL.get(axis[0], axis[0])
    if letter in "XYZ":
        if direction in ABOUT:
            kind = "roll" if ABOUT[direction] == letter else "tilt"
        else:
            kind = "positioning" if direction == letter else "straightness"
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
    own = _PARALLEL.get(axis[0], axis[0])
    line = ABOUT.get(own, "Z")
    return [f"{d}0{axis}" for d in "XYZABC" if d not in (line, own)]


_COMMON = (*of_machine(rotary=("A", "B", "C")), "E_X", "E_Y", "E_Z", "E_R", "E_D", "F_X", "F_Y", "F_Z")
