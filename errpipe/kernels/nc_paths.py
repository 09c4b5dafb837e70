"""Lines and arcs of an NC program as straight segments. Lengths in mm, angles in rad, of rotary axes in deg.

Both ways to read a program come here, block by block and in bulk, so that both give the same bits.
"""

from __future__ import annotations

import math

from errpipe.kernels import bare_kernel


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
def is_long_way_round(start, end):
    """Whether angles of one turn, deg, lie further apart than half of it: a control may go the other way."""
    return 0.0 <= start < 360.0 and 0.0 <= end < 360.0 and abs(end - start) > 180.0


@bare_kernel
def radii_agree(at_start, at_end):
    """Whether the radii of an arc's two ends, mm, are the same: within 0.0254 mm or 0.1 % (LinuxCNC)."""
    return abs(at_start - at_end) <= max(0.0254, 1e-3 * at_start)


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
    return max(1, math.ceil(math.sqrt(x * x + y * y + z * z) / longest))


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
