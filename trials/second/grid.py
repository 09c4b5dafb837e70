"""The work space on a grid: tool-point errors with different loads, tool lengths and bed temperatures."""

from __future__ import annotations

import numpy as np

from .climate import Climate, sensor_drift, sign
from .heat import bodies, lagged, refractivity, room
from .novel_shop import grid_novel
from .scene import Column, Maker, Part, Response, Scene

Rng = np.random.Generator
STEP = 20.0


class Volume:
    """Points of five or six runs, each with its own load and overhang, while the bed warms up and cools down."""

    def __init__(self, rng: Rng):
        self.size = {
            "X": float(rng.choice([500, 600, 700, 800, 1000])),
            "Y": float(rng.choice([400, 500, 600])),
            "Z": float(rng.choice([300, 400, 500])),
        }
        self.shape = {"X": 6, "Y": 6, "Z": 4}
        self.runs_count = int(rng.choice([5, 5, 6]))
        full = float(rng.choice([200, 400, 800]))
        rows, now = [], 0.0
        for run in range(1, self.runs_count + 1):
            load = 0.0 if rng.random() < 0.3 else round(rng.uniform(0.1, 1.0) * full)
            overhang = float(rng.choice([80, 120, 160, 200, 250, 300]))
            ticks = {a: self._ticks(rng, a) for a in "XYZ"}
            for z in ticks["Z"]:
                for y in ticks["Y"]:
                    for x in ticks["X"]:
                        now += rng.uniform(7, 11.3)
                        rows.append((str(run), round(now), x, y, z, load, overhang))
            now += rng.uniform(1200, 4200)
        self.runs = np.array([r[0] for r in rows])
        self.t, self.x, self.y, self.z, self.load, self.overhang = (
            np.array([r[k] for r in rows], float) for k in range(1, 7)
        )
        self.clock = np.arange(0, self.t[-1] + 2 * STEP, STEP)
        self._warm(rng)

    def _ticks(self, rng: Rng, a: str) -> np.ndarray:
        n, size = self.shape[a], self.size[a]
        even = np.linspace(0.05, 0.95, n) * size + rng.uniform(-0.045, 0.045, n) * size
        return np.round(np.clip(even, 0.02 * size, 0.98 * size), 2)

    def _warm(self, rng: Rng) -> None:
        air = room(rng, self.clock, rng.uniform(18.5, 22.5), rng.uniform(0.4, 1.5))
        peak = rng.uniform(0.4, 1.1) * self.clock[-1]
        power = np.zeros((len(self.clock), 1))
        power[:, 0] = np.where(self.clock < peak, rng.uniform(40, 110), rng.uniform(0, 20))
        bed = bodies(
            STEP,
            np.array([rng.uniform(60000, 130000)]),
            np.zeros((1, 1)),
            power,
            air + rng.uniform(1, 4),
            np.array([6.0]),
            np.array([air[0] + rng.uniform(0.5, 3.5)]),
        )[:, 0]
        self.temps = {"T_bed": bed, "T_air": air}
        self.pressure = rng.uniform(990, 1020) + lagged(
            self.clock, np.cumsum(rng.normal(0, 0.15, len(self.clock))), 1800
        )

    def place(self, a: str) -> np.ndarray:
        return {"X": self.x, "Y": self.y, "Z": self.z}[a]


def scene(rng: Rng) -> Scene:
    vol = Volume(rng)
    climate = Climate(vol.clock, vol.temps, vol.t)
    columns = {"t": Column({"role": "time", "unit": "s"}, vol.t, 1.0)}
    for a in "XYZ":
        columns[a.lower()] = Column({"role": "position", "axis": a, "unit": "mm"}, vol.place(a), 0.01)
    columns["load"] = Column({"role": "load", "unit": "kg"}, vol.load, 1.0)
    columns["overhang"] = Column({"role": "overhang", "unit": "mm"}, vol.overhang, 1.0)
    for name, place in (("T_bed", "bed"), ("T_air", "air in the work space")):
        values = climate.at(vol.temps[name]) + rng.normal(0, 0.03, len(vol.t))
        columns[name] = Column({"role": "temperature", "unit": "degC", "location": place}, values, 0.01)
    responses = [
        Response(f"E_{a}", "um", _makers(vol, climate, a), grid_novel(vol, climate, a), (0.1,), (), (0.3, 4.7))
        for a in "XYZ"
    ]
    constants = {a: f"{{role: axis, kind: linear, travel: [0, {vol.size[a]:.0f}], unit: mm}}" for a in "XYZ"}
    return Scene(
        "volumetric grid",
        f"Work space on a grid, {vol.runs_count} runs",
        f"vmc-{rng.integers(1, 9)}",
        constants,
        columns,
        responses,
        vol.runs,
    )


def _makers(vol: Volume, climate: Climate, me: str) -> dict[str, Maker]:
    makers = {**_rigid(vol, me), **_warmth(vol, climate, me), "sensor_drift": sensor_drift(vol.t)}
    if me == "Z":
        makers |= _weight(vol)
    return makers


def _rigid(vol: Volume, me: str) -> dict[str, Maker]:
    own, others = vol.place(me), [a for a in "XYZ" if a != me]

    def scale(rng: Rng) -> Part:
        k = sign(rng) * rng.uniform(8, 50)
        return Part("scale_error", k * own / 1000, [me.lower()], {"scale_error.slope": (abs(k), "um/m")})

    def square(rng: Rng) -> Part:
        a = str(rng.choice(others))
        s = sign(rng) * rng.uniform(8, 60)
        return Part("squareness", s * vol.place(a) / 1000, [a.lower()], {"squareness.angle": (abs(s), "urad")})

    def straight(rng: Rng) -> Part:
        a = str(rng.choice(others))
        u = 2 * vol.place(a) / vol.size[a] - 1
        bow = (1 - u**2) + rng.uniform(-0.5, 0.5) * (u**3 - u) + rng.uniform(-0.2, 0.2) * (u**4 - u**2)
        return Part("straightness", sign(rng) * rng.uniform(3, 20) * bow, [a.lower()])

    def abbe(rng: Rng) -> Part:
        """A rotation that grows along one axis, times a lever: another axis or the tool."""
        a = str(rng.choice(others if me != "Z" else ["X", "Y"]))
        rest = [b for b in "XYZ" if b not in (a, me)]
        name = "overhang" if me != "Z" and rng.random() < 0.5 else rest[0].lower()
        lever = vol.overhang if name == "overhang" else vol.place(rest[0])
        u = vol.place(a) / vol.size[a]
        eps = sign(rng) * rng.uniform(8, 50)
        turn = u + rng.uniform(-0.12, 0.12) * (u**2 - u)
        return Part("angular_abbe", eps * turn * lever / 1000, [a.lower(), name])

    return {"scale_error": scale, "squareness": square, "straightness": straight, "angular_abbe": abbe}


def _warmth(vol: Volume, climate: Climate, me: str) -> dict[str, Maker]:
    def expansion(rng: Rng) -> Part:
        k = sign(rng) * rng.uniform(5, 20)
        return Part(
            "scale_expansion",
            k * vol.place(me) / 1000 * climate.at(climate.near(rng, "T_bed")),
            [me.lower(), "T_bed"],
            {"scale_expansion.coefficient": (abs(k), "um/m/K")},
        )

    def drift(rng: Rng) -> Part:
        k = sign(rng) * rng.uniform(1, 8)
        return Part(
            "thermal_drift",
            k * climate.at(climate.near(rng, "T_bed")),
            ["T_bed"],
            {"thermal_drift.coefficient": (abs(k), "um/K")},
        )

    def air(rng: Rng) -> Part:
        n = refractivity(climate.at(vol.temps["T_air"]), np.full(len(vol.t), 1010.0))
        return Part("air_refraction", sign(rng) * vol.place(me) / 1000 * (n - n[0]) * 1e6, [me.lower(), "T_air"])

    return {"scale_expansion": expansion, "thermal_drift": drift, "air_refraction": air}


def _weight(vol: Volume) -> dict[str, Maker]:
    def sag(rng: Rng) -> Part:
        """A ram (cantilever under its own weight and the tool's) along X or Y, or the tool's overhang."""
        kind = str(rng.choice(["x", "y", "overhang"]))
        arm = vol.overhang if kind == "overhang" else vol.place(kind.upper())
        u = arm / np.max(arm)
        mix = rng.uniform(0, 1)
        return Part("gravity_sag", -rng.uniform(5, 40) * (mix * u**2 * (3 - u) / 2 + (1 - mix) * u**3), [kind])

    def load(rng: Rng) -> Part:
        a = str(rng.choice(["X", "Y"]))
        u = vol.place(a) / vol.size[a]
        tilt = rng.uniform(0.0, 0.9) if rng.random() < 0.7 else 0.0
        value = -rng.uniform(5, 30) * vol.load / max(vol.load.max(), 1.0) * (1 - tilt * u)
        return Part("workpiece_load", value, ["load", a.lower()] if tilt else ["load"])

    return {"gravity_sag": sag, "workpiece_load": load}
