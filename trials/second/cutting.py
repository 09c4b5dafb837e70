"""Cutting series: diameters of bored parts over days, tools change, the machine warms up and cools down."""

from __future__ import annotations

import numpy as np

from .climate import Climate, faulty_sensor, sensor_drift, sign, thermal_makers
from .heat import bodies, lagged, rod, room
from .novel_shop import cutting_novel
from .scene import Column, Maker, Part, Response, Scene

Rng = np.random.Generator
STEP = 30.0
PLACES = {"T_spindle": "front spindle bearing", "T_bed": "bed", "T_ambient": "room", "T_coolant": "coolant tank"}


class Series:
    """Parts, tools and cutting data, with breaks; temperatures on a clock."""

    def __init__(self, rng: Rng):
        self.n, self.tools = int(rng.integers(280, 500)), int(rng.integers(5, 9))
        cycle = rng.uniform(95, 180)
        cuts = np.sort(rng.choice(np.arange(18, self.n - 18), self.tools - 1, replace=False))
        tool = np.searchsorted(cuts, np.arange(self.n), side="right")
        self.runs = np.array([str(k + 1) for k in tool])
        pause = np.zeros(self.n)
        breaks = rng.choice(self.n - 1, int(rng.integers(9, 16)), replace=False) + 1
        pause[breaks] = rng.uniform(600, 4300, len(breaks))
        self.t = np.round(np.cumsum(cycle + rng.uniform(-0.045, 0.045, self.n) * cycle + pause))
        self.cutting = cycle
        self._data(rng, tool)
        metres = np.round(rng.uniform(0.13, 0.5) * cycle)
        self.cut = np.zeros(self.n)
        for k in range(self.tools):
            rows = tool == k
            self.cut[rows] = np.cumsum(np.round(metres * rng.uniform(0.97, 1.03, rows.sum())))
        self._warm(rng)

    def _data(self, rng: Rng, tool: np.ndarray) -> None:
        n = self.n
        change = np.sort(rng.choice(n, int(rng.integers(10, 22)), replace=False))
        part = np.searchsorted(change, np.arange(n), side="right")
        kinds = part.max() + 1
        self.rpm = rng.choice([800, 1200, 1600, 2000, 2600, 3200], kinds)[part].astype(float)
        self.depth = rng.choice([0.3, 0.5, 0.8, 1.0, 1.5, 2.0], kinds)[part]
        per_rev = rng.choice([0.08, 0.12, 0.2, 0.25, 0.3], kinds)[part]
        self.feed = np.round(self.rpm * per_rev)
        self.overhang = rng.choice([60.0, 80.0, 100.0, 130.0, 160.0], self.tools)[tool]
        hard = rng.uniform(900, 1500) * (1 + 0.05 * np.sin(np.arange(n) / rng.uniform(20, 60)))
        self.force = hard * self.depth**0.95 * per_rev**0.75 * 0.7 * rng.normal(1, 0.045, n)
        flow = rng.random(kinds) < 0.6
        self.flow = flow[part].astype(float)

    def _warm(self, rng: Rng) -> None:
        self.clock = np.arange(0, self.t[-1] + 2 * STEP, STEP)
        i = np.clip(np.searchsorted(self.t, self.clock), 0, self.n - 1)
        busy = (self.t[i] - self.clock) < self.cutting
        u = np.where(busy, self.rpm[i] / 3200, 0.0)
        self.speed, self.wet = np.where(busy, self.rpm[i], 0.0), np.where(busy, self.flow[i], 0.0)
        air = room(rng, self.clock, rng.uniform(19, 23), rng.uniform(1.0, 3.5))
        power = np.zeros((len(u), 3))
        power[:, 0] = rng.uniform(14, 30) * u**1.3
        power[:, 1] = rng.uniform(0, 25) * u
        power[:, 2] = rng.uniform(5, 30) * self.wet
        links = np.zeros((3, 3))
        links[0, 1] = links[1, 0] = 0.4
        capacity = np.array([rng.uniform(1300, 3000), 60000, 9000.0])
        start = air[0] + np.array([rng.uniform(0, 1), rng.normal(-1, 1), rng.normal(0, 0.3)])
        temps = bodies(STEP, capacity, links, power, air, np.array([1.1, 3.0, 6.0]), start)
        self.temps = dict(zip(["T_spindle", "T_bed", "T_coolant"], temps.T, strict=True)) | {"T_ambient": air}
        source = np.zeros((len(u), 10))
        source[:, 2], source[:, 8] = u**1.3, 0.4 * u**1.3
        self.growth = rod(STEP, 10, 0.4, 1.3e-5, source, (1 + np.round(0.5 * u, 2)) / rng.uniform(1200, 4500)).mean(1)


def scene(rng: Rng) -> Scene:
    job = Series(rng)
    climate = Climate(job.clock, job.temps, job.t)
    columns = {
        "t": Column({"role": "time", "unit": "s"}, job.t, 1.0),
        "F_p": Column({"role": "force", "axis": "X", "unit": "N"}, job.force + rng.normal(0, 2, job.n), 0.1),
        "rpm": Column({"role": "spindle_speed", "unit": "rpm"}, job.rpm, 1.0),
        "feed": Column({"role": "feed", "unit": "mm/min"}, job.feed, 1.0),
        "depth_of_cut": Column({"role": "depth_of_cut", "unit": "mm"}, job.depth, 0.1),
        "overhang": Column({"role": "overhang", "unit": "mm"}, job.overhang, 1.0),
        "cut_length": Column({"role": "cut_length", "unit": "m"}, job.cut, 1.0),
    }
    for name, place in PLACES.items():
        values = climate.at(job.temps[name]) + rng.normal(0, 0.06, job.n)
        columns[name] = Column({"role": "temperature", "unit": "degC", "location": place}, values, 0.1)
    columns["coolant"] = Column({"role": "coolant"}, job.flow, 1)
    response = Response(
        "E_D", "um", _makers(job, climate, columns), cutting_novel(job, climate), (0.1, 0.5), (), (0.5, 2.0)
    )
    title = f"Boring series, {job.n} parts, {job.tools} tools"
    return Scene("cutting series", title, f"lathe-{rng.integers(1, 7)}", {}, columns, [response], job.runs)


def _makers(job: Series, climate: Climate, columns: dict) -> dict[str, Maker]:
    makers = thermal_makers(climate, ["T_spindle", "T_bed", "T_ambient"], "T_ambient")
    makers |= {"sensor_drift": sensor_drift(job.t), **_process(job)}
    makers["sensor_fault"] = faulty_sensor(climate, columns, ["T_spindle"])

    def growth(rng: Rng) -> Part:
        size = sign(rng) * rng.uniform(8, 50)
        return Part("spindle_growth", size * climate.at(job.growth) / (np.max(job.growth) + 1e-9), ["rpm"])

    def coolant(rng: Rng) -> Part:
        value = lagged(job.clock, job.wet, rng.uniform(150, 700))
        return Part("coolant_effect", sign(rng) * rng.uniform(2, 15) * climate.at(value), ["coolant"])

    def centrifugal(rng: Rng) -> Part:
        return Part("centrifugal_growth", sign(rng) * rng.uniform(2, 15) * (job.rpm / 3200) ** 2, ["rpm"])

    return makers | {"spindle_growth": growth, "coolant_effect": coolant, "centrifugal_growth": centrifugal}


def _process(job: Series) -> dict[str, Maker]:
    def compliance(rng: Rng) -> Part:
        """A boring bar: cantilever of the overhang's length, in a holder that gives way too."""
        bar = rng.uniform(0.2, 0.95)
        c = rng.uniform(5, 50)
        value = c * job.force / 1000 * ((1 - bar) + bar * (job.overhang / 100) ** 3)
        return Part("cutting_compliance", sign(rng) * value, ["F_p", "overhang", "depth_of_cut"])

    def wear(rng: Rng) -> Part:
        """Running-in, steady flank wear and a little acceleration at the end of the tool's life."""
        s = job.cut / job.cut.max()
        value = s + rng.uniform(0, 0.15) * (1 - np.exp(-s / 0.05)) + rng.uniform(0, 0.2) * s**3
        return Part("tool_wear", sign(rng) * rng.uniform(3, 30) * value, ["cut_length"])

    return {"cutting_compliance": compliance, "tool_wear": wear}
