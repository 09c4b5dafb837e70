"""Bidirectional positioning of a linear axis over several thermal states: ball screw, bed, room and laser."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import bodies
from .air import path_error
from .case import Array, Bench, Column, Contribution, Response
from .faults import sensor_fault

DT = 10.0  # s, step of the thermal world
STEEL_GROWTH = 11.5  # um/m/K


@dataclass
class Walk:
    """Where the axis was at every row."""

    run: list[str]
    t: Array
    x: Array
    side: Array
    feed: Array
    measured: Array
    since: Array  # mm travelled since the last reversal


def targets(rng: np.random.Generator, travel: float) -> Array:
    """Irregular targets, as ISO 230-2 asks, so that periodic errors are not sampled in step."""
    n = int(rng.integers(18, 45))
    raw = np.linspace(0.0, travel, n) + rng.uniform(-0.3, 0.3, n) * travel / n
    edge = rng.uniform(0.002, 0.03) * travel
    return np.round(edge + (raw - raw.min()) / np.ptp(raw) * (travel - 2 * edge), 4)


def walk(
    rng: np.random.Generator, travel: float, logged: bool
) -> tuple[Walk, list[tuple[float, float, float, float, float]]]:
    """Rows of all runs, and phases (start, end, feed, low, high) for the heat."""
    goal = targets(rng, travel)
    n_runs, passes = int(rng.integers(7, 12)), 3 if goal.size < 30 else 2
    feeds = rng.choice([1000.0, 2000.0, 3000.0, 5000.0, 8000.0, 10000.0], size=2)
    fastest = rng.uniform(9000, 33000)
    dwell = rng.uniform(2.6, 3.6)
    heated = int(np.ceil(n_runs * rng.uniform(0.45, 0.8)))
    parts, phases = [], []
    now = 0.0
    for number in range(n_runs):
        feed = float(rng.choice(feeds))
        if number:
            pause = float(np.round(rng.uniform(400, 2900), 1))
            busy = number < heated
            speed = float(np.round(fastest * rng.choice([0.4, 0.7, 1.0]))) if busy else 0.0
            low, high = np.sort(rng.uniform(0.05, 0.95, 2)) * travel
            if high - low < 0.3 * travel:
                low, high = 0.15 * travel, 0.85 * travel
            phases.append((now, now + pause, speed, low, high))
            if logged:
                parts.append(_log(rng, f"w{number + 1}", now, pause, speed, low, high, parts[-1]["x"][-1]))
            now += pause
        leg = np.concatenate([goal, goal[::-1]])
        x = np.tile(leg, passes)
        side = np.tile(np.repeat([1.0, -1.0], goal.size), passes)
        hop = np.abs(np.diff(x, prepend=x[0]))
        t = now + np.cumsum(dwell + rng.uniform(0.0, 0.6, x.size) + hop / feed * 60.0 * 0.8 + 0.3)
        phases.append((now, float(t[-1]), float(hop.sum() / (t[-1] - now) * 60.0), 0.0, travel))
        over = rng.uniform(0.15, 0.8)
        since = np.tile(np.concatenate([goal - goal[0], goal[-1] - goal[::-1]]) + over, passes)
        parts.append(
            {
                "run": str(number + 1),
                "t": t,
                "x": x,
                "side": side,
                "feed": np.full(x.size, feed),
                "measured": np.ones(x.size, bool),
                "since": since,
            }
        )
        now = float(t[-1]) + rng.uniform(5, 60)
    rows = {k: np.concatenate([p[k] for p in parts]) for k in ("t", "x", "side", "feed", "measured", "since")}
    run = [p["run"] for p in parts for _ in p["t"]]
    return Walk(
        run, np.round(rows["t"], 1), rows["x"], rows["side"], rows["feed"], rows["measured"], rows["since"]
    ), phases


def _log(rng, label, now, pause, speed, low, high, rest) -> dict:
    step = 60.0 if speed else 150.0
    t = np.arange(now + 25.0, now + pause, step)
    t = t if t.size else np.array([now + pause / 2])
    x = rng.uniform(low, high, t.size) if speed else np.full(t.size, rest)
    side = rng.choice([-1.0, 1.0], t.size) if speed else np.full(t.size, -1.0)
    since = rng.uniform(0.0, (high - low), t.size) if speed else np.full(t.size, 300.0)
    return {
        "run": label,
        "t": t,
        "x": x,
        "side": side,
        "feed": np.full(t.size, speed),
        "measured": np.zeros(t.size, bool),
        "since": since,
    }


@dataclass
class Heat:
    """Temperatures of the machine on the thermal clock, K of rise."""

    clock: Array
    screw: Array  # (time, cells)
    nut: Array
    bearing: Array
    bed: Array
    tilt: Array  # far end of the bed against its middle
    air: Array
    pressure: Array


def warm_up(rng: np.random.Generator, end: float, phases, travel: float, drive_at_zero: bool) -> Heat:
    """Screw as a bar under a moving heat source, nut, bearing and bed as nodes, the room around them."""
    n, cells = int(end / DT) + 3, 32
    clock = np.arange(n) * DT
    edges = np.linspace(0, travel, cells + 1)
    power, place = np.zeros(n), np.zeros((n, cells))
    drag = rng.uniform(0.3, 1.0)  # share of the friction that grows with speed
    for start, stop, feed, low, high in phases:
        on = (clock >= start) & (clock < stop)
        power[on] = feed / 1e4 * ((1 - drag) + drag * feed / 2e4)
        over = np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0, None)
        place[on] = over / max(over.sum(), 1e-9)
    air = bodies.room(rng, n, DT, rng.uniform(0.1, 2.0), rng.uniform(0.1, 0.6), rng.uniform(0, 24))
    air = air + rng.choice([0.0, 1.0]) * rng.uniform(-1.5, 2.0) * clock / clock[-1]
    share = power[:, None] * place
    rod = bodies.bar(cells, travel / 1e3, 1.0e-3, 0.113, rng.uniform(12, 40), **bodies.STEEL)
    bearing = bodies.two_nodes(DT, power, rng.uniform(500, 1200), rng.uniform(3000, 7000), rng.uniform(0.3, 0.6))
    bearing *= rng.uniform(4, 14) / max(bearing.max(), 1e-9)
    hot = rod.respond(DT, share)
    hot *= rng.uniform(2.0, 7.0) / max(hot.mean(axis=1).max(), 1e-9)
    forced = np.outer(air, rod.air)
    forced[:, 0 if drive_at_zero else -1] += 0.5 * bearing
    screw = hot + rod.respond(DT, forced)
    nut = bodies.two_nodes(DT, power, rng.uniform(400, 900), rng.uniform(2000, 4000), rng.uniform(0.2, 0.5))
    nut = nut * rng.uniform(6, 18) / max(nut.max(), 1e-9) + 0.6 * bodies.lump(DT, air, 2000.0)
    guide = bodies.lump(DT, power, rng.uniform(5000, 15000))
    bed = guide * rng.uniform(0.5, 3.0) / max(guide.max(), 1e-9) + bodies.lump(DT, air, rng.uniform(8000, 25000))
    tilt = rng.uniform(-0.15, 0.15) * bodies.lump(DT, bearing, 4000.0)
    return Heat(
        clock, screw, nut, bearing + 0.3 * bodies.lump(DT, air, 3000.0), bed, tilt, air, bodies.weather(rng, n, DT)
    )


def growth(heat: Heat, w: Walk, travel: float, drive_at_zero: bool) -> Array:
    """um that the nut moves because the screw between the fixed bearing and it is warm: an integral over the cells."""
    cells = heat.screw.shape[1]
    step = travel / cells
    theta = heat.screw if drive_at_zero else heat.screw[:, ::-1]
    grown = (
        np.concatenate([np.zeros((theta.shape[0], 1)), np.cumsum(theta, axis=1)], axis=1) * step * STEEL_GROWTH / 1e3
    )
    along = (w.x if drive_at_zero else travel - w.x) / step
    i = np.clip(along.astype(int), 0, cells - 1)
    k = np.clip(np.searchsorted(heat.clock, w.t), 0, heat.clock.size - 1)
    value = grown[k, i] + (along - i) * (grown[k, i + 1] - grown[k, i])
    return value if drive_at_zero else -value


def make(rng: np.random.Generator) -> Bench:
    """One axis, X or Y, measured in 6 to 11 runs."""
    axis = str(rng.choice(["X", "X", "X", "Y"]))
    low, component = axis.lower(), f"E{axis}{axis}"
    travel = float(rng.choice([400, 500, 630, 800, 1000, 1250]))
    lead = float(rng.choice([5, 8, 10, 12, 16, 20]))
    period = float(rng.choice([0.01, 0.02, 0.04, 0.1]))
    drive_at_zero = bool(rng.random() < 0.6)
    logged = bool(rng.random() < 0.55)
    w, phases = walk(rng, travel, logged)
    heat = warm_up(rng, float(w.t[-1]), phases, travel, drive_at_zero)
    base = {k: rng.uniform(19.5, 23.0) for k in ("nut", "bearing", "bed", "air")}

    def at(series: Array) -> Array:
        return np.interp(w.t, heat.clock, series)

    step = float(rng.choice([0.01, 0.01, 0.05, 0.1]))
    shiver = {"decimals": 2, "step": step, "noise": float(rng.choice([0.02, 0.04])), "sensor": True}
    room_base = base["air"]
    near = {k: room_base + rng.uniform(-0.7, 0.7) for k in base}
    columns = {
        "t": Column({"role": "time", "unit": "s"}, w.t, 1),
        low: Column({"role": "position", "axis": axis, "unit": "mm"}, w.x, 4),
        "dir": Column({"role": "direction", "axis": axis}, w.side, 0),
        "feed": Column({"role": "feed", "axis": axis, "unit": "mm/min"}, w.feed, 1),
        "T_nut": Column(_temp("ball-screw nut"), near["nut"] + at(heat.nut), **shiver),
        "T_bearing": Column(_temp("fixed screw bearing"), near["bearing"] + at(heat.bearing), **shiver),
        "T_bed": Column(_temp("bed, under the guideway"), near["bed"] + at(heat.bed), **shiver),
        "T_air": Column(_temp("air beside the beam path"), near["air"] + at(heat.air), **shiver),
        "p_air": Column({"role": "pressure", "unit": "hPa"}, at(heat.pressure), 2, 0.0, 0.03),
    }
    drive_end = 0.0 if drive_at_zero else travel
    constants = {
        axis: {
            "role": "axis",
            "kind": "linear",
            "travel": [0, int(travel)],
            "screw_lead": lead,
            "encoder_period": period,
            "drive_end": drive_end,
            "unit": "mm",
        }
    }
    effects = _effects(rng, w, heat, at, low, travel, lead, period, drive_end, near["air"])
    effects.update(sensor_fault(rng, columns, w.t, ("T_nut", "T_bearing", "T_bed")))
    bench = Bench(
        "linear positioning",
        f"{axis} axis, bidirectional positioning, {len({r for r in w.run if r[0] != 'w'})} runs over a shift",
        f"vmc-{rng.integers(1, 9)}",
        constants,
        columns,
        w.run,
        w.measured,
        {},
    )
    hideable = tuple(e for e in effects if logged or e != "feed_heating")  # without a log nobody knows the motion
    bench.responses[component] = Response(component, "um", effects, _novel(rng, w, heat, at, low, travel), hideable)
    return bench


def _temp(location: str) -> dict:
    return {"role": "temperature", "unit": "degC", "location": location}


def _effects(rng, w, heat, at, low, travel, lead, period, drive_end, air_base) -> dict[str, Contribution]:
    x, t = w.x, w.t
    sign = float(rng.choice([-1, 1]))
    out = {}

    def add(effect, values, drivers, **more):
        out[effect] = Contribution(effect, np.asarray(values, float), drivers, **more)

    slope = rng.uniform(5, 50) * rng.choice([-1, 1])
    add("scale_error", slope * x / 1e3, (low,), params={"slope": (slope, "um/m", True)})
    amplitude, phase = rng.uniform(0.8, 4.0), rng.uniform(0, 2 * np.pi)
    swell = 1.0 + rng.uniform(-0.25, 0.25) * (x / travel - 0.5) * 2
    add(
        "pitch_cyclic",
        amplitude
        * swell
        * (
            np.sin(2 * np.pi * x / lead + phase)
            + rng.uniform(0, 0.3) * np.sin(4 * np.pi * x / lead + rng.uniform(0, 6))
        ),
        (low,),
        params={"period": (lead, "mm", False)},
    )
    add(
        "interpolation",
        rng.uniform(0.2, 1.0)
        * (np.sin(2 * np.pi * x / period + phase) + rng.uniform(0, 0.2) * np.sin(4 * np.pi * x / period)),
        (low,),
        params={"period": (period, "mm", False)},
    )
    out["local_wear"] = worn_stretch(rng, x, low, travel)
    gap = rng.uniform(3, 14)
    give = 1.0 - rng.uniform(0, 0.06) * np.exp(-w.since / 1.0)
    add(
        "backlash",
        gap / 2 * w.side * give * sign,
        ("dir",),
        params={"lost_motion": (gap, "um", True)},
        ideal=gap / 2 * w.side * sign,
    )
    far = np.abs(x - drive_end) / travel
    drag = 1.0 + rng.uniform(-0.06, 0.06) * np.clip(at(heat.nut) / 15.0, 0, 1)
    add("screw_windup", -rng.uniform(3, 12) / 2 * w.side * far * drag, ("dir", low))
    reach = np.exp(rng.uniform(np.log(0.08), np.log(2.0)))
    add(
        "friction_hysteresis", rng.uniform(2, 8) * w.side * (1 - 2 * np.exp(-((w.since / reach) ** 0.85))), ("dir", low)
    )
    alpha = rng.uniform(5, 18) * rng.choice([-1, 1])
    strip = bodies.lump(10.0, heat.bed, rng.uniform(60, 400))
    strip_tilt = bodies.lump(10.0, heat.tilt, 300.0)
    local = at(strip) * x / 1e3 + at(strip_tilt) * (x**2 / travel - x) / 1e3
    add(
        "scale_expansion",
        alpha * local,
        (low, "T_bed"),
        params={"coefficient": (alpha, "um/m/K", True)},
        ideal=alpha * at(heat.bed) * x / 1e3,
    )
    add("feed_heating", growth(heat, w, travel, drive_end == 0.0), (low, "feed", "t"))
    source = str(rng.choice(["nut", "bearing", "bed"]))
    k = rng.uniform(1, 4) * rng.choice([-1, 1])
    add(
        "thermal_drift",
        k * at(bodies.lump(10.0, getattr(heat, source), rng.uniform(20, 90))),
        (f"T_{source}",),
        params={"coefficient": (k, "um/K", True)},
        ideal=k * at(getattr(heat, source)),
    )
    slow = str(rng.choice(["nut", "bearing"]))
    thick = rng.uniform(0.02, 0.12)
    add(
        "thermal_lag",
        rng.uniform(0.6, 3) * sign * at(bodies.wall_after(10.0, getattr(heat, slow), thick, rng.uniform(35, 70))),
        (f"T_{slow}",),
        params={"tau": (0.0, "s", False)},
    )
    other = "bed" if rng.random() < 0.6 else slow
    add(
        "thermal_interaction",
        rng.uniform(0.05, 0.5) * sign * at(getattr(heat, slow) * getattr(heat, other)),
        (f"T_{slow}", f"T_{other}"),
    )
    pair = [("bearing", "bed"), ("nut", "bed"), ("bearing", "nut"), ("bed", "air")][int(rng.integers(4))]
    bend = bodies.lump(10.0, getattr(heat, pair[0]) - getattr(heat, pair[1]), rng.uniform(30, 120))
    k = rng.uniform(1, 5) * rng.choice([-1, 1])
    add(
        "gradient_bending",
        k * at(bend),
        tuple(f"T_{p}" for p in pair),
        params={"coefficient": (k, "um/K", True)},
        ideal=k * at(getattr(heat, pair[0]) - getattr(heat, pair[1])),
    )
    mass = bodies.wall_after(10.0, heat.air, rng.uniform(0.05, 0.3), rng.uniform(15, 40))
    add("ambient_drift", rng.uniform(2, 8) * sign * at(mass), ("T_air",))
    celsius = air_base + at(bodies.lump(10.0, heat.air, rng.uniform(20, 200)))
    pressure = at(heat.pressure)
    add("air_refraction", sign * path_error(x, celsius, pressure, (air_base, pressure[0])), (low, "T_air", "p_air"))
    hours = t / 3600.0
    rate = rng.uniform(0.5, 4) * rng.choice([-1, 1])
    bent = hours + rng.uniform(-0.05, 0.05) * (hours**2 / hours[-1] - hours)
    add("sensor_drift", rate * bent, ("t",), params={"rate": (rate, "um/h", True)}, ideal=rate * hours)
    return out


def worn_stretch(rng: np.random.Generator, x: Array, column: str, travel: float) -> Contribution:
    """A worn stretch: nothing outside, a smooth hollow with flanks of its own inside."""
    width = rng.uniform(0.12, 0.3) * travel
    lo = rng.uniform(0.05, 0.95) * (travel - width)
    inside = np.clip((x - lo) / width, 0, 1)
    lean = rng.uniform(0.8, 1.3)
    hollow = np.sin(np.pi * inside**lean) ** 2 * rng.uniform(3, 15) * rng.choice([-1, 1])
    place = [float(np.round(lo, 2)), float(np.round(lo + width, 2))]
    return Contribution(
        "local_wear", hollow, (column,), active=(inside > 0) & (inside < 1), where={"ranges": {column: place}}
    )


def _novel(rng, w, heat, at, low, travel) -> dict[str, Contribution]:
    x, t = w.x, w.t
    out = {}

    def add(name, values, drivers=()):
        out[name] = Contribution(f"outside the vocabulary: {name}", np.asarray(values, float), drivers)

    order = {r: i for i, r in enumerate(dict.fromkeys(w.run))}
    number = np.array([order[r] for r in w.run])
    steps = rng.normal(0, 1, number.max() + 1)
    add("datum lost between runs", 3.0 * steps[number])
    beat = rng.uniform(260, 900)
    wave = np.abs((t / beat) % 1.0 - 0.5) * 4 - 1
    add("hydraulic pump cycling", 2.0 * np.sign(wave) * (1 - np.exp(-np.abs(wave) * 3)))
    since = t % rng.uniform(400, 1100)
    add("lubrication pulses", 3.0 * np.exp(-since / rng.uniform(50, 140)) * (0.4 + x / travel))
    strain = at(heat.screw.mean(axis=1))
    limit = rng.uniform(0.35, 0.65) * strain.max()
    add("pretension lost", np.maximum(strain - limit, 0.0) * w.side * 2.0 * (0.3 + 0.7 * x / travel))
    visits = np.zeros(t.size)
    for _ in range(int(rng.integers(2, 5))):
        visits += rng.choice([-1, 1]) * (
            (t > (a := rng.uniform(0, 0.9) * t[-1])) & (t < a + rng.uniform(0.05, 0.2) * t[-1])
        )
    add("floor tilted by a crane", 4.0 * visits * (0.4 + 0.6 * x / travel))
    chain = rng.uniform(0.25, 0.75) * travel
    add("cable chain", 2.5 * np.tanh((x - chain) / (0.06 * travel)) * (w.side > 0))
    add("guide joint", 2.5 * w.side * np.cos(np.pi * x / travel * rng.integers(2, 5) + rng.uniform(0, 3)))
    return out
