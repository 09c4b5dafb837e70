"""What a protocol hands to the composer: columns of a recording and the error mechanisms that may act in it.

Values are float64 arrays over the rows of the recording; deviations in um (N for drive forces).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np


@dataclass
class Part:
    """What one mechanism contributes to one response, on every row.

    `params` are the sizes that the key states, name -> (value, unit); those in `fixed` do not grow with the size.
    `acting` marks the rows that size it; `cells` replaces displayed columns (a sensor that failed). With `in_sim` it is
    the simulation that goes wrong (by minus the values); `along` is physics that must then be included. `again` gives
    the values anew where the axis is not where it was told to be (a period of micrometres).
    """

    effect: str
    values: np.ndarray
    drivers: list[str]
    params: dict[str, tuple[float, str]] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()
    acting: np.ndarray | None = None
    where: dict | None = None
    cells: dict[str, np.ndarray] = field(default_factory=dict)
    truth: str = ""
    in_sim: bool = False
    again: Callable[[np.ndarray], np.ndarray] | None = None
    along: list[Part] = field(default_factory=list)

    def scaled(self, factor: float) -> Part:
        """The same mechanism, `factor` times as large."""
        params = {k: (v if k in self.fixed else v * abs(factor), u) for k, (v, u) in self.params.items()}
        again = (lambda x, anew=self.again: factor * anew(x)) if self.again else None
        along = [a.scaled(factor) for a in self.along]
        return replace(self, values=self.values * factor, params=params, along=along, again=again)


Maker = Callable[[np.random.Generator], "Part | None"]


@dataclass
class Column:
    """One column: its manifest entry, its values before the display, and the display's step."""

    spec: dict
    values: np.ndarray
    step: float = 0.0
    noise: float = 0.0


@dataclass
class Response:
    """One measured component with the mechanisms that the protocol knows for it."""

    component: str
    unit: str
    makers: dict[str, Maker]
    novel: dict[str, Maker]
    step: tuple[float, ...] = (0.01, 0.05, 0.1)
    always: tuple[str, ...] = ()
    scale: tuple[float, float] = (0.1, 3.0)


@dataclass
class Scene:
    """A recording before anything went wrong with it."""

    protocol: str
    title: str
    machine: str
    constants: dict[str, str]
    columns: dict[str, Column]
    responses: list[Response]
    runs: np.ndarray
    logging: np.ndarray | None = None
    timed: bool = True

    @property
    def rows(self) -> int:
        return len(self.runs)

    def measured(self) -> np.ndarray:
        """Rows whose error cell is filled."""
        return np.ones(self.rows, bool) if self.logging is None else ~self.logging

    def by_role(self, role: str) -> dict[str, np.ndarray]:
        """Displayed columns of one role, by name."""
        return {k: shown(c) for k, c in self.columns.items() if c.spec["role"] == role}


def shown(column: Column) -> np.ndarray:
    """The column as its display shows it."""
    return np.round(column.values / column.step) * column.step if column.step else column.values


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
