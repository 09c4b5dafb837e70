"""The modal state of an NC program, and the motion each block asks for, in machine coordinates and mm."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from errpipe.kernels import nc_paths
from errpipe.ncprogram.blocks import Block

MM_PER_INCH = 25.4
LINEAR = "XYZ"
ROTARY = "ABC"
OFFSETS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
PLANES = {"G17": ("X", "Y", "Z"), "G18": ("Z", "X", "Y"), "G19": ("Y", "Z", "X")}
CENTRES = {"X": "I", "Y": "J", "Z": "K"}
MOTIONS = ("G0", "G1", "G2", "G3")

# Everything that may stand in a program without moving an axis in a way this module would not see.
HARMLESS_G = {"G4", "G40", "G61", "G61.1", "G64", "G80", "G94", "G95", "G96", "G97", "G98", "G99", "G69", "G50"}
# Spindle, coolant, stop, override and end: none moves an axis.
HARMLESS_M = {f"M{n}" for n in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 30, 48, 49, 50, 51, 52, 53, 60)}
# Of a block with a motion these act behind it (LinuxCNC's order of execution).
STOPS_M = {"M0", "M1", "M2", "M30", "M60"}
# Spindle and coolant off: before the motion of their block in LinuxCNC, behind it in others.
OFF_M = {"M5", "M9"}
# The control moves the axes to a place of its own: to change the tool or the pallet; to a reference point.
LEAVING_M = {"M6", "M60"}
LEAVING_G = {"G28", "G30", "G53"}
KNOWN_LETTERS = set("GMFSTPDQHXYZABCIJKR")
# Of each of these groups one block may hold one code (LinuxCNC's modal groups).
GROUPS = (
    *({*MOTIONS, "G80"}, set(PLANES), {"G20", "G21"}, {"G90", "G91"}, {"G90.1", "G91.1"}, set(OFFSETS)),
    *({"G43", "G43.1", "G49"}, {"G94", "G95"}, {"G61", "G61.1", "G64"}, LEAVING_G | {"G4"}),
)
LARGEST_COORDINATE = 1e5  # mm or deg: 100 m is longer than any machine, and 277 turns of a table
LARGEST_RADIUS = 1e7  # mm; also of a centre's distance
MAX_TURNS = 1000  # of one arc


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
    """Modal state. position: tool point in part coordinates, mm (deg), None where it is not yet known.

    plane_set: whether the program named its plane; until then it is the one that LinuxCNC begins with.
    """

    motion: str = ""
    plane: str = "G17"
    plane_set: bool = False
    inch: bool = False
    absolute: bool = True
    arc_absolute: bool = False
    offset: str = "G54"
    tool_length: float = 0.0
    position: tuple[float | None, ...] = (None,) * 6
    ended: bool = False


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
    if block.has("O") and (len(block.words) > 1 or state.motion):  # else it is the number of the program
        raise block.refused("a subroutine or loop (O word) is not understood")
    for word in block.words:
        if word.letter not in KNOWN_LETTERS | {"O"}:
            raise block.refused(f"the word {word.text} is not understood")
        largest = LARGEST_COORDINATE if word.letter in LINEAR + ROTARY else LARGEST_RADIUS
        if word.letter in "XYZABCIJKR" and abs(word.value) > largest:
            raise block.refused(f"{word.text[:20]} is beyond any machine (at most {largest:g})")
    for code in block.codes("M"):
        if code not in HARMLESS_M:
            raise block.refused(f"{code} is not understood")
    if state.ended and block.words:
        raise block.refused("words after the program's end (M2 or M30)")
    _one_of_each_group(block)
    state = _modes(block, state, setup)
    if {"M2", "M30"} & set(block.codes("M")):
        state = replace(state, ended=True)
    state = _leaving(block, state)
    leaves = bool(LEAVING_G & set(block.codes("G")))
    if leaves or not block.has(LINEAR + ROTARY) or "G43.1" in block.codes("G"):
        _no_idle_words(block)
        return state, None
    for code, what in (("G4", "a dwell (G4)"), ("G50", "G50 (a lathe's: the zero of the part)")):
        if code in block.codes("G"):
            raise block.refused(f"axis words beside {what} are not understood")
    if state.motion not in MOTIONS:
        raise block.refused("axes are given but no motion (G0, G1, G2 or G3) is in force")
    _no_idle_tool(block)
    _no_turning_cycle(block, state)
    _no_drawing_angle(block, state)
    if state.motion in ("G0", "G1"):
        for letter in "IJKRPQ":
            if block.value(letter) is not None:
                raise block.refused(f"the word {letter} beside a straight move is not understood")
    end = _end(block, state)
    centre = _arc(block, state, end) if state.motion in ("G2", "G3") else None
    motion = Motion(state.motion, state.position, end, state.plane, centre, _turns(block))
    return replace(state, position=end), motion


def _leaving(block: Block, state: State) -> State:
    """The state with the places forgotten to which the control sends axes on its own: they are not in the program.

    Without this a move in X and Y behind a tool change would bring Z back down with the new tool.
    """
    codes = LEAVING_G & set(block.codes("G"))
    if "G53" in codes and (state.motion != "G0" or not block.has(LINEAR + ROTARY)):
        raise block.refused("G53 is understood with G0 and axis words")
    away = LINEAR if LEAVING_M & set(block.codes("M")) else ""
    if codes:
        away += "".join(n for n in LINEAR + ROTARY if block.has(n)) or LINEAR + ROTARY
    places = zip(LINEAR + ROTARY, state.position, strict=True)
    return replace(state, position=tuple(None if letter in away else place for letter, place in places))


def _one_of_each_group(block: Block) -> None:
    codes = block.codes("G")
    for group in GROUPS:
        both = [code for code in codes if code in group]
        if len(both) > 1:
            raise block.refused(f"{' and '.join(both)} in one block contradict each other")


def _no_idle_words(block: Block) -> None:
    """Raises DataError for words that belong to a motion, in a block that makes none: an arc without its end, say."""
    codes = block.codes("G")
    if "G4" in codes and block.value("P") is None:
        raise block.refused("a dwell (G4) without its time (P)")
    meant = {"P": ("G4", "G64", "G30"), "Q": ("G64",), "H": ("G43",), "D": ()}
    for word in block.words:
        if word.letter in "IJKR":
            raise block.refused(f"{word.text} without the axis words of its end is not understood")
        if word.letter in meant and not set(meant[word.letter]) & set(codes):
            raise block.refused(f"{word.text} belongs to nothing in the block")


def _no_idle_tool(block: Block) -> None:
    """Raises DataError for H without G43 and for D: other controls than LinuxCNC change the tool's length by them."""
    for letter, code in (("H", "G43"), ("D", "G41 or G42")):
        if block.value(letter) is not None and code not in block.codes("G"):
            raise block.refused(f"the word {letter} without {code} is not understood")


def _no_turning_cycle(block: Block, state: State) -> None:
    """Raises DataError for a turning cycle of most lathes (Fanuc's G code system A): each piece would be one."""
    codes = set(block.codes("G"))
    ends = block.has("X") and block.has("Z") and not block.has("Y")
    if codes & {"G90", "G94"} and ends and not codes & set(MOTIONS) and not (state.plane_set and state.plane == "G17"):
        code = "G90" if "G90" in codes else "G94"
        raise block.refused(
            f"{code} with X and Z is a turning cycle on a lathe: name the motion (G0, G1) in the block, or G17 above it"
        )


def _no_drawing_angle(block: Block, state: State) -> None:
    """Raises DataError for an angle or a chamfer of the drawing on a lathe (Fanuc: X20 A45, X20 C2).

    It sets where a cut ends, or takes a corner off behind it: each piece of the cut would do so. A control that knows
    these has no axis of that letter, so none stands anywhere.
    """
    if state.motion != "G1" or block.has("Y") or (state.plane_set and state.plane == "G17"):
        return
    places = dict(zip(LINEAR + ROTARY, state.position, strict=True))
    for word in block.words:
        if word.letter in "AC" and places[word.letter] is None:
            raise block.refused(
                f"{word.text} may be an angle or a chamfer of the drawing, as on a lathe: is {word.letter} a rotary "
                "axis, move it with G0 first, or name G17 above it"
            )


def _turns(block: Block) -> int:
    """Turns of an arc (P). Raises DataError for what is no number of turns."""
    given = block.value("P")
    if given is None:
        return 1
    if given != int(given) or not 1 <= given <= MAX_TURNS:
        raise block.refused(f"P{given:g} is no number of turns (allowed: 1 to {MAX_TURNS})")
    return int(given)


def _modes(block: Block, state: State, setup: Setup) -> State:
    for code in block.codes("G"):
        if code in MOTIONS:
            state = replace(state, motion=code)
        elif code in PLANES:
            state = replace(state, plane=code, plane_set=True)
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
        elif code not in HARMLESS_G | LEAVING_G:
            raise block.refused(f"{code} is not understood")
    return state


def offset_of(block: Block, setup: Setup, code: str) -> tuple[float, float, float]:
    """A work offset in mm. Raises DataError if the set-up does not name it."""
    if code not in setup.offsets:
        raise block.refused(f"the work offset {code} is missing (give --offset {code}=x,y,z)")
    return setup.offsets[code]


def _change_offset(block: Block, state: State, setup: Setup, code: str) -> State:
    """The machine does not move while the part's zero is shifted."""
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
        if given is None or block.has("XYABC") or set(block.codes("G")) & set(MOTIONS):
            raise block.refused("G43.1 is understood with Z alone")
        length = given * (MM_PER_INCH if state.inch else 1.0)
    else:
        number = block.value("H")
        if number is None or number != int(number) or int(number) not in setup.tools:
            which = "H" if number is None else f"H{int(number)}"
            raise block.refused(f"the tool length of {which} is missing (give --tool H1=120)")
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
            raise block.refused(f"an increment in {letter}, but the position of {letter} is not known")
        else:
            end.append(here + given * scale)
    return tuple(end)


def _arc(block: Block, state: State, end: tuple[float | None, ...]) -> tuple[float, float]:
    """Centre of an arc in its plane, from I J K or R. Raises DataError if the radii disagree."""
    first, second, through = PLANES[state.plane]
    if not state.plane_set and not block.has(second + CENTRES[second]):
        raise block.refused(
            f"an arc without {second} or {CENTRES[second]} before any plane was named: a lathe begins with G18, a mill "
            "with G17 (name it above the arc)"
        )
    a, b = LINEAR.index(first), LINEAR.index(second)
    ends = (state.position[a], state.position[b], end[a], end[b])
    if any(v is None for v in ends):
        raise block.refused("an arc from a place that is not known")
    a0, b0, a1, b1 = (float(v) for v in ends if v is not None)
    scale = MM_PER_INCH if state.inch else 1.0
    radius, across = block.value("R"), CENTRES[through]
    if block.value(across) is not None:
        raise block.refused(f"{across} is not a centre in the plane in force ({state.plane})")
    if radius is not None and block.has("IJK"):
        raise block.refused("an arc with both a radius and a centre")
    if radius is not None:
        return _centre_from_radius(block, (a0, b0), (a1, b1), radius * scale, state.motion == "G2")
    i, j = (block.value(CENTRES[letter]) for letter in (first, second))
    if i is None and j is None:
        raise block.refused("an arc without centre (I, J, K) or radius (R)")
    if state.arc_absolute and (i is None or j is None):
        raise block.refused("an absolute centre (G90.1) needs both its words")
    from_a, from_b = (0.0, 0.0) if state.arc_absolute else (a0, b0)
    centre = (from_a + (i or 0.0) * scale, from_b + (j or 0.0) * scale)
    start_radius = nc_paths.distance(a0 - centre[0], b0 - centre[1])
    end_radius = nc_paths.distance(a1 - centre[0], b1 - centre[1])
    if not nc_paths.radii_agree(start_radius, end_radius):
        raise block.refused(f"the arc's radius is {start_radius:.4f} mm at its start, {end_radius:.4f} at its end")
    return centre


def _centre_from_radius(
    block: Block, start: tuple[float, float], end: tuple[float, float], radius: float, clockwise: bool
) -> tuple[float, float]:
    x, y, exists = nc_paths.centre_from_radius(*start, *end, radius, clockwise)
    if not exists:
        chord = nc_paths.distance(end[0] - start[0], end[1] - start[1])
        raise block.refused(f"no arc of radius {radius:g} mm joins its ends, {chord:.4f} mm apart")
    return x, y
