"""Feedback traces of an axis under way: deviation from command, or drive force, at a few hundred hertz."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from .climate import sign
from .contact import dahl, lugre, maxwell_slip, since_reversal
from .novel_axis import trace_novel
from .scene import Column, Maker, Part, Response, Scene

Rng = np.random.Generator


class Motion:
    """Moves at feeds, creeping moves with reversals and multisines, one kind to a run."""

    def __init__(self, rng: Rng):
        self.rate = float(rng.choice([200, 200, 400]))
        self.dt = 1 / self.rate
        self.travel = float(rng.choice([400, 600, 900]))
        self.lead = float(rng.choice([5, 10, 16, 20]))
        self.encoder = float(rng.choice([0.02, 0.04, 0.1]))
        self.count = int(rng.integers(4, 7))
        self.n = int(rng.integers(9000, 16000)) // self.count
        kinds = ["moves", "creep", "sine", *rng.choice(["moves", "creep", "sine"], self.count - 3)]
        parts, now, x = [], 0.0, rng.uniform(0.35, 0.65) * self.travel
        for k, kind in enumerate(kinds):
            v, feed = self._speed(rng, kind)
            path = x + np.cumsum(v) * self.dt
            over = max(path.max() - 0.97 * self.travel, 0) - max(0.03 * self.travel - path.min(), 0)
            path, x = path - over, float(path[-1] - over)
            acc = np.gradient(v, self.dt)
            parts.append(
                (np.full(self.n, str(k + 1)), now + np.arange(self.n) * self.dt, path, v, acc, np.full(self.n, feed))
            )
            now += self.n * self.dt + rng.uniform(8, 60)
        self.runs, self.t, self.x, self.v, self.a, self.feed = (np.concatenate(p) for p in zip(*parts, strict=True))

    def _speed(self, rng: Rng, kind: str) -> tuple[np.ndarray, float]:
        time = self.n * self.dt
        if kind == "sine":
            freq = rng.uniform(0.3, 3.0, 6)
            t = np.arange(self.n) * self.dt
            v = sum(rng.uniform(0.4, 1) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in freq)
            top = rng.uniform(25, 90)
            return v / np.max(np.abs(v)) * top, round(top * 60, -1)
        feed = float(rng.choice([120, 240] if kind == "creep" else [1200, 2400, 4000, 6000, 10000]))
        top, v, i = feed / 60, np.zeros(self.n), 0
        speed = sign(rng) * top * rng.uniform(0.45, 1)
        while i < self.n:
            span = int(min(rng.uniform(0.03, 0.4) * time, 0.35 * self.travel / abs(speed)) * self.rate) + 5
            v[i : i + span] = speed
            i += span
            if rng.random() < 0.3:
                i += int(0.15 * self.rate)
            speed = (-np.sign(speed) if rng.random() < 0.75 else np.sign(speed)) * top * rng.uniform(0.45, 1)
        ramp = max(int(rng.uniform(0.06, 0.15) * self.rate), 4)
        return uniform_filter1d(uniform_filter1d(v, ramp), max(ramp // 3, 2)), feed


def scene(rng: Rng) -> Scene:
    path = Motion(rng)
    force = bool(rng.random() < 0.55)
    vn = rng.normal(0, max(0.001 * np.max(np.abs(path.v)), 0.03), len(path.t))
    an = rng.normal(0, 0.009 * np.max(np.abs(path.a)), len(path.t))
    columns = {
        "t": Column({"role": "time", "unit": "s"}, path.t, 1e-4),
        "x": Column({"role": "position", "axis": "X", "unit": "mm"}, path.x, 1e-5),
        "x_cmd": Column({"role": "command", "axis": "X", "unit": "mm"}, path.x, 1e-5),
        "vx": Column({"role": "velocity", "axis": "X", "unit": "mm/s"}, path.v + vn, 1e-4),
        "ax": Column({"role": "acceleration", "axis": "X", "unit": "mm/s2"}, path.a + an, 0.01),
    }
    if rng.random() < 0.4:
        columns["feed"] = Column({"role": "feed", "axis": "X", "unit": "mm/min"}, path.feed, 1.0)
    if force:
        response = Response("F_X", "N", _forces(path), trace_novel(path, True), (0.1,), ("moving_mass",), (1.5, 8.0))
        what = "drive force"
    else:
        response = Response("EXX", "um", _deviations(path), trace_novel(path, False), (0.01,), (), (0.3, 1.5))
        what = "deviation from command"
    constants = {
        "X": f"{{role: axis, kind: linear, travel: [0, {path.travel:.0f}], screw_lead: {path.lead}, "
        f"encoder_period: {path.encoder}, drive_end: 0, unit: mm}}"
    }
    title = f"X axis under way, {what}, {path.rate:.0f} Hz after decimation"
    return Scene("feedback trace", title, f"vmc-{rng.integers(1, 9)}", constants, columns, [response], path.runs)


def _forces(path: Motion) -> dict[str, Maker]:
    def mass(rng: Rng) -> Part:
        m = rng.uniform(0.3, 1.2)
        return Part("moving_mass", m * path.a, ["ax"])

    def coulomb(rng: Rng) -> Part:
        """LuGre bristles without the Stribeck part."""
        f = rng.uniform(5, 120)
        z = lugre(path.v, path.dt, 1.0, 1.0, 1.0, rng.uniform(0.001, 0.006))
        return Part("coulomb_friction", f * z, ["vx"], {"coulomb_friction.force": (f, "N")})

    def viscous(rng: Rng) -> Part:
        """Shear of an oil film, thinning a few per cent at speed."""
        b = rng.uniform(50, 2500)
        thin = 1 - rng.uniform(0, 0.06) * np.abs(path.v) / np.max(np.abs(path.v))
        return Part(
            "viscous_friction", b / 1000 * path.v * thin, ["vx"], {"viscous_friction.coefficient": (b, "N s/m")}
        )

    def stribeck(rng: Rng) -> Part:
        f, vs = rng.uniform(5, 100), rng.uniform(0.8, 8)
        z = lugre(path.v, path.dt, 0.0, 1.0, vs, rng.uniform(0.0005, 0.002))
        slow = np.abs(path.v) < 2 * vs
        return Part("stribeck_friction", f * z, ["vx"], {}, (), slow)

    def ripple(rng: Rng) -> Part:
        pitch = float(rng.choice([path.lead, path.lead / 2, path.lead / 4, 24.0, 30.0, 36.0, 60.0]))
        a, u = rng.uniform(2, 40), 2 * np.pi * path.x / pitch + rng.uniform(0, 6.28)
        return Part(
            "torque_ripple",
            a * (np.sin(u) + rng.uniform(0, 0.2) * np.sin(2 * u + 1)),
            ["x"],
            {"torque_ripple.amplitude": (a, "N")},
        )

    return {
        "moving_mass": mass,
        "coulomb_friction": coulomb,
        "viscous_friction": viscous,
        "stribeck_friction": stribeck,
        "torque_ripple": ripple,
    }


def _deviations(path: Motion) -> dict[str, Maker]:
    return {**_following(path), **_friction(path), **_periodic(path)}


def _following(path: Motion) -> dict[str, Maker]:
    def lag(rng: Rng) -> Part:
        """Velocity feed-forward that is a little off: what is left of v/Kv, through the loop's own short lag."""
        tau = sign(rng) * rng.uniform(0.03, 0.4) * 1e-3
        v = path.v - rng.uniform(0, 0.003) * path.a
        return Part("following_error", -1000 * tau * v, ["vx"], {"following_error.lag": (abs(tau) * 1000, "ms")})

    def inertia(rng: Rng) -> Part:
        c = sign(rng) * rng.uniform(1, 10)
        return Part(
            "inertial_deflection", -c * path.a / 1000, ["ax"], {"inertial_deflection.compliance": (abs(c), "um/(m/s2)")}
        )

    def spike(rng: Rng) -> Part:
        tau, power = rng.uniform(0.02, 0.15), rng.uniform(0.3, 0.9)
        side = np.where(np.abs(path.v) > 0.05, np.sign(path.v), 0)
        after = since_reversal(side, path.t, path.runs)
        size = (path.feed / path.feed.max()) ** power
        ok = np.isfinite(after)
        pulse = np.where(ok, size * np.exp(-np.minimum(after, 1e6) / tau) * (1 - np.exp(-after / (0.1 * tau))), 0.0)
        return Part(
            "reversal_spike", sign(rng) * rng.uniform(2, 15) * pulse * side, ["vx", "t"], {}, (), ok & (after < 3 * tau)
        )

    return {"following_error": lag, "inertial_deflection": inertia, "reversal_spike": spike}


def _friction(path: Motion) -> dict[str, Maker]:
    step = np.diff(path.x, prepend=path.x[0])
    flow = np.cumsum(np.where(np.abs(step) > 1, 0, step))

    def gap(rng: Rng) -> Part:
        b = sign(rng) * rng.uniform(2, 12)
        return Part("backlash", 0.5 * b * dahl(flow, 0.003), ["vx"], {"backlash.lost_motion": (abs(b), "um")})

    def bristles(rng: Rng) -> Part:
        a = sign(rng) * rng.uniform(1, 8)
        if rng.random() < 0.5:
            z = dahl(flow, rng.uniform(0.1, 0.5), rng.choice([1.0, 1.4]))
        else:
            breaks = np.array([0.05, 0.2, 0.6]) * rng.uniform(0.5, 1.5)
            z = maxwell_slip(flow, breaks, np.array([0.5, 0.3, 0.2]) / breaks)
        return Part("friction_hysteresis", a * z, ["x", "vx"])

    return {"backlash": gap, "friction_hysteresis": bristles}


def _periodic(path: Motion) -> dict[str, Maker]:
    def cyclic(rng: Rng) -> Part:
        period = path.lead * (1 if rng.random() < 0.8 else 0.5)
        u = 2 * np.pi * path.x / period + rng.uniform(0, 6.28)
        value = rng.uniform(0.5, 5) * (np.sin(u) + rng.uniform(0, 0.2) * np.sin(2 * u + 1))
        return Part("pitch_cyclic", value, ["x"], {"pitch_cyclic.period": (period, "mm")}, ("pitch_cyclic.period",))

    def signal(rng: Rng) -> Part:
        size, phase = rng.uniform(0.2, 1.5), rng.uniform(0, 6.28)

        def at(x: np.ndarray) -> np.ndarray:
            u = 2 * np.pi * x / path.encoder + phase
            return size * (np.sin(u) + 0.15 * np.sin(2 * u))

        period = {"interpolation.period": (path.encoder, "mm")}
        return Part("interpolation", at(path.x), ["x"], period, ("interpolation.period",), again=at)

    def scale(rng: Rng) -> Part:
        k = sign(rng) * rng.uniform(5, 50)
        return Part("scale_error", k * (path.x - path.x[0]) / 1000, ["x"], {"scale_error.slope": (abs(k), "um/m")})

    return {"pitch_cyclic": cyclic, "interpolation": signal, "scale_error": scale}
