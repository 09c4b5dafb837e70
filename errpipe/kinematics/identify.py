"""Error components from indirect tests: a smoothness prior for every curve, set-up as nuisance parameters, intervals.

Every error motion is a sum of smooth functions (`basis`); the prior standard deviation of their coefficients falls with
wave number. Size, smoothness and noise are estimated from the readings by marginal likelihood (`evidence`). A shape
that the basis cannot represent therefore widens the interval instead of biasing the estimate, and a component that a
test does not observe keeps its prior width and is named (`observability`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from errpipe.domain.components import SQUARENESS, STRAIGHTNESS, parse
from errpipe.errors import DataError
from errpipe.kinematics import basis, evidence, synthesis
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.kinematics.observations import Observations, reading

FAMILIES = ("positioning", STRAIGHTNESS, "angular", "scale", "slope of angle", "offset", SQUARENESS, "radial slope")
# Prior standard deviation, rms over the travel: the bending part of three families, the linear part of two (um,
# urad), constants in um and in urad, the linear part of a rotary axis' radial and axial motion over part of a
# turn. Sizes of ordinary machines; they are re-estimated from the readings.
TYPICAL = (4.0, 3.0, 12.0, 12.0, 24.0, 30.0, 55.0, 4.0)
SMOOTHNESS = 3.0  # prior: coefficients fall with this power of the wave number; re-estimated from the readings
CERTAINTY = (0.8, 0.8, 0.8, 0.4, 0.3, 0.25, 0.25, 0.3, 0.3, 3.0)  # prior sd of log(size by family, smoothness, noise)


@dataclass(frozen=True)
class Prior:
    """Columns of the design: name, component, function (-1: constant), family, relative wave number (1: none)."""

    names: tuple[str, ...]
    component: np.ndarray
    function: np.ndarray
    family: np.ndarray
    rough: np.ndarray

    def spreads(self, setup: np.ndarray) -> evidence.Spreads:
        """Prior of these columns followed by set-up columns of given spreads."""
        p, m = len(self.names), len(setup)
        return evidence.Spreads(
            np.r_[self.family, np.full(m, -1)],
            np.r_[self.rough, np.ones(m)],
            np.r_[np.ones(p), setup],
            np.r_[TYPICAL, SMOOTHNESS, 1.0],
            np.array(CERTAINTY),
        )


@dataclass(frozen=True)
class Parametrisation:
    """A chain with a basis per axis."""

    chain: Chain
    bases: tuple[basis.AxisBasis, ...]
    prior: Prior

    @classmethod
    def of(cls, chain: Chain, modes: int = 12, without: tuple[str, ...] = ()) -> Parametrisation:
        """All components of a chain but those in `without`."""
        bases = tuple(
            basis.of_axis(chain.machine.axes[a].kind, chain.machine.axes[a].travel, modes) for a in chain.axes
        )
        rows: list[tuple[str, int, int, int, float]] = []
        for c, name in enumerate(chain.components):
            if name in without:
                continue
            if chain.drives[c] < 0:
                rows.append((name, c, -1, 6 if chain.angular[c] else 5, 1.0))
                continue
            family = FAMILIES.index(family_of(name))
            for j, rough in enumerate(bases[chain.drives[c]].rough):
                if rough > 0.0:
                    rows.append((f"{name}[{j}]", c, j, family, rough))
                elif not parse(name).is_straightness:  # the slope of a straightness is squareness
                    rows.append((f"{name}[{j}]", c, j, {0: 3, 1: 7, 2: 4}[family], 1.0))
        names, *columns = zip(*rows, strict=True)
        return cls(chain, bases, Prior(names, *map(np.array, columns)))

    @cached_property
    def zeroed(self) -> np.ndarray:
        """True for functions of a positioning deviation, which is zero at its axis' datum."""
        kinds = [parse(self.chain.components[c]).kind for c in self.prior.component]
        return np.array([k in ("positioning", "angular positioning") for k in kinds])

    def functions(self, q: np.ndarray) -> np.ndarray:
        """Value of each parameter's function at q, shape (n, parameters): d(component)/d(parameter)."""
        values = []
        for a, name in enumerate(self.chain.axes):
            values.append(self.bases[a](q[:, a]))
            zero = self.bases[a](np.array([self.chain.machine.axes[name].zero]))
            values[-1] = np.concatenate([values[-1], values[-1] - zero], axis=1)
        out = np.ones((len(q), len(self.prior.names)))
        for i, (c, j) in enumerate(zip(self.prior.component, self.prior.function, strict=True)):
            if j < 0:
                continue
            a = self.chain.drives[c]
            is_zeroed = self.zeroed[i]
            out[:, i] = values[a][:, j + (self.bases[a].size if is_zeroed else 0)]
        return out

    def design(self, obs: Observations) -> np.ndarray:
        """d(reading)/d(parameter), shape (n, parameters), set-up columns not included."""
        displacement = np.zeros((len(obs), len(self.prior.names)))
        for q, weights in obs.on_components(self.chain):
            displacement += weights[:, self.prior.component] * self.functions(q)
        return displacement


def family_of(component: str) -> str:
    """Family of an error motion, whose size and smoothness share one prior: positioning, straightness or angular."""
    c = parse(component)
    if c.unit == "urad":
        return "angular"
    return "positioning" if c.kind == "positioning" else STRAIGHTNESS


@dataclass(frozen=True)
class Identified:
    """Posterior of the components of a machine, given a set of readings.

    mean, covariance: of the parameters of `model` (um, urad), set-up eliminated; setup: its values by name (um,
    urad) with standard errors; noise: um; sizes: prior standard deviation by family; power: smoothness.
    """

    model: Parametrisation
    mean: np.ndarray
    covariance: np.ndarray
    spread: np.ndarray
    setup: dict[str, tuple[float, float]]
    noise: float
    sizes: dict[str, float]
    power: float
    rows: int
    residual: np.ndarray = field(repr=False)

    def component(self, name: str, position: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Value and standard error of a component at positions (a constant needs none). Raises KeyError."""
        chain = self.model.chain
        c = chain.index(name)
        position = np.zeros(1) if chain.drives[c] < 0 else np.atleast_1d(np.asarray(position, dtype=float))
        q = np.zeros((len(position), len(chain.axes)))
        q[:, max(chain.drives[c], 0)] = position
        columns = np.flatnonzero(self.model.prior.component == c)
        rows = self.model.functions(q)[:, columns]
        covariance = self.covariance[np.ix_(columns, columns)]
        return rows @ self.mean[columns], np.sqrt(np.sum((rows @ covariance) * rows, axis=1))

    def predict(self, q: np.ndarray, tip: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Deviation of the tool point and its standard error, um, each (n, 3)."""
        chain = self.model.chain
        q = np.atleast_2d(np.asarray(q, dtype=float))
        jac = synthesis.jacobian(chain, q, tip)[:, :3]
        rows = jac[:, :, self.model.prior.component] * self.model.functions(q)[:, None, :]
        value = rows @ self.mean
        return value, np.sqrt(np.einsum("nkp,pq,nkq->nk", rows, self.covariance, rows, optimize=True))

    def errors(self, nodes: int = 201) -> MachineErrors:
        """The components as curves and constants, for synthesis and tables."""
        chain = self.model.chain
        values: dict[str, float | Callable[[np.ndarray], np.ndarray]] = {}
        for c, name in enumerate(chain.components):
            if chain.drives[c] < 0:
                values[name] = float(self.component(name)[0][0])
            else:
                values[name] = lambda p, name=name: self.component(name, p)[0]  # type: ignore[misc]
        return MachineErrors.of(chain, values, nodes)

    def table(self) -> list[dict[str, Any]]:
        """One row per constant: name, value, 95 % interval, unit, and the share of its prior variance removed."""
        out = []
        for i, name in enumerate(self.model.prior.names):
            if self.model.prior.function[i] < 0:
                value, error = float(self.mean[i]), float(np.sqrt(self.covariance[i, i]))
                row = {"component": name, "value": value, "ci95": (value - 1.96 * error, value + 1.96 * error)}
                seen = 1.0 - (error / self.spread[i]) ** 2
                out.append(row | {"unit": self.model.chain.unit(name), "seen": seen})
        return out


def identify(
    model: Parametrisation,
    obs: Observations,
    *,
    noise: float | None = None,
    power: float | None = None,
    iterations: int = 2,
) -> Identified:
    """Solve for all components and set-up parameters.

    noise (um) and power are estimated if not given, like the prior sizes of the families.
    Raises DataError if readings are missing or fewer than 8.
    """
    if len(obs) < 8 or not np.isfinite(obs.value).all():
        raise DataError(f"identification needs at least 8 readings, all of them numbers (found {len(obs)} rows)")
    chain = model.chain
    plain = np.hstack([model.design(obs), obs.nuisance])
    design = plain / obs.noise[:, None]
    spreads = model.prior.spreads(obs.nuisance_spread)
    seen = np.flatnonzero(design.any(axis=0))  # a column without readings keeps its prior
    known = np.array([np.nan] * len(FAMILIES) + [np.nan if v is None else v for v in (power, noise)], dtype=float)
    offset, hyper = np.zeros(len(obs)), np.empty(0)  # no prior sizes estimated yet
    for _ in range(max(1, iterations)):
        moments = evidence.Moments.of(design[:, seen], (obs.value - offset) / obs.noise)
        start = hyper if hyper.size else None
        hyper = evidence.estimate(spreads.take(seen), moments, known, start)
        mean, cov = np.zeros(design.shape[1]), np.diag(spreads.of(hyper) ** 2)
        mean[seen], cov[np.ix_(seen, seen)] = evidence.solve(spreads.take(seen), moments, hyper)
        curvature = bending_of_lengths(chain, model, obs, plain, mean)
        if np.abs(curvature - offset).max() < 1e-3 * hyper[-1]:
            break
        offset = curvature
    p = len(model.prior.names)
    error = np.sqrt(np.diag(cov))
    setup = {n: (float(mean[p + i]), float(error[p + i])) for i, n in enumerate(obs.nuisance_names)}
    *size_of_families, learnt_power, learnt_noise = map(float, hyper)
    return Identified(
        *(model, mean[:p], cov[:p, :p], spreads.of(hyper)[:p], setup),
        noise=learnt_noise,
        sizes=dict(zip(FAMILIES, size_of_families, strict=True)),
        power=learnt_power,
        rows=len(obs),
        residual=obs.value - offset - plain @ mean,
    )


def bending_of_lengths(chain: Chain, model: Parametrisation, obs: Observations, design, mean) -> np.ndarray:
    """True reading minus linear reading at the estimate: second order in a bar's sideways set-up error."""
    lengths = ~np.isnan(obs.socket[:, 0])
    if not lengths.any():
        return np.zeros(len(obs))
    p = len(model.prior.names)
    comps = np.zeros((len(obs), len(chain.components)))
    np.add.at(comps.T, model.prior.component, (model.functions(obs.q) * mean[:p]).T)
    deviation = synthesis.first_order(chain, obs.q, comps, obs.tip)
    return np.where(lengths, reading(chain, obs, deviation, mean[p:]) - design @ mean, 0.0)
