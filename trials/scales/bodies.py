"""Bodies with time constants of twenty seconds to a day; grids; cutting series of every size."""

from __future__ import annotations

import numpy as np
import pandas as pd

from trials.folder import Array, Sheet
from trials.rivals import first_order

from .bench import Bench, Effect, Rng, log_uniform, unit_rms

SAMPLINGS = (0.1, 0.5, 1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600)  # s, what loggers offer


def levels(rng: Rng, t: Array, stay: float, high: float) -> Array:
    """Steps between 0 and `high`, each for a random while around `stay`."""
    out, i = np.zeros(t.size), 0
    while i < t.size:
        until = t[i] + stay * rng.uniform(0.5, 2)
        n = max(int(np.searchsorted(t, until)) - i, 1)
        out[i : i + n] = high * rng.choice([0, rng.uniform(0.3, 1), 1])
        i += n
    return out


def warm_body(rng: Rng) -> Bench:
    """Drift of a tool point while a heat source works at changing levels and the room follows its own day."""
    tau = log_uniform(rng, 20, 86400)
    step = min(SAMPLINGS, key=lambda s: abs(np.log(s / (tau / rng.uniform(20, 60)))))
    rows = int(np.clip(rng.uniform(9, 16) * tau / step, 200, 6000))
    t = np.arange(rows) * step
    speed = np.round(levels(rng, t, 1.5 * tau, log_uniform(rng, 500, 40000)), 0)
    heat = speed / max(speed.max(), 1.0)
    head = 21 + rng.uniform(5, 20) * first_order(t, heat, tau * rng.uniform(0.1, 0.25))
    frame = 20.5 + rng.uniform(2, 6) * first_order(t, levels(rng, t, 2 * tau, 1.0), tau * rng.uniform(0.3, 0.6))
    room = 20 + rng.uniform(1, 3) * np.sin(2 * np.pi * t / (rng.uniform(4, 8) * tau) + rng.uniform(0, 6))
    show = lambda u: np.round(u + 0.01 * rng.normal(size=rows), 3)  # noqa: E731
    letter = str(rng.choice(["X", "Y", "Z"]))
    run = 1 + (np.arange(rows) * int(rng.integers(1, 5))) // rows
    data = pd.DataFrame({"run": run.astype(str), "t": np.round(t, 3), "speed": speed})
    data["T_head"], data["T_frame"], data["T_room"] = show(head), show(frame), show(room)
    columns = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "speed": {"role": "spindle_speed", "unit": "rpm"},
        "T_head": {"role": "temperature", "unit": "degC", "location": "head casting"},
        "T_frame": {"role": "temperature", "unit": "degC", "location": "frame"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room air"},
    }
    sheet = Sheet(f"Drift of a body of {tau:.0f} s", data, columns, "body", {})
    size = log_uniform(rng, 0.3, 60)
    effects = _thermal_effects(size, tau, t, heat, head, frame, room)
    base = [unit_rms(first_order(t, heat, 0.6 * tau)), unit_rms(room), unit_rms(frame)]
    return Bench(f"body of {tau:.3g} s, a reading every {step:g} s", sheet, f"E_{letter}", "um", effects, base)


def _thermal_effects(
    size: float, tau: float, t: Array, heat: Array, head: Array, frame: Array, room: Array
) -> dict[str, Effect]:
    def per(u: Array) -> float:
        return 2 * size / max(np.ptp(u), 1e-9)

    lag = first_order(t, frame, tau)
    slow = first_order(t, room, tau)
    bend = head - frame
    grow = first_order(t, heat**1.2, tau)
    hours = t / 3600
    return {
        "thermal_drift": Effect(per(head) * (head - head[0]), ("T_head",), {"gain": (per(head), "um/K", True)}),
        "thermal_lag": Effect(
            per(lag) * (lag - lag[0]), ("T_frame",), {"gain": (per(lag), "um/K", True), "tau": (tau, "s", False)}
        ),
        "ambient_drift": Effect(
            per(slow) * (slow - slow[0]),
            ("T_room",),
            {"gain": (per(slow), "um/K", True), "tau": (tau, "s", False)},
            ("thermal_lag",),
        ),
        "gradient_bending": Effect(
            per(bend) * (bend - bend[0]), ("T_head", "T_frame"), {"gain": (per(bend), "um/K", True)}
        ),
        "spindle_growth": Effect(2 * size * grow / max(np.ptp(grow), 1e-9), ("speed",), {"tau": (tau, "s", False)}),
        "sensor_drift": Effect(
            2 * size * t / t[-1], ("t",), {"rate": (2 * size / max(hours[-1], 1e-12), "um/h", True)}
        ),
        "centrifugal_growth": Effect(2 * size * heat**2, ("speed",), {"at_full_speed": (2 * size, "um", True)}),
    }


def grid(rng: Rng) -> Bench:
    """A volume measured point by point with several tool lengths and loads: 20 mm to 10 m."""
    edge = log_uniform(rng, 20, 10000)
    spans = edge * rng.uniform(0.5, 1.0, 3)
    shape = rng.integers(4, 8, 3)
    axes = [np.linspace(0, s, n) for s, n in zip(spans, shape, strict=True)]
    x, y, z = (g.ravel() for g in np.meshgrid(*axes, indexing="ij"))
    legs = np.array([0.15, 0.35]) * edge
    tools = [np.tile(g, 2) for g in (x, y, z)]
    x, y, z = tools
    leg = np.repeat(legs, x.size // 2)
    mass = log_uniform(rng, 1, 5000)
    load = np.tile(np.repeat([0.0, mass], x.size // 4 + 1)[: x.size // 2], 2)
    rng.shuffle(load)
    t = np.arange(x.size) * rng.uniform(5, 20)
    run = np.repeat(["tool 1", "tool 2"], x.size // 2)
    data = pd.DataFrame({"run": run, "t": np.round(t, 1), "x": np.round(x, 4), "y": np.round(y, 4)})
    data["z"], data["overhang"], data["load"] = np.round(z, 4), np.round(leg, 3), np.round(load, 1)
    columns = {"run": {"role": "run"}, "t": {"role": "time", "unit": "s"}}
    columns |= {a.lower(): {"role": "position", "axis": a, "unit": "mm"} for a in "XYZ"}
    columns |= {"overhang": {"role": "overhang", "unit": "mm"}, "load": {"role": "load", "unit": "kg"}}
    facts = {
        a: {"role": "axis", "kind": "linear", "travel": [0.0, round(float(s), 4)], "unit": "mm"}
        for a, s in zip("XYZ", spans, strict=True)
    }
    sheet = Sheet(f"Grid of {edge:.0f} mm", data, columns, "grid", facts)
    size = log_uniform(rng, 0.3, 3) * edge**0.35
    u, w = x / spans[0], y / spans[1]
    tilt = leg / legs.max() * u
    effects = {
        "squareness": Effect(size * 2 * u, ("x",), {"angle": (size * 2 / spans[0] * 1e3, "urad", True)}),
        "straightness": Effect(6 * size * u * (1 - u), ("x",), {}),
        "angular_abbe": Effect(2 * size * tilt, ("x", "overhang"), {}),
        "workpiece_load": Effect(2 * size * load / mass, ("load",), {"at_full_load": (2 * size, "um", True)}),
    }
    base = [unit_rms(np.sin(2.3 * w)), unit_rms(z / spans[2] * w)]
    return Bench(f"grid of {edge:.3g} mm", sheet, "E_Y", "um", effects, base)


def cutting(rng: Rng) -> Bench:
    """A series of parts: tools worn and changed, forces that vary from part to part."""
    parts = int(rng.integers(60, 400))
    tools = int(rng.integers(2, 7))
    each = int(np.ceil(parts / tools))
    length = np.concatenate([np.cumsum(rng.uniform(0.6, 1.4, each)) for _ in range(tools)])[:parts]
    length *= log_uniform(rng, 0.2, 200)
    run = np.array([f"tool {1 + i // each}" for i in range(parts)])
    force = log_uniform(rng, 3, 3000) * rng.uniform(0.2, 1.0, parts)
    pace = log_uniform(rng, 2, 1800)
    t = np.cumsum(rng.uniform(0.8, 1.3, parts)) * pace
    warm = 21 + rng.uniform(2, 8) * (1 - np.exp(-t / (0.3 * t[-1]))) + 0.02 * rng.normal(size=parts)
    data = pd.DataFrame({"run": run, "t": np.round(t, 1), "cut_length": np.round(length, 4)})
    data["force"], data["T_spindle"] = np.round(force, 3), np.round(warm, 3)
    columns = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "cut_length": {"role": "cut_length", "unit": "m"},
        "force": {"role": "force", "axis": "X", "unit": "N"},
        "T_spindle": {"role": "temperature", "unit": "degC", "location": "spindle housing"},
    }
    sheet = Sheet("Series of parts", data, columns, "lathe", {})
    size = log_uniform(rng, 0.5, 40)
    wear = 2 * size / length.max()
    push = 2 * size / force.max()
    gain = 2 * size / np.ptp(warm)
    effects = {
        "tool_wear": Effect(
            wear * length, ("cut_length",), {"rate": (wear, "um/m", True), "at_the_end": (2 * size, "um", True)}
        ),
        "cutting_compliance": Effect(push * force, ("force",), {"compliance": (push * 1e3, "um/kN", True)}),
        "thermal_drift": Effect(gain * (warm - warm[0]), ("T_spindle",), {"gain": (gain, "um/K", True)}),
    }
    base = [unit_rms(rng.normal(size=parts).cumsum()), unit_rms(np.sin(0.07 * np.arange(parts)))]
    return Bench(f"{parts} parts, one each {pace:.3g} s", sheet, "E_D", "um", effects, base)
