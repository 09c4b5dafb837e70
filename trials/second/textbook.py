"""Textbook forms of the effects over the displayed columns, to find what a recording cannot tell apart.

Every form is a design matrix (rows x few columns) whose free factors a fit may choose; written from the one-line
signatures of the effects, not from the mechanisms of this package.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np
from scipy.signal import lfilter

from .contact import since_reversal
from .scene import Scene

Form = tuple[str, list[str], np.ndarray]
LAGS = np.geomspace(150, 40000, 15)
HIDDEN_TAU = 600.0  # below, a lag is no lag: s


class Book:
    """The forms of one recording, on every `stride`-th row."""

    def __init__(self, scene: Scene, most: int = 1500):
        self.scene = scene
        self.keep = np.unique(np.linspace(0, scene.rows - 1, min(most, scene.rows)).astype(int))
        self.t = scene.columns["t"].values
        self.grid = np.linspace(self.t[0], self.t[-1], 2500)
        self.temps = {k: v - v[0] for k, v in scene.by_role("temperature").items()}
        self.spots = {k: scene.columns[k].spec.get("location", "") for k in self.temps}

    def col(self, name: str) -> np.ndarray:
        return self.scene.columns[name].values

    def forms(self, component: str) -> Iterator[Form]:
        """All forms for one component: (effect, drivers, design on the kept rows)."""
        maker = {
            "linear positioning": self._positioning,
            "spindle drift": self._spindle,
            "circular test": self._circle,
            "feedback trace": self._trace,
            "volumetric grid": self._grid,
            "cutting series": self._cutting,
        }
        for effect, drivers, *columns in maker[self.scene.protocol](component):
            yield effect, drivers, np.column_stack(columns)[self.keep]
        yield "sensor_drift", ["t"], self.t[self.keep, None] / 3600

    def held(self, values: np.ndarray) -> np.ndarray:
        """A switched quantity on the grid: the last value holds, but not over a night."""
        usual = np.median(np.diff(self.t))
        if self.scene.protocol == "cutting series":  # a row is written when its part is finished
            i = np.clip(np.searchsorted(self.t, self.grid), 0, len(self.t) - 1)
            return np.where(self.t[i] - self.grid < 1.5 * usual, values[i], 0.0)
        i = np.clip(np.searchsorted(self.t, self.grid, side="right") - 1, 0, len(self.t) - 1)
        night = self.grid - self.t[i] > 20 * usual + 60
        return np.where(night & (self.scene.protocol != "linear positioning"), 0.0, values[i])

    def lag(self, values: np.ndarray, tau: float, switched: bool = False) -> np.ndarray:
        u = self.held(values) if switched else np.interp(self.grid, self.t, values)
        keep = np.exp(-(self.grid[1] - self.grid[0]) / tau)
        y, _ = lfilter([1 - keep], [1, -keep], u, zi=[keep * u[0]])
        return np.interp(self.t, self.grid, y)

    def _thermal(self, ambient: str, reach: np.ndarray | None = None) -> Iterator[tuple]:
        names = list(self.temps)
        for n in names:
            yield "thermal_drift", [n], self.temps[n]
            for tau in LAGS[LAGS > HIDDEN_TAU]:
                yield "thermal_lag", [n], self.lag(self.temps[n], tau)
        for tau in LAGS[8:]:
            if ambient:
                yield "ambient_drift", [ambient], self.lag(self.temps[ambient], tau)
        for a, b in combinations_with_replacement(names, 2):
            yield "thermal_interaction", sorted({a, b}), self.temps[a] * self.temps[b]
            if a != b:
                yield "gradient_bending", [a, b], self.temps[a] - self.temps[b]

    def _positioning(self, component: str) -> Iterator[tuple]:
        x, side = self.col("x"), self.col("dir")
        const = self._constants("X")
        yield "scale_error", ["x"], x
        for p in (const["screw_lead"], const["screw_lead"] / 2):
            yield "pitch_cyclic", ["x"], *waves(x, p)
        yield "interpolation", ["x"], *waves(x, const["encoder_period"])
        yield from bumps(x, "x")
        yield "backlash", ["dir"], side
        yield "friction_hysteresis", ["dir", "x"], side
        yield "screw_windup", ["dir", "x"], side * (x - const["drive_end"])
        yield from self._thermal("T_air")
        for n, v in self.temps.items():
            yield "scale_expansion", ["x", n], x * v
        yield (
            "air_refraction",
            ["x", "T_air", "p_air"],
            x * self.temps["T_air"],
            x * (self.col("p_air") - self.col("p_air")[0]),
        )
        for tau in LAGS[4:12]:
            if self.scene.logging is not None and self.scene.logging.any():
                yield "feed_heating", ["x", "feed", "T_nut"], (x - const["drive_end"]) * self.lag(self.col("feed"), tau)

    def _spindle(self, component: str) -> Iterator[tuple]:
        rpm = self.col("rpm")
        yield from self._thermal("T_ambient")
        yield "centrifugal_growth", ["rpm"], rpm**2
        for tau in LAGS:
            for power in (1.0, 1.5, 2.0):
                yield "spindle_growth", ["rpm"], self.lag(rpm**power, tau, True)
        if "coolant" in self.scene.columns:
            yield from self._coolant()

    def _coolant(self) -> Iterator[tuple]:
        flow = self.col("coolant")
        cool = flow * (self.col("T_coolant") - np.mean(self.col("T_coolant")))
        yield "coolant_effect", ["coolant", "T_coolant"], flow, cool
        for tau in LAGS[:6]:
            yield "coolant_effect", ["coolant", "T_coolant"], self.lag(flow, tau, True), self.lag(cool, tau, True)

    def _cutting(self, component: str) -> Iterator[tuple]:
        yield from self._spindle(component)
        f, arm, cut = self.col("F_p"), (self.col("overhang") / 100) ** 3, self.col("cut_length")
        drivers = ["F_p", "overhang", "depth_of_cut"]
        yield "cutting_compliance", drivers, f
        yield "cutting_compliance", drivers, f * arm
        yield "cutting_compliance", drivers, f, f * arm
        yield "tool_wear", ["cut_length"], cut
        yield "tool_wear", ["cut_length"], cut, np.sqrt(cut)
        yield "tool_wear", ["cut_length"], cut, cut**2
        yield "gravity_sag", ["overhang"], arm

    def _grid(self, component: str) -> Iterator[tuple]:
        me = component[-1].lower()
        others = [a for a in "xyz" if a != me]
        own = self.col(me)
        yield "scale_error", [me], own
        for a in others:
            low, high = self.col(a).min(), self.col(a).max()
            u = 2 * (self.col(a) - low) / (high - low) - 1
            yield "squareness", [a], u
            yield "straightness", [a], 3 * u**2 - 1, 5 * u**3 - 3 * u
            for b in [*(c for c in others if c != a), "overhang"]:
                yield "angular_abbe", [a, b], self.col(a) * self.col(b)
        if me == "z":
            load = self.col("load")
            for a in ("x", "y", "overhang"):
                q = self.col(a) / 500
                yield "gravity_sag", [a], q**2
                yield "gravity_sag", [a], q**3
                yield "gravity_sag", [a], q**2 * (3 - q)
                yield "workpiece_load", ["load", a], load, load * q
            yield "workpiece_load", ["load"], load
        yield from self._thermal("")
        for n, v in self.temps.items():
            yield ("air_refraction" if "air" in n else "scale_expansion"), [me, n], own * v

    def _trace(self, component: str) -> Iterator[tuple]:
        x, v, a = self.col("x"), self.col("vx"), self.col("ax")
        const = self._constants("X")
        s = np.tanh(v / max(0.02, np.std(np.diff(v)) / 1.4))
        if component.startswith("F"):
            yield "coulomb_friction", ["vx"], s
            yield "viscous_friction", ["vx"], v
            for vs in (0.5, 1, 2, 4, 8, 12):
                yield "stribeck_friction", ["vx"], s * np.exp(-((v / vs) ** 2))
            for p in (const["screw_lead"], const["screw_lead"] / 2, const["screw_lead"] / 4, 24, 30, 36, 60):
                yield "torque_ripple", ["x"], *waves(x, p)
            return
        yield "following_error", ["vx"], v
        yield "inertial_deflection", ["ax"], a
        yield "scale_error", ["x"], x
        for p in (const["screw_lead"], const["screw_lead"] / 2):
            yield "pitch_cyclic", ["x"], *waves(x, p)
        yield "interpolation", ["x"], *waves(x, const["encoder_period"])
        yield "backlash", ["vx"], s
        yield from bumps(x, "x")
        steps = np.diff(x, prepend=x[0])
        for length in (0.02, 0.1, 0.3, 1.0):
            yield "friction_hysteresis", ["x", "vx"], approach(steps, length)
        after = since_reversal(np.where(np.abs(v) > 0.3, np.sign(v), 0), self.t, self.scene.runs)
        for tau in (0.02, 0.05, 0.1, 0.2, 0.4):
            yield "reversal_spike", ["vx", "t"], s * np.exp(-np.minimum(np.nan_to_num(after, posinf=99), 99) / tau)

    def _circle(self, component: str) -> Iterator[tuple]:
        axes = {a: (self.col(a), self.col("v" + a), self.col("a" + a)) for a in "xy"}
        radius = float(np.median(np.hypot(axes["x"][0], axes["y"][0])))
        x, vx, _ = axes["x"]
        y, vy, _ = axes["y"]
        yield "squareness", ["x", "y"], x * y
        yield "servo_mismatch", ["vx", "vy", "x", "y", "feed"], (vy * y - vx * x)
        for a, (p, v, acc) in axes.items():
            share, other = p / radius, (y if a == "x" else x) / radius
            s = np.tanh(v / 0.5)
            names = [a, "v" + a, "dir_" + a]
            yield "scale_error", [a], p * share
            yield "straightness", [a, "y" if a == "x" else "x"], other * share**2, other * (share**3 - 0.75 * share)
            yield "backlash", names, s * share
            yield "inertial_deflection", ["a" + a], acc * share
            steps = np.diff(p, prepend=p[0])
            for length in (0.05, 0.2, 0.6, 1.5):
                yield "friction_hysteresis", names, approach(steps, length) * share
            for period in (self._constants(a.upper())["screw_lead"], self._constants(a.upper())["screw_lead"] / 2):
                yield "pitch_cyclic", [a], *(w * share for w in waves(p, period))
            after = since_reversal(np.sign(s * (np.abs(s) > 0.5)), self.t, self.scene.runs)
            for tau in (0.03, 0.07, 0.15, 0.3, 0.6):
                pulse = s * share * np.exp(-np.minimum(np.nan_to_num(after, posinf=99), 99) / tau)
                yield "reversal_spike", [*names, "feed"], pulse, pulse * self.col("feed")

    def _constants(self, axis: str) -> dict[str, float]:
        pairs = [p.split(": ") for p in self.scene.constants[axis].strip("{}").split(", ") if ": " in p]
        return {k: float(v) for k, v in pairs if k in ("screw_lead", "encoder_period", "drive_end")}


def waves(x: np.ndarray, period: float) -> list[np.ndarray]:
    return [f(2 * np.pi * k * x / period) for k in (1, 2) for f in (np.sin, np.cos)]


def bumps(x: np.ndarray, name: str) -> Iterator[tuple]:
    """Raised cosines of three widths over the stretch that was covered."""
    low, span = x.min(), np.ptp(x)
    for width in (0.12, 0.2, 0.3):
        for centre in np.linspace(0.05, 0.95, 16):
            s = (x - low) / span - centre
            yield "local_wear", [name], np.where(np.abs(s) < width / 2, 1 + np.cos(2 * np.pi * s / width), 0.0)


def approach(steps: np.ndarray, length: float) -> np.ndarray:
    """Exponential approach to the side of travel over `length` of motion."""
    z, out = 0.0, np.empty(len(steps))
    keep = np.exp(-np.abs(steps) / length).tolist()
    for i, d in enumerate(steps.tolist()):
        if d:
            z = z * keep[i] + (1 - keep[i]) * (1 if d > 0 else -1)
        out[i] = z
    return out
