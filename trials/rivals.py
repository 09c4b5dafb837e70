"""Textbook forms of any scale, to find which other effects a recording cannot tell from the hidden one.

Written for this purpose, independently of the library that is judged. Every range follows from the recording's own
travel, length and sampling. A rival is accepted as a name of the hidden contribution where its form, with a constant
beside it, explains at least EXPLAINS of it, or where what it leaves is lost in the noise once the gains of what the
simulation holds may move as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from .folder import Array, Sheet

EXPLAINS = 0.97  # as in the first generator and the public sample's key
RULED_OUT = 18.0  # sum of squares left, in variances of the noise: chi-square of 9, a reading counted as half
BUMPS = (0.1, 0.2, 0.4, 0.7)  # widths of worn stretches, in half travels: on a few places a bow and a bump are one
Form = tuple[str, tuple[str, ...], Array]  # effect, drivers, columns (rows, k)


def first_order(t: Array, u: Array, tau: float) -> Array:
    """tau dy/dt + y = u, u straight between rows, settled at the start; starts again where time steps back."""
    y = np.empty_like(u, dtype=float)
    y[0] = u[0]
    dt = np.diff(t)
    for i in range(1, u.size):
        h = dt[i - 1]
        if h < 0:
            y[i] = u[i]
            continue
        keep = np.exp(-h / tau)
        slope = (u[i] - u[i - 1]) / h if h > 0 else 0.0
        y[i] = u[i] - slope * tau + (y[i - 1] - u[i - 1] + slope * tau) * keep
    return y


def accepted(
    sheet: Sheet, component: str, effect: str, hidden: Array, base: list[Array] | None = None, noise: float = 0.0
) -> tuple[list[str], dict[str, list[str]]]:
    """Names the key accepts for a hidden contribution, the true one first, and the drivers of each.

    base: what the simulation holds, whose gains may move; noise: rms of the measuring noise. Shapes (rows,).
    """
    names, drivers = [effect], {}
    pick = np.arange(0, hidden.size, max(1, hidden.size // 3000))
    y = hidden[pick] - hidden[pick].mean()
    beside = np.column_stack([np.ones(pick.size), *(b[pick] for b in base or [])])
    lost = RULED_OUT * noise**2 * pick.size / hidden.size
    for name, used, design in forms(sheet):
        if not possible(name, component, sheet.columns[used[0]].get("axis")):
            continue
        x = design[pick] - design[pick].mean(axis=0)
        size = np.sqrt((x**2).mean(axis=0))
        x = x[:, size > 1e-12] / size[size > 1e-12]
        if not x.size or not np.all(np.isfinite(x)):
            continue
        alike = _left(y, x) <= (1 - EXPLAINS) * float(y @ y)
        if alike or (noise and _left(y, np.hstack([beside, x])) <= lost):
            if name not in names:
                names.append(name)
            drivers.setdefault(name, [])
            drivers[name] += [d for d in used if d not in drivers[name]]
    return names, drivers


def _left(y: Array, x: Array) -> float:
    """Sum of squares that a fit of the columns leaves."""
    return float(np.sum((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2))


FORCES = {"coulomb_friction", "viscous_friction", "stribeck_friction", "torque_ripple"}
ON_FORCES = FORCES | {"friction_hysteresis", "tool_wear", "sensor_drift", "thermal_drift", "thermal_lag"}
ALONG = {"scale_error", "scale_expansion"}  # along the axis itself, where a component says which
ACROSS = {"squareness", "straightness", "gravity_sag"}  # across it


def possible(effect: str, component: str, axis: str | None) -> bool:
    """Whether an effect of an axis (None: of no axis) can be named on a component at all."""
    if component.startswith("F_"):
        return effect in ON_FORCES
    if effect in FORCES:
        return False
    direction = component[2] if component.startswith("E_") else component[1]
    if axis is not None and effect in ALONG:
        return axis == direction
    if axis is not None and effect in ACROSS:
        return axis != direction
    return True


def forms(sheet: Sheet) -> Iterator[Form]:
    """Every textbook form that the columns allow."""
    value = {n: sheet.values(n) for n, s in sheet.columns.items() if s["role"] not in ("run", "group", "ignore")}
    for t in sheet.names("time"):
        yield "sensor_drift", (t,), value[t][:, None]
    yield from _places(sheet, value)
    yield from _temperatures(sheet, value)
    yield from _motion(sheet, value)
    yield from _process(sheet, value)


def _places(sheet: Sheet, value: dict[str, Array]) -> Iterator[Form]:
    places = sheet.names("position")
    for p in places:
        x = value[p]
        low, span = np.nanmin(x), max(np.ptp(x), 1e-30)
        u = 2 * (x - low) / span - 1
        yield "scale_error", (p,), u[:, None]
        yield "squareness", (p,), u[:, None]
        yield "straightness", (p,), np.column_stack([u**2, u**3])
        yield "gravity_sag", (p,), np.column_stack([u, u**2])
        for centre in np.linspace(-1, 1, 9):
            for width in BUMPS:
                yield "local_wear", (p,), np.exp(-0.5 * ((u - centre) / width) ** 2)[:, None]
        for q in places:
            if q != p:
                yield "angular_abbe", (p, q), np.column_stack([value[q], value[q] * u])
        for side in sheet.names("direction"):
            yield "backlash", (side,), value[side][:, None]
            yield "friction_hysteresis", (side, p), value[side][:, None]
            for end in (0, 1):
                yield "screw_windup", (side, p), (value[side] * np.abs((x - low) / span - end))[:, None]


def _temperatures(sheet: Sheet, value: dict[str, Array]) -> Iterator[Form]:
    sensors = sheet.names("temperature")
    rise = {s: value[s] - value[s][0] for s in sensors}
    times = sheet.names("time")
    for s in sensors:
        yield "thermal_drift", (s,), rise[s][:, None]
        yield "thermal_interaction", (s,), (rise[s] ** 2)[:, None]
        for p in sheet.names("position"):
            yield "scale_expansion", (p, s), (value[p] * rise[s])[:, None]
        if times:
            yield from _lags(sheet, value[times[0]], value, s)
    for a, b in combinations(sensors, 2):
        yield "gradient_bending", (a, b), (value[a] - value[b])[:, None]
        yield "thermal_interaction", (a, b), (rise[a] * rise[b])[:, None]


def _lags(sheet: Sheet, t: Array, value: dict[str, Array], s: str) -> Iterator[Form]:
    if t.size > 20000:  # a long log: every tenth of its rows is enough for a lag
        return
    room = any(w in str(sheet.columns[s].get("location", "")) for w in ("room", "air", "ambient"))
    for tau in _taus(t):
        lag = first_order(t, value[s], tau)[:, None]
        yield "thermal_lag", (s,), lag
        if room:
            yield "ambient_drift", (s,), lag


def _taus(t: Array) -> Array:
    steps = np.diff(t)
    return np.geomspace(2 * np.median(steps[steps > 0]), np.ptp(t) / 2, 12)


def _motion(sheet: Sheet, value: dict[str, Array]) -> Iterator[Form]:
    for v in sheet.names("velocity"):
        s, fast = np.sign(value[v]), max(np.abs(value[v]).max(), 1e-30)
        yield "viscous_friction", (v,), value[v][:, None]
        yield "following_error", (v,), value[v][:, None]
        yield "coulomb_friction", (v,), s[:, None]
        yield "backlash", (v,), s[:, None]
        yield "friction_hysteresis", (v, *sheet.names("position")), s[:, None]
        for knee in (0.02, 0.05, 0.1, 0.2):
            yield "stribeck_friction", (v,), (s * np.exp(-((value[v] / (knee * fast)) ** 2)))[:, None]
    for a in sheet.names("acceleration"):
        yield "inertial_deflection", (a,), value[a][:, None]


def _process(sheet: Sheet, value: dict[str, Array]) -> Iterator[Form]:
    times = sheet.names("time")
    for n in sheet.names("spindle_speed"):
        u = value[n] / max(np.abs(value[n]).max(), 1e-30)
        yield "centrifugal_growth", (n,), (u**2)[:, None]
        if times and u.size <= 20000:
            for tau in _taus(value[times[0]]):
                for power in (0.8, 1.0, 1.5):
                    yield "spindle_growth", (n,), first_order(value[times[0]], u**power, tau)[:, None]
    for n in sheet.names("coolant"):
        yield "coolant_effect", (n,), value[n][:, None]
    for n in sheet.names("cut_length"):
        yield "tool_wear", (n,), value[n][:, None]
    for n in sheet.names("load"):
        yield "workpiece_load", (n,), value[n][:, None]
    for n in sheet.names("overhang"):
        yield "gravity_sag", (n,), np.column_stack([value[n] ** 2, value[n] ** 3])
    if any(sheet.columns[n]["component"] in ("E_D", "E_X", "E_Y", "E_Z") for n in sheet.names("error")):
        for n in sheet.names("force"):
            yield "cutting_compliance", (n,), value[n][:, None]
