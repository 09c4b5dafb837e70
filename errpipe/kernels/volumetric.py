"""Deviation of tool against workpiece along a serial chain: exact, first order, and its Jacobian.

The chain is a flat list of factors from workpiece to tool. kind 0: straight motion along `vec` by q[axis] (mm);
1: turn about `vec` through `point` by q[axis] (deg); 2: a small error motion about `point`, whose three shifts
(um) and three angles (urad) are sums over its entries, each one component times one vector. Everything is in
machine coordinates with all axes at zero, so a factor needs no frame of its own.

Deviations come out in the workpiece's frame: three shifts in um, then three angles in urad.
"""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel

MOVE, TURN, ERROR = 0, 1, 2  # kinds of steps along a chain
UM = 1e-3  # mm per um; also um per (mm urad)
URAD = 1e-6  # rad
DEG = np.pi / 180.0  # rad


@kernel
def _turn(v, angle, p):
    """Rodrigues: p turned about the unit vector v, in place."""
    c, s = np.cos(angle), np.sin(angle)
    dot = (v[0] * p[0] + v[1] * p[1] + v[2] * p[2]) * (1.0 - c)
    x = p[0] * c + (v[1] * p[2] - v[2] * p[1]) * s + v[0] * dot
    y = p[1] * c + (v[2] * p[0] - v[0] * p[2]) * s + v[1] * dot
    z = p[2] * c + (v[0] * p[1] - v[1] * p[0]) * s + v[2] * dot
    p[0], p[1], p[2] = x, y, z


@kernel
def _turn_small(e, p):
    """p turned by the rotation vector e (rad), in place; exact, and accurate for tiny e."""
    a2 = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    if a2 < 1e-8:
        s, k = 1.0 - a2 / 6.0, 0.5 - a2 / 24.0
    else:
        a = np.sqrt(a2)
        s, k = np.sin(a) / a, (1.0 - np.cos(a)) / a2
    cx = e[1] * p[2] - e[2] * p[1]
    cy = e[2] * p[0] - e[0] * p[2]
    cz = e[0] * p[1] - e[1] * p[0]
    x = p[0] + s * cx + k * (e[1] * cz - e[2] * cy)
    y = p[1] + s * cy + k * (e[2] * cx - e[0] * cz)
    z = p[2] + s * cz + k * (e[0] * cy - e[1] * cx)
    p[0], p[1], p[2] = x, y, z


@kernel
def _product(a, b):
    """Matrix product of two (3, 3), summed in the order of their rows."""
    out = np.zeros((3, 3))
    for i in range(3):
        for k in range(3):
            for j in range(3):
                out[i, j] += a[i, k] * b[k, j]
    return out


@kernel
def _error(first, last, entry_comp, entry_angle, entry_vec, comps, d, e):
    """Shift d (mm) and rotation vector e (rad) of one error factor."""
    for k in range(3):
        d[k] = e[k] = 0.0
    for i in range(first, last):
        c = comps[entry_comp[i]]
        for k in range(3):
            if entry_angle[i]:
                e[k] += c * URAD * entry_vec[i, k]
            else:
                d[k] += c * UM * entry_vec[i, k]


@kernel
def _move_ideal(kind, step, vec, point, p):
    """Carry point p through an ideal motion by `step` (mm or deg), in place; an error factor leaves it."""
    if kind == MOVE:
        for k in range(3):
            p[k] += step * vec[k]
    elif kind == TURN:
        for k in range(3):
            p[k] -= point[k]
        _turn(vec, step * DEG, p)
        for k in range(3):
            p[k] += point[k]


@kernel
def _through(factors, f, q, comps, p, r, d, e):
    """Carry point p and the rows of r (images of x, y, z) through factor f. comps empty: without errors."""
    kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec = factors
    if kind[f] != ERROR:
        _move_ideal(kind[f], q[axis[f]], vec[f], point[f], p)
        for k in range(3 if kind[f] == TURN else 0):
            _turn(vec[f], q[axis[f]] * DEG, r[k])
    elif comps.size > 0:
        _error(entries[f], entries[f + 1], entry_comp, entry_angle, entry_vec, comps, d, e)
        for k in range(3):
            p[k] -= point[f, k]
            if inverse[f]:  # the shift comes off before the opposite rotation
                p[k], d[k], e[k] = p[k] - d[k], 0.0, -e[k]
        _turn_small(e, p)
        for k in range(3):
            p[k] += point[f, k] + d[k]
            _turn_small(e, r[k])


@kernel
def _rotation_between(ideal, actual, out):
    """Rotation vector (urad) of actual = R ideal; rows are images of x, y, z; for angles far below 1 rad."""
    m = _product(actual.T, ideal)
    x = 0.5 * (m[2, 1] - m[1, 2])
    y = 0.5 * (m[0, 2] - m[2, 0])
    z = 0.5 * (m[1, 0] - m[0, 1])
    s2 = x * x + y * y + z * z
    s = np.sqrt(s2)
    factor = 1.0 + s2 / 6.0 if s < 1e-4 else np.arcsin(min(1.0, s)) / s
    out[0], out[1], out[2] = x * factor / URAD, y * factor / URAD, z * factor / URAD


@kernel
def pose(kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec, q, tip, comps):
    """Tool tip and its axes in the workpiece frame, shape (n, 4, 3): tip, then images of x, y, z.

    q (n, axes), tip (n, 3) with all axes at zero, comps (n, components), or (n, 0) for the ideal machine.
    """
    factors = kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec
    n, unturned = q.shape[0], np.eye(3)
    out, d, e = np.empty((n, 4, 3)), np.empty(3), np.empty(3)
    for i in range(n):
        p, r = out[i, 0], out[i, 1:]
        p[:] = tip[i]
        r[:] = unturned
        for f in range(kind.size - 1, -1, -1):
            _through(factors, f, q[i], comps[i], p, r, d, e)
    return out


@kernel
def exact(kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec, q, tip, comps):
    """Deviation by full transforms, shape (n, 6): um, urad, in the ideal workpiece frame."""
    n = q.shape[0]
    none = np.empty((n, 0))
    ideal = pose(kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec, q, tip, none)
    actual = pose(kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec, q, tip, comps)
    out = np.empty((n, 6))
    for i in range(n):
        for k in range(3):
            out[i, k] = (actual[i, 0, k] - ideal[i, 0, k]) / UM
        _rotation_between(ideal[i, 1:], actual[i, 1:], out[i, 3:])
    return out


@kernel
def _sweep(kind, axis, vec, point, q, tip, arm, pre):
    """Per factor: its arm (ideal tip minus its point, mm) and the ideal turn before it (rows: images of x, y, z)."""
    p, r, turned = tip.copy(), np.eye(3), np.empty(3)
    for f in range(kind.size - 1, -1, -1):
        for k in range(3):
            arm[f, k] = p[k] - point[f, k]
        if kind[f] == MOVE:  # as `_move_ideal`, whose call with slices takes as long as all the rest
            for k in range(3):
                p[k] += q[axis[f]] * vec[f, k]
        elif kind[f] == TURN:
            for k in range(3):
                p[k] -= point[f, k]
            _turn(vec[f], q[axis[f]] * DEG, p)
            for k in range(3):
                p[k] += point[f, k]
    for f in range(kind.size):
        for k in range(3):
            for m in range(3):
                pre[f, k, m] = r[k, m]
        if kind[f] != TURN:
            continue
        for k in range(3):  # r <- r * turn: the image of e_k is r applied to turned e_k
            for m in range(3):
                turned[m] = 1.0 if m == k else 0.0
                r[k, m] = 0.0
            _turn(vec[f], q[axis[f]] * DEG, turned)
            for m in range(3):
                for j in range(3):
                    r[k, j] += turned[m] * pre[f, m, j]


@kernel
def jacobian(kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec, q, tip, components):
    """d(deviation)/d(component), shape (n, 6, components): um/um, um/urad, urad/urad."""
    n = q.shape[0]
    out = np.zeros((n, 6, components))
    arm, pre, w = np.empty((kind.size, 3)), np.empty((kind.size, 3, 3)), np.empty(3)
    for i in range(n):
        _sweep(kind, axis, vec, point, q[i], tip[i], arm, pre)
        for f in range(kind.size):
            if kind[f] != ERROR:
                continue
            sign, a = -1.0 if inverse[f] else 1.0, arm[f]
            for t in range(entries[f], entries[f + 1]):
                c, v = entry_comp[t], entry_vec[t]
                w[0], w[1], w[2] = v[0], v[1], v[2]
                if entry_angle[t]:  # a rotation shifts the tip by its cross product with the arm
                    w[0] = (v[1] * a[2] - v[2] * a[1]) * UM
                    w[1] = (v[2] * a[0] - v[0] * a[2]) * UM
                    w[2] = (v[0] * a[1] - v[1] * a[0]) * UM
                for k in range(3):
                    for m in range(3):
                        out[i, m, c] += sign * w[k] * pre[f, k, m]
                for k in range(3 if entry_angle[t] else 0):
                    for m in range(3):
                        out[i, 3 + m, c] += sign * v[k] * pre[f, k, m]
    return out


@kernel
def first_order(kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec, q, tip, comps):
    """Deviation to first order in the components, shape (n, 6): um, urad."""
    n = q.shape[0]
    out = np.zeros((n, 6))
    arm, pre = np.empty((kind.size, 3)), np.empty((kind.size, 3, 3))
    d, e, w = np.empty(3), np.empty(3), np.empty(3)
    for i in range(n):
        _sweep(kind, axis, vec, point, q[i], tip[i], arm, pre)
        for f in range(kind.size):
            if kind[f] != ERROR:
                continue
            _error(entries[f], entries[f + 1], entry_comp, entry_angle, entry_vec, comps[i], d, e)
            a = arm[f]
            w[0] = d[0] + e[1] * a[2] - e[2] * a[1]
            w[1] = d[1] + e[2] * a[0] - e[0] * a[2]
            w[2] = d[2] + e[0] * a[1] - e[1] * a[0]
            sign = -1.0 if inverse[f] else 1.0
            for k in range(3):
                for m in range(3):
                    out[i, m] += sign * w[k] * pre[f, k, m] / UM
                    out[i, 3 + m] += sign * e[k] * pre[f, k, m] / URAD
    return out


@kernel
def second_order_bound(kind, axis, vec, point, inverse, entries, entry_comp, entry_angle, entry_vec, q, tip, comps):
    """Upper bound of |exact - first order| of the tip, um, shape (n,).

    Going from the tool inwards, factor k moves a point already displaced by D. With |R - I| <= |e| and
    |R - I - [e]x| <= |e|^2 / 2 it departs from first order by at most |e|^2/2 (arm + D) + |e| D (+ |e||d|
    for an inverse), and D grows by at most |e| (arm + D) + |d|.
    """
    out = np.zeros(q.shape[0])
    arm, pre = np.empty((kind.size, 3)), np.empty((kind.size, 3, 3))
    d, e = np.empty(3), np.empty(3)
    for i in range(out.size):
        _sweep(kind, axis, vec, point, q[i], tip[i], arm, pre)
        displaced = 0.0
        for f in range(kind.size - 1, -1, -1):
            if kind[f] != ERROR:
                continue
            _error(entries[f], entries[f + 1], entry_comp, entry_angle, entry_vec, comps[i], d, e)
            angle, shift, reach = _length(e), _length(d), _length(arm[f])
            out[i] += 0.5 * angle * angle * (reach + displaced) + angle * displaced
            if inverse[f]:
                out[i] += angle * shift
            displaced += angle * (reach + displaced) + shift
        out[i] /= UM
    return out


@kernel
def _length(v):
    """Euclidean length of a vector of three."""
    return np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)


@kernel
def curves(position, start, step, table):
    """Linear interpolation in uniform tables of one axis, held at the ends; table (nodes, m) -> (n, m)."""
    n, last, m = position.size, table.shape[0] - 1, table.shape[1]
    out = np.empty((n, m))
    for i in range(n):
        s = min(max((position[i] - start) / step, 0.0), float(last))
        j = min(int(s), last - 1)
        f = s - j
        for k in range(m):
            out[i, k] = table[j, k] + f * (table[j + 1, k] - table[j, k])
    return out
