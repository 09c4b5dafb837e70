"""Shapes over position that a term multiplies with a driver: level, line, polynomial, smooth curve, harmonics.

A profile is linear in its parameters: value = basis(x) @ parameters. Outside its `span` a fitted
polynomial or curve holds its end value, as a compensation table does; a line and harmonics continue.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from errpipe.domain.recording import FrozenModel
from errpipe.terms._base import Parameter
from errpipe.yamlfile import quantity

MM_PER_M = 1000.0


class Shape(FrozenModel, ABC):
    """A profile over position x (rows,), in mm or deg: its parameters, and one column for each."""

    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""

    def units(self, rotary: bool) -> tuple[str, ...]:
        """Units of the parameters; rotary: x is in deg."""
        return ("um",) * len(self.names())

    def settled(self, x: np.ndarray) -> Self:
        """The shape with what it reads off the positions written down."""
        return self

    @abstractmethod
    def basis(self, x: np.ndarray, rotary: bool = False) -> np.ndarray:
        """Columns, shape (rows, parameters), in um per unit of each parameter."""

    def penalty(self) -> np.ndarray | None:
        """Square matrix over the parameters of the quadratic penalty, or None."""
        return None


class Level(Shape):
    """The same everywhere."""

    kind: Literal["level"] = "level"

    def names(self) -> tuple[str, ...]:
        return ("gain",)

    def basis(self, x: np.ndarray, rotary: bool = False) -> np.ndarray:
        return np.ones((x.size, 1))


class Line(Shape):
    """Proportional to the distance from `origin`, um per m (um per deg on a rotary axis)."""

    kind: Literal["line"] = "line"
    origin: float = quantity("mm", "Where the line is zero.", 0.0)

    def names(self) -> tuple[str, ...]:
        return ("slope",)

    def units(self, rotary: bool) -> tuple[str, ...]:
        return ("um/deg" if rotary else "um/m",)

    def basis(self, x: np.ndarray, rotary: bool = False) -> np.ndarray:
        return ((x - self.origin) / (1.0 if rotary else MM_PER_M))[:, None]


class Polynomial(Shape):
    """Chebyshev polynomials of degrees `lowest` to `degree` over `span`.

    Raw powers of mm reach a condition number of 1e18 at degree 6 over a metre; Chebyshev's stay below 3.
    The level belongs to `offset`; a straight part that a temperature also moves is best given once.
    """

    kind: Literal["polynomial"] = "polynomial"
    degree: int = Field(4, ge=1, le=40, description="Highest degree.")
    lowest: int = Field(1, ge=0, description="1 leaves out the level, 2 the straight line too.")
    span: tuple[float, float] | None = quantity("mm", "Ends of the curve; the positions seen, where not given.", None)

    @model_validator(mode="after")
    def _some_degree(self) -> Polynomial:
        if self.lowest > self.degree:
            raise ValueError(f"lowest degree {self.lowest} is above degree {self.degree}")
        return self

    def names(self) -> tuple[str, ...]:
        return tuple(f"c{k}" for k in range(self.lowest, self.degree + 1))

    def settled(self, x: np.ndarray) -> Polynomial:
        return self if self.span else self.model_copy(update={"span": _span(x)})

    def basis(self, x: np.ndarray, rotary: bool = False) -> np.ndarray:
        low, high = self.span or _span(x)
        u = np.clip(2.0 * (x - low) / (high - low) - 1.0, -1.0, 1.0)
        return np.polynomial.chebyshev.chebvander(u, self.degree)[:, self.lowest :]


class Curve(Shape):
    """A smooth curve: cubic B-splines on `segments` equal stretches, held smooth by the solver's penalty.

    The level is always left out (it belongs to `offset`), the straight part too unless `line` is true.
    """

    kind: Literal["curve"] = "curve"
    segments: int = Field(20, ge=2, le=400, description="Stretches of equal length; more than the shape needs.")
    line: bool = Field(True, description="The curve may hold a straight part.")
    span: tuple[float, float] | None = quantity("mm", "Ends of the curve; the positions seen, where not given.", None)

    def names(self) -> tuple[str, ...]:
        return tuple(f"b{k}" for k in range(self.segments + (2 if self.line else 1)))

    def settled(self, x: np.ndarray) -> Curve:
        return self if self.span else self.model_copy(update={"span": _span(x)})

    def basis(self, x: np.ndarray, rotary: bool = False) -> np.ndarray:
        from scipy.interpolate import BSpline

        low, high = self.span or _span(x)
        step = (high - low) / self.segments
        knots = low + step * np.arange(-3, self.segments + 4)
        inside = np.clip(x, knots[3], knots[-4])
        known = np.isfinite(inside)
        full = np.full((x.size, self.segments + 3), np.nan)
        full[known] = BSpline.design_matrix(inside[known], knots, 3).toarray()
        return full @ self._free()

    def penalty(self) -> np.ndarray | None:
        """Squared second differences of neighbouring coefficients: 0 for a straight line."""
        second = np.diff(np.eye(self.segments + 3), n=2, axis=0) @ self._free()
        return second.T @ second

    def _free(self) -> np.ndarray:
        """Coefficient directions without the level (and the line), shape (splines, parameters)."""
        count = self.segments + 3
        place = np.linspace(-1.0, 1.0, count)
        taken = np.ones((count, 1)) if self.line else np.column_stack([np.ones(count), place])
        # A QR by Householder reflections is the same on every machine up to rounding; signs are fixed here.
        full, _ = np.linalg.qr(np.column_stack([taken, np.eye(count)])[:, : count + taken.shape[1]])
        free = full[:, taken.shape[1] : count]
        return free * np.where(np.sum(free, axis=0) < 0, -1.0, 1.0)


class Harmonics(Shape):
    """Sine and cosine of the given orders of one period."""

    kind: Literal["harmonics"] = "harmonics"
    period: float = quantity("mm", "Repeat length, such as the screw lead.", gt=0)
    orders: tuple[int, ...] = Field((1,), min_length=1, description="Multiples of the basic wave.")

    def names(self) -> tuple[str, ...]:
        return tuple(f"{wave}{k}" for k in self.orders for wave in ("sin", "cos"))

    def basis(self, x: np.ndarray, rotary: bool = False) -> np.ndarray:
        angle = 2.0 * np.pi * x[:, None] / self.period * np.asarray(self.orders, dtype=float)
        return np.stack([np.sin(angle), np.cos(angle)], axis=2).reshape(x.size, -1)


Profile = Annotated[Level | Line | Polynomial | Curve | Harmonics, Field(discriminator="kind")]


def parameters(profile: Profile, rotary: bool, per: str = "", typical: tuple[float, float] = (0.1, 100.0)):
    """Linear parameters of a profile; `per`: unit of the driver it is multiplied with, such as K."""
    units = (f"{unit}/{per}" if per else unit for unit in profile.units(rotary))
    return tuple(Parameter(name, unit, typical) for name, unit in zip(profile.names(), units, strict=True))


def curve(profile: Profile, gains: np.ndarray, rotary: bool) -> Callable[[np.ndarray], np.ndarray]:
    """The profile with its parameters put in, as a function of position."""
    gains = np.asarray(gains, dtype=float)

    def value(x: np.ndarray) -> np.ndarray:
        flat = np.atleast_1d(np.asarray(x, dtype=float)).ravel()
        return (profile.basis(flat, rotary) @ gains).reshape(np.shape(x))

    return value


def _span(x: np.ndarray) -> tuple[float, float]:
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    return (low, high) if high > low else (low, low + 1.0)
