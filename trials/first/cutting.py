"""Cutting series: parts bored one after another, tools that wear in three phases, a spindle that warms."""

from __future__ import annotations

import numpy as np

from . import bodies
from .case import Array, Bench, Column, Contribution, Response
from .faults import sensor_fault

DT = 20.0
DEPTHS, SPEEDS = [0.3, 0.5, 0.8, 1.2, 2.0], [800.0, 1200.0, 1600.0, 2000.0, 2600.0, 3200.0]
FEEDS, OVERHANGS = [0.08, 0.12, 0.16, 0.2, 0.25, 0.3], [60.0, 80.0, 100.0, 130.0, 160.0]


def wear(length: Array, life: float, rng: np.random.Generator) -> Array:
    """Flank wear over the length cut, 0..about 1 at the end of life: running in, steady, steep."""
    u = length / life
    return rng.uniform(0.12, 0.3) * (1 - np.exp(-u / 0.06)) + 0.55 * u + rng.uniform(0.1, 0.4) * u**4


def plan(rng: np.random.Generator) -> dict[str, Array]:
    """Parts in order: batches of a part type within the life of a tool."""
    tools, n = int(rng.integers(5, 9)), int(rng.integers(280, 520))
    lives = rng.dirichlet(np.full(tools, 3.0)) * n
    counts = np.maximum(lives.astype(int), 15)
    rows: dict[str, list] = {k: [] for k in ("tool", "depth", "rpm", "feed", "overhang", "coolant", "cut", "t")}
    now, per_part = 0.0, rng.uniform(12, 90)
    base_time, change = rng.uniform(25, 60), rng.uniform(250, 800)
    for tool, count in enumerate(counts):
        overhang = float(rng.choice(OVERHANGS))
        left, length = 0, 0.0
        for _ in range(count):
            if left <= 0:
                left = int(rng.integers(5, 40))
                depth, rpm, feed = float(rng.choice(DEPTHS)), float(rng.choice(SPEEDS)), float(rng.choice(FEEDS))
                wet = float(rng.random() < 0.55)
                minutes = rng.uniform(0.7, 3.5)
                stretch = per_part * rng.uniform(0.7, 1.3)
            left -= 1
            now += np.round((base_time + 60 * minutes) * rng.uniform(0.97, 1.03))
            length += stretch * rng.uniform(0.96, 1.04)
            for k, v in zip(rows, (tool, depth, rpm, rpm * feed, overhang, wet, length, now), strict=True):
                rows[k].append(v)
        now += change + (rng.random() < 0.5) * rng.uniform(600, 3600)  # a break now and then
    return {k: np.array(v, float) for k, v in rows.items()}


def make(rng: np.random.Generator) -> Bench:
    """One series on a lathe; one diameter per part."""
    p = plan(rng)
    t, n = p["t"], p["t"].size
    cells = int(t[-1] / DT) + 2
    clock = np.arange(cells) * DT

    step = np.diff(t, prepend=t[0] - np.median(np.diff(t)))
    busy = np.minimum(step, 2 * np.median(step))  # between the tools, and in breaks, spindle and coolant stand

    def held(v: Array) -> Array:
        part = np.minimum(np.searchsorted(t, clock), n - 1)
        return np.where(clock >= t[part] - busy[part], v[part], 0.0)

    room = bodies.room(rng, cells, DT, rng.uniform(0.8, 3.0), rng.uniform(0.1, 0.5), rng.uniform(0, 24))
    level = held(p["rpm"]) / 3200.0
    warm = level ** rng.uniform(1.0, 1.5)
    bearing = bodies.two_nodes(DT, warm, rng.uniform(600, 1500), rng.uniform(3500, 8000), rng.uniform(0.2, 0.5))
    bearing = bearing * rng.uniform(9, 20) + 0.7 * bodies.lump(DT, room, 3000.0)
    growth = _shaft(rng, warm, room)
    bed = bodies.lump(DT, room, rng.uniform(12000, 30000)) + 0.02 * bodies.lump(DT, bearing, 20000.0)
    tank = 0.8 * bodies.lump(DT, room, 4000.0) + rng.uniform(0.2, 1.2) * bodies.lump(DT, held(p["coolant"]), 4000.0)

    def at(series: Array) -> Array:
        return np.interp(t, clock, series)

    usual = rng.uniform(1.0, 1.8) * p["cut"].max()
    lives = usual * (1 + rng.choice([0.0, 0.1]) * rng.uniform(-1, 1, int(p["tool"].max()) + 1))
    worn = wear(p["cut"], lives[p["tool"].astype(int)], rng)
    hard = 1 + 0.03 * np.sin(t / rng.uniform(8000, 30000)) + rng.normal(0, 0.03, n)
    force = rng.uniform(900, 1700) * p["depth"] * (p["feed"] / p["rpm"]) ** 0.75 * hard * (1 + 0.15 * worn)
    base = rng.uniform(18.5, 23.0)
    show = {"decimals": 1, "step": 0.1, "noise": 0.05, "sensor": True}
    columns = {
        "t": Column({"role": "time", "unit": "s"}, t, 1),
        "F_p": Column({"role": "force", "axis": "X", "unit": "N"}, force, 1, 0.1, 1.0),
        "rpm": Column({"role": "spindle_speed", "unit": "rpm"}, p["rpm"], 1),
        "feed": Column({"role": "feed", "unit": "mm/min"}, p["feed"], 1),
        "depth_of_cut": Column({"role": "depth_of_cut", "unit": "mm"}, p["depth"], 1),
        "overhang": Column({"role": "overhang", "unit": "mm"}, p["overhang"], 1),
        "cut_length": Column({"role": "cut_length", "unit": "m"}, np.round(p["cut"]), 1),
        "T_spindle": Column(_temp("front spindle bearing"), base + 1.0 + at(bearing), **show),
        "T_bed": Column(_temp("bed"), base - 0.5 + at(bed), **show),
        "T_ambient": Column(_temp("room"), base + at(room), **show),
        "T_coolant": Column(_temp("coolant tank"), base - 0.3 + at(tank), **show),
        "coolant": Column({"role": "coolant"}, p["coolant"], 0),
    }
    world = {
        "bearing": bearing,
        "bed": bed,
        "room": room,
        "tank": tank,
        "growth": growth,
        "wet": held(p["coolant"]),
        "level": level,
    }
    effects = _effects(rng, p, world, at, force, worn)
    effects.update(sensor_fault(rng, columns, t, ("T_spindle", "T_bed")))
    tools = int(p["tool"].max()) + 1
    bench = Bench(
        "cutting series",
        f"Boring series, {n} parts, {tools} tools",
        f"lathe-{rng.integers(1, 6)}",
        {},
        columns,
        [str(int(k) + 1) for k in p["tool"]],
        np.ones(n, bool),
        {},
        lossy=False,
    )
    bench.responses["E_D"] = Response("E_D", "um", effects, _novel(rng, p, t))
    return bench


def _temp(location: str) -> dict:
    return {"role": "temperature", "unit": "degC", "location": location}


def _shaft(rng, warm: Array, room: Array) -> Array:
    """Radial growth of the headstock: a block with a heated bore, six cells deep."""
    block = bodies.plate(6, rng.uniform(0.05, 0.12), 0.0, rng.uniform(60, 140), **bodies.IRON)
    forcing = np.outer(room, block.air)
    forcing[:, 0] += 2500.0 * warm
    mean = block.respond(DT, forcing).mean(axis=1)
    return mean * rng.uniform(8, 30) / max(np.ptp(mean), 1e-9)


def _effects(rng, p, w, at, force, worn) -> dict[str, Contribution]:
    out = {}

    def sign() -> float:
        return float(rng.choice([-1, 1]))

    def add(effect, values, drivers, **more):
        out[effect] = Contribution(effect, np.asarray(values, float), drivers, **more)

    add("tool_wear", rng.uniform(8, 30) * worn, ("cut_length",))
    bar = (p["overhang"] / 100.0) ** 3
    add(
        "cutting_compliance",
        2 * force * (rng.uniform(5, 20) + rng.uniform(2, 15) * bar) / 1e3,
        ("F_p", "overhang", "depth_of_cut"),
    )
    add("spindle_growth", at(w["growth"]), ("rpm",))
    source = str(rng.choice(["bearing", "bed"]))
    label = {"bearing": "T_spindle", "bed": "T_bed"}[source]
    k = sign() * (rng.uniform(0.6, 2) if source == "bearing" else rng.uniform(2, 8))
    add(
        "thermal_drift",
        k * at(bodies.lump(DT, w[source], rng.uniform(20, 100))),
        (label,),
        ideal=k * at(w[source]),
        params={"coefficient": (k, "um/K", True)},
    )
    behind = bodies.wall_after(DT, w["bearing"], rng.uniform(0.03, 0.12), rng.uniform(30, 60))
    add("thermal_lag", sign() * rng.uniform(0.7, 2.5) * at(behind), ("T_spindle",), params={"tau": (0.0, "s", False)})
    mass = bodies.wall_after(DT, w["room"], rng.uniform(0.04, 0.25), rng.uniform(15, 40))
    add("ambient_drift", sign() * rng.uniform(4, 12) * at(mass) / max(np.ptp(at(mass)), 0.5), ("T_ambient",))
    chill = bodies.lump(DT, w["wet"] * (1 + 0.04 * w["tank"]), rng.uniform(60, 500))
    add("coolant_effect", sign() * rng.uniform(3, 12) * at(chill), ("coolant", "T_coolant"))
    product = at(w["bearing"] * w["bed"])
    add(
        "thermal_interaction", sign() * product * rng.uniform(6, 14) / max(np.ptp(product), 0.1), ("T_spindle", "T_bed")
    )
    k = sign() * rng.uniform(0.7, 2.5)
    bend = bodies.lump(DT, w["bearing"] - w["tank"], rng.uniform(20, 100))
    add(
        "gradient_bending",
        k * at(bend),
        ("T_spindle", "T_coolant"),
        params={"coefficient": (k, "um/K", True)},
        ideal=k * at(w["bearing"] - w["tank"]),
    )
    add("centrifugal_growth", sign() * rng.uniform(4, 15) * (p["rpm"] / 3200) ** 2, ("rpm",))
    hours = p["t"] / 3600
    rate = sign() * rng.uniform(0.5, 2.5)
    add(
        "sensor_drift",
        rate * (hours + 0.03 * (hours**2 / hours[-1] - hours)),
        ("t",),
        ideal=rate * hours,
        params={"rate": (rate, "um/h", True)},
    )
    return out


def _novel(rng, p, t) -> dict[str, Contribution]:
    out = {}

    def add(name, values):
        out[name] = Contribution(f"outside the vocabulary: {name}", np.asarray(values, float), ())

    n, tool = t.size, p["tool"].astype(int)
    add("tool seating", rng.normal(0, 4, tool.max() + 1)[tool])
    edges = np.sort(rng.uniform(0, n, int(rng.integers(6, 16))))
    batch = np.searchsorted(edges, np.arange(n))
    add("clamping force", rng.normal(0, 4, batch.max() + 1)[batch])
    heap, state = np.zeros(n), 0.0
    limit = rng.uniform(15, 45)
    for i in range(n):
        state = 0.0 if state > limit else state + p["depth"][i] * rng.uniform(0.7, 1.3)
        heap[i] = state
    add("chip heap", 8.0 * (heap / limit) ** 1.5)
    add("bar ends", 5.0 * ((np.arange(n) % int(rng.integers(7, 23))) / 10.0))
    return out
