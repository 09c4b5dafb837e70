"""Bidirectional positioning of a linear axis over the thermal states of a shift (laser on the table)."""

from __future__ import annotations

import numpy as np

from .climate import Climate, faulty_sensor, sensor_drift, sign, thermal_makers
from .contact import dahl, maxwell_slip
from .heat import bodies, lagged, refractivity, rod, room
from .novel_axis import positioning_novel
from .scene import Column, Part, Response, Scene

Rng = np.random.Generator
STEP = 20.0
ALPHA_STEEL = 11.5  # um/m/K


class Plan:
    """Where the axis is and how it moves: measuring runs, and warm-up or rest between them."""

    def __init__(self, rng: Rng):
        self.travel = float(rng.choice([400, 500, 630, 800, 1000, 1250]))
        self.lead = float(rng.choice([5, 8, 10, 12, 16, 20]))
        self.encoder = float(rng.choice([0.01, 0.02, 0.04, 0.1]))
        self.drive_end = float(rng.choice([0.0, self.travel]))
        self.visits = int(rng.choice([2, 3]))
        self.count = int(rng.integers(28, 45) if self.visits == 2 else rng.integers(19, 30))
        self.runs = int(rng.integers(7, 12))
        self.logged = bool(rng.random() < 0.55)
        self.targets = self._targets(rng)
        self.rapid = float(rng.choice([15000, 20000, 24000, 32000])) * rng.uniform(0.9, 1.05)
        self.rows: list[tuple] = []  # run, t, x, dir, feed, logging
        self.spells: list[tuple] = []  # start, end, mean speed mm/s
        self._walk(rng)

    def _targets(self, rng: Rng) -> np.ndarray:
        pitch = self.travel / self.count
        x = (np.arange(self.count) + 0.5) * pitch + rng.uniform(-0.46, 0.46, self.count) * pitch
        return np.round(np.clip(x, 0, self.travel), 4)

    def _walk(self, rng: Rng) -> None:
        feeds = rng.choice([1000, 2000, 3000, 5000, 8000, 10000], int(rng.choice([1, 1, 2, 3])), replace=False)
        warm = int(rng.integers(2, max(3, round(0.7 * self.runs))))
        t = 0.0
        for run in range(1, self.runs + 1):
            if run > 1:
                t = self._between(rng, run, t, run <= warm + 1)
            t = self._measure(rng, run, t, float(rng.choice(feeds)))

    def _measure(self, rng: Rng, run: int, t: float, feed: float) -> float:
        start, there = t, self.targets
        path = np.concatenate([there, there[::-1]] * self.visits)
        side = np.concatenate([np.ones(self.count), -np.ones(self.count)] * self.visits)
        moved = np.abs(np.diff(path, prepend=path[0]))
        times = t + np.cumsum(3.0 + moved * 60 / feed + rng.uniform(0, 0.6, len(path)))
        self.rows += [
            (str(run), *r, False) for r in zip(np.round(times, 1), path, side, [feed] * len(path), strict=True)
        ]
        self.spells.append((start, times[-1], moved.sum() / (times[-1] - start)))
        return float(times[-1])

    def _between(self, rng: Rng, run: int, t: float, moving: bool) -> float:
        length = rng.uniform(400, 1700) if moving else rng.uniform(1100, 3100)
        feed = round(self.rapid * rng.choice([0.4, 0.7, 1.0])) if moving else 0.0
        times = np.arange(t + 30, t + length, 60.0 if moving else 150.0)
        n = len(times)
        x = np.round(rng.uniform(0, self.travel, n), 4) if moving else np.full(n, self.targets[0])
        side = rng.choice([-1.0, 1.0], n) if moving else np.ones(n)
        if self.logged:
            self.rows += [(f"w{run}", *r, True) for r in zip(np.round(times, 1), x, side, [feed] * n, strict=True)]
        self.spells.append((t, t + length, 0.75 * feed / 60))
        return t + length


class Heat:
    """Screw (rod), nut, bearing, bed and air while the plan runs."""

    def __init__(self, rng: Rng, plan: Plan, end: float):
        self.clock = np.arange(0, end + STEP, STEP)
        speed = np.zeros(len(self.clock))
        for a, b, v in plan.spells:
            speed[(self.clock >= a) & (self.clock < b)] = v
        self.speed = speed
        base = rng.uniform(20, 23)
        self.air = room(rng, self.clock, base, rng.uniform(0.5, 2.0))
        self._bodies(rng, speed, base)
        self._screw(rng, plan, speed)
        drop = rng.uniform(-24, 24)
        shape = np.tanh(3 * (self.clock / end - rng.uniform(0.3, 0.7)))
        self.pressure = (
            rng.uniform(985, 1025)
            + drop * 0.5 * (shape - shape[0]) / 1.0
            + lagged(self.clock, rng.normal(0, 3, len(self.clock)), 900)
        )

    def _bodies(self, rng: Rng, speed: np.ndarray, base: float) -> None:
        """Nut, bearing, bed: W, J/K, W/K."""
        gain = rng.uniform(14, 26) / 300.0
        power = np.zeros((len(speed), 3))
        capacity = np.array([rng.uniform(500, 900), rng.uniform(900, 1800), rng.uniform(9000, 25000)])
        power[:, 0] = gain * speed * rng.uniform(0.9, 1.2)
        power[:, 1] = gain * speed * rng.uniform(0.4, 1.3)
        power[:, 2] = gain * speed * rng.uniform(0.8, 2.5)
        links = np.zeros((3, 3))
        links[0, 2] = links[2, 0] = 0.15
        links[1, 2] = links[2, 1] = 0.25
        loss = np.array([0.8, 0.8, rng.uniform(0.8, 2.0)])
        start = base + np.array([rng.normal(0, 0.2), rng.normal(0, 0.2), rng.normal(0, 0.3)])
        self.nut, self.bearing, self.bed = bodies(STEP, capacity, links, power, self.air, loss, start).T

    def _screw(self, rng: Rng, plan: Plan, speed: np.ndarray) -> None:
        cells = 24
        source = np.outer(speed, np.ones(cells)) * rng.uniform(5, 12) / 300 / 2500
        edge = 0 if plan.drive_end == 0 else cells - 1
        source[:, edge] += speed / 300 * rng.uniform(0.0, 0.03)
        loss = np.full(len(speed), 1 / rng.uniform(1200, 4500))
        self.theta = rod(STEP, cells, plan.travel, 13.0, source, loss)
        self.edges = np.linspace(0, plan.travel, cells + 1)

    def growth(self, plan: Plan, t: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Expansion of the screw between its fixed bearing and the nut, um."""
        cum = np.concatenate([np.zeros((len(self.clock), 1)), np.cumsum(self.theta * np.diff(self.edges), axis=1)], 1)
        i = np.clip(np.searchsorted(self.clock, t) - 1, 0, len(self.clock) - 2)
        f = ((t - self.clock[i]) / STEP)[:, None]
        rows = cum[i] * (1 - f) + cum[i + 1] * f
        here = np.array([np.interp(p, self.edges, r) for p, r in zip(x, rows, strict=True)])
        if plan.drive_end:
            here = here - rows[:, -1]
        return ALPHA_STEEL * here / 1000


def scene(rng: Rng) -> Scene:
    plan = Plan(rng)
    runs = np.array([r[0] for r in plan.rows])
    t, x, side, feed = (np.array([r[k] for r in plan.rows], float) for k in (1, 2, 3, 4))
    logging = np.array([r[5] for r in plan.rows])
    heat = Heat(rng, plan, max(s[1] for s in plan.spells) + 60)
    climate = Climate(
        heat.clock, {"T_nut": heat.nut, "T_bearing": heat.bearing, "T_bed": heat.bed, "T_air": heat.air}, t
    )
    columns = _columns(rng, runs, t, x, side, feed, climate, heat)
    makers = _makers(plan, heat, climate, columns, t, x, side, ~logging)
    response = Response(
        "EXX", "um", makers, positioning_novel(plan, climate, t, x, side, runs), (0.01, 0.1), (), (0.3, 2.0)
    )
    constants = {
        "X": f"{{role: axis, kind: linear, travel: [0, {plan.travel:.0f}], screw_lead: {plan.lead}, "
        f"encoder_period: {plan.encoder}, drive_end: {plan.drive_end}, unit: mm}}"
    }
    return Scene(
        "linear positioning",
        f"X axis, bidirectional positioning, {plan.runs} runs over a shift",
        f"vmc-{rng.integers(1, 9)}",
        constants,
        columns,
        [response],
        runs,
        logging,
    )


def _columns(
    rng: Rng,
    runs: np.ndarray,
    t: np.ndarray,
    x: np.ndarray,
    side: np.ndarray,
    feed: np.ndarray,
    climate: Climate,
    heat: Heat,
) -> dict[str, Column]:
    step, grain = float(rng.choice([0.01, 0.01, 0.05])), rng.uniform(0.02, 0.06)
    where = {
        "T_nut": "ball-screw nut",
        "T_bearing": "fixed screw bearing",
        "T_bed": "bed, under the guideway",
        "T_air": "air beside the beam path",
    }
    columns = {
        "t": Column({"role": "time", "unit": "s"}, t, 0.1),
        "x": Column({"role": "position", "axis": "X", "unit": "mm"}, x, 1e-4),
        "dir": Column({"role": "direction", "axis": "X"}, side, 1),
        "feed": Column({"role": "feed", "axis": "X", "unit": "mm/min"}, feed, 1.0),
    }
    for name, place in where.items():
        values = climate.at(climate.temps[name]) + rng.normal(0, grain, len(t))
        columns[name] = Column({"role": "temperature", "unit": "degC", "location": place}, values, step)
    weather = climate.at(heat.pressure) + rng.normal(0, 0.04, len(t))
    columns["p_air"] = Column({"role": "pressure", "unit": "hPa"}, weather, 0.01 if step == 0.01 else 0.02)
    return columns


def _makers(
    plan: Plan,
    heat: Heat,
    climate: Climate,
    columns: dict,
    t: np.ndarray,
    x: np.ndarray,
    side: np.ndarray,
    measured: np.ndarray,
) -> dict:
    metre = x / 1000
    makers = {**_geometry(plan, x), **_reversal(plan, x, side)}
    makers |= thermal_makers(climate, ["T_nut", "T_bearing", "T_bed", "T_air"], "T_air")
    makers["sensor_drift"] = sensor_drift(t)
    faults = (
        faulty_sensor(climate, columns, ["T_bed", "T_bearing", "T_nut"]),
        faulty_sensor(climate, columns, ["T_bed", "T_nut"], metre, "scale_expansion", ("x",)),
    )
    makers["sensor_fault"] = lambda rng: faults[int(rng.integers(2))](rng)

    def expansion(rng: Rng) -> Part:
        a = sign(rng) * rng.uniform(5, 20)
        return Part(
            "scale_expansion",
            a * metre * climate.at(climate.near(rng, "T_bed")),
            ["x", "T_bed"],
            {"scale_expansion.coefficient": (abs(a), "um/m/K")},
        )

    def heating(rng: Rng) -> Part:
        s = sign(rng)
        return Part("feed_heating", s * heat.growth(plan, t, x), ["x", "feed", "T_nut"])

    def air(rng: Rng) -> Part:
        n = refractivity(climate.at(heat.air), climate.at(heat.pressure))
        return Part("air_refraction", sign(rng) * metre * (n - n[0]) * 1e6, ["x", "T_air", "p_air"])

    makers |= {"scale_expansion": expansion, "feed_heating": heating, "air_refraction": air}
    return makers


def _geometry(plan: Plan, x: np.ndarray) -> dict:
    def lead(rng: Rng) -> Part:
        k = sign(rng) * rng.uniform(5, 50)
        return Part("scale_error", k * x / 1000, ["x"], {"scale_error.slope": (abs(k), "um/m")})

    def cyclic(rng: Rng) -> Part:
        period = plan.lead if rng.random() < 0.8 else plan.lead / 2
        a, ph = rng.uniform(0.7, 4), rng.uniform(0, 2 * np.pi, 2)
        value = a * (
            np.sin(2 * np.pi * x / period + ph[0]) + rng.uniform(0, 0.25) * np.sin(4 * np.pi * x / period + ph[1])
        )
        return Part("pitch_cyclic", value, ["x"], {"pitch_cyclic.period": (period, "mm")}, ("pitch_cyclic.period",))

    def signal(rng: Rng) -> Part:
        a, ph = rng.uniform(0.2, 1.2), rng.uniform(0, 2 * np.pi)
        u = 2 * np.pi * x / plan.encoder + ph
        return Part(
            "interpolation",
            a * (np.sin(u) + 0.15 * np.sin(2 * u)),
            ["x"],
            {"interpolation.period": (plan.encoder, "mm")},
            ("interpolation.period",),
        )

    def wear(rng: Rng) -> Part:
        width = rng.uniform(0.12, 0.3) * plan.travel
        a = rng.uniform(0, plan.travel - width)
        s = (x - a) / width
        inside = (s > 0) & (s < 1)
        edge = rng.uniform(0.15, 0.5)
        shape = np.clip(np.minimum(s, 1 - s) / edge, 0, 1)
        depth = sign(rng) * rng.uniform(3, 20)
        value = np.where(inside, depth * 0.5 * (1 - np.cos(np.pi * shape)), 0.0)
        return Part(
            "local_wear",
            value,
            ["x"],
            {"local_wear.depth": (abs(depth), "um")},
            (),
            inside,
            {"ranges": {"x": [round(a, 1), round(a + width, 1)]}},
        )

    return {"scale_error": lead, "pitch_cyclic": cyclic, "interpolation": signal, "local_wear": wear}


def _reversal(plan: Plan, x: np.ndarray, side: np.ndarray) -> dict:
    far = np.abs(x - plan.drive_end) / plan.travel
    path = np.cumsum(np.abs(np.diff(x, prepend=x[0])) + 0.3)

    def gap(rng: Rng) -> Part:
        b = sign(rng) * rng.uniform(2, 20)
        uneven = 1 + rng.uniform(0, 0.06) * np.sin(2 * np.pi * x / plan.travel + rng.uniform(0, 6))
        return Part("backlash", 0.5 * b * side * uneven, ["dir"], {"backlash.lost_motion": (abs(b), "um")})

    def windup(rng: Rng) -> Part:
        a = sign(rng) * rng.uniform(2, 15)
        bearing = rng.uniform(0, 0.04)
        return Part(
            "screw_windup",
            0.5 * a * side * (bearing + (1 - bearing) * far),
            ["dir", "x"],
            {"screw_windup.far_end": (abs(a), "um")},
        )

    def bristles(rng: Rng) -> Part:
        a = sign(rng) * rng.uniform(1, 10)
        if rng.random() < 0.5:
            z = dahl(np.cumsum(side * np.diff(path, prepend=0)), rng.uniform(0.05, 0.3))
        else:
            breaks = np.array([0.03, 0.1, 0.3]) * rng.uniform(0.5, 1.2)
            z = maxwell_slip(np.cumsum(side * np.diff(path, prepend=0)), breaks, np.array([0.5, 0.3, 0.2]) / breaks)
        return Part("friction_hysteresis", a * z, ["dir", "x"])

    return {"backlash": gap, "screw_windup": windup, "friction_hysteresis": bristles}
