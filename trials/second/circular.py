"""Circular tests in X-Y with a ball bar: both directions, some feeds, repeated."""

from __future__ import annotations

import numpy as np

from .climate import sign
from .contact import dahl, since_reversal
from .novel_axis import circular_novel
from .scene import Column, Maker, Part, Response, Scene

Rng = np.random.Generator


class Circles:
    """The paths: angle, position, velocity and acceleration of both axes at every reading."""

    def __init__(self, rng: Rng):
        self.radius = float(rng.choice([50, 100, 150, 200]))
        pool = [1000, 2000, 3000, 4000, 6000]
        self.feeds = sorted(float(f) for f in rng.choice(pool, int(rng.choice([2, 3])), replace=False))
        self.repeats = 2
        self.per_run = int(rng.integers(900, 1750) if len(self.feeds) == 2 else rng.integers(800, 1400))
        runs, t, angle, feed, spin = [], [], [], [], []
        now, k = 0.0, 0
        for _ in range(self.repeats):
            for f in self.feeds:
                for s in (1.0, -1.0):
                    k += 1
                    span = 2 * np.pi * self.radius / (f / 60)
                    turn = np.arange(self.per_run) / self.per_run
                    start = abs(rng.normal(0.6, 0.4)) * np.pi / 180
                    runs += [str(k)] * self.per_run
                    t.append(now + rng.uniform(0, 0.01) + turn * span)
                    angle.append(start + s * 2 * np.pi * turn)
                    feed.append(np.full(self.per_run, f))
                    spin.append(np.full(self.per_run, s))
                    now += span + rng.uniform(18, 60)
        self.runs, self.t = np.array(runs), np.concatenate(t)
        self.angle, self.feed, self.spin = np.concatenate(angle), np.concatenate(feed), np.concatenate(spin)
        self.speed = self.feed / 60
        self.x, self.y = self.radius * np.cos(self.angle), self.radius * np.sin(self.angle)
        self.vx, self.vy = -self.speed * self.spin * np.sin(self.angle), self.speed * self.spin * np.cos(self.angle)
        self.ax = -(self.speed**2) / self.radius * np.cos(self.angle)
        self.ay = -(self.speed**2) / self.radius * np.sin(self.angle)
        self.leads = rng.choice([5.0, 10.0, 16.0, 20.0], 2)

    def axis(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity, acceleration, and share of that axis' deviation in the radius."""
        if name == "X":
            return self.x, self.vx, self.ax, self.x / self.radius
        return self.y, self.vy, self.ay, self.y / self.radius


def scene(rng: Rng) -> Scene:
    path = Circles(rng)
    columns = _columns(rng, path)
    response = Response("E_R", "um", _makers(path, columns), circular_novel(path), (0.01,), (), (0.15, 1.2))
    constants = {
        a: f"{{role: axis, kind: linear, travel: {w}, screw_lead: {lead}, unit: mm}}"
        for a, w, lead in zip("XY", ("[-400, 400]", "[-250, 250]"), path.leads, strict=True)
    }
    title = f"Circular test X-Y, radius {path.radius:.0f} mm, both directions, {len(path.feeds)} feeds"
    return Scene("circular test", title, f"vmc-{rng.integers(1, 9)}", constants, columns, [response], path.runs)


def _columns(rng: Rng, path: Circles) -> dict[str, Column]:
    n = len(path.t)
    columns = {"t": Column({"role": "time", "unit": "s"}, path.t, 1e-4)}
    for a in "XY":
        columns[a.lower()] = Column({"role": "position", "axis": a, "unit": "mm"}, path.axis(a)[0], 1e-4)
    for a in "XY":
        v = path.axis(a)[1] + rng.normal(0, 0.2, n)
        columns[f"v{a.lower()}"] = Column({"role": "velocity", "axis": a, "unit": "mm/s"}, v, 1e-3)
    for a in "XY":
        acc = path.axis(a)[2] + rng.normal(0, 0.01 * np.max(path.speed) ** 2 / path.radius, n)
        columns[f"a{a.lower()}"] = Column({"role": "acceleration", "axis": a, "unit": "mm/s2"}, acc, 0.01)
    columns["feed"] = Column({"role": "feed", "unit": "mm/min"}, path.feed, 1.0)
    if rng.random() < 0.5:
        for a in "XY":
            columns[f"dir_{a.lower()}"] = Column({"role": "direction", "axis": a}, np.sign(path.axis(a)[1]), 1)
    return columns


def _makers(path: Circles, columns: dict) -> dict[str, Maker]:
    return {**_shape(path), **_friction(path, columns), **_servo(path)}


def _shape(path: Circles) -> dict[str, Maker]:
    def scale(rng: Rng) -> Part:
        a = str(rng.choice(["X", "Y"]))
        p, _, _, share = path.axis(a)
        k = sign(rng) * rng.uniform(5, 50)
        return Part("scale_error", k * p / 1000 * share, [a.lower()], {"scale_error.slope": (abs(k), "um/m")})

    def square(rng: Rng) -> Part:
        s = sign(rng) * rng.uniform(5, 60)
        return Part(
            "squareness", s * path.x * path.y / path.radius / 1000, ["x", "y"], {"squareness.angle": (abs(s), "urad")}
        )

    def straight(rng: Rng) -> Part:
        a, b = ("X", "Y") if rng.random() < 0.5 else ("Y", "X")
        p, share = path.axis(a)[0] / path.radius, path.axis(b)[3]
        bow = (
            sign(rng)
            * rng.uniform(2, 12)
            * (p**2 + rng.uniform(-0.7, 0.7) * (p**3 - p) + rng.uniform(-0.2, 0.2) * p**4)
        )
        return Part("straightness", bow * share, [a.lower(), b.lower()])

    def cyclic(rng: Rng) -> Part:
        i = int(rng.integers(2))
        a = "XY"[i]
        period = float(path.leads[i]) * (1 if rng.random() < 0.8 else 0.5)
        p, _, _, share = path.axis(a)
        u = 2 * np.pi * p / period + rng.uniform(0, 6.28)
        value = rng.uniform(0.5, 5) * (np.sin(u) + rng.uniform(0, 0.2) * np.sin(2 * u + 1)) * share
        return Part(
            "pitch_cyclic", value, [a.lower()], {"pitch_cyclic.period": (period, "mm")}, ("pitch_cyclic.period",)
        )

    return {"scale_error": scale, "squareness": square, "straightness": straight, "pitch_cyclic": cyclic}


def _friction(path: Circles, columns: dict) -> dict[str, Maker]:
    def names(a: str) -> list[str]:
        more = [f"dir_{a.lower()}"] if f"dir_{a.lower()}" in columns else []
        return [a.lower(), f"v{a.lower()}", *more]

    def gap(rng: Rng) -> Part:
        a = str(rng.choice(["X", "Y"]))
        p, v, _, share = path.axis(a)
        b = sign(rng) * rng.uniform(2, 15)
        state = dahl(_unwound(p, path.runs), 0.004)
        return Part(
            "backlash",
            0.5 * b * np.where(np.abs(state) > 0, state, np.sign(v)) * share,
            names(a),
            {"backlash.lost_motion": (abs(b), "um")},
        )

    def bristles(rng: Rng) -> Part:
        a = str(rng.choice(["X", "Y"]))
        p, _, _, share = path.axis(a)
        state = dahl(_unwound(p, path.runs), rng.uniform(0.2, 1.0) * path.radius / 100, rng.choice([1.0, 1.5]))
        return Part("friction_hysteresis", sign(rng) * rng.uniform(1, 10) * state * share, names(a))

    def spike(rng: Rng) -> Part:
        axes = ["X", "Y"] if rng.random() < 0.3 else [str(rng.choice(["X", "Y"]))]
        tau, power = rng.uniform(0.03, 0.25), rng.uniform(0.3, 0.9)
        total, acting = np.zeros(len(path.t)), np.zeros(len(path.t), bool)
        for a in axes:
            _, v, _, share = path.axis(a)
            after = since_reversal(np.sign(v), path.t, path.runs)
            rise = 1 - np.exp(-after / (0.05 * tau))
            size = (path.feed / path.feed.max()) ** power
            pulse = np.where(np.isfinite(after), size * np.exp(-np.minimum(after, 1e6) / tau) * rise, 0)
            total += pulse * np.sign(v) * share
            acting |= np.isfinite(after) & (after < 3 * tau)
        drivers = [d for a in axes for d in names(a)] + ["feed"]
        return Part("reversal_spike", sign(rng) * rng.uniform(2, 15) * total, drivers, {}, (), acting)

    return {"backlash": gap, "friction_hysteresis": bristles, "reversal_spike": spike}


def _unwound(p: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """Position without the jump back to the start of a run, so that a contact does not slip there."""
    step = np.diff(p, prepend=p[0])
    step[1:][runs[1:] != runs[:-1]] = 0
    return np.cumsum(step)


def _servo(path: Circles) -> dict[str, Maker]:
    def mismatch(rng: Rng) -> Part:
        """Two loops of second order that lag by different times."""
        lag = sign(rng) * 1e-3 * rng.uniform(0.01, 0.3)
        jerk = rng.uniform(0, 2e-5)
        ex = 1000 * (-0.5 * lag * path.vx + jerk * lag * path.ax)
        ey = 1000 * (0.5 * lag * path.vy - jerk * lag * path.ay)
        return Part(
            "servo_mismatch",
            (ex * path.x + ey * path.y) / path.radius,
            ["vx", "vy", "x", "y", "feed"],
            {"servo_mismatch.lag_difference": (abs(lag) * 1000, "ms")},
        )

    def inertia(rng: Rng) -> Part:
        a = str(rng.choice(["X", "Y"]))
        _, _, acc, share = path.axis(a)
        c = sign(rng) * rng.uniform(2, 40)
        return Part(
            "inertial_deflection",
            c * acc / 1000 * share,
            [f"a{a.lower()}"],
            {"inertial_deflection.compliance": (abs(c), "um/(m/s2)")},
        )

    return {"servo_mismatch": mismatch, "inertial_deflection": inertia}
