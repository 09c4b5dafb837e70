"""Spindle drift: a bearing heats shaft, housing and column while the speed and the room change."""

from __future__ import annotations

import numpy as np

from . import bodies
from .case import Array, Bench, Column, Contribution, Response
from .faults import sensor_fault

SHAFT, HOUSING = 8, 5


def speeds(rng: np.random.Generator, n: int, dt: float, top: float) -> Array:
    """Speed levels held for a quarter of an hour to three hours, at rest first and last."""
    rpm = np.zeros(n)
    i = int(rng.uniform(0, 9000) / dt)
    end = n - int(rng.uniform(0.05, 0.25) * n)
    while i < end:
        hold = max(int(rng.uniform(1200, 9000) / dt), 3)
        rpm[i : min(i + hold, end)] = top * rng.choice([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
        i += hold
    if rpm.max() == 0:
        rpm[n // 4 : n // 2] = top
    return rpm


def flow(rng: np.random.Generator, n: int, dt: float) -> Array:
    on = np.zeros(n)
    i = int(rng.uniform(0.02, 0.3) * n)
    while i < 0.85 * n:
        hold = max(int(rng.uniform(600, 4500) / dt), 2)
        on[i : i + hold] = 1.0
        i += hold + int(rng.uniform(600, 9000) / dt)
    return on


class Machine:
    """Temperatures of the whole machine on the sampling clock, over all runs and the nights between."""

    def __init__(self, rng: np.random.Generator, n: int, dt: float, rpm: Array, coolant: Array, top: float) -> None:
        self.dt, self.rpm, self.coolant, self.top = dt, rpm, coolant, top
        self.room = bodies.room(rng, n, dt, rng.uniform(0.3, 1.8), rng.uniform(0.1, 0.5), rng.uniform(0, 24))
        quiet = rng.normal(0, 0.06, n)
        loss = (rpm / top) ** rng.uniform(1.1, 1.7) * (1 + quiet)
        self._spindle(rng, loss)
        heat = rng.uniform(4, 12)
        self.motor = (
            bodies.two_nodes(dt, (rpm / top) ** 1.2, rng.uniform(900, 2000), rng.uniform(4000, 8000), 0.4) * heat
        )
        self.motor = self.motor + 0.5 * bodies.lump(dt, self.room, 6000.0)
        self._column(rng)
        bed = bodies.wall_after(dt, self.room, 0.06, rng.uniform(8, 20))
        self.bed = bed + 0.03 * bodies.lump(dt, self.housing, 20000.0)
        tank = bodies.lump(dt, coolant, rng.uniform(2500, 6000)) * rng.uniform(0.8, 3)
        self.tank = tank + 0.6 * bodies.lump(dt, self.room, 9000.0)

    def _spindle(self, rng, loss: Array) -> None:
        cells = 1 + SHAFT + HOUSING
        shaft = bodies.bar(SHAFT, 0.3, 5e-3, 0.25, 1.0, **bodies.STEEL)
        house = bodies.bar(HOUSING, 0.35, 2.5e-2, 0.6, rng.uniform(12, 25), **bodies.IRON)
        joints, air = np.zeros((cells, cells)), np.zeros(cells)
        s, h = slice(1, 1 + SHAFT), slice(1 + SHAFT, cells)
        joints[s, s], joints[h, h] = shaft.joints, house.joints
        joints[0, 1] = joints[1, 0] = rng.uniform(15, 40)
        joints[0, 1 + SHAFT] = joints[1 + SHAFT, 0] = rng.uniform(10, 30)
        capacity = np.concatenate([[rng.uniform(1500, 5000)], shaft.capacity, house.capacity * rng.uniform(0.5, 1.2)])
        air[h] = house.air
        body = bodies.Body(capacity, joints, air)
        levels = np.unique(np.round(self.rpm / self.top, 3))
        blow = rng.uniform(10, 60)
        air_at = {}
        for k, level in enumerate(levels):
            moved = air.copy()
            moved[s] = shaft.air * (8 + blow * level**0.7)
            air_at[k] = moved
        forcing = np.outer(self.room, np.concatenate([[0.0], shaft.air * 8, house.air]))
        forcing[:, 0] += loss * rng.uniform(150, 400)
        warm = body.march(self.dt, forcing, np.searchsorted(levels, np.round(self.rpm / self.top, 3)), air_at)
        self.bearing, self.shaft, self.house = warm[:, 0], warm[:, s], warm[:, h]
        self.housing = warm[:, 1 + SHAFT + HOUSING // 2]
        hot = max(self.bearing.max(), 1e-6)
        scale = rng.uniform(7, 18) / hot
        for name in ("bearing", "shaft", "house", "housing"):
            setattr(self, name, getattr(self, name) * scale)

    def _column(self, rng) -> None:
        wall = bodies.plate(8, rng.uniform(0.04, 0.12), rng.uniform(8, 20), rng.uniform(6, 15), **bodies.IRON)
        forcing = np.zeros((self.room.size, 8))
        shine = rng.uniform(0.1, 0.3)
        forcing[:, 0] = wall.air[0] * ((1 - shine) * self.room + shine * self.housing)
        forcing[:, -1] = wall.air[-1] * self.room
        warm = wall.respond(self.dt, forcing)
        extra = rng.uniform(0.02, 0.1) * bodies.lump(self.dt, self.housing, 3000.0)
        self.wall_front, self.wall_back = warm[:, 0] + extra, warm[:, -1]


def make(rng: np.random.Generator) -> Bench:
    """One or two days at changing speed; E_Z and often E_X."""
    dt = float(rng.choice([30, 60, 90, 120]))
    top = float(rng.choice([8000, 10000, 12000, 15000, 18000, 24000]))
    hours = float(rng.choice([8, 10, 12, 18, 22, 30]))
    two = bool(rng.random() < 0.75)
    while hours * 3600 / dt > 2700:
        dt *= 2
    while hours * 3600 / dt < 480:
        dt /= 2
    gap = rng.uniform(25000, 50000) if two else 0.0
    n_run = int(rng.uniform(0.96, 1.0) * hours * 3600 / dt / (2 if two else 1))
    n_gap = int(gap / dt)
    n = n_run * (2 if two else 1) + n_gap
    parts = [speeds(rng, n_run, dt, top)] + ([np.zeros(n_gap), speeds(rng, n_run, dt, top)] if two else [])
    coolant = np.concatenate([flow(rng, n_run, dt)] + ([np.zeros(n_gap), flow(rng, n_run, dt)] if two else []))
    rpm = np.concatenate(parts)
    wet = bool(rng.random() < 0.75)
    machine = Machine(rng, n, dt, rpm, coolant if wet else np.zeros(n), top)
    keep = np.concatenate([np.arange(n_run)] + ([np.arange(n_run + n_gap, n)] if two else []))
    run = ["1"] * n_run + ["2"] * (n_run if two else 0)
    columns, sensors = _columns(rng, machine, keep, wet)
    names = ["E_Z"] if rng.random() < 0.45 else ["E_X", "E_Z"]
    bench = Bench(
        "spindle drift",
        f"Spindle at changing speed, {hours:.0f} h, one reading every {dt:.0f} s",
        f"vmc-{rng.integers(1, 9)}",
        {"tool_length": {"value": int(rng.choice([100, 150, 200])), "unit": "mm"}},
        columns,
        run,
        np.ones(keep.size, bool),
        {},
    )
    for name in names:
        size = 1.0 if name == "E_Z" else rng.uniform(0.08, 0.5)
        effects = _effects(rng, machine, keep, columns, sensors, size, name)
        if name == "E_Z":
            effects.update(sensor_fault(rng, columns, columns["t"].values, tuple(sensors)))
        bench.responses[name] = Response(name, "um", effects, _novel(rng, machine, keep, columns, size))
    return bench


PLACES = {
    "T_bearing": ("front spindle bearing, outer ring", "bearing"),
    "T_motor": ("spindle motor", "motor"),
    "T_housing": ("headstock", "housing"),
    "T_col_front": ("column, front wall", "wall_front"),
    "T_col_back": ("column, back wall", "wall_back"),
    "T_bed": ("bed", "bed"),
    "T_ambient": ("room, beside the machine", "room"),
    "T_coolant": ("coolant tank", "tank"),
}


def _columns(rng, machine: Machine, keep: Array, wet: bool) -> tuple[dict[str, Column], dict[str, Array]]:
    chosen = list(PLACES)
    if rng.random() < 0.3:
        chosen = [c for c in chosen if c not in ("T_bearing", "T_motor", "T_housing")]
    elif rng.random() < 0.4:
        chosen.remove(str(rng.choice(["T_motor", "T_housing", "T_col_back"])))
    if not wet:
        chosen.remove("T_coolant")
    step = float(rng.choice([0.01, 0.05, 0.1]))
    room = rng.uniform(18.5, 22.5)
    columns = {
        "t": Column({"role": "time", "unit": "s"}, np.round(keep * machine.dt + 0.0, 1), 1),
        "rpm": Column({"role": "spindle_speed", "unit": "rpm"}, machine.rpm[keep], 1),
    }
    sensors = {}
    for name in chosen:
        place, node = PLACES[name]
        sensors[name] = getattr(machine, node)
        base = room + rng.uniform(-1.2, 1.2)
        columns[name] = Column(
            {"role": "temperature", "unit": "degC", "location": place},
            base + sensors[name][keep],
            2,
            step,
            float(rng.choice([0.02, 0.05])),
            True,
        )
    if wet:
        columns["coolant"] = Column({"role": "coolant"}, machine.coolant[keep], 0)
    if rng.random() < 0.3:
        columns["p_hyd"] = Column(
            {"role": "pressure", "unit": "hPa", "location": "hydraulic circuit of the counterweight"},
            _hydraulics(rng, keep * machine.dt),
            1,
            10.0,
            20.0,
        )
    return columns, sensors


def _hydraulics(rng, t: Array) -> Array:
    beat = rng.uniform(2400, 9000)
    return 58000 + 3500 * (2 * np.abs((t / beat) % 1.0 - 0.5) - 0.5) + 600 * np.sin(t / rng.uniform(5000, 20000))


def _effects(rng, m: Machine, keep, columns, sensors, size, name) -> dict[str, Contribution]:
    dt, out = m.dt, {}
    t = columns["t"].values

    def add(effect, whole, drivers, ideal=None, **more):
        values = np.asarray(whole, float)[keep]
        textbook = None if ideal is None else ideal[keep] * size
        out[effect] = Contribution(effect, (values - values[0]) * size, drivers, ideal=textbook, **more)

    def sign() -> float:
        return float(rng.choice([-1, 1]))

    long = m.shaft.mean(axis=1) * 0.3 * 11.5 if name == "E_Z" else m.house.mean(axis=1) * 0.35 * 11.0
    add("spindle_growth", long * rng.uniform(0.5, 1.6), ("rpm",))
    add("centrifugal_growth", sign() * rng.uniform(2, 15) * (m.rpm / m.top) ** 2, ("rpm",))
    near = str(rng.choice([s for s in sensors if s not in ("T_ambient", "T_coolant")]))
    k = sign() * min(rng.uniform(1, 5), 18.0 / max(np.ptp(sensors[near]), 0.3))
    add(
        "thermal_drift",
        k * bodies.lump(dt, sensors[near], max(rng.uniform(10, 80), 0.2 * dt)),
        (near,),
        ideal=k * sensors[near],
        params={"coefficient": (k * size, "um/K", True)},
    )
    far = str(
        rng.choice([s for s in ("T_bearing", "T_motor", "T_housing", "T_col_front", "T_coolant") if s in sensors])
    )
    behind = bodies.wall_after(dt, sensors[far], rng.uniform(0.02, 0.1), rng.uniform(25, 60))
    add(
        "thermal_lag",
        sign() * behind * rng.uniform(4, 14) / max(np.ptp(behind), 0.1),
        (far,),
        params={"tau": (0.0, "s", False)},
    )
    one, other = (str(c) for c in rng.choice([s for s in sensors if s != "T_ambient"], 2))
    product = sensors[one] * sensors[other]
    add(
        "thermal_interaction",
        sign() * product * rng.uniform(4, 12) / max(np.ptp(product), 0.1),
        tuple(dict.fromkeys((one, other))),
    )
    if "T_col_back" in sensors:
        k = sign() * rng.uniform(3, 15)
        add(
            "gradient_bending",
            k * bodies.lump(dt, m.wall_front - m.wall_back, rng.uniform(20, 90)),
            ("T_col_front", "T_col_back"),
            ideal=k * (m.wall_front - m.wall_back),
            params={"coefficient": (k * size, "um/K", True)},
        )
    heavy = bodies.wall_after(dt, m.room, rng.uniform(0.05, 0.3), rng.uniform(12, 40))
    add("ambient_drift", sign() * rng.uniform(2, 6) * heavy / max(np.ptp(heavy) / np.ptp(m.room), 0.3), ("T_ambient",))
    if m.coolant.any():
        chill = bodies.lump(dt, m.coolant * (1 + 0.05 * m.tank), rng.uniform(60, 500))
        add("coolant_effect", sign() * rng.uniform(3, 15) * chill, ("coolant", "T_coolant"))
    hours = np.arange(m.room.size) * dt / 3600
    rate = sign() * rng.uniform(0.5, 3)
    add(
        "sensor_drift",
        rate * (hours + rng.uniform(-0.04, 0.04) * (hours**2 / hours[-1] - hours)),
        ("t",),
        ideal=rate * hours,
        params={"rate": (rate * size, "um/h", True)},
    )
    out["clock_offset"] = _late(rng, t, out)
    return out


def _late(rng, t: Array, out: dict[str, Contribution]) -> Contribution:
    """The recorder's clock runs behind: everything the machine does comes tau later than the simulation says."""
    parts = [p for p in ("spindle_growth", "centrifugal_growth", "coolant_effect", "thermal_drift") if p in out]
    parts = [
        "spindle_growth",
        *[str(p) for p in rng.choice(parts[1:], min(len(parts) - 1, int(rng.integers(1, 3))), replace=False)],
    ]
    tau = float(np.round(rng.uniform(90, 600)))
    whole = sum(out[p].values for p in parts)
    shift = np.interp(t - tau, t, whole) - whole
    return Contribution("clock_offset", shift, ("t",), {"offset": (tau, "s", False)}, display=("", parts))  # type: ignore[arg-type]


def _novel(rng, m: Machine, keep, columns, size) -> dict[str, Contribution]:
    t = np.arange(m.room.size) * m.dt
    out = {}

    def add(name, values):
        values = np.asarray(values, float)[keep]
        out[name] = Contribution(f"outside the vocabulary: {name}", values * size, ())

    doors = np.zeros(t.size)
    for at in np.sort(rng.uniform(0, t[-1], int(t[-1] / rng.uniform(4000, 12000)) + 3)):
        doors[(t >= at) & (t < at + rng.uniform(150, 1500))] = 1.0
    add("doors", -rng.uniform(3, 9) * bodies.lump(m.dt, doors, rng.uniform(60, 400)))
    if "p_hyd" in columns:
        p = np.interp(t, columns["t"].values, columns["p_hyd"].values)
        add("hydraulic pressure", rng.uniform(2, 6) * (p - p.mean()) / np.ptp(p) * 2)
    started = (m.rpm > 0) & (np.roll(m.rpm, 1) == 0)
    steps = np.cumsum(started)
    add("preload reset at start", rng.normal(0, 4, steps.max() + 1)[steps])
    sun = np.clip(np.sin(2 * np.pi * (t / 86400 + rng.uniform(0, 1))), 0, None) * (
        1 - 0.8 * (np.sin(t / rng.uniform(900, 2500)) > 0.3)
    )
    add("sun through a window", rng.uniform(4, 9) * bodies.lump(m.dt, sun, 900.0))
    source, state, slip = m.housing, 0.0, np.zeros(t.size)
    width = rng.uniform(0.25, 0.45) * max(np.ptp(source), 0.1)
    for i in range(1, t.size):
        state = max(-width / 2, min(width / 2, state + source[i] - source[i - 1]))
        slip[i] = state
    add("joint slip", rng.uniform(5, 10) * slip / width)
    every = rng.uniform(1500, 5000)
    add("lubrication pulses", rng.uniform(4, 8) * np.exp(-(t % every) / rng.uniform(120, 500)))
    band = (t / rng.uniform(1800, 5000)) % 1.0
    add("chiller cycling", 3.0 * (np.where(band < 0.35, band / 0.35, (1 - band) / 0.65) - 0.5) * (m.rpm > 0))
    return out
