"""Plain motion blocks of an NC program in bulk: bytes in, tool points out; numbers in, bytes out.

Plain is a block of ASCII words that `ncprogram` would read without a refusal and without a change of mode but G0 to G3.
Reading stops before anything else, also before whatever may have to be refused. A number is its digits over a power of
ten, both exact in double precision, so the quotient is the number that Python reads. Lengths in mm, angles in deg.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.kernels import bare_kernel
from errpipe.kernels.nc_paths import (
    arc_points,
    arc_shape,
    centre_from_radius,
    chord_error_of,
    distance,
    is_long_way_round,
    radii_agree,
    straight_pieces,
    straight_points,
)

POSITION, LINE, ROW, TEXT, MOTION, MOVES = range(6)  # what the cursor holds, see `read`
LETTERS = "XYZABCIJKRGNFS"
_G, _N = LETTERS.index("G"), LETTERS.index("N")
_SLOT = np.full(128, -1, dtype=np.int64)
_SLOT[[[ord(letter) for letter in LETTERS], [ord(letter) for letter in LETTERS.lower()]]] = np.arange(len(LETTERS))
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

    scale: mm per unit; first, second, through: axes of the plane; named: whether the program named them; centres:
    whether I, J, K are increments; longest, chord_error: mm; segments: most of a block; coordinate, radius: largest
    words; line: longest, characters.
    """

    scale: float
    absolute: bool
    first: int
    second: int
    through: int
    named: bool
    centres: bool
    longest: float
    chord_error: float
    segments: int
    coordinate: float
    radius: float
    line: int


@bare_kernel
def _number(data, at, end):
    """The number that begins at `at`, and where it ends: -1 if there is none, or none that is read exactly."""
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
def _begins_number(c):
    """Whether a byte begins a number, or stands between a letter and its number."""
    return 48 <= c <= 57 or c == 43 or c == 45 or c == 46 or c == 32 or c == 9


@bare_kernel
def _comment(data, at, end):
    """Where the comment that begins at `at` ends: -1 where it is not plain or not the last thing of its line."""
    last = end
    if data[at] == 59:
        first = at + 1
        while first < end and (data[first] == 32 or data[first] == 9):
            first += 1
        if first + 1 < end and 97 <= data[first] | 32 <= 122 and _begins_number(data[first + 1]):
            return -1  # may be a block of its own where ';' ends blocks
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
def _group(code, mode):
    """Modal group of a G code that changes nothing but the motion, -1 of another."""
    if code == 0.0 or code == 1.0 or code == 2.0 or code == 3.0:
        return 0
    if mode.named and code == 19.0 - mode.through:
        return 1
    if code == (21.0 if mode.scale == 1.0 else 20.0):
        return 2
    return 3 if code == (90.0 if mode.absolute else 91.0) else -1


@bare_kernel
def _words(data, at, end, mode, value, out, used):
    """Words of a block to `value`, leading ones to `out`: (end of these, motion or -1, bits of the words, comment).

    The end is -1 where the block is not plain. comment: where it begins and ends in `data`.
    """
    seen, groups, motion, start = 0, 0, -1, used
    while at < end:
        c = data[at]
        if c == 32 or c == 9:
            at += 1
            continue
        if c == 40 or c == 59:
            return used, motion, seen, at, (-1 if groups & 9 == 8 else _comment(data, at, end))
        slot = _SLOT[c] if c < 128 else -1
        if slot < 0 or (seen >> slot & 1 and slot != _G) or (slot == _N and seen):
            return -1, motion, seen, at, at
        number, after = _number(data, at + 1, end)
        if after < 0:
            return -1, motion, seen, at, at
        seen |= 1 << slot
        value[slot] = number
        group = -1
        if slot == _G:
            group = _group(number, mode)
            if group < 0 or groups >> group & 1 or data[at + 1] == 45:
                return -1, motion, seen, at, at
            groups |= 1 << group
            motion = int(number) if group == 0 else motion
        if slot >= _G and not (group == 0 and motion > 1):
            if used > start:
                out[used] = 32
                used += 1
            used = _copy(data, at, after, out, used)
        at = after
    if groups & 9 == 8:  # G90 or G91 without G0 to G3: may be a turning cycle
        return -1, motion, seen, end, end
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
def _centre(value, seen, here, goal, mode, clockwise):
    """Centre of an arc in its plane, and whether its words say one."""
    a, b = mode.first, mode.second
    if seen >> (6 + mode.through) & 1 or not mode.centres:
        return 0.0, 0.0, False
    if not mode.named and not seen >> b & 1 and not seen >> (6 + b) & 1:
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
def _turns_unknown(seen, here, goal):
    """Whether a rotary axis is named whose position or direction of rotation is unknown."""
    unknown = False
    for n in range(_ROTARY, here.size):
        unknown |= bool(seen >> n & 1 and (here[n] != here[n] or is_long_way_round(here[n], goal[n])))
    return unknown


@bare_kernel
def _may_be_drawing(seen, motion, here, mode):
    """Whether A or C may be an angle or a chamfer of a lathe's drawing: not if its position is known, or on a mill."""
    mill = seen >> 1 & 1 or (mode.named and mode.through == 2)
    unknown = (seen >> 3 & 1 and here[3] != here[3]) or (seen >> 5 & 1 and here[5] != here[5])
    return bool(motion == 1 and unknown and not mill)


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
    if pieces > mode.segments or (pieces > 1 and _turns_unknown(seen, here, goal)):
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
        used, motion, seen, remark, remark_end = _words(data, begin, end, mode, value, rows.bytes, text)
        if used < 0 or remark_end < 0 or not seen & _AXES:
            break
        motion = motion if motion >= 0 else cursor[MOTION]
        if motion < 0 or _may_be_drawing(seen, motion, here, mode) or not _goal(value, seen, here, mode, goal):
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
def words(commands, given, scale, decimals, absolute, last, shown):
    """Words of the linear axes, NaN for none, into `shown`: (largest of them, its row); NaN where one is not known.

    commands: (n, 3) mm; given: as in `Rows`; scale: mm per unit; last: (3,) the places before, and after.
    """
    farthest, row, ten = 0.0, 0, _POWER[decimals]
    for k in range(commands.shape[0]):
        for n in range(_ROTARY):
            value = np.rint(commands[k, n] / scale * ten) / ten + 0.0
            word = value if absolute else np.rint((value - last[n]) * ten) / ten + 0.0
            size = abs(word)
            if not size <= farthest and farthest == farthest:
                farthest, row = size, k
            shown[k, n] = word if given[k] >> n & 1 or value != last[n] else np.nan
            shown[k, _ROTARY + n] = np.nan
            last[n] = value
    return farthest, row


@bare_kernel
def _digits(value, decimals, out, used):
    """Append a number of at most 15 digits that was rounded to so many decimals."""
    whole, ten = np.uint64(np.rint(abs(value) * _POWER[decimals])), np.uint64(10)
    if value < 0.0:
        out[used] = 45
        used += 1
    size, above = 1, ten
    while above <= whole or size <= decimals:
        size, above = size + 1, above * ten
    size += decimals > 0  # the point
    for k in range(used + size - 1, used - 1, -1):
        if k == used + size - 1 - decimals and decimals > 0:
            out[k] = 46
        else:
            rest = whole // ten
            out[k] = whole - rest * ten + np.uint64(48)
            whole = rest
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
