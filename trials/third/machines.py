"""Stages, mills, lathes, gantries, robot joints and telescope mounts, with effects that stray from the textbook.

Frames and strokes are those of the sweep; what acts on them is not the textbook's formula: amplitudes vary along the
axis and with time, a wave has harmonics, friction builds up.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from trials.folder import Array, Sheet
from trials.rivals import first_order
from trials.scales.axes import Axis, drive_force, positioning, presliding, strokes, under_way
from trials.scales.bench import Bench, Effect, Rng, log_uniform, unit_rms
from trials.scales.bodies import cutting, grid, warm_body

STRAY = 0.15  # rms by which an effect's size varies from place to place and hour to hour


def smooth(rng: Rng, u: Array) -> Array:
    """A smooth random function of u in 0..1, of rms about 1."""
    out = np.zeros(u.size)
    for k in range(1, 4):
        out += rng.normal() * np.sin(np.pi * k * u + rng.uniform(0, 6)) / k
    return out / 1.17


def strayed(rng: Rng, bench: Bench) -> Bench:
    """Every effect as a machine would show it rather than as the textbook writes it."""
    sheet = bench.sheet
    along = sheet.names("position") or sheet.names("time")
    x = sheet.values(along[0])
    u = (x - x.min()) / max(np.ptp(x), 1e-12)
    w = np.linspace(0, 1, x.size)
    effects = {}
    for name, effect in bench.effects.items():
        if name in LAWS:
            effects[name] = effect
            continue
        vary = 1 + STRAY * (smooth(rng, u) + smooth(rng, w)) / 2**0.5
        if name in WAVES:
            vary = vary + rng.uniform(0.05, 0.3) * np.sign(effect.values) * np.abs(effect.values) / np.ptp(
                effect.values
            )
        effects[name] = Effect(effect.values * vary, effect.drivers, effect.sizes, effect.also)
    return Bench(bench.scale, sheet, bench.component, bench.unit, effects, bench.base)


LAWS = {"sensor_drift", "following_error", "inertial_deflection", "viscous_friction"}  # proportional to one column
WAVES = {"pitch_cyclic", "torque_ripple"}


def stage(rng: Rng) -> Bench:
    """A stage of 1 to 60 mm: positioning runs or a log."""
    which = int(rng.integers(0, 3))
    return positioning(rng, which) if rng.random() < 0.6 else under_way(rng, which)


def mill_or_lathe(rng: Rng) -> Bench:
    """An axis of 250 mm to 2 m: positioning runs, a log, its drive force."""
    make = (positioning, under_way, drive_force)[int(rng.integers(3))]
    return make(rng, int(rng.integers(3, 6)))


def gantry(rng: Rng) -> Bench:
    """A gantry or a long bed of 6 to 20 m."""
    return positioning(rng, int(rng.integers(6, 8)))


def robot(rng: Rng) -> Bench:
    """A robot's joint: the torque of a gear with two meshes, friction that builds up, beside gravity's torque."""
    axis = Axis(rng, 9)
    rate = float(rng.choice([100, 250]))
    x = strokes(rng, axis, rate, 40.0) - 180
    t = np.arange(x.size) / rate
    v = np.gradient(x, t)
    a = np.gradient(v, t)
    data = pd.DataFrame({"t": np.round(t, 5), "joint": np.round(x, 5), "rate": np.round(v, 5), "accel": np.round(a, 4)})
    columns = {
        "t": {"role": "time", "unit": "s"},
        "joint": {"role": "position", "axis": "C", "unit": "deg"},
        "rate": {"role": "velocity", "axis": "C", "unit": "deg/s"},
        "accel": {"role": "acceleration", "axis": "C", "unit": "deg/s2"},
    }
    facts = {"C": {"role": "axis", "kind": "rotary", "travel": [-180.0, 180.0], "unit": "deg"}}
    sheet = Sheet(f"robot joint, torque at {rate:g} Hz", data, columns, "robot", facts)
    dry = log_uniform(rng, 0.1, 50)
    teeth = int(rng.integers(12, 40))
    wave = dry * (np.sin(np.radians(teeth * x) + rng.uniform(0, 6)) + 0.2 * np.sin(np.radians(3 * teeth * x)))
    effects = {
        "coulomb_friction": Effect(dry * presliding(x, 0.15), ("rate",), {"torque": (dry, "N m", True)}),
        "viscous_friction": Effect(dry * v / np.abs(v).max(), ("rate",), {}),
        "torque_ripple": Effect(
            wave, ("joint",), {"amplitude": (dry, "N m", True), "period": (360 / teeth, "deg", False)}
        ),
    }
    base = [unit_rms(a), unit_rms(np.sin(np.radians(x) + 0.4))]
    return Bench("robot joint", sheet, "F_C", "N m", effects, base)


def mount(rng: Rng) -> Bench:
    """A telescope mount that tracks at 15 degrees an hour: a worm of 180 to 360 teeth, bearings, a cooling night."""
    hours = rng.uniform(2, 6)
    step = float(rng.choice([2, 5, 10]))
    t = np.arange(0, hours * 3600, step)
    x = rng.uniform(-60, 0) + 15.041 * t / 3600
    night = 12 - rng.uniform(2, 6) * (1 - np.exp(-t / 6000)) + 0.05 * smooth(rng, t / t[-1])
    tube = first_order(t, night, rng.uniform(1500, 4000)) + 0.4
    data = pd.DataFrame({"t": np.round(t, 2), "ra": np.round(x, 6)})
    data["T_air"] = np.round(night + 0.02 * rng.normal(size=t.size), 3)
    data["T_tube"] = np.round(tube + 0.02 * rng.normal(size=t.size), 3)
    columns = {
        "t": {"role": "time", "unit": "s"},
        "ra": {"role": "position", "axis": "C", "unit": "deg"},
        "T_air": {"role": "temperature", "unit": "degC", "location": "ambient air"},
        "T_tube": {"role": "temperature", "unit": "degC", "location": "tube"},
    }
    facts = {"C": {"role": "axis", "kind": "rotary", "travel": [-90.0, 90.0], "unit": "deg"}}
    sheet = Sheet("mount, tracking a star", data, columns, "mount", facts)
    teeth = int(rng.integers(180, 361))
    size = log_uniform(rng, 2, 100)
    turn = np.radians(teeth * x)
    wave = size * (np.sin(turn) + rng.uniform(0, 0.3) * np.sin(2 * turn + 1))
    gain = 2 * size / np.ptp(tube)
    effects = {
        "pitch_cyclic": Effect(
            wave,
            ("ra",),
            {"amplitude": (size, "urad", True), "period": (360 / teeth, "deg", False)},
            ("interpolation",),
        ),
        "thermal_drift": Effect(gain * (tube - tube[0]), ("T_tube",), {"gain": (gain, "urad/K", True)}),
    }
    base = [unit_rms(np.sin(np.radians(3 * x) + 0.5)), unit_rms((x - x[0]) ** 2)]
    return Bench("telescope mount", sheet, "ECC", "urad", effects, base)


MACHINES: dict[str, tuple[float, Callable[[Rng], Bench]]] = {  # share of the cases, and how one is drawn
    "stage": (0.2, stage),
    "mill or lathe": (0.2, mill_or_lathe),
    "gantry": (0.1, gantry),
    "robot": (0.1, robot),
    "mount": (0.08, mount),
    "warm body": (0.18, warm_body),
    "grid": (0.06, grid),
    "cutting series": (0.08, cutting),
}


# ---------------------------------------------------------------- outside the vocabulary
def outside(rng: Rng, bench: Bench) -> tuple[str, Array, tuple[str, ...]]:
    """A mechanism that no name of the vocabulary fits: what it is, values of rms 1, columns it follows."""
    sheet = bench.sheet
    times = sheet.names("time")
    t = sheet.values(times[0])
    u = (t - t.min()) / max(np.ptp(t), 1e-12)
    kinds = ["beat", "doors"]
    if sheet.names("acceleration"):
        kinds.append("ringing")
    if len(sheet.names("temperature")) >= 2:
        kinds.append("thermostat")
    kind = str(rng.choice(kinds))
    drivers = (times[0],)
    if kind == "beat":  # a vibration sampled too slowly: a slow beat that nothing recorded follows
        values = np.sin(2 * np.pi * rng.uniform(9, 25) * u + 3 * smooth(rng, u))
    elif kind == "doors":  # a door opened now and then: a jump that dies away
        values = np.zeros(t.size)
        for start in rng.uniform(0.05, 0.95, int(rng.integers(4, 9))):
            late = (u - start) * (u > start)
            values += rng.choice([-1, 1]) * rng.uniform(0.6, 1) * (u > start) * np.exp(-late / 0.02)
    elif kind == "ringing":  # a mode of the frame, struck by each change of acceleration
        a = sheet.names("acceleration")[0]
        values, drivers = _ringing(rng, t, sheet.values(a)), (a, times[0])
    else:  # a chiller that switches between two temperatures of one sensor, with hysteresis
        s = sheet.names("temperature")[0]
        values, drivers = _thermostat(sheet.values(s)), (s,)
    return kind, unit_rms(values), drivers


def _ringing(rng: Rng, t: Array, push: Array) -> Array:
    """A damped oscillator driven by the acceleration, less its own static part."""
    step = float(np.median(np.diff(t)))
    omega, damping = 2 * np.pi / (step * rng.uniform(12, 40)), rng.uniform(0.02, 0.06)
    root = omega * np.sqrt(1 - damping**2)
    decay, c, s = np.exp(-damping * omega * step), np.cos(root * step), np.sin(root * step)
    x = y = 0.0
    out = np.empty(t.size)
    jerk = np.diff(push, prepend=push[0])
    for i, kick in enumerate(jerk.tolist()):
        x, y = decay * (x * c - y * s) + kick, decay * (x * s + y * c)
        out[i] = x
    return out


def _thermostat(sensor: Array) -> Array:
    low, high = np.quantile(sensor, [0.4, 0.6])
    on, out = False, np.empty(sensor.size)
    for i, v in enumerate(sensor.tolist()):
        on = True if v > high else False if v < low else on
        out[i] = on
    return out
