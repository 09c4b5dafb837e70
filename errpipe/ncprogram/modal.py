"""The modal state of an NC program, and the motion each block asks for, in machine coordinates and mm."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from errpipe.ncprogram.blocks import Block, refuse

MM_PER_INCH = 25.4
LINEAR = "XYZ"
ROTARY = "ABC"
OFFSETS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
PLANES = {"G17": ("X", "Y", "Z"), "G18": ("Z", "X", "Y"), "G19": ("Y", "Z", "X")}
CENTRES = {"X": "I", "Y": "J", "Z": "K"}
MOTIONS = ("G0", "G1", "G2", "G3")

# Everything that may stand in a program without moving an axis in a way this module would not see.
HARMLESS_G = {"G4", "G40", "G61", "G61.1", "G64", "G80", "G94", "G95", "G96", "G97", "G98", "G99", "G69", "G50"}
HARMLESS_M = {f"M{n}" for n in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 30, 48, 49, 50, 51, 52, 53, 60)}
KNOWN_LETTERS = set("GMFSTPDQHXYZABCIJKR")


@dataclass(frozen=True)
class Setup:
    """What the program cannot say: work offsets and tool lengths in mm, where the machine stands at the start.

    offsets: G54 ... -> (X, Y, Z) of the part's zero in machine coordinates. tools: H number -> length in Z.
    """

    offsets: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    tools: dict[int, float] = field(default_factory=dict)
    start: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class State:
    """Modal state. position: tool point in part coordinates, mm (deg), None where it is not yet known."""

    motion: str = ""
    plane: str = "G17"
    inch: bool = False
    absolute: bool = True
    arc_absolute: bool = False
    offset: str = "G54"
    tool_length: float = 0.0
    position: tuple[float | None, ...] = (None,) * 6
    feed_mode: str = "G94"


@dataclass(frozen=True)
class Motion:
    """One motion: mode G0..G3, ends in part coordinates (mm, deg), arcs with centre, turns and plane."""

    mode: str
    start: tuple[float | None, ...]
    end: tuple[float | None, ...]
    plane: str
    centre: tuple[float, float] | None = None
    turns: int = 1


def advance(block: Block, state: State, setup: Setup) -> tuple[State, Motion | None]:
    """The state after a block and the motion it makes, if any. Raises DataError for what is not understood."""
    for word in block.words:
        if word.letter not in KNOWN_LETTERS:
            raise refuse(block.line, block.source, f"the word {word.text} is not understood")
    for code in block.codes("M"):
        if code not in HARMLESS_M:
            raise refuse(block.line, block.source, f"{code} is not understood")
    state = _modes(block, state, setup)
    if not any(block.value(a) is not None for a in LINEAR + ROTARY):
        return state, None
    if "G4" in block.codes("G") or "G43.1" in block.codes("G"):
        return state, None
    if state.motion not in MOTIONS:
        raise refuse(block.line, block.source, "axes are given but no motion (G0, G1, G2 or G3) is in force")
    if state.motion in ("G0", "G1"):
        for letter in "IJKRP":
            if block.value(letter) is not None:
                raise refuse(block.line, block.source, f"the word {letter} beside a straight move is not understood")
    end = _end(block, state)
    centre = _arc(block, state, end) if state.motion in ("G2", "G3") else None
    motion = Motion(state.motion, state.position, end, state.plane, centre, int(block.value("P") or 1))
    return replace(state, position=end), motion


def _modes(block: Block, state: State, setup: Setup) -> State:
    for code in block.codes("G"):
        if code in MOTIONS:
            state = replace(state, motion=code)
        elif code in PLANES:
            state = replace(state, plane=code)
        elif code in ("G20", "G21"):
            state = replace(state, inch=code == "G20")
        elif code in ("G90", "G91"):
            state = replace(state, absolute=code == "G90")
        elif code in ("G90.1", "G91.1"):
            state = replace(state, arc_absolute=code == "G90.1")
        elif code in OFFSETS:
            state = _change_offset(block, state, setup, code)
        elif code in ("G43", "G43.1", "G49"):
            state = _change_tool(block, state, setup, code)
        elif code == "G80":
            state = replace(state, motion="")
        elif code in HARMLESS_G:
            state = replace(state, feed_mode=code) if code in ("G94", "G95") else state
        else:
            raise refuse(block.line, block.source, f"{code} is not understood")
    return state


def offset_of(block: Block, setup: Setup, code: str) -> tuple[float, float, float]:
    """A work offset in mm. Raises DataError where the set-up does not name it."""
    if code not in setup.offsets:
        raise refuse(block.line, block.source, f"the work offset {code} was not given (say --offset {code}=x,y,z)")
    return setup.offsets[code]


def _change_offset(block: Block, state: State, setup: Setup, code: str) -> State:
    """The machine stands still while the part's zero moves."""
    new, old = offset_of(block, setup, code), setup.offsets.get(state.offset)
    moved: list[float | None] = list(state.position)
    for n in range(3):
        here = moved[n]
        moved[n] = None if here is None or old is None else here + old[n] - new[n]
    return replace(state, offset=code, position=tuple(moved))


def _change_tool(block: Block, state: State, setup: Setup, code: str) -> State:
    if code == "G49":
        length = 0.0
    elif code == "G43.1":
        given = block.value("Z")
        if given is None or block.value("X") is not None or block.value("Y") is not None:
            raise refuse(block.line, block.source, "G43.1 is understood with Z alone")
        length = given * (MM_PER_INCH if state.inch else 1.0)
    else:
        number = block.value("H")
        if number is None or int(number) not in setup.tools:
            which = "H" if number is None else f"H{int(number)}"
            raise refuse(block.line, block.source, f"the tool length of {which} was not given (say --tool H1=120)")
        length = setup.tools[int(number)]
    z = state.position[2]
    moved = None if z is None else z + state.tool_length - length
    return replace(state, tool_length=length, position=(*state.position[:2], moved, *state.position[3:]))


def _end(block: Block, state: State) -> tuple[float | None, ...]:
    end: list[float | None] = []
    for n, letter in enumerate(LINEAR + ROTARY):
        given, here = block.value(letter), state.position[n]
        scale = MM_PER_INCH if state.inch and letter in LINEAR else 1.0
        if given is None:
            end.append(here)
        elif state.absolute:
            end.append(given * scale)
        elif here is None:
            raise refuse(block.line, block.source, f"an increment in {letter}, but where {letter} stands is not known")
        else:
            end.append(here + given * scale)
    return tuple(end)


def _arc(block: Block, state: State, end: tuple[float | None, ...]) -> tuple[float, float]:
    """Centre of an arc in its plane, from I J K or R. Raises DataError where the radii disagree."""
    first, second, _ = PLANES[state.plane]
    a, b = LINEAR.index(first), LINEAR.index(second)
    ends = (state.position[a], state.position[b], end[a], end[b])
    if any(v is None for v in ends):
        raise refuse(block.line, block.source, "an arc from a place that is not known")
    a0, b0, a1, b1 = (float(v) for v in ends if v is not None)
    scale = MM_PER_INCH if state.inch else 1.0
    radius = block.value("R")
    if radius is not None:
        return _centre_from_radius(block, (a0, b0), (a1, b1), radius * scale, state.motion == "G2")
    i, j = (block.value(CENTRES[letter]) for letter in (first, second))
    if i is None and j is None:
        raise refuse(block.line, block.source, "an arc without centre (I, J, K) or radius (R)")
    if state.arc_absolute:
        centre = ((i or 0.0) * scale, (j or 0.0) * scale)
    else:
        centre = (a0 + (i or 0.0) * scale, b0 + (j or 0.0) * scale)
    start_radius = math.hypot(a0 - centre[0], b0 - centre[1])
    end_radius = math.hypot(a1 - centre[0], b1 - centre[1])
    if abs(start_radius - end_radius) > max(0.0254, 1e-3 * start_radius):
        found = f"the arc's radius is {start_radius:.4f} mm at its start, {end_radius:.4f} at its end"
        raise refuse(block.line, block.source, found)
    return centre


def _centre_from_radius(
    block: Block, start: tuple[float, float], end: tuple[float, float], radius: float, clockwise: bool
) -> tuple[float, float]:
    chord = math.hypot(end[0] - start[0], end[1] - start[1])
    if chord == 0.0 or chord > 2 * abs(radius) + 1e-6:
        raise refuse(block.line, block.source, f"no arc of radius {radius:g} mm joins its ends, {chord:.4f} mm apart")
    height = math.sqrt(max(radius * radius - chord * chord / 4, 0.0))
    side = 1.0 if (radius > 0) != clockwise else -1.0
    mid = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    normal = (-(end[1] - start[1]) / chord, (end[0] - start[0]) / chord)
    return (mid[0] + side * height * normal[0], mid[1] + side * height * normal[1])
