"""Gains times lagged rises, and times products of one sensor's rate of warming with another one's rise.

Heat transfer grows with speed, so the effect of a kelvin depends on whether the machine runs. No sensor measures it,
but the rate of warming indicates it. The state equation of such a machine is bilinear,

    d theta / dt = (A + s W) theta + B u          theta: rises, s: speed, u: heat

and the part of theta due to W is, to first order, lagged products of s and theta (Volterra series of second order;
Rugh 1981, Nonlinear System Theory, chapter 3). The sensors' rates replace s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from errpipe.models._thermal import ThermalFamily, linear

if TYPE_CHECKING:
    from errpipe.domain import driver as d
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem

# For columns of unit rms, and the factor by which a product of unit rms is reduced. The competition selects both.
RIDGE = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
SCALES = (1.0, 3.0, 10.0)
MOST_SENSORS = 8  # products grow with twice its square
LATE = 0.25  # time constant of the lagged products, as a share of the number of the recording's time constants


class Bilinear(ThermalFamily):
    """Ridge on rises, lagged rises, and products of a sensor's rate with a sensor's rise, direct and lagged."""

    family: Literal["bilinear"] = Field("bilinear", description="Model family.")
    nonlinear: ClassVar[bool] = True

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Every setting; none for one run, for no sensor or more than `MOST_SENSORS`, or if no lag can be resolved.

        A single run cannot validate a product for another day.
        """

        from errpipe.thermal import linear as t

        taus = t.time_constants(problem.recording, problem.plain)
        if problem.one_run or not 0 < problem.plain <= MOST_SENSORS or not taus:
            return ()
        rises = problem.drivers[: problem.plain]
        features = _Products(t.rates(problem), rises, taus[int(LATE * len(taus))])
        whole = t.extended(problem, features.columns())
        width, count = len(problem.drivers), len(whole.drivers)

        @cache
        def path(groups: tuple[int, ...], scale: float) -> np.ndarray:
            scales = np.r_[np.ones(width), np.full(count - width, scale)]
            return t.ridge_path(*whole.stacked(groups, count), RIDGE, scales)

        def entrant(scale: float, number: int) -> Entrant:
            def gains(groups: tuple[int, ...]) -> np.ndarray:
                return path(groups, scale)[number]

            def linear_part(groups: tuple[int, ...]) -> Any:
                known = gains(groups)[:width]
                return tuple((name, float(g), node) for g, node in zip(known, problem.drivers, strict=True) if g)

            def parts(groups: tuple[int, ...]) -> Any:
                return (*linear_part(groups), ("products", 1.0, features.sum(gains(groups)[width:])))

            name = f"bilinear, ridge {RIDGE[number]:g}, products {scale:g}"
            one = linear(self.family_name(), name, whole, gains)
            return replace(one, parts=parts, linear=linear_part)

        return [entrant(scale, number) for scale in SCALES for number in range(len(RIDGE))]


class _Products(NamedTuple):
    """Rates and rises of the sensors, K, and the time constant of their lagged products, s."""

    rates: tuple[d.Driver, ...]
    rises: tuple[d.Driver, ...]
    late: float

    def columns(self) -> list[d.Driver]:
        """Every product, and every lagged product; K2."""
        from errpipe.domain import driver as d

        plain: list[d.Driver] = [d.Product(of=(rate, x)) for rate in self.rates for x in self.rises]
        return plain + [self._lagged(node) for node in plain]

    def sum(self, gains: np.ndarray) -> d.Driver:
        """Gains (um/K2) times the columns, with one product per sensor and a single lag."""
        from errpipe.domain import driver as d

        at_once, late = gains.reshape(2, len(self.rates), len(self.rises))
        both = (self._sum(at_once), self._lagged(self._sum(late)))
        return d.Affine(weights=(1.0, 1.0), of=both)

    def _sum(self, gains: np.ndarray) -> d.Driver:
        from errpipe.domain import driver as d

        by_rate = (d.Affine(weights=tuple(map(float, row)), of=self.rises) for row in gains)
        products = tuple(d.Product(of=pair) for pair in zip(self.rates, by_rate, strict=True))
        return d.Affine(weights=(1.0,) * len(products), of=products)

    def _lagged(self, of: d.Driver) -> d.Driver:
        from errpipe.domain import driver as d

        return d.lag(of, self.late)
