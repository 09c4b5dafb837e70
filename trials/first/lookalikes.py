"""Textbook forms of the effects, to find which others a recording cannot tell from the hidden one.

Written for this purpose alone and independently of errpipe's terms; the true mechanisms are not made from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from .case import Array, Bench, Contribution

EXPLAINS = 0.97  # share of the hidden contribution that another effect's textbook form explains
LAGS = np.geomspace(150, 30000, 13)


@dataclass
class Form:
    """One textbook design: columns (rows, k) to be fitted with a constant."""

    effect: str
    drivers: tuple[str, ...]
    design: Array
    tau: float | None = None


def lagged(t: Array, u: Array, taus: Array, *, steps: bool = False) -> Array:
    """First-order lags (rows, taus) of u: straight between rows, settled at the start; with `steps` held, cold."""
    out = np.empty((t.size, taus.size))
    dt = np.maximum(np.diff(t), 0.0)
    keep = np.exp(-dt[:, None] / taus)
    if steps:
        before = after = np.repeat(u[:-1, None], taus.size, axis=1)
        state = np.zeros(taus.size)
    else:
        trail = (np.diff(u) / np.maximum(dt, 1e-9))[:, None] * taus
        before, after = u[:-1, None] - trail, u[1:, None] - trail
        state = np.full(taus.size, u[0])
    out[0] = state
    for i in range(1, t.size):
        state = after[i - 1] + (state - before[i - 1]) * keep[i - 1]
        out[i] = state
    return out


def by_role(bench: Bench, role: str) -> list[str]:
    return [name for name, c in bench.columns.items() if c.spec["role"] == role]


def _held(shown: Array) -> Array:
    """Empty cells take the last value."""
    seen = np.maximum.accumulate(np.where(np.isnan(shown), 0, np.arange(shown.size)))
    return shown[seen]


def _col(*arrays: Array) -> Array:
    return np.column_stack(arrays)


def forms(bench: Bench, display: tuple[str, Array] | None = None) -> Iterator[Form]:
    """Every textbook form that the columns allow; `display` replaces a column by what a faulty sensor shows."""
    t = bench.time()
    value = {n: c.values for n, c in bench.columns.items()}
    if display is not None:
        value[display[0]] = _held(display[1])
    yield Form("sensor_drift", ("t",), _col(t))
    yield from _axes(bench, value)
    yield from _thermal(bench, value, t)
    yield from _process(bench, value, t)


def _axes(bench: Bench, value: dict[str, Array]) -> Iterator[Form]:
    positions = by_role(bench, "position")
    axis_of = {n: bench.columns[n].spec["axis"] for n in positions}
    sides = _sides(bench, value)
    for p in positions:
        x, facts = value[p], bench.constants.get(axis_of[p], {})
        low, high = x.min(), x.max()
        u = 2 * (x - low) / max(high - low, 1e-9) - 1
        yield from _circular_or_plain(bench, value, p, x, u, positions)
        if "screw_lead" in facts:
            a = 2 * np.pi * x / facts["screw_lead"]
            waves = _col(np.sin(a), np.cos(a), np.sin(2 * a), np.cos(2 * a))
            yield Form("pitch_cyclic", (p,), waves * np.reshape(_radial(bench, value, p), (-1, 1)))
        if "encoder_period" in facts:
            a = 2 * np.pi * x / facts["encoder_period"]
            yield Form("interpolation", (p,), _col(np.sin(a), np.cos(a), np.sin(2 * a), np.cos(2 * a)))
        for width in (0.04, 0.06, 0.08) if bench.protocol != "volumetric grid" else ():
            for centre in np.linspace(low, high, 25):
                bump = np.exp(-0.5 * ((x - centre) / (width * (high - low))) ** 2)
                yield Form("local_wear", (p,), _col(bump * _radial(bench, value, p)))
        side = sides.get(axis_of[p])
        if side is not None:
            name, s = side
            weight = _radial(bench, value, p)
            yield Form("backlash", (name,), _col(s * weight))
            ends = [facts["drive_end"]] if "drive_end" in facts else facts.get("travel", [low, high])
            for end in ends:
                yield Form("screw_windup", (name, p), _col(s * np.abs(x - end) * weight))
    if bench.protocol == "volumetric grid":
        yield from _volume(bench, value, positions)


def _radial(bench: Bench, value: dict[str, Array], p: str) -> Array | float:
    if bench.protocol != "circular test":
        return 1.0
    r = np.hypot(value["x"], value["y"])
    return value[p] / r


def _sides(bench: Bench, value: dict[str, Array]) -> dict[str, tuple[str, Array]]:
    out = {}
    for n, c in bench.columns.items():
        if c.spec["role"] == "velocity":
            out.setdefault(c.spec["axis"], (n, np.sign(value[n])))
        if c.spec["role"] == "direction":
            out[c.spec["axis"]] = (n, value[n])
    return out


def _circular_or_plain(bench, value, p, x, u, positions) -> Iterator[Form]:
    if bench.protocol == "circular test":
        r = np.hypot(value["x"], value["y"])
        q = positions[1 - positions.index(p)]
        weight = value[p] / r
        w = value[q] / r
        yield Form("scale_error", (p,), _col(x * weight))
        v = value[q] / r.max()
        yield Form("straightness", (p, q), _col((v**2) * weight, (v**3) * weight))
        yield Form("squareness", (p, q), _col(x * w))
        return
    if bench.protocol == "volumetric grid":
        return
    yield Form("scale_error", (p,), _col(u))


def _volume(bench, value, positions) -> Iterator[Form]:
    legs = [n for n in ("overhang",) if n in value]
    for p in positions:
        u = value[p] / 1000.0
        c = u - u.mean()
        yield Form("scale_error", (p,), _col(c))
        yield Form("squareness", (p,), _col(c))
        v = 2 * (value[p] - value[p].min()) / np.ptp(value[p]) - 1
        yield Form("straightness", (p,), _col(1.5 * v**2, 2.5 * v**3 - 1.5 * v))  # about the line through it
        yield Form("gravity_sag", (p,), _col(u**2))
        yield Form("gravity_sag", (p,), _col(u**3))
        for q in [*positions, *legs]:
            if q != p:
                z = value[q] / 1000.0
                yield Form("angular_abbe", (p, q), _col(z * c))
                yield Form("angular_abbe", (p, q), _col(z * u, z * u**2))
        if "load" in value:
            yield Form("workpiece_load", ("load", p), _col(value["load"], value["load"] * c))
    if "load" in value:
        yield Form("workpiece_load", ("load",), _col(value["load"]))
    for q in legs:
        yield Form("gravity_sag", (q,), _col(value[q] ** 2))
        yield Form("gravity_sag", (q,), _col(value[q] ** 3))


def _thermal(bench: Bench, value: dict[str, Array], t: Array) -> Iterator[Form]:
    sensors = by_role(bench, "temperature")
    rise = {s: value[s] - value[s][0] for s in sensors}
    tall = [value[p] / 1000.0 for p in by_role(bench, "position")]
    places = list(zip(by_role(bench, "position"), tall, strict=True))
    room = [
        s for s in sensors if "room" in bench.columns[s].spec["location"] or "air" in bench.columns[s].spec["location"]
    ]
    for s in sensors:
        yield Form("thermal_drift", (s,), _col(rise[s]))
        yield Form("thermal_interaction", (s,), _col(rise[s] ** 2))
        for p, x in places:
            yield Form("scale_expansion", (p, s), _col(x * rise[s]))
    for a, b in combinations(sensors, 2):
        yield Form("gradient_bending", (a, b), _col(value[a] - value[b]))
        yield Form("thermal_interaction", (a, b), _col(rise[a] * rise[b]))
    for s in sensors:
        lags = lagged(t, value[s], LAGS)
        for k, tau in enumerate(LAGS):
            if 500 <= tau <= 15000:
                yield Form("thermal_lag", (s,), _col(lags[:, k]), tau)
            if s in room and tau >= 2500:
                yield Form("ambient_drift", (s,), _col(lags[:, k]), tau)
    pressures = [n for n in by_role(bench, "pressure") if "location" not in bench.columns[n].spec]
    for s in room:
        for p, x in places:
            parts = [x * rise[s]] + [x * (value[q] - value[q][0]) for q in pressures]
            yield Form("air_refraction", (p, s, *pressures), _col(*parts))


def _process(bench: Bench, value: dict[str, Array], t: Array) -> Iterator[Form]:
    for n in by_role(bench, "spindle_speed"):
        top = max(value[n].max(), 1.0)
        yield Form("centrifugal_growth", (n,), _col((value[n] / top) ** 2))
        for power in (0.8, 1.0, 1.3, 1.7):
            lags = lagged(t, (value[n] / top) ** power, LAGS[:10], steps=True)
            for k in range(10):
                yield Form("spindle_growth", (n,), _col(lags[:, k]), float(LAGS[k]))
    for n in by_role(bench, "coolant"):
        yield Form("coolant_effect", (n,), _col(value[n]))
        for k, lag in enumerate(lagged(t, value[n], LAGS[:5], steps=True).T):
            yield Form("coolant_effect", (n,), _col(lag), float(LAGS[k]))
        for s in (s for s in by_role(bench, "temperature") if "coolant" in bench.columns[s].spec["location"]):
            yield Form("coolant_effect", (n, s), _col(value[n] * (value[s] - value[s].mean()), value[n]))
    for n in by_role(bench, "cut_length"):
        yield Form("tool_wear", (n,), _col(value[n]))
        yield Form("tool_wear", (n,), _col(value[n], value[n] ** 2, value[n] ** 3))
    if bench.protocol == "cutting series":
        for n in by_role(bench, "force"):
            f = value[n]
            yield Form("cutting_compliance", (n,), _col(f))
            if "overhang" in value:
                yield Form("cutting_compliance", (n, "overhang"), _col(f, f * (value["overhang"] / 100.0) ** 3))
    places = by_role(bench, "position")
    if bench.protocol == "linear positioning":
        motion = value["feed"] * (1 - bench.measured)
        for tau in LAGS[3:11]:
            heat = lagged(t, motion, np.array([tau]), steps=True)[:, 0]
            for p in places:
                facts = bench.constants[bench.columns[p].spec["axis"]]
                yield Form("feed_heating", (p, "feed"), _col((value[p] - facts["drive_end"]) * heat), float(tau))
    if bench.protocol == "linear positioning":
        yield Form("friction_hysteresis", ("dir", *places), _col(value["dir"]))
    speeds, pushes = by_role(bench, "velocity"), by_role(bench, "acceleration")
    if bench.protocol == "circular test":
        yield from _servo_circle(value)
    else:
        for v in speeds:
            s = np.sign(value[v])
            yield Form("viscous_friction", (v,), _col(value[v]))
            yield Form("following_error", (v,), _col(value[v]))
            yield Form("coulomb_friction", (v,), _col(s))
            yield Form("friction_hysteresis", (v, *places), _col(s))
            for knee in (1.0, 2.0, 4.0, 8.0, 14.0):
                yield Form("stribeck_friction", (v,), _col(s * np.exp(-((value[v] / knee) ** 2))))
        for a in pushes:
            yield Form("inertial_deflection", (a,), _col(value[a]))


def _servo_circle(value) -> Iterator[Form]:
    x, y, vx, vy, ax, ay = (value[n] for n in ("x", "y", "vx", "vy", "ax", "ay"))
    r = np.hypot(x, y)
    yield Form("servo_mismatch", ("vx", "vy", "x", "y", "feed"), _col((x * vx - y * vy) / r))
    yield Form("inertial_deflection", ("ax", "ay"), _col((x * ax + y * ay) / r))
    yield Form("friction_hysteresis", ("vx", "x"), _col(np.sign(vx) * x / r))
    yield Form("friction_hysteresis", ("vy", "y"), _col(np.sign(vy) * y / r))


# Effects of one response only: which forms can speak of which unit.
FORCES = {"coulomb_friction", "viscous_friction", "stribeck_friction", "torque_ripple"}
NOT_FORCES = {
    "following_error",
    "inertial_deflection",
    "backlash",
    "screw_windup",
    "friction_hysteresis",
    "scale_error",
    "pitch_cyclic",
    "interpolation",
    "straightness",
}


def possible(effect: str, component: str, drivers: tuple[str, ...]) -> bool:
    """Whether an effect can be named on a component at all."""
    force = component.startswith("F_")
    if force:
        return effect not in NOT_FORCES
    if effect in FORCES:
        return False
    if component in ("E_X", "E_Y", "E_Z") and effect in (
        "scale_error",
        "squareness",
        "straightness",
        "air_refraction",
        "scale_expansion",
    ):
        own = component[-1].lower()
        along = drivers[0] == own
        return along if effect in ("scale_error", "air_refraction", "scale_expansion") else not along
    return True


@dataclass
class Verdict:
    """What the textbook makes of a hidden contribution."""

    accepted: list[str]
    drivers: dict[str, list[str]]
    own_share: float
    best: tuple[str, float]
    tau: float | None


class Target:
    """A hidden contribution on the rows that matter, ready to be compared with many designs."""

    def __init__(self, values: Array, others: Array) -> None:
        self.values = values - values.mean()
        self.total = max(float(self.values @ self.values), 1e-30)
        others = others - others.mean(axis=0)
        basis, size, _ = np.linalg.svd(others, full_matrices=False)
        self.basis = basis[:, size > 1e-9 * max(size.max(initial=0.0), 1e-30)]
        self.rest = self.values - self.basis @ (self.basis.T @ self.values)

    def explained(self, design: Array) -> tuple[float, float]:
        """Share that [1, design] explains, and the rms left once the other effects may move as well."""
        design = design - design.mean(axis=0)
        design = design / np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-12)
        share = _taken(self.values, design) / self.total
        beside = design - self.basis @ (self.basis.T @ design)
        left = float(self.rest @ self.rest) - _taken(self.rest, beside)
        return share, float(np.sqrt(max(left, 0.0) / self.values.size))


def _taken(y: Array, design: Array) -> float:
    """Sum of squares of y that the columns (of rms about 1) take; columns without substance take nothing."""
    weight, turn = np.linalg.eigh(design.T @ design)
    solid = weight > 1e-8 * y.size
    return float(np.sum((turn[:, solid].T @ (design.T @ y)) ** 2 / weight[solid]))


def sharpened(bench: Bench, sensor: str, tau: float, values: Array, rows: Array) -> float:
    """The lag in s that suits a contribution best, near one found on the coarse ladder."""
    taus = tau * np.geomspace(1 / 1.7, 1.7, 61)
    target = Target(values[rows], np.zeros((int(rows.sum()), 0)))
    lags = lagged(bench.time(), bench.columns[sensor].values, taus)[rows]
    return float(taus[int(np.argmax([target.explained(lag[:, None])[0] for lag in lags.T]))])


def compare(
    bench: Bench, component: str, hidden: Contribution, included: Array, noise: float, rows: Array, partial: bool
) -> Verdict:
    """Which effects the key must accept for a hidden contribution, and by which drivers.

    With `partial` the rivals, too, may act only where the hidden effect does.
    """
    index = np.flatnonzero(rows)
    pick = index[:: max(1, index.size // 1500)]
    gate = hidden.active if partial else None
    evidence = 9.0 * 2.0 / index.size  # chi-square of 9, noise half as informative as its rows
    target = Target(hidden.values[pick], included[pick])
    name = hidden.effect
    accepted, seen, tau = {name}, {name: list(hidden.drivers)}, None
    own, best = 0.0, ("", 0.0)
    best_of: dict[str, tuple[float, tuple[str, ...]]] = {}
    shares: list[tuple[float, Form]] = []
    for form in forms(bench, hidden.display):
        if not possible(form.effect, component, form.drivers):
            continue
        share, left = target.explained(form.design[pick])
        if gate is not None:
            for design in (form.design, form.design - form.design[0]):
                gated = target.explained(design[pick] * gate[pick, None])
                share, left = max(share, gated[0]), min(left, gated[1])
        shares.append((share, form))
        if form.effect == name and share > own:
            own, tau = share, form.tau
        if form.effect != name and share > best[1]:
            best = (form.effect, share)
        if share > best_of.get(form.effect, (-1.0, ()))[0]:
            best_of[form.effect] = (share, form.drivers)
        if share >= EXPLAINS or left**2 <= evidence * noise**2:
            accepted.add(form.effect)
    for effect in accepted:
        top = best_of.get(effect, (0.0, ()))[0]
        known = seen.setdefault(effect, [])
        for share, form in shares:
            if form.effect == effect and share >= max(min(top, EXPLAINS), top - 0.01):
                known.extend(d for d in form.drivers if d not in known)
    return Verdict([name, *sorted(accepted - {name})], seen, own, best, tau)
