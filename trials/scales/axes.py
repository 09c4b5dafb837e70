"""Linear and rotary axes of every size: positioning runs, logs under way, drive forces."""

from __future__ import annotations

import numpy as np
import pandas as pd

from trials.folder import Array, Sheet

from .bench import Bench, Effect, Rng, log_uniform, unit_rms

# name, travel, unit of position: a piezo stage to a bridge-type gantry, a tilting head and a rotary table
AXES = (
    ("flexure stage", 1.0, "mm"),
    ("crossed-roller stage", 11.2, "mm"),
    ("linear stage", 60.0, "mm"),
    ("small mill", 250.0, "mm"),
    ("machining centre", 800.0, "mm"),
    ("lathe bed", 2000.0, "mm"),
    ("gantry", 6000.0, "mm"),
    ("long bed", 20000.0, "mm"),
    ("tilting head", 15.0, "deg"),
    ("rotary table", 360.0, "deg"),
)


class Axis:
    """One axis drawn from AXES: its letter, units, travel, and the size of what may go wrong on it."""

    def __init__(self, rng: Rng, which: int | None = None) -> None:
        self.name, travel, self.unit = AXES[int(rng.integers(len(AXES))) if which is None else which]
        self.rotary = self.unit == "deg"
        self.travel = travel if which is not None or self.rotary else travel * rng.uniform(0.8, 1.25)
        self.letter = str(rng.choice(["A", "B", "C"] if self.rotary else ["X", "Y", "Z"]))
        self.low = 0.0 if rng.random() < 0.7 else -0.5 * self.travel
        self.column = f"pos_{self.letter.lower()}"
        self.component = f"E{self.letter}{self.letter}"
        self.error_unit = "urad" if self.rotary else "um"
        # 0.05 to 3 um on a millimetre, 3 to 200 um on 20 m; 2 to 100 urad on a rotary axis
        self.size = log_uniform(rng, 2, 100) if self.rotary else log_uniform(rng, 0.05, 3) * self.travel**0.42

    def facts(self, **more: float | None) -> dict[str, dict]:
        span = [float(f"{self.low:.6g}"), float(f"{self.low + self.travel:.6g}")]
        fact = {"role": "axis", "kind": "rotary" if self.rotary else "linear", "travel": span, "unit": self.unit}
        return {self.letter: {**fact, **{k: v for k, v in more.items() if v is not None}}}


def first_places(rng: Rng, axis: Axis) -> tuple[Array, Array, Array, Array]:
    """Bidirectional positioning: place, direction, cycle, time of every reading."""
    count = int(rng.integers(25, 130))
    pitch = axis.travel / count
    cycles = int(rng.integers(3, 7))
    dwell = rng.uniform(1, 5)
    # ISO 230-2 asks for targets that are not equally spaced: a random part of up to 0.3 of the pitch
    x, side, cycle = [], [], []
    for k in range(cycles):
        places = axis.low + pitch * (np.arange(count) + 0.5 + rng.uniform(-0.3, 0.3, count))
        x += [places, places[::-1]]
        side += [np.ones(count), -np.ones(count)]
        cycle.append(np.full(2 * count, k))
    x, side, cycle = np.concatenate(x), np.concatenate(side), np.concatenate(cycle)
    move = np.abs(np.diff(x, prepend=x[0])) / axis.travel * rng.uniform(4, 60)
    return x, side, cycle, np.round(np.cumsum(move + dwell), 2)


def positioning(rng: Rng, which: int | None = None) -> Bench:
    """ISO 230-2 runs of an axis in several thermal states."""
    axis = Axis(rng, which)
    x, side, cycle, t = first_places(rng, axis)
    states = int(rng.integers(2, 4))
    level = np.cumsum(np.r_[0, rng.uniform(1.5, 5, states)])[cycle % (states + 1)]
    scale_temperature = 20.5 + level + 0.3 * np.sin(2 * np.pi * t / t[-1]) + 0.02 * rng.normal(size=t.size)
    room = 20 + 0.8 * np.sin(2 * np.pi * t / (1.7 * t[-1]) + rng.uniform(0, 6)) + 0.02 * rng.normal(size=t.size)
    step = axis.travel / x.size * cycle.max()
    period = log_uniform(rng, 4 * step, axis.travel / 6)
    known = rng.random() < 0.5
    facts = axis.facts(screw_lead=float(f"{period:.6g}") if known and not axis.rotary else None)
    data = pd.DataFrame({"run": [f"cycle {k + 1}" for k in cycle], "t": t, axis.column: np.round(x, 6), "dir": side})
    data["T_scale"], data["T_room"] = np.round(scale_temperature, 3), np.round(room, 3)
    columns = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        axis.column: {"role": "position", "axis": axis.letter, "unit": axis.unit},
        "dir": {"role": "direction", "axis": axis.letter},
        "T_scale": {"role": "temperature", "unit": "degC", "location": "scale"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room air"},
    }
    sheet = Sheet(f"{axis.name}, positioning runs", data, columns, axis.name, facts)
    places = data[axis.column].to_numpy()
    effects = _place_effects(rng, axis, places, side, period, "dir", also_friction=True)
    rise = data["T_scale"].to_numpy() - data["T_scale"][0]
    slope = axis.size / max(axis.travel * np.ptp(rise), 1e-9) * 2
    if not axis.rotary:
        effects["scale_expansion"] = Effect(
            slope * places * rise, (axis.column, "T_scale"), {"slope": (slope * 1e3, "um/m/K", True)}
        )
    gain = axis.size / np.ptp(rise)
    effects["thermal_drift"] = Effect(gain * rise, ("T_scale",), {"gain": (gain, f"{axis.error_unit}/K", True)})
    u = (places - axis.low) / axis.travel
    base = [unit_rms(u**2 + rng.uniform(-1, 1) * u), unit_rms(np.cos(2 * np.pi * u * rng.uniform(0.4, 1.1)))]
    return Bench(f"{axis.name} {axis.travel:.4g} {axis.unit}", sheet, axis.component, axis.error_unit, effects, base)


def _place_effects(
    rng: Rng, axis: Axis, x: Array, side: Array, period: float, by: str, *, also_friction: bool
) -> dict[str, Effect]:
    """Wave, lost motion, wear of one stretch, scale error and wind-up of an axis."""
    size, unit = axis.size, axis.error_unit
    phase = rng.uniform(0, 2 * np.pi)
    centre, width = axis.low + axis.travel * rng.uniform(0.2, 0.8), axis.travel * rng.uniform(0.03, 0.08)
    wave = size * np.sin(2 * np.pi * x / period + phase)
    sizes = {"amplitude": (size, unit, True), "period": (period, axis.unit, False)}
    out = {"pitch_cyclic": Effect(wave, (axis.column,), sizes, ("interpolation",))}
    also = ("friction_hysteresis",) if also_friction else ()
    out["backlash"] = Effect(0.5 * size * side, (by,), {"lost_motion": (size, unit, True)}, also)
    bump = 3 * size * np.exp(-0.5 * ((x - centre) / width) ** 2)
    out["local_wear"] = Effect(bump, (axis.column,), {"depth": (3 * size, unit, True)})
    slope = 2 * size / axis.travel
    per = (slope, "urad/deg") if axis.rotary else (slope * 1e3, "um/m")
    out["scale_error"] = Effect(slope * (x - axis.low), (axis.column,), {"slope": (*per, True)})
    if not axis.rotary:
        far = (x - axis.low) / axis.travel
        out["screw_windup"] = Effect(size * far * side, (by, axis.column), {"far_end": (2 * size, unit, True)})
    return out


def strokes(rng: Rng, axis: Axis, rate: float, seconds: float) -> Array:
    """Trapezoidal strokes between random places at several speeds, sampled at `rate`."""
    out, x = [], axis.low + axis.travel * rng.uniform(0.1, 0.9)
    rows, need = 0, int(seconds * rate)
    while rows < need:
        goal = axis.low + axis.travel * rng.uniform(0.02, 0.98)
        if abs(goal - x) < 0.15 * axis.travel:
            continue
        lasting = seconds * log_uniform(rng, 0.02, 0.12)
        ramp = rng.uniform(0.1, 0.3) * lasting
        s = np.arange(0, lasting, 1 / rate)
        top = (goal - x) / (lasting - ramp)
        up, down = np.minimum(s, ramp), np.maximum(s - (lasting - ramp), 0)
        path = x + top * (up**2 / (2 * ramp) + np.maximum(s - ramp, 0) - down**2 / (2 * ramp))
        out.append(path)
        x, rows = path[-1], rows + s.size
    return np.concatenate(out)[:need]


def under_way(rng: Rng, which: int | None = None, rate: float | None = None, seconds: float | None = None) -> Bench:
    """A log of an axis under way: strokes at several speeds, or one pass at constant speed."""
    axis = Axis(rng, which)
    one_pass = rate is None and rng.random() < 0.25
    rate = rate or float(rng.choice([1000, 250, 100, 20]))
    seconds = seconds or float(np.clip(rng.choice([20, 60, 100, 400]), 3000 / rate, 24000 / rate))
    if one_pass:
        x = axis.low + axis.travel * np.arange(int(rate * seconds)) / (rate * seconds)
    else:
        x = strokes(rng, axis, rate, seconds)
    n = x.size
    t = np.arange(n) / rate
    v = np.gradient(x, t)
    a = np.gradient(v, t)
    digits = int(np.ceil(-np.log10(axis.travel * 1e-8)))
    data = pd.DataFrame({"t": np.round(t, 6), axis.column: np.round(x, digits)})
    data["v"], data["a"] = np.round(v, digits), np.round(a, digits)
    warm = 22 + 3 * (1 - np.exp(-t / (seconds * rng.uniform(0.15, 0.5))))
    data["T_motor"] = np.round(warm + 0.01 * rng.normal(size=n), 3)
    columns = {
        "t": {"role": "time", "unit": "s"},
        axis.column: {"role": "position", "axis": axis.letter, "unit": axis.unit},
        "v": {"role": "velocity", "axis": axis.letter, "unit": f"{axis.unit}/s"},
        "a": {"role": "acceleration", "axis": axis.letter, "unit": f"{axis.unit}/s2"},
        "T_motor": {"role": "temperature", "unit": "degC", "location": "motor"},
    }
    sheet = Sheet(f"{axis.name}, log under way at {rate:g} Hz", data, columns, axis.name, axis.facts())
    period = log_uniform(rng, min(max(8 * np.abs(v).max() / rate, axis.travel / 200), axis.travel / 6), axis.travel / 5)
    effects = _place_effects(rng, axis, x, np.sign(v), period, "v", also_friction=False)
    if one_pass:
        effects = {k: effects[k] for k in ("pitch_cyclic", "local_wear")}
    else:
        fast, hard = np.abs(v).max(), np.abs(a).max()
        unit = axis.error_unit
        delay = axis.size / fast
        seconds_per = 1e-6 * 180 / np.pi if axis.rotary else 1e-3  # of urad/(deg/s), of um/(mm/s)
        effects["following_error"] = Effect(delay * v, ("v",), {"delay": (delay * seconds_per, "s", True)})
        push = (axis.size / hard * 1e3, "um/(m/s2)") if not axis.rotary else (axis.size / hard, "urad/(deg/s2)")
        effects["inertial_deflection"] = Effect(axis.size / hard * a, ("a",), {"compliance": (*push, True)})
        settle = axis.travel * rng.uniform(0.005, 0.03)
        effects["friction_hysteresis"] = Effect(
            presliding(x, settle) * axis.size, ("v", axis.column), {"size": (axis.size, unit, True)}
        )
    u = (x - axis.low) / axis.travel
    base = [unit_rms(u**2 + rng.uniform(-1, 1) * u), unit_rms(np.sin(2 * np.pi * u * rng.uniform(0.3, 0.9)))]
    return Bench(f"{axis.name} {axis.travel:.4g} {axis.unit}", sheet, axis.component, axis.error_unit, effects, base)


def presliding(x: Array, settle: float) -> Array:
    """Friction that builds up over `settle` after each reversal and then keeps the direction's sign (Dahl)."""
    z = np.empty(x.size)
    z[0] = 0.0
    dx = np.diff(x)
    for i, d in enumerate(dx.tolist()):
        s = 1.0 if d > 0 else -1.0
        z[i + 1] = s + (z[i] - s) * np.exp(-abs(d) / settle)
    return z


def drive_force(rng: Rng, which: int | None = None) -> Bench:
    """The drive force of an axis along strokes; the simulation holds the moving mass and an offset."""
    axis = Axis(rng, which)
    while axis.rotary and which is None:
        axis = Axis(rng)
    rate = float(rng.choice([500, 200, 50]))
    seconds = float(np.clip(rng.choice([20, 40, 100]), 4000 / rate, 20000 / rate))
    x = strokes(rng, axis, rate, seconds)
    t = np.arange(x.size) / rate
    v = np.gradient(x, t)
    a = np.gradient(v, t)
    digits = int(np.ceil(-np.log10(axis.travel * 1e-8)))
    data = pd.DataFrame({"t": np.round(t, 6), axis.column: np.round(x, digits), "v": np.round(v, digits)})
    data["a"] = np.round(a, digits)
    columns = {
        "t": {"role": "time", "unit": "s"},
        axis.column: {"role": "position", "axis": axis.letter, "unit": axis.unit},
        "v": {"role": "velocity", "axis": axis.letter, "unit": f"{axis.unit}/s"},
        "a": {"role": "acceleration", "axis": axis.letter, "unit": f"{axis.unit}/s2"},
    }
    sheet = Sheet(f"{axis.name}, drive force at {rate:g} Hz", data, columns, axis.name, axis.facts())
    fast = np.abs(v).max()
    dry = log_uniform(rng, 0.02, 300)
    sign = np.sign(v)
    period = log_uniform(rng, min(max(10 * fast / rate, axis.travel / 150), axis.travel / 7), axis.travel / 6)
    knee = fast * rng.uniform(0.03, 0.1)
    wave = dry * np.sin(2 * np.pi * x / period + rng.uniform(0, 6))
    effects = {
        "coulomb_friction": Effect(dry * sign, ("v",), {"force": (dry, "N", True)}),
        "viscous_friction": Effect(dry / fast * v, ("v",), {"slope": (dry / fast * 1e3, "N s/m", True)}),
        "stribeck_friction": Effect(dry * sign * np.exp(-((v / knee) ** 2)), ("v",), {"excess": (dry, "N", True)}),
        "torque_ripple": Effect(
            wave, (axis.column,), {"amplitude": (dry, "N", True), "period": (period, axis.unit, False)}
        ),
    }
    return Bench(f"{axis.name} {axis.travel:.4g} {axis.unit}", sheet, f"F_{axis.letter}", "N", effects, [unit_rms(a)])
