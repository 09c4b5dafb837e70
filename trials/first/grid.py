"""Volumetric grid: the tool point measured all over the work space with different loads and tool lengths."""

from __future__ import annotations

import numpy as np

from . import bodies
from .air import path_error
from .case import Array, Bench, Column, Contribution, Response

DT = 20.0
AXES = ("x", "y", "z")


def make(rng: np.random.Generator) -> Bench:
    """E_X, E_Y and E_Z at some 144 points in 4 to 6 runs."""
    size = {
        "x": float(rng.choice([500, 600, 700, 800])),
        "y": float(rng.choice([400, 500, 600])),
        "z": float(rng.choice([350, 400, 500])),
    }
    shape = {"x": int(rng.integers(5, 7)), "y": int(rng.integers(5, 7)), "z": int(rng.integers(4, 5))}
    at = {
        a: np.round(
            (np.linspace(0.02, 0.98, shape[a]) + rng.uniform(-0.04, 0.04, shape[a]).clip(0 if shape[a] < 2 else -0.04))
            * size[a],
            2,
        )
        for a in AXES
    }
    at = {a: np.sort(np.clip(v, 0, size[a])) for a, v in at.items()}
    runs = int(rng.integers(4, 7))
    one = _scan(at)
    n_one, n = one["x"].size, one["x"].size * runs
    pos = {a: np.tile(one[a], runs) for a in AXES}
    step = rng.uniform(8, 11)
    t, now = [], 0.0
    for _ in range(runs):
        t.append(np.round(now + np.cumsum(rng.uniform(step - 1, step + 1, n_one))))
        now = t[-1][-1] + rng.uniform(900, 5000)
    t = np.concatenate(t)
    full = float(rng.choice([200, 300, 400, 800]))
    loads = np.round(rng.permutation(np.concatenate([[0.0, full], rng.uniform(0.1, 0.9, runs - 2) * full])))
    tools = rng.permutation(
        np.resize(rng.choice([80.0, 120.0, 160.0, 200.0, 250.0, 300.0], min(runs, 4), replace=False), runs)
    )
    load, tool = np.repeat(loads, n_one), np.repeat(tools, n_one)
    clock = np.arange(int(t[-1] / DT) + 2) * DT
    air = bodies.room(rng, clock.size, DT, rng.uniform(0.4, 1.6), rng.uniform(0.1, 0.4), rng.uniform(0, 24))
    work = bodies.lump(DT, np.ones(clock.size), rng.uniform(4000, 12000)) * rng.uniform(0, 4)
    bed = work + bodies.lump(DT, air, rng.uniform(5000, 12000))
    base = rng.uniform(19.0, 23.0)
    show = {"decimals": 2, "step": 0.01, "noise": 0.03, "sensor": True}
    columns = {"t": Column({"role": "time", "unit": "s"}, t, 1)}
    for a in AXES:
        columns[a] = Column({"role": "position", "axis": a.upper(), "unit": "mm"}, pos[a], 2)
    columns |= {
        "load": Column({"role": "load", "unit": "kg"}, load, 1),
        "overhang": Column({"role": "overhang", "unit": "mm"}, tool, 1),
        "T_bed": Column(
            {"role": "temperature", "unit": "degC", "location": "bed"}, base + 1 + np.interp(t, clock, bed), **show
        ),
        "T_air": Column(
            {"role": "temperature", "unit": "degC", "location": "air in the work space"},
            base + np.interp(t, clock, air),
            **show,
        ),
    }
    run = [str(k + 1) for k in range(runs) for _ in range(n_one)]
    constants = {a.upper(): {"role": "axis", "kind": "linear", "travel": [0, int(size[a])], "unit": "mm"} for a in AXES}
    bench = Bench(
        "volumetric grid",
        f"Work space on a grid, {runs} runs",
        f"vmc-{rng.integers(1, 9)}",
        constants,
        columns,
        run,
        np.ones(n, bool),
        {},
        lossy=False,
    )
    world = {
        "t": t,
        "load": load,
        "tool": tool,
        "clock": clock,
        "bed": bed,
        "air": air,
        "base": base,
        "run": np.repeat(np.arange(runs), n_one),
        **pos,
    }
    for a in AXES:
        bench.responses[f"E_{a.upper()}"] = Response(
            f"E_{a.upper()}", "um", _effects(rng, world, size, a), _novel(rng, world, size)
        )
    return bench


def _scan(at: dict[str, Array]) -> dict[str, Array]:
    """There and back along x, rows in y, layers in z."""
    rows = {a: [] for a in AXES}
    for z in at["z"]:
        for j, y in enumerate(at["y"]):
            line = at["x"] if j % 2 == 0 else at["x"][::-1]
            rows["x"].extend(line)
            rows["y"].extend([y] * line.size)
            rows["z"].extend([z] * line.size)
    return {a: np.array(v) for a, v in rows.items()}


def _rail(rng, u: Array) -> Array:
    """Angle of a carriage on a rail that sags between its feet: the slope of a smooth profile, about -1..1."""
    return (
        rng.uniform(0.6, 1.0) * (u - 0.5) * 2
        + rng.uniform(-0.35, 0.35) * np.cos(np.pi * u)
        + rng.uniform(-0.2, 0.2) * np.sin(2 * np.pi * u)
    )


def _effects(rng, w, size, own) -> dict[str, Contribution]:
    out = {}
    others = [a for a in AXES if a != own]

    def sign() -> float:
        return float(rng.choice([-1, 1]))

    def add(effect, values, drivers, **more):
        out[effect] = Contribution(effect, np.asarray(values, float), drivers, **more)

    def now(series: Array) -> Array:
        return np.interp(w["t"], w["clock"], series)

    k = sign() * rng.uniform(8, 50)
    add("scale_error", k * w[own] / 1e3, (own,), params={"slope": (k, "um/m", True)})
    alpha = sign() * rng.uniform(6, 18)
    add(
        "scale_expansion",
        alpha
        * now(bodies.lump(DT, w["bed"], rng.uniform(30, 300)))
        * w[own]
        / 1e3
        * (1 + 0.05 * (w[own] / size[own] - 0.5)),
        (own, "T_bed"),
        ideal=alpha * now(w["bed"]) * w[own] / 1e3,
        params={"coefficient": (alpha, "um/m/K", True)},
    )
    a = str(rng.choice(others))
    s = sign() * rng.uniform(10, 60)
    add("squareness", s * w[a] / 1e3, (a,), params={"angle": (s, "urad", True)})
    a = str(rng.choice(others))
    u = w[a] / size[a]
    arch = (
        4 * u * (1 - u)
        + rng.uniform(-0.5, 0.5) * np.sin(2 * np.pi * u)
        + rng.uniform(-0.15, 0.15) * np.sin(3 * np.pi * u)
    )
    arch = arch - np.polyval(np.polyfit(u, arch, 1), u)
    add("straightness", sign() * rng.uniform(4, 18) * arch, (a,))
    a = str(rng.choice(AXES))
    lever = str(rng.choice(["overhang", *[b for b in AXES if b not in (a, own)]])) if rng.random() < 0.8 else "overhang"
    arm = (w["tool"] if lever == "overhang" else w[lever]) / 1e3
    add("angular_abbe", sign() * rng.uniform(15, 50) * _rail(rng, w[a] / size[a]) * arm, (a, lever))
    reach = str(rng.choice(["y", "z"] if own == "x" else [b for b in ("y", "z", "x") if b != own][:2]))
    out_to = w[reach] / size[reach]
    beam = out_to**3 * rng.uniform(0.6, 1.0) + rng.uniform(0.0, 0.4) * out_to**4
    add("gravity_sag", -rng.uniform(8, 35) * beam, (reach,))
    if own == "z":
        along = "x" if rng.random() < 0.7 else "y"
        v = w[along] / size[along] - rng.uniform(0.3, 0.7)
        table = rng.uniform(0.3, 1.0) + rng.uniform(0.5, 1.5) * sign() * v + rng.uniform(-0.4, 0.4) * v**2
        add("workpiece_load", -rng.uniform(8, 30) * w["load"] / w["load"].max() * table, ("load", along))
    air = w["base"] + now(bodies.lump(DT, w["air"], rng.uniform(20, 200)))
    add(
        "air_refraction",
        sign() * path_error(w[own] + rng.uniform(0, 40), air, np.full(air.size, 1010.0), (w["base"], 1010.0)),
        (own, "T_air"),
    )
    k = sign() * rng.uniform(1.5, 6)
    add(
        "thermal_drift",
        k * now(bodies.lump(DT, w["bed"], rng.uniform(20, 100))),
        ("T_bed",),
        ideal=k * now(w["bed"]),
        params={"coefficient": (k, "um/K", True)},
    )
    k = sign() * rng.uniform(1.5, 6)
    add(
        "gradient_bending",
        k * now(bodies.lump(DT, w["bed"] - w["air"], rng.uniform(20, 100))),
        ("T_bed", "T_air"),
        ideal=k * now(w["bed"] - w["air"]),
        params={"coefficient": (k, "um/K", True)},
    )
    rate = sign() * rng.uniform(0.7, 4)
    add("sensor_drift", rate * w["t"] / 3600, ("t",), params={"rate": (rate, "um/h", True)})
    return out


def _novel(rng, w, size) -> dict[str, Contribution]:
    t, run = w["t"], w["run"]
    since = t - np.array([t[run == k][0] for k in range(run.max() + 1)])[run]
    crane = np.zeros(t.size)
    for _ in range(int(rng.integers(3, 8))):
        start = int(rng.uniform(0, 0.95) * t.size)
        crane[start : start + int(rng.integers(15, 70))] = rng.choice([-1, 1])
    layer = np.unique(w["z"], return_inverse=True)[1]
    hops = rng.normal(0, 1, (run.max() + 1, layer.max() + 1))
    beat = rng.uniform(120, 500)
    made = {
        "fixture creeping": 8 * np.exp(-since / rng.uniform(150, 500)) * rng.uniform(0.5, 1.5, run.max() + 1)[run],
        "crane in the next bay": 6 * crane,
        "clamp of the z axis": 4 * hops[run, layer],
        "lubrication pulses": 5 * np.exp(-(t % beat) / (0.25 * beat)),
        "probe cable": 4 * np.tanh((w["y"] / size["y"] - 0.45) * 12) * (np.diff(w["x"], append=w["x"][-1]) < 0),
        "stop of the x carriage": 5 * (np.diff(w["x"], prepend=-1e3) > 0) * np.tanh((w["x"] / size["x"] - 0.5) * 6),
    }
    return {n: Contribution(f"outside the vocabulary: {n}", v, ()) for n, v in made.items()}
