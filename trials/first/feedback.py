"""Feedback traces: an axis under way, its drive force or its deviation from the command, at a few hundred hertz."""

from __future__ import annotations

import numpy as np

from .case import Array, Bench, Column, Contribution, Response
from .friction import bouc_wen, lugre, play
from .linear import worn_stretch
from .servo import any_loop, follow, spike


def motion(
    rng: np.random.Generator, seconds: float, dt: float, feed: float, travel: float
) -> tuple[Array, Array, Array]:
    """Position mm, speed mm/s, acceleration mm/s2: stretches of constant speed, jerk-limited ramps, short rests."""
    n = int(seconds / dt)
    goal = np.zeros(n)
    i, x = 0, rng.uniform(0.3, 0.7) * travel
    start, way = x, float(rng.choice([-1, 1]))
    while i < n:
        v = feed / 60.0 * rng.uniform(0.3, 1.05) * (1 if rng.random() < 0.72 else rng.uniform(0.05, 0.2))
        room = (0.93 * travel - x) if way > 0 else (x - 0.07 * travel)
        hold = min(rng.uniform(0.9, 5.5), max(room / v, 0.15))
        k = max(int(hold / dt), 4)
        goal[i : i + k] = way * v
        x += way * v * min(k, n - i) * dt
        i += k
        if rng.random() < 0.7:
            i += int(rng.uniform(0.05, 0.3) / dt)
        way = -way if rng.random() < 0.85 or room < 0.1 * travel else way
    ramp = max(int(feed / 60.0 / rng.uniform(300, 2000) / dt), 6)
    pad = 3 * ramp
    padded = np.concatenate([np.full(pad, goal[0]), goal, np.full(pad, goal[-1])])
    kernel = np.ones(ramp) / ramp
    smooth = np.convolve(np.convolve(padded, kernel, "same"), np.ones(max(ramp // 3, 2)) / max(ramp // 3, 2), "same")
    v = smooth[pad:-pad]
    a = np.gradient(v, dt)
    return np.clip(start + np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * dt)]), -50, travel + 50), v, a


def make(rng: np.random.Generator) -> Bench:
    """F_X or EXX over 4 to 6 runs."""
    travel = float(rng.choice([400, 500, 600, 750, 900]))
    rate = float(rng.choice([200, 250, 400]))
    dt = 1.0 / rate
    n_runs = int(rng.integers(4, 7))
    seconds = min(rng.uniform(7, 20), 15500 * dt / n_runs)
    parts, now = [], 0.0
    feeds = rng.choice([600, 1200, 2000, 4000, 6000, 10000, 16000], n_runs)
    for k in range(n_runs):
        x, v, a = motion(rng, seconds, dt, float(max(feeds[k], 1200 if k == 0 else 0)), travel)
        parts.append(
            {"t": now + np.arange(x.size) * dt, "x": x, "v": v, "a": a, "label": str(k + 1), "feed": float(feeds[k])}
        )
        now += seconds + rng.uniform(10, 40)
    path = {k: np.concatenate([p[k] for p in parts]) for k in ("t", "x", "v", "a")}
    run = [p["label"] for p in parts for _ in p["t"]]
    lead, period = float(rng.choice([5, 10, 12, 16, 20])), float(rng.choice([0.02, 0.04, 0.1]))
    constants = {
        "X": {
            "role": "axis",
            "kind": "linear",
            "travel": [0, int(travel)],
            "screw_lead": lead,
            "encoder_period": period,
            "drive_end": 0,
            "unit": "mm",
        }
    }
    top = np.abs(path["v"]).max()
    columns = {
        "t": Column({"role": "time", "unit": "s"}, path["t"], 4),
        "x": Column({"role": "position", "axis": "X", "unit": "mm"}, path["x"], 5),
        "x_cmd": Column({"role": "command", "axis": "X", "unit": "mm"}, path["x"], 5),
        "vx": Column({"role": "velocity", "axis": "X", "unit": "mm/s"}, path["v"], 4, 0.0, 1e-3 * top),
        "ax": Column({"role": "acceleration", "axis": "X", "unit": "mm/s2"}, path["a"], 2, 0.0, rng.uniform(5, 20)),
    }
    if rng.random() < 0.5:
        columns["feed"] = Column(
            {"role": "feed", "axis": "X", "unit": "mm/min"},
            np.repeat([p["feed"] for p in parts], [p["t"].size for p in parts]),
            1,
        )
    force = bool(rng.random() < 0.5)
    what = "drive force" if force else "deviation from command"
    bench = Bench(
        "feedback trace",
        f"X axis under way, {what}, {rate:.0f} Hz after decimation",
        f"vmc-{rng.integers(1, 9)}",
        constants,
        columns,
        run,
        np.ones(path["t"].size, bool),
        {},
        spikes=0.006,
    )
    pieces = [slice(i * parts[0]["t"].size, (i + 1) * parts[0]["t"].size) for i in range(n_runs)]
    if force:
        effects = _forces(rng, path, pieces, dt, lead)
        hideable = tuple(e for e in effects if e != "moving_mass")
        bench.responses["F_X"] = Response("F_X", "N", effects, _novel_forces(rng, path, pieces, travel), hideable)
    else:
        effects = _deviations(rng, path, pieces, dt, lead, period, travel)
        bench.responses["EXX"] = Response("EXX", "um", effects, _novel_deviations(rng, path, pieces, travel), None, "x")
    return bench


def _runs(pieces: list[slice], shape) -> Array:
    return np.concatenate([shape(p) for p in pieces])


def _forces(rng, path, pieces, dt, lead) -> dict[str, Contribution]:
    x, v, a, t = path["x"], path["v"], path["a"], path["t"]
    out = {}

    def add(effect, values, drivers, **more):
        out[effect] = Contribution(effect, np.asarray(values, float), drivers, **more)

    mass = rng.uniform(80, 700)
    add("moving_mass", mass * a / 1e3, ("ax",))
    level, bristle = rng.uniform(5, 120), rng.uniform(0.003, 0.02)

    def slide(static: float, knee: float) -> Array:
        return _runs(pieces, lambda p: lugre(t[p], v[p], level, static, knee, bristle))

    add("coulomb_friction", slide(level, 1.0), ("vx",), params={"force": (level, "N", True)}, ideal=level * np.sign(v))
    b = rng.uniform(100, 2500)
    thin = 1 + rng.uniform(-0.05, 0.05) * t / t[-1]
    add("viscous_friction", b * v / 1e3 * thin, ("vx",), params={"coefficient": (b, "N s/m", True)}, ideal=b * v / 1e3)
    knee = rng.uniform(2.0, 15.0)
    add("stribeck_friction", (slide(level * 1.8, knee) - slide(level, knee)) * rng.uniform(0.5, 1.5), ("vx",))
    period = float(np.round(rng.choice([lead, lead / 2, rng.uniform(8, 60)]), 3))
    wave = np.sin(2 * np.pi * x / period + rng.uniform(0, 6)) + rng.uniform(0, 0.4) * np.sin(
        4 * np.pi * x / period + rng.uniform(0, 6)
    )
    add(
        "torque_ripple",
        rng.uniform(3, 40) * wave * (1 + 0.04 * np.sign(v)),
        ("x",),
        params={"period": (period, "mm", False)},
    )
    return out


def _deviations(rng, path, pieces, dt, lead, period, travel) -> dict[str, Contribution]:
    x, v, a = path["x"], path["v"], path["a"]
    out = {}

    def sign() -> float:
        return float(rng.choice([-1, 1]))

    def add(effect, values, drivers, **more):
        out[effect] = Contribution(effect, np.asarray(values, float), drivers, **more)

    lag = rng.uniform(0.03, 0.25) * 1e-3
    trail = _runs(pieces, lambda p: follow(dt, x[p], lag, 2 * np.pi * 35))
    way = sign()
    add(
        "following_error",
        way * 1e3 * trail,
        ("vx",),
        params={"lag": (lag * 1e3, "ms", True)},
        ideal=-way * 1e3 * lag * v,
    )
    k = sign() * rng.uniform(1, 10)
    add("inertial_deflection", k * a / 1e3, ("ax",), params={"coefficient": (k, "um/(m/s2)", True)})
    wave = np.sin(2 * np.pi * x / lead + rng.uniform(0, 6)) + rng.uniform(0, 0.3) * np.sin(
        4 * np.pi * x / lead + rng.uniform(0, 6)
    )
    add("pitch_cyclic", rng.uniform(0.5, 4) * wave, ("x",), params={"period": (lead, "mm", False)})
    fine = np.sin(2 * np.pi * x / period + rng.uniform(0, 6)) + rng.uniform(0, 0.2) * np.sin(4 * np.pi * x / period)
    add("interpolation", rng.uniform(0.2, 1.0) * fine, ("x",), params={"period": (period, "mm", False)})
    gap = rng.uniform(2, 12)
    add(
        "backlash",
        way * gap / 2 * _runs(pieces, lambda p: play(x[p], gap / 1e3, float(np.sign(v[p][0])))),
        ("vx",),
        params={"lost_motion": (gap, "um", True)},
        ideal=way * gap / 2 * np.sign(v),
    )
    length = np.exp(rng.uniform(np.log(0.05), np.log(1.5)))
    curled = _runs(pieces, lambda p: bouc_wen(x[p], length, 1.4, float(np.sign(v[p][0]))))
    add("friction_hysteresis", sign() * rng.uniform(1.5, 7) * curled, ("vx", "x"))
    side = _runs(pieces, lambda p: play(x[p], 0.002, float(np.sign(v[p][0]))))
    add("screw_windup", -sign() * rng.uniform(4, 14) / 2 * side * x / travel, ("vx", "x"))
    loop, knee, bristle = any_loop(rng), rng.uniform(1, 5), rng.uniform(0.005, 0.05)
    glitch = _runs(pieces, lambda p: spike(loop, dt, v[p], knee, bristle))
    add(
        "reversal_spike",
        sign() * rng.uniform(3, 12) * glitch / max(np.abs(glitch).max(), 1e-9),
        ("vx", "t", "x", "ax"),
        active=np.abs(glitch) > 0.05 * np.abs(glitch).max(),
    )
    out["local_wear"] = _worn(rng, x)
    return out


def _worn(rng, x: Array) -> Contribution:
    low, high = float(x.min()), float(x.max())
    worn = worn_stretch(rng, x - low, "x", high - low)
    a, b = worn.where["ranges"]["x"]
    worn.where = {"ranges": {"x": [round(a + low, 2), round(b + low, 2)]}}
    return worn


def _ringing(rng, path, pieces) -> Array:
    f, life = rng.uniform(4, 12), rng.uniform(0.15, 0.5)
    out = np.zeros(path["t"].size)
    for p in pieces:
        t, a = path["t"][p], path["a"][p]
        kick = np.abs(np.diff(a, prepend=a[0]))
        big = np.flatnonzero(kick > 0.5 * kick.max())
        last = None
        for i in big.tolist():
            if last is not None and t[i] - t[last] < 0.08:
                continue
            last = i
            s = t - t[i]
            out[p] += np.where(s >= 0, np.sin(2 * np.pi * f * s) * np.exp(-np.clip(s, 0, None) / life), 0.0)
    return out


def _after_rest(path, pieces, life: float) -> Array:
    out = np.zeros(path["t"].size)
    for p in pieces:
        t, v = path["t"][p], path["v"][p]
        still = np.abs(v) < 0.02 * np.abs(v).max()
        last = np.maximum.accumulate(np.where(still, t, t[0] - 60))
        out[p] = np.sign(v) * np.exp(-(t - last) / life) * ~still
    return out


def _saw(rng, path) -> Array:
    pitch, slow = rng.uniform(0.5, 3), np.exp(-((path["v"] / 25.0) ** 2))
    return slow * ((path["x"] / pitch) % 1.0 - 0.5) * np.sign(path["v"])


def _novel_forces(rng, path, pieces, travel) -> dict[str, Contribution]:
    x, v, a, t = path["x"], path["v"], path["a"], path["t"]
    edge = rng.uniform(0.35, 0.6) * travel
    made = {
        "ringing": 20 * _ringing(rng, path, pieces),
        "wiper breakaway": 30 * _after_rest(path, pieces, rng.uniform(0.3, 1.0)),
        "stick-slip": 20 * _saw(rng, path),
        "cable chain": 20 * np.tanh((x - edge) / (0.05 * travel)) * (v > 0),
        "gear friction under load": 30 * np.sign(v) * np.abs(a) / np.abs(a).max(),
        "counterbalance valve": 15 * np.sign(np.sin(2 * np.pi * t / rng.uniform(1.5, 5.0))),
    }
    return {n: Contribution(f"outside the vocabulary: {n}", w, ()) for n, w in made.items()}


def _novel_deviations(rng, path, pieces, travel) -> dict[str, Contribution]:
    x, v, t = path["x"], path["v"], path["t"]
    edge = rng.uniform(0.35, 0.6) * travel
    made = {
        "ringing": 3 * _ringing(rng, path, pieces),
        "seal breakaway": 5 * _after_rest(path, pieces, rng.uniform(0.3, 1.2)),
        "stick-slip": 4 * _saw(rng, path),
        "cable chain": 4 * np.tanh((x - edge) / (0.05 * travel)) * (v > 0),
        "floor vibration": 2 * np.sin(2 * np.pi * rng.uniform(1.5, 9) * t + rng.uniform(0, 6)),
        "one-sided guide": 4 * np.clip(v, 0, None) ** 2 / np.abs(v).max() ** 2,
    }
    return {n: Contribution(f"outside the vocabulary: {n}", w, ()) for n, w in made.items()}
