"""Components from indirect tests: a smooth prior for every curve, set-up parameters beside them, honest intervals.

Every error motion is a sum of smooth functions (`basis`) whose coefficients a priori fall with wave number;
how large and how smooth is estimated from the readings themselves by their marginal likelihood, with the
noise. So a wiggle that the basis was not made for widens the interval instead of bending the answer, and what
a test cannot see keeps its prior width and is named (`observability`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from errpipe.domain.components import parse
from errpipe.errors import DataError
from errpipe.kinematics import basis, evidence, synthesis
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.kinematics.observations import Observations, reading

FAMILIES = ("positioning", "straightness", "angular", "scale", "slope of angle", "offset", "squareness", "radial slope")
# Spread before measuring, rms over the travel: the bending part of three families, the straight part of two (um,
# urad), constants in um and in urad, the straight part of a rotary axis' radial and axial motion over part of a
# turn. Sizes of ordinary machines; the readings move them.
TYPICAL = (4.0, 3.0, 12.0, 12.0, 24.0, 30.0, 55.0, 4.0)
SMOOTHNESS = 3.0  # coefficients fall with this power of the wave number, unless the readings say otherwise
CERTAINTY = (0.8, 0.8, 0.8, 0.4, 0.3, 0.25, 0.25, 0.3, 0.3, 3.0)  # spread of log(size by family, smoothness, noise)


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
                elif parse(name).kind != "straightness":  # the slope of a straightness is squareness
                    rows.append((f"{name}[{j}]", c, j, {0: 3, 1: 7, 2: 4}[family], 1.0))
        names, *columns = zip(*rows, strict=True)
        return cls(chain, bases, Prior(names, *map(np.array, columns)))

    @cached_property
    def zeroed(self) -> np.ndarray:
        """True for functions of a positioning deviation, which is zero at its axis' datum."""
        kinds = [parse(self.chain.components[c]).kind for c in self.prior.component]
        own = np.array([k in ("positioning", "angular positioning") for k in kinds])
        return own & np.array([c < 0 or not self.bases[c].closed for c in self.chain.drives[self.prior.component]])

    def functions(self, q: np.ndarray) -> np.ndarray:
        """Value of each parameter's function at q, shape (n, parameters): d(component)/d(parameter)."""
        values = []
        for a, name in enumerate(self.chain.axes):
            values.append(self.bases[a](q[:, a]))
            if not self.bases[a].closed:
                zero = self.bases[a](np.array([self.chain.machine.axes[name].zero]))
                values[-1] = np.concatenate([values[-1], values[-1] - zero], axis=1)
        out = np.ones((len(q), len(self.prior.names)))
        for i, (c, j) in enumerate(zip(self.prior.component, self.prior.function, strict=True)):
            if j < 0:
                continue
            a = self.chain.drives[c]
            own = self.zeroed[i]
            out[:, i] = values[a][:, j + (self.bases[a].size if own else 0)]
        return out

    def design(self, obs: Observations) -> np.ndarray:
        """d(reading)/d(parameter), shape (n, parameters), set-up columns not included."""
        found = np.zeros((len(obs), len(self.prior.names)))
        for q, weights in obs.on_components(self.chain):
            found += weights[:, self.prior.component] * self.functions(q)
        return found


def family_of(component: str) -> str:
    """positioning, straightness or angular: how large and smooth an error motion may be expected to be."""
    c = parse(component)
    if c.unit == "urad":
        return "angular"
    return "positioning" if c.kind == "positioning" else "straightness"


@dataclass(frozen=True)
class Identified:
    """What a set of readings says about a machine.

    mean, covariance: of the parameters of `model` (um, urad), set-up eliminated; setup: its values by name (um,
    urad) with standard errors; noise: um; sizes: spread before measuring by family; power: smoothness.
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
        mine = np.flatnonzero(self.model.prior.component == c)
        rows = self.model.functions(q)[:, mine]
        own = self.covariance[np.ix_(mine, mine)]
        return rows @ self.mean[mine], np.sqrt(np.sum((rows @ own) * rows, axis=1))

    def interval(self, name: str, position: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """95 % interval of a component."""
        value, error = self.component(name, position)
        return value - 1.96 * error, value + 1.96 * error

    def predict(self, q: np.ndarray, tip: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Deviation of the tool point and its standard error, um, each (n, 3)."""
        chain = self.model.chain
        q = np.atleast_2d(np.asarray(q, dtype=float))
        jac = synthesis.jacobian(chain, q, tip)[:, :3]
        rows = jac[:, :, self.model.prior.component] * self.model.functions(q)[:, None, :]
        value = rows @ self.mean
        return value, np.sqrt(np.einsum("nkp,pq,nkq->nk", rows, self.covariance, rows, optimize=True))

    def covariance_at(self, q: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
        """Covariance of the predicted tool point over all places, shape (3 n, 3 n), um2, X Y Z of a place together."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        jac = synthesis.jacobian(self.model.chain, q, tip)[:, :3]
        rows = (jac[:, :, self.model.prior.component] * self.model.functions(q)[:, None, :]).reshape(3 * len(q), -1)
        return rows @ self.covariance @ rows.T

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
        """One row per constant: name, value, 95 % interval, unit, and how much of its spread the readings removed."""
        out = []
        for i, name in enumerate(self.model.prior.names):
            if self.model.prior.function[i] < 0:
                error = float(np.sqrt(self.covariance[i, i]))
                value = float(self.mean[i])
                seen = 1.0 - (error / self.spread[i]) ** 2
                unit = self.model.chain.unit(name)
                out.append(
                    {
                        "component": name,
                        "value": value,
                        "ci95": (value - 1.96 * error, value + 1.96 * error),
                        "unit": unit,
                        "seen": seen,
                    }
                )
        return out


def identify(
    model: Parametrisation,
    obs: Observations,
    *,
    noise: float | None = None,
    sizes: Mapping[str, float] | None = None,
    power: float | None = None,
    iterations: int = 2,
) -> Identified:
    """Solve for all components and set-up parameters.

    noise (um), sizes (spread before measuring by family, um or urad) and power are estimated where not given.
    Raises DataError where readings are missing or fewer than a handful.
    """
    if len(obs) < 8 or not np.isfinite(obs.value).all():
        raise DataError(f"identification needs at least 8 readings, all of them numbers (found {len(obs)} rows)")
    chain = model.chain
    plain = np.hstack([model.design(obs), obs.nuisance])
    design = plain / obs.noise[:, None]
    spreads = model.prior.spreads(obs.nuisance_spread)
    told = np.flatnonzero(design.any(axis=0))  # what no reading knows of keeps its prior: it needs no solving
    offset, hyper = np.zeros(len(obs)), np.empty(0)  # no sizes learnt yet
    for _ in range(max(1, iterations)):
        moments = evidence.Moments.of(design[:, told], (obs.value - offset) / obs.noise)
        start = hyper if hyper.size else None
        hyper = evidence.learn(spreads.take(told), moments, _known(sizes, power, noise), start)
        mean, cov = np.zeros(design.shape[1]), np.diag(spreads.of(hyper) ** 2)
        mean[told], cov[np.ix_(told, told)] = evidence.solve(spreads.take(told), moments, hyper)
        bent = bending_of_lengths(chain, model, obs, plain, mean)
        if np.abs(bent - offset).max() < 1e-3 * hyper[-1]:
            break
        offset = bent
    p = len(model.prior.names)
    error = np.sqrt(np.diag(cov))
    setup = {n: (float(mean[p + i]), float(error[p + i])) for i, n in enumerate(obs.nuisance_names)}
    found = dict(zip(FAMILIES, map(float, hyper[:-2]), strict=True))
    return Identified(
        model,
        mean[:p],
        cov[:p, :p],
        spreads.of(hyper)[:p],
        setup,
        float(hyper[-1]),
        found,
        float(hyper[-2]),
        len(obs),
        obs.value - offset - plain @ mean,
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


def _known(sizes: Mapping[str, float] | None, power: float | None, noise: float | None) -> np.ndarray:
    """What the caller fixes, NaN where the readings decide."""
    given = [(sizes or {}).get(f) for f in FAMILIES] + [power, noise]
    return np.array([np.nan if v is None else v for v in given], dtype=float)
