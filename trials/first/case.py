"""The nouns of a trial: columns, contributions of effects, responses and the bench that carries them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray


@dataclass
class Column:
    """One column of the recording: what the manifest says of it, its true values, how it is displayed."""

    spec: dict[str, Any]
    values: Array
    decimals: int = 4
    step: float = 0.0  # display resolution; 0: as many decimals as given
    noise: float = 0.0  # rms of the sensor's own noise, in the column's unit
    sensor: bool = False  # may lose cells or die


@dataclass
class Contribution:
    """What one effect adds to one response, per row, at a natural size.

    `params` maps a name to (value, unit, scales): scales says whether the value grows with the contribution.
    `active` marks the rows that size it (None: all), `where` is what the key states as its location.
    """

    effect: str
    values: Array
    drivers: tuple[str, ...]
    params: dict[str, tuple[float, str, bool]] = field(default_factory=dict)
    active: Array | None = None
    where: dict[str, Any] | None = None
    carrier: Contribution | None = (
        None  # what the simulation must hold for the effect to exist (a faulty sensor's term)
    )
    ideal: Array | None = None  # what the textbook form would give with `params`, where the mechanism differs from it
    display: tuple[str, Array] | None = None  # column that shows something else than the truth, and what it shows

    def scaled(self, factor: float) -> Contribution:
        """The same effect, `factor` times as large."""
        params = {k: (v * factor if grows else v, unit, grows) for k, (v, unit, grows) in self.params.items()}
        carrier = self.carrier.scaled(factor) if self.carrier else None
        ideal = self.ideal * factor if self.ideal is not None else None
        return Contribution(
            self.effect,
            self.values * factor,
            self.drivers,
            params,
            self.active,
            self.where,
            carrier,
            ideal,
            self.display,
        )

    def size_in_the_textbook(self, size: float, rows: Array) -> float:
        """The size that the textbook form needs to come closest to the contribution."""
        if self.ideal is None:
            return size
        a, b = self.values[rows], self.ideal[rows]
        a, b = a - a.mean(), b - b.mean()
        return size * float(a @ b) / max(float(b @ b), 1e-30)

    def rms(self, rows: Array) -> float:
        """Size over the rows in which it acts: without its mean where it acts everywhere, as it stands elsewhere."""
        if self.active is not None:
            part = self.values[rows & self.active]
            return float(np.sqrt(np.mean(part**2))) if part.size else 0.0
        return float(np.std(self.values[rows]))


@dataclass
class Response:
    """One recorded response and all mechanisms that could act on it."""

    component: str
    unit: str
    effects: dict[str, Contribution]
    novel: dict[str, Contribution]
    hideable: tuple[str, ...] | None = None  # None: every effect
    follow: str | None = None  # a position column that carries the measured deviation


@dataclass
class Bench:
    """A machine that was measured: columns, truth by response. `measured` marks rows that hold an error."""

    protocol: str
    title: str
    machine: str
    constants: dict[str, Any]
    columns: dict[str, Column]
    run: list[str]
    measured: Array
    responses: dict[str, Response]
    spikes: float = 0.004  # typical share of outliers
    lossy: bool = True  # rows may be missing or repeated

    @property
    def rows(self) -> int:
        return len(self.run)

    def time(self) -> Array:
        return self.columns["t"].values
