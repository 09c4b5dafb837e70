"""Circular tests in the X-Y plane: both directions, two or three feeds, a ball bar's radial deviation."""

from __future__ import annotations

import numpy as np

from .case import Array, Bench, Column, Contribution, Response
from .friction import bouc_wen, play
from .linear import worn_stretch
from .servo import any_loop, spike

FINE = 0.001  # s


def make(rng: np.random.Generator) -> Bench:
    """E_R over 4 to 12 circles."""
    radius = float(rng.choice([50, 100, 150]))
    feeds = sorted(rng.choice([1000, 2000, 3000, 4000, 6000], int(rng.integers(2, 4)), replace=False).tolist())
    repeats = int(rng.choice([1, 2, 2]))
    points = int(min(rng.integers(1200, 1750), 15500 // (len(feeds) * 2 * repeats)))
    runs, now = [], 0.0
    for _ in range(repeats):
        for feed in feeds:
            for turn in (1, -1):
                omega = feed / 60.0 / radius
                phase0 = rng.uniform(0, 0.025)
                step = 2 * np.pi / points / omega
                local = np.arange(points + 1) * step
                runs.append(
                    {
                        "label": str(len(runs) + 1),
                        "feed": feed,
                        "turn": turn,
                        "omega": omega,
                        "phase0": phase0,
                        "t": now + phase0 / omega * 0.5 + local,
                        "angle": turn * (phase0 + omega * local),
                    }
                )
                now += local[-1] + rng.uniform(15, 60)
    angle = np.concatenate([r["angle"] for r in runs])
    w = np.concatenate([np.full(r["angle"].size, r["turn"] * r["omega"]) for r in runs])
    path = {
        "angle": angle,
        "w": w,
        "t": np.concatenate([r["t"] for r in runs]),
        "x": radius * np.cos(angle),
        "y": radius * np.sin(angle),
        "feed": np.concatenate([np.full(r["angle"].size, r["feed"], float) for r in runs]),
    }
    path["vx"], path["vy"] = -w * path["y"], w * path["x"]
    path["ax"], path["ay"] = -(w**2) * path["x"], -(w**2) * path["y"]
    run = [r["label"] for r in runs for _ in r["angle"]]
    leads = [float(v) for v in rng.choice([5, 8, 10, 12, 16, 20], 2)]
    constants = {
        "X": {"role": "axis", "kind": "linear", "travel": [-400, 400], "screw_lead": leads[0], "unit": "mm"},
        "Y": {"role": "axis", "kind": "linear", "travel": [-250, 250], "screw_lead": leads[1], "unit": "mm"},
    }
    speed = float(rng.choice([0.1, 0.3]))
    columns = {"t": Column({"role": "time", "unit": "s"}, path["t"], 4)}
    for name in ("x", "y"):
        columns[name] = Column({"role": "position", "axis": name.upper(), "unit": "mm"}, path[name], 4)
    for kind, unit, noise in (("v", "mm/s", speed), ("a", "mm/s2", 2.5 * speed)):
        for axis in ("x", "y"):
            role = "velocity" if kind == "v" else "acceleration"
            columns[kind + axis] = Column(
                {"role": role, "axis": axis.upper(), "unit": unit},
                path[kind + axis],
                3 if kind == "v" else 2,
                0.0,
                noise,
            )
    columns["feed"] = Column({"role": "feed", "unit": "mm/min"}, path["feed"], 0)
    if rng.random() < 0.5:
        for axis in ("x", "y"):
            columns[f"dir_{axis}"] = Column({"role": "direction", "axis": axis.upper()}, _side(path["v" + axis]), 0)
    bench = Bench(
        "circular test",
        f"Circular test X-Y, radius {radius:.0f} mm, both directions, {len(feeds)} feeds",
        f"vmc-{rng.integers(1, 9)}",
        constants,
        columns,
        run,
        np.ones(angle.size, bool),
        {},
        lossy=False,
    )
    bench.responses["E_R"] = Response(
        "E_R", "um", _effects(rng, path, runs, radius, leads, columns), _novel(rng, path, runs, radius)
    )
    return bench


def _side(v: Array) -> Array:
    return np.where(v >= 0, 1.0, -1.0)


def _effects(rng, path, runs, radius, leads, columns) -> dict[str, Contribution]:
    x, y, r = path["x"], path["y"], radius
    out = {}

    def sign() -> float:
        return float(rng.choice([-1, 1]))

    def add(effect, values, drivers, **more):
        out[effect] = Contribution(effect, np.asarray(values, float), drivers, **more)

    def axis() -> tuple[str, Array, str, tuple[str, ...]]:
        a = str(rng.choice(["x", "y"]))
        extra = (f"v{a}", f"dir_{a}") if f"dir_{a}" in columns else (f"v{a}",)
        return a, path[a], "y" if a == "x" else "x", extra

    a, p, q, sides = axis()
    slope = sign() * rng.uniform(8, 50)
    add("scale_error", slope * p / 1e3 * p / r, (a,), params={"slope": (slope, "um/m", True)})
    s = sign() * rng.uniform(8, 50)
    add("squareness", s * x * y / r / 1e3, ("x", "y"), params={"angle": (s, "urad", True)})
    a, p, q, sides = axis()
    reach = 1.15 * r
    bow = (
        rng.uniform(1.5, 6)
        * sign()
        * ((p / reach) ** 2 + rng.uniform(-0.7, 0.7) * (p / reach) ** 3 + rng.uniform(-0.3, 0.3) * (p / reach) ** 4)
    )
    add("straightness", bow * path[q] / r, (a, q))
    a, p, q, sides = axis()
    lead = leads[0 if a == "x" else 1]
    phase = rng.uniform(0, 6)
    cyclic = rng.uniform(0.7, 3) * (
        np.sin(2 * np.pi * p / lead + phase) + rng.uniform(0, 0.3) * np.sin(4 * np.pi * p / lead)
    )
    add("pitch_cyclic", cyclic * p / r, (a,), params={"period": (lead, "mm", False)})
    a, p, q, sides = axis()
    gap, way = rng.uniform(2, 12), sign()
    add(
        "backlash",
        way * gap / 2 * _by_run(path, runs, p, lambda v: play(v, gap / 1e3)) * p / r,
        (*sides, a, q),
        params={"lost_motion": (gap, "um", True)},
        ideal=way * gap / 2 * _side(path[f"v{a}"]) * p / r,
    )
    a, p, q, sides = axis()
    end = -400.0 if a == "x" else -250.0
    add(
        "screw_windup",
        -sign() * rng.uniform(6, 20) / 2 * _side(path[f"v{a}"]) * (p - end) / (-2 * end) * p / r,
        (*sides, a),
    )
    a, p, q, sides = axis()
    length = np.exp(rng.uniform(np.log(0.08), np.log(2.0)))
    curled = _by_run(path, runs, p, lambda v: bouc_wen(v, length, rng.uniform(1.0, 1.8), np.sign(v[1] - v[0])))
    add("friction_hysteresis", -sign() * rng.uniform(2, 8) * curled * p / r, (*sides, a, q))
    a, p, q, sides = axis()
    glitch = _spikes(rng, path, runs, radius, a)
    add(
        "reversal_spike",
        sign() * rng.uniform(3, 12) * glitch / max(np.abs(glitch).max(), 1e-9),
        (*sides, a, "feed", "t"),
        active=np.abs(glitch) > 0.03 * np.abs(glitch).max(),
    )
    lag = sign() * rng.uniform(0.02, 0.25) * 1e-3
    wave = 1.0 / (1.0 + 1j * path["w"] * lag)
    ey = 1e3 * r * (np.imag(np.exp(1j * path["angle"]) * wave) - np.sin(path["angle"]))
    add(
        "servo_mismatch", ey * y / r, ("vx", "vy", "x", "y", "feed"), params={"lag_difference": (lag * 1e3, "ms", True)}
    )
    k = rng.uniform(2, 12) * sign()
    resonance = 2 * np.pi * rng.uniform(8, 20)
    stretch = 1.0 / (1.0 - np.minimum((path["w"] / resonance) ** 2, 0.5))
    add(
        "inertial_deflection",
        k * stretch * (path["ax"] * x + path["ay"] * y) / r / 1e3,
        ("ax", "ay", "feed", "vx", "vy"),
        params={"coefficient": (k, "um/(m/s2)", True)},
    )
    a, p, q, sides = axis()
    worn = worn_stretch(rng, p + r, a, 2 * r)
    lo, hi = worn.where["ranges"][a]
    out["local_wear"] = Contribution(
        "local_wear",
        worn.values * p / r,
        (a,),
        active=worn.active,
        where={"ranges": {a: [round(lo - r, 2), round(hi - r, 2)]}},
    )
    return out


def _by_run(path, runs, values, shape) -> Array:
    out, start = np.empty(values.size), 0
    for run in runs:
        part = slice(start, start + run["angle"].size)
        lead_in = values[part][:1] - np.sign(values[part][1] - values[part][0]) * np.linspace(1.0, 0.0, 60) * 30
        out[part] = shape(np.concatenate([lead_in, values[part]]))[lead_in.size :]
        start = part.stop
    return out


def _spikes(rng, path, runs, radius, axis) -> Array:
    """Radial trace of the friction's push after each reversal of one axis, from a 1 ms loop around the reversal."""
    loop, knee, bristle = any_loop(rng), rng.uniform(1, 5), rng.uniform(0.01, 0.06)
    both = rng.random() < 0.3
    out, start = np.zeros(path["t"].size), 0
    for run in runs:
        t = run["t"] - run["t"][0]
        a0, w = run["phase0"], run["omega"]
        shift = 0.0 if axis == "x" else np.pi / 2
        for k in range(0, 4):
            at = (shift + k * np.pi - a0) / w  # both turns: the angle runs through +-(shift + k pi)
            if not 0 < at < t[-1]:
                continue
            if not both and k % 2 == (1 if loop.damping > 0.55 else 0):
                continue
            fine = np.arange(-0.06, 0.7, FINE)
            v = -radius * w * np.sin(w * fine) * np.cos(k * np.pi) * (1 if axis == "x" else run["turn"])
            trace = spike(loop, FINE, v, knee, bristle)
            away = np.cos(k * np.pi) * (1 if axis == "x" else run["turn"])
            near = (t >= at) & (t < at + 0.63)
            out[start : start + t.size][near] += np.interp(t[near] - at, fine, trace) * away
        start += t.size
    return out


def _novel(rng, path, runs, radius) -> dict[str, Contribution]:
    x, y, r, t = path["x"], path["y"], radius, path["t"]
    out = {}

    def add(name, values):
        out[name] = Contribution(f"outside the vocabulary: {name}", np.asarray(values, float), ())

    add(
        "pump vibration",
        2.0 * np.sin(2 * np.pi * rng.uniform(2.5, 7.0) * t + rng.uniform(0, 6)) * (1 + 0.4 * np.sin(path["angle"])),
    )
    slow = np.exp(-((path["vx"] / (0.25 * np.abs(path["vx"]).max())) ** 2))
    travel = rng.uniform(1.2, 4.0)
    add("stick-slip", 3.0 * slow * (((x + 0.3 * y) / travel) % 1.0 - 0.5) * np.sign(path["vx"]))
    add(
        "gear backlash under load",
        4.0 * np.sign(path["vx"]) * np.clip(path["ax"] / np.abs(path["ax"]).max(), 0, None) ** 2 * x / r,
    )
    joints = rng.uniform(-0.8, 0.8, 3) * r
    cover = sum(np.tanh((x - j) / (0.04 * r)) * s for j, s in zip(joints, (1, -1.4, 0.8), strict=True))
    add("telescopic cover", 1.6 * cover * (path["vx"] > 0) * y / r)
    first = np.array([float(label["t"][0]) for label in runs])
    since = t - first[np.searchsorted(first, t, side="right") - 1]
    add("table settling", 3.5 * np.exp(-since / rng.uniform(0.8, 3.0)) * np.where(path["w"] > 0, 1, 0.7))
    add(
        "three-lobed ball",
        2.0
        * np.cos(3 * path["angle"] * np.sign(path["w"]) + rng.uniform(0, 6))
        * (1 + 0.5 * np.cos(5 * path["angle"])),
    )
    return out
