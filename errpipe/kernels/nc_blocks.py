"""Plain motion blocks of an NC program in bulk: bytes in, tool points out; numbers in, bytes out.

Plain is a block of ASCII words that `ncprogram` would read without a refusal and without a change of mode but G0 to G3.
Reading stops before anything else, also before whatever may have to be refused. A number is its digits over a power of
ten, both exact in double precision, so the quotient is the number that Python reads. Lengths in mm, angles in deg.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from errpipe.kernels import bare_kernel

POSITION, LINE, ROW, TEXT, MOTION, MOVES = range(6)  # what the cursor holds, see `read`
LETTERS = "XYZABCIJKRGNFS"
_G, _N = LETTERS.index("G"), LETTERS.index("N")
_SLOT = np.full(128, -1, dtype=np.int64)
_SLOT[[ord(letter) for letter in LETTERS]] = np.arange(len(LETTERS))
_AXES, _CENTRE = 0b111111, 0b1111 << 6  # bits of X to C, of I, J, K and R
_ROTARY = 3  # the first of these axes
_POWER = np.array([float(f"1e{n}") for n in range(23)])  # larger ones are not exact
_LARGEST_WHOLE = 10**14  # digits of a number read as one integer; all below 2**53 are exact


class Rows(NamedTuple):
    """Room for the rows of a program to come, and the texts beside their words.

    points: (n, 6) tool points; given: (n,) bit per axis that the block names; number: (n,) line of the program;
    text: (n, 3) where in `bytes` the row's leading words begin, and end, and its comment ends.
    """

    points: np.ndarray
    given: np.ndarray
    number: np.ndarray
    text: np.ndarray
    bytes: np.ndarray


class Mode(NamedTuple):
    """The modes in force that no plain block changes, and what limits a segment.

    scale: mm per unit; first, second, through: axes of the plane; centres: whether I, J, K are increments;
    longest, chord_error: mm; segments: most of a block; coordinate, radius: largest words; line: longest, characters.
    """

    scale: float
    absolute: bool
    first: int
    second: int
    through: int
    centres: bool
    longest: float
    chord_error: float
    segments: int
    coordinate: float
    radius: float
    line: int


@bare_kernel
def _number(data, at, end):
    """The number that begins at `at`, and where it ends: -1 where there is none, or none that is read exactly."""
    negative = at < end and data[at] == 45
    if at < end and (data[at] == 43 or data[at] == 45):
        at += 1
    digits, whole, decimals, point = 0, np.int64(0), 0, False
    while at < end:
        c = data[at]
        if 48 <= c <= 57:
            whole = whole * 10 + np.int64(c - 48)
            digits += 1
            decimals += point
            if whole >= _LARGEST_WHOLE or decimals > 22:
                return 0.0, -1
        elif c == 46 and not point:
            point = True
        else:
            break
        at += 1
    value = float(whole) / _POWER[decimals]
    return (-value if negative else value), (at if digits else -1)


@bare_kernel
def _copy(data, at, end, out, used):
    """Append bytes; returns where the next ones go."""
    for k in range(at, end):
        out[used + k - at] = data[k]
    return used + end - at


@bare_kernel
def _comment(data, at, end):
    """Where the comment that begins at `at` ends: -1 where it is not plain or not the last thing of its line."""
    last = end
    if data[at] == 40:
        last = at + 1
        while last < end and data[last] != 41:
            if data[last] == 40:
                return -1
            last += 1
        last += 1
        if last > end:
            return -1
        for k in range(last, end):
            if data[k] != 32 and data[k] != 9:
                return -1
    for k in range(at, last):
        if (data[k] < 32 and data[k] != 9) or data[k] > 126:
            return -1
    while data[last - 1] == 32 or data[last - 1] == 9:
        last -= 1
    return last


@bare_kernel
def _words(data, at, end, value, out, used):
    """Words of a block to `value`, leading ones to `out`: (end of these, motion or -1, bits of the words, comment).

    The end is -1 where the block is not plain. comment: where it begins and ends in `data`.
    """
    seen, motion, start = 0, -1, used
    while at < end:
        c = data[at]
        if c == 32 or c == 9:
            at += 1
            continue
        if c == 40 or c == 59:
            return used, motion, seen, at, _comment(data, at, end)
        slot = _SLOT[c] if c < 128 else -1
        if slot < 0 or seen >> slot & 1 or (slot == _N and seen):
            return -1, motion, seen, at, at
        number, after = _number(data, at + 1, end)
        if after < 0:
            return -1, motion, seen, at, at
        seen |= 1 << slot
        value[slot] = number
        if slot == _G:
            motion = int(number) if 0.0 <= number <= 3.0 else -1
            if motion != number or data[at + 1] == 45:
                return -1, motion, seen, at, at
        if slot >= _G and not (slot == _G and motion > 1):
            if used > start:
                out[used] = 32
                used += 1
            used = _copy(data, at, after, out, used)
        at = after
    return used, motion, seen, end, end


@bare_kernel
def _goal(value, seen, here, mode, goal):
    """Where the block's words lead to; False where a word is too large or an increment starts nowhere."""
    for n in range(here.size):
        goal[n] = here[n]
        if seen >> n & 1:
            if not abs(value[n]) <= mode.coordinate:
                return False
            step = value[n] * mode.scale if n < _ROTARY else value[n]
            goal[n] = step if mode.absolute else here[n] + step
            if goal[n] != goal[n]:
                return False
    return True


@bare_kernel
def distance(x, y):
    """Length of a vector in a plane."""
    return math.sqrt(x * x + y * y)


@bare_kernel
def centre_from_radius(x0, y0, x1, y1, radius, clockwise):
    """Centre of the arc between two places, and whether there is one. A negative radius takes the longer way."""
    chord = distance(x1 - x0, y1 - y0)
    if chord == 0.0 or chord > 2 * abs(radius) + 1e-6:
        return 0.0, 0.0, False
    height = math.sqrt(max(radius * radius - chord * chord / 4, 0.0))
    side = 1.0 if (radius > 0) != clockwise else -1.0
    return (
        (x0 + x1) / 2 + side * height * (-(y1 - y0) / chord),
        (y0 + y1) / 2 + side * height * ((x1 - x0) / chord),
        True,
    )


@bare_kernel
def radii_agree(at_start, at_end):
    """Whether the radii of an arc's two ends, mm, are the same: within 0.0254 mm or 0.1 % (LinuxCNC)."""
    return abs(at_start - at_end) <= max(0.0254, 1e-3 * at_start)


@bare_kernel
def _centre(value, seen, here, goal, mode, clockwise):
    """Centre of an arc in its plane, and whether its words say one."""
    a, b = mode.first, mode.second
    if seen >> (6 + mode.through) & 1 or not mode.centres:
        return 0.0, 0.0, False
    for n in range(6, 10):
        if seen >> n & 1 and not abs(value[n]) <= mode.radius:
            return 0.0, 0.0, False
    if seen >> 9 & 1:
        none = not seen & (0b111 << 6)
        x, y, exists = centre_from_radius(here[a], here[b], goal[a], goal[b], value[9] * mode.scale, clockwise)
        return x, y, exists and none
    i = value[6 + a] * mode.scale if seen >> (6 + a) & 1 else 0.0
    j = value[6 + b] * mode.scale if seen >> (6 + b) & 1 else 0.0
    x, y = here[a] + i, here[b] + j
    agree = radii_agree(distance(here[a] - x, here[b] - y), distance(goal[a] - x, goal[b] - y))
    return x, y, agree and seen & _CENTRE != 0


@bare_kernel
def arc_shape(here, goal, x, y, first, second, counter, turns, chord_error, longest):
    """Angle at the start and swept, radii at both ends, segments: straight ones stay within `chord_error` of the arc.

    A radius that changes makes a spiral. At least four segments, none longer than `longest`.
    """
    turn = 2 * math.pi
    a = math.atan2(here[second] - y, here[first] - x)
    b = math.atan2(goal[second] - y, goal[first] - x)
    sweep = (b - a) % turn if counter else -((a - b) % turn)
    if distance(goal[first] - here[first], goal[second] - here[second]) < 1e-9:
        sweep = turn if counter else -turn
    sweep += math.copysign(turn * (turns - 1), sweep)
    r0 = distance(here[first] - x, here[second] - y)
    r1 = distance(goal[first] - x, goal[second] - y)
    widest = 2 * math.acos(max(1 - min(chord_error / max(r0, r1, 1e-9), 1.0), -1.0))
    widest = max(widest, 1e-9)  # rad: the cosine of less is 1 in double precision
    pieces = max(4.0, math.ceil(abs(sweep) / widest), math.ceil(abs(sweep) * max(r0, r1) / longest))
    return a, sweep, r0, r1, int(pieces)


@bare_kernel
def straight_pieces(here, goal, longest):
    """How many segments of at most `longest` a straight line is split into."""
    x, y, z = goal[0] - here[0], goal[1] - here[1], goal[2] - here[2]
    return max(1, int(math.ceil(math.sqrt(x * x + y * y + z * z) / longest)))


@bare_kernel
def straight_points(here, goal, pieces, out):
    """Ends of the segments of a straight line, all axes in step."""
    for k in range(pieces - 1):
        share = (k + 1) * (1.0 / pieces)
        for n in range(here.size):
            out[k, n] = here[n] + share * (goal[n] - here[n])
    for n in range(here.size):
        out[pieces - 1, n] = goal[n]


@bare_kernel
def arc_points(here, goal, x, y, first, second, shape, out):
    """Ends of the segments of an arc of this `arc_shape`; the axes outside its plane in step."""
    a, sweep, r0, r1, pieces = shape
    straight_points(here, goal, pieces, out)
    for k in range(pieces - 1):
        share = (k + 1) * (1.0 / pieces)
        radius, angle = r0 + share * (r1 - r0), a + share * sweep
        out[k, first] = x + radius * math.cos(angle)
        out[k, second] = y + radius * math.sin(angle)


@bare_kernel
def chord_error_of(shape):
    """Largest distance between an arc and its segments."""
    _, sweep, r0, r1, pieces = shape
    return max(r0, r1) * (1 - math.cos(abs(sweep) / pieces / 2))


@bare_kernel
def _turning_from_nowhere(seen, here):
    """Whether a rotary axis is named of which nobody knows where it stands."""
    for n in range(_ROTARY, here.size):
        if seen >> n & 1 and here[n] != here[n]:
            return True
    return False


@bare_kernel
def _path(value, seen, motion, here, goal, mode, points):
    """Tool points of a block into `points`: (how many, chord error); 0 where it is not plain, -1 without room."""
    x, y, exists, error = 0.0, 0.0, not seen & _CENTRE, 0.0
    shape = (0.0, 0.0, 0.0, 0.0, 1)
    if motion > 1:
        x, y, exists = _centre(value, seen, here, goal, mode, motion == 2)
    if not exists:
        return 0, error
    if motion > 1:
        shape = arc_shape(here, goal, x, y, mode.first, mode.second, motion == 3, 1, mode.chord_error, mode.longest)
        error = chord_error_of(shape)
    pieces = straight_pieces(here, goal, mode.longest) if motion == 1 else shape[4]
    if pieces > mode.segments or (pieces > 1 and _turning_from_nowhere(seen, here)):
        return 0, error
    if pieces > points.shape[0]:
        return -1, error
    if motion > 1:
        arc_points(here, goal, x, y, mode.first, mode.second, shape, points)
    else:
        straight_points(here, goal, pieces, points)
    return pieces, error


@bare_kernel
def read(data, cursor, here, mode, rows, value, goal):
    """Read plain blocks until another one, the end of `data`, or want of room: (whether that is it, chord error).

    data: the program's bytes; cursor: place in them, line number, rows used, bytes used, G0 to G3 (-1: none) and
    motions so far; here: (6,) where the axes stand, NaN: not known; value, goal: room for words (14,) and axes (6,).
    """
    worst = 0.0
    if not (here[0] == here[0] and here[1] == here[1] and here[2] == here[2]):
        return False, worst
    while cursor[POSITION] < data.size:
        begin = end = cursor[POSITION]
        while end < data.size and data[end] != 10:
            end += 1
        after = end + 1
        if end > begin and data[end - 1] == 13:
            end -= 1
        if end - begin > mode.line:
            break
        text, row = cursor[TEXT], cursor[ROW]
        used, motion, seen, remark, remark_end = _words(data, begin, end, value, rows.bytes, text)
        if used < 0 or remark_end < 0 or not seen & _AXES:
            break
        motion = motion if motion >= 0 else cursor[MOTION]
        if motion < 0 or not _goal(value, seen, here, mode, goal):
            break
        pieces, error = _path(value, seen, motion, here, goal, mode, rows.points[row:])
        if pieces <= 0:
            return pieces < 0, worst
        if motion > 1:
            if used > text:
                rows.bytes[used] = 32
                used += 1
            rows.bytes[used], rows.bytes[used + 1] = 71, 49  # G1
            used += 2
        cursor[TEXT] = _copy(data, remark, remark_end, rows.bytes, used)
        for k in range(row, row + pieces):
            rows.given[k], rows.number[k], rows.text[k, :] = seen & _AXES, cursor[LINE], 0
        rows.text[row, 0], rows.text[row, 1], rows.text[row, 2] = text, used, cursor[TEXT]
        for n in range(here.size):
            here[n] = goal[n]
        worst = max(worst, error)
        cursor[ROW], cursor[POSITION], cursor[MOTION] = row + pieces, min(after, data.size), motion
        cursor[LINE] += 1
        cursor[MOVES] += 1
    return False, worst


@bare_kernel
def _digits(value, decimals, out, used):
    """Append a number of at most 15 digits that was rounded to so many decimals."""
    whole = np.int64(np.rint(abs(value) * _POWER[decimals]))
    if value < 0.0:
        out[used] = 45
        used += 1
    size, rest = 1, whole // 10
    while rest > 0 or size <= decimals:
        size, rest = size + 1, rest // 10
    size += decimals > 0  # the point
    for k in range(size):
        if k == decimals and decimals > 0:
            out[used + size - 1 - k] = 46
        else:
            out[used + size - 1 - k] = 48 + whole % 10
            whole //= 10
    return used + size


@bare_kernel
def write(shown, decimals, text, texts, out, ends):
    """Rows as lines: leading words, the axes, a comment, with a blank between; returns how many are not empty.

    shown: (n, 6) words of X to C, rounded to `decimals` (6,), NaN: none; text, texts: as in `Rows`; ends: where each
    line ends in `out`.
    """
    used, kept = 0, 0
    for k in range(shown.shape[0]):
        begin = used
        used = _copy(texts, text[k, 0], text[k, 1], out, used)
        for n in range(shown.shape[1]):
            if shown[k, n] == shown[k, n]:
                if used > begin:
                    out[used] = 32
                    used += 1
                out[used] = 88 + n if n < _ROTARY else 62 + n  # X, Y, Z, A, B, C
                used = _digits(shown[k, n], decimals[n], out, used + 1)
        if text[k, 2] > text[k, 1]:
            if used > begin:
                out[used] = 32
                used += 1
            used = _copy(texts, text[k, 1], text[k, 2], out, used)
        if used > begin:
            out[used] = 10
            used += 1
            kept += 1
        ends[k] = used
    return kept
