"""Drift of a spindle's nose at changing speed in a room that is not constant."""

from __future__ import annotations

import numpy as np

from .climate import Climate, faulty_sensor, sensor_drift, sign, thermal_makers
from .heat import bodies, lagged, rod, room
from .novel_spindle import spindle_novel
from .scene import Column, Maker, Part, Response, Scene

Rng = np.random.Generator
STEP = 30.0
PLACES = {
    "T_bearing": "'front spindle bearing, outer ring'",
    "T_motor": "spindle motor",
    "T_housing": "headstock",
    "T_col_front": "'column, front wall'",
    "T_col_back": "'column, back wall'",
    "T_bed": "bed",
    "T_ambient": "'room, beside the machine'",
    "T_coolant": "coolant tank",
}
KITS = [
    ["T_bearing", "T_motor", "T_housing", "T_col_front", "T_bed", "T_ambient"],
    ["T_bearing", "T_motor", "T_housing", "T_col_front", "T_col_back", "T_bed", "T_ambient"],
    ["T_col_front", "T_col_back", "T_bed", "T_ambient"],
    ["T_bearing", "T_housing", "T_bed", "T_ambient"],
]


class Rig:
    """Speeds, coolant and temperatures of a machine on a clock; between two days it stands still."""

    def __init__(self, rng: Rng):
        self.dt = float(rng.choice([30, 60, 90, 120]))
        self.days = int(rng.choice([1, 2, 2]))
        hours = float(rng.choice([8, 14, 18, 22, 30])) if self.dt > 30 else float(rng.choice([8, 14, 22]))
        self.count = int(hours * 3600 / self.dt / self.days)
        self.hours = round(self.count * self.days * self.dt / 3600)
        pause = rng.uniform(28000, 38000)
        starts = np.arange(self.days) * (self.count * self.dt + pause)
        self.t = np.concatenate([s + np.arange(self.count) * self.dt for s in np.round(starts)])
        self.runs = np.repeat([str(i + 1) for i in range(self.days)], self.count)
        self.clock = np.arange(0, self.t[-1] + 2 * STEP, STEP)
        self.top = float(rng.choice([8000, 10000, 12000, 15000, 24000]))
        self.rpm = self._levels(rng, [0, 0.2, 0.4, 0.6, 0.8, 1.0], (1200, 9000), 0.28) * self.top
        self.flow = self._levels(rng, [0.0, 1.0], (800, 8000), 0.5)
        self.air = room(rng, self.clock, rng.uniform(19, 22.5), rng.uniform(0.7, 2.6))
        self._bodies(rng)
        self._shaft(rng)

    def _levels(self, rng: Rng, values: list[float], spell: tuple[float, float], idle: float) -> np.ndarray:
        out = np.zeros(len(self.clock))
        length = self.count * self.dt
        for start in np.unique([self.t[self.runs == r][0] for r in np.unique(self.runs)]):
            now = rng.uniform(1200, 7000)
            while now < length:
                span = rng.uniform(*spell)
                value = 0.0 if rng.random() < idle else float(rng.choice(values[1:]))
                out[(self.clock >= start + now) & (self.clock < start + min(now + span, length))] = value
                now += span
        return out

    def _bodies(self, rng: Rng) -> None:
        """Bearing, motor, housing, column front and back, bed, coolant: a network of seven."""
        names = ["T_bearing", "T_motor", "T_housing", "T_col_front", "T_col_back", "T_bed", "T_coolant"]
        n, u = len(names), self.rpm / self.top
        capacity = np.array([900, 2600, 3500, 14000, 15000, 45000, 30000]) * rng.uniform(0.7, 1.4, n)
        links = np.zeros((n, n))
        for a, b, w in ((0, 2, 1.2), (1, 2, 0.8), (2, 3, 1.0), (3, 4, 1.2), (3, 5, 0.5), (4, 5, 0.5)):
            links[a, b] = links[b, a] = w * rng.uniform(0.6, 1.5)
        loss = np.array([0.6, 1.2, 1.2, 1.8, 2.2, 3.0, 3.5])
        power = np.zeros((len(u), n))
        power[:, 0] = rng.uniform(14, 24) * u ** rng.uniform(1.1, 1.6)
        power[:, 1] = rng.uniform(10, 18) * u ** rng.uniform(1.0, 1.5)
        power[:, 6] = rng.uniform(2, 10) * self.flow * (0.3 + u) - rng.uniform(0, 3)
        start = self.air[0] + np.append(rng.normal(0.5, 0.6, n - 1), rng.normal(-1, 0.5))
        temps = bodies(STEP, capacity, links, power, self.air, loss, start)
        self.temps = dict(zip(names, temps.T, strict=True))
        self.temps["T_ambient"] = self.air

    def _shaft(self, rng: Rng) -> None:
        """The spindle's shaft: heated at its front bearing, better cooled at speed."""
        cells, u = 10, self.rpm / self.top
        source = np.zeros((len(u), cells))
        source[:, 2] = u ** rng.uniform(1.2, 1.8)
        source[:, 7] = 0.4 * u ** rng.uniform(1.2, 1.8)
        levels = np.round(1 + rng.uniform(0.0, 0.8) * u, 2)
        rise = rod(STEP, cells, 0.35, 1.3e-5, source * 0.02, levels / rng.uniform(900, 4500))
        self.growth = rise.mean(1)


def scene(rng: Rng) -> Scene:
    rig = Rig(rng)
    climate = Climate(rig.clock, rig.temps, rig.t)
    kit = list(KITS[int(rng.choice(4, p=[0.35, 0.25, 0.25, 0.15]))])
    wet = "T_bearing" in kit and rng.random() < 0.75
    if wet:
        kit.append("T_coolant")
    columns = _columns(rng, rig, climate, kit, wet)
    names = ["E_Z"] if rng.random() < 0.35 else ["E_X", "E_Z"] if rng.random() < 0.75 else ["E_Y", "E_Z"]
    responses = []
    for name in names:
        scale = (0.15, 2.3) if name == "E_Z" else (0.1, 0.8)
        responses.append(
            Response(
                name,
                "um",
                _makers(rig, climate, columns, kit, wet),
                spindle_novel(rig, climate, columns),
                (0.01, 0.05, 0.1),
                (),
                scale,
            )
        )
    title = f"Spindle at changing speed, {rig.hours} h, one reading every {rig.dt:.0f} s"
    constants = {"tool_length": f"{{value: {int(rng.choice([100, 150, 200]))}, unit: mm}}"}
    return Scene("spindle drift", title, f"vmc-{rng.integers(1, 9)}", constants, columns, responses, rig.runs)


def _columns(rng: Rng, rig: Rig, climate: Climate, kit: list[str], wet: bool) -> dict[str, Column]:
    step, grain = float(rng.choice([0.01, 0.05, 0.1])), rng.uniform(0.02, 0.06)
    columns = {
        "t": Column({"role": "time", "unit": "s"}, rig.t, 1.0),
        "rpm": Column({"role": "spindle_speed", "unit": "rpm"}, climate.at(rig.rpm), 100.0),
    }
    columns["rpm"].values = rig.rpm[np.clip(np.round(rig.t / STEP).astype(int), 0, len(rig.rpm) - 1)]
    for name in kit:
        values = climate.at(rig.temps[name]) + rng.normal(0, grain, len(rig.t))
        columns[name] = Column({"role": "temperature", "unit": "degC", "location": PLACES[name]}, values, step)
    if wet:
        flow = rig.flow[np.clip(np.round(rig.t / STEP).astype(int), 0, len(rig.flow) - 1)]
        columns["coolant"] = Column({"role": "coolant"}, flow, 1)
    if rng.random() < 0.25:
        columns["p_hyd"] = Column(
            {"role": "pressure", "unit": "hPa", "location": "hydraulic unit"},
            climate.at(hydraulics(rng, rig.clock)),
            10.0,
        )
    return columns


def hydraulics(rng: Rng, clock: np.ndarray) -> np.ndarray:
    """An accumulator that leaks and is pumped up again, hPa."""
    high, low = rng.uniform(61000, 63000), rng.uniform(55000, 57000)
    p, out, pumping = rng.uniform(low, high), np.empty(len(clock)), False
    leak, pump = rng.uniform(0.1, 0.6), rng.uniform(3, 6)
    for i in range(len(clock)):
        out[i] = p
        pumping = p < low or (pumping and p < high)
        p += STEP * (pump if pumping else -leak)
    return out + rng.normal(0, 20, len(clock))


def _makers(rig: Rig, climate: Climate, columns: dict, kit: list[str], wet: bool) -> dict[str, Maker]:
    solid = [k for k in kit if k not in ("T_coolant",)]
    makers = thermal_makers(climate, solid, "T_ambient")
    makers["sensor_drift"] = sensor_drift(rig.t)
    makers["sensor_fault"] = faulty_sensor(climate, columns, [k for k in solid if k != "T_ambient"])
    now = rig.rpm[np.clip(np.round(rig.t / STEP).astype(int), 0, len(rig.rpm) - 1)]

    def growth(rng: Rng) -> Part:
        size = sign(rng) * rng.uniform(8, 50)
        return Part("spindle_growth", size * climate.at(rig.growth) / (np.max(rig.growth) + 1e-9), ["rpm"])

    def centrifugal(rng: Rng) -> Part:
        c = sign(rng) * rng.uniform(2, 18)
        square = (now / rig.top) ** 2 * (1 + rng.uniform(0, 0.06) * (now / rig.top))
        return Part("centrifugal_growth", c * square, ["rpm"])

    def coolant(rng: Rng) -> Part:
        tau = rng.uniform(150, 900)
        if rng.random() < 0.5:
            drive, names = rig.flow, ["coolant"]
        else:
            drive, names = rig.flow * (rig.temps["T_coolant"] - rig.air.mean()), ["coolant", "T_coolant"]
        value = lagged(rig.clock, drive, tau)
        return Part("coolant_effect", sign(rng) * rng.uniform(2, 12) * climate.at(value), names)

    makers |= {"spindle_growth": growth, "centrifugal_growth": centrifugal}
    if wet:
        makers["coolant_effect"] = coolant
    return makers
