"""The thermal mechanisms that several protocols share, on a clock of their own so that pauses count."""

from __future__ import annotations

import numpy as np

from .heat import lagged
from .scene import Maker, Part

Rng = np.random.Generator


class Climate:
    """True temperatures over the whole time of a recording, and what follows from them at the rows' times."""

    def __init__(self, clock: np.ndarray, temps: dict[str, np.ndarray], rows: np.ndarray):
        self.clock, self.temps, self.rows = clock, temps, rows

    def at(self, values: np.ndarray) -> np.ndarray:
        return np.interp(self.rows, self.clock, values)

    def rise(self, name: str) -> np.ndarray:
        """Temperature above the first one, on the clock."""
        return self.temps[name] - self.temps[name][0]

    def near(self, rng: Rng, name: str) -> np.ndarray:
        """The body beside a sensor: half a minute behind it (conduction over a few centimetres)."""
        return lagged(self.clock, self.rise(name), rng.uniform(5, 30))

    def behind(self, rng: Rng, name: str, tau: float) -> np.ndarray:
        """A body heated through a wall: one long and one short time constant in series."""
        return lagged(self.clock, lagged(self.clock, self.rise(name), tau), rng.uniform(0.01, 0.05) * tau)


def thermal_makers(climate: Climate, sensors: list[str], ambient: str) -> dict[str, Maker]:
    """Makers of the effects that need only temperatures: drift, lag, interaction, bending, ambient drift."""
    own = [s for s in sensors if s != ambient]

    def drift(rng: Rng) -> Part:
        name = str(rng.choice(own))
        k = sign(rng) * rng.uniform(1, 8)
        return Part(
            "thermal_drift",
            k * climate.at(climate.near(rng, name)),
            [name],
            {"thermal_drift.coefficient": (abs(k), "um/K")},
        )

    def late(rng: Rng, effect: str, name: str, taus: tuple[float, float], most: float) -> Part:
        tau = float(np.exp(rng.uniform(*np.log(taus))))
        k = sign(rng) * rng.uniform(1, most)
        size = f"{effect}.tau"
        return Part(effect, k * climate.at(climate.behind(rng, name, tau)), [name], {size: (tau, "s")}, (size,))

    def lag(rng: Rng) -> Part:
        return late(rng, "thermal_lag", str(rng.choice(own)), (900, 9500), 8)

    def interaction(rng: Rng) -> Part:
        a = str(rng.choice(own))
        b = str(rng.choice(own)) if rng.random() < 0.6 else a
        k = sign(rng) * rng.uniform(0.05, 0.5)
        value = climate.at(climate.near(rng, a)) * climate.at(climate.near(rng, b))
        return Part(
            "thermal_interaction", k * value, sorted({a, b}), {"thermal_interaction.coefficient": (abs(k), "um/K2")}
        )

    def bending(rng: Rng) -> Part:
        a, b = (str(v) for v in rng.choice(own, 2, replace=False))
        k = sign(rng) * rng.uniform(1, 12)
        value = climate.at(climate.near(rng, a) - climate.near(rng, b))
        return Part("gradient_bending", k * value, [a, b], {"gradient_bending.coefficient": (abs(k), "um/K")})

    def surroundings(rng: Rng) -> Part:
        return late(rng, "ambient_drift", ambient, (3500, 25000), 6)

    makers: dict[str, Maker] = {"thermal_drift": drift, "thermal_lag": lag, "thermal_interaction": interaction}
    if ambient:
        makers["ambient_drift"] = surroundings
    if len(own) > 1:
        makers["gradient_bending"] = bending
    return makers


def sensor_drift(t: np.ndarray) -> Maker:
    """A zero that walks away with time: a rate in um/h that settles a little."""

    def make(rng: Rng) -> Part:
        rate = sign(rng) * rng.uniform(0.5, 5)
        hours = (t - t[0]) / 3600
        bend = rng.uniform(0, 0.08) / max(hours[-1], 1e-6)
        value = rate * hours * (1 - bend * hours)
        return Part("sensor_drift", value, ["t"], {"sensor_drift.rate": (abs(rate * (1 - bend * hours[-1])), "um/h")})

    return make


def sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def window(rng: Rng, t: np.ndarray, runs: np.ndarray) -> tuple[np.ndarray, dict]:
    """Some rows in a row: whole runs where there are several, else a stretch of time. With its `where`."""
    labels = list(dict.fromkeys(runs.tolist()))
    if len(labels) >= 4 and rng.random() < 0.7:
        count = int(rng.integers(2, max(3, len(labels) // 2 + 1)))
        first = int(rng.integers(1, len(labels) - count + 1))
        chosen = labels[first : first + count]
        return np.isin(runs, chosen), {"runs": [str(c) for c in chosen]}
    a = rng.uniform(0.15, 0.55)
    b = a + rng.uniform(0.2, 0.4)
    lo, hi = np.quantile(t, [a, b])
    return (t >= lo) & (t <= hi), {"ranges": {"t": [round(float(lo), 1), round(float(hi), 1)]}}


def faulty_sensor(
    climate: Climate,
    columns: dict,
    names: list[str],
    reach: np.ndarray | float = 1.0,
    effect: str = "thermal_drift",
    more: tuple[str, ...] = (),
) -> Maker:
    """The simulation trusts a sensor that stuck, stepped or died (then the last value holds) for a while.

    `reach` is the response to one kelvin per unit coefficient: 1 for an offset, metres along the axis for a slope.
    """

    def make(rng: Rng) -> Part:
        name, kind = str(rng.choice(names)), str(rng.choice(["stuck", "stepped", "dead"]))
        t, true = climate.rows, columns[name].values
        start, end = np.quantile(t, rng.uniform(0.15, 0.5)), np.quantile(t, rng.uniform(0.6, 0.95))
        inside = (t >= start) & (t <= end)
        held = true[np.argmax(inside)]
        wrong = np.where(inside, true + sign(rng) * rng.uniform(2.0, 6.0) if kind == "stepped" else held, true)
        shown = np.where(inside, np.nan, true) if kind == "dead" else wrong
        k = sign(rng) * rng.uniform(1, 8)
        accepts = Part(effect, k * reach * (climate.at(climate.rise(name))), [*more, name])
        smooth = np.where(inside, wrong - climate.at(climate.temps[name]), 0.0)
        span = {"ranges": {"t": [round(float(t[inside][0]), 1), round(float(t[inside][-1]), 1)]}}
        return Part(
            "sensor_fault", -k * reach * smooth, [name], {}, (), inside, span, {name: shown}, "", True, [accepts]
        )

    return make
