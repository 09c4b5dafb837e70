"""Observability of a machine's components by a test, and the smallest additional measurement that completes it.

Parameters are scaled by their prior standard deviation and readings by their noise. An eigenvector of the posterior
covariance with more than half of its prior variance is unobserved ("unseen"): its components are named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from errpipe.domain.components import describe
from errpipe.kinematics import identify as ident
from errpipe.kinematics import observations as o
from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.observations import Observations

UNOBSERVED = 0.5  # threshold: eigenvalue of the scaled posterior covariance (share of the prior variance)
NAMED = 0.3  # weight in an unobserved eigenvector from which a component is named
NEARLY, HELPS = 1e-3, 0.05  # weight of variance removed short of UNOBSERVED; smallest gain of a proposed measurement
PARALLEL = 0.9  # cosine of two axes, such as Z and W, that make no circle
MIN_BAR_LENGTH = 1.0  # mm: below it a bar has no direction; real ones are 50 mm and longer
MAX_EXTRA = 12  # measurements proposed: more than a day's work
BENDS = 2  # modes per curve: line and first bends; finer detail only needs more points


@dataclass(frozen=True)
class Unobserved:
    """A combination of components that a test does not observe. left: share of its prior variance that remains."""

    components: tuple[str, ...]
    left: float

    def sentence(self) -> str:
        if len(self.components) == 1:
            return f"{self.components[0]} ({describe(self.components[0])}) is not observed"
        return "only combinations are observed of " + ", ".join(self.components)


@dataclass(frozen=True)
class Observability:
    """rank of the scaled design, number of parameters, observed share of each component (0..1), unobserved ones."""

    rank: int
    parameters: int
    seen: dict[str, float]
    unobserved: tuple[Unobserved, ...]


@dataclass(frozen=True)
class Proposal:
    """A proposed measurement: description, components it makes observable, readings and minutes."""

    name: str
    resolves: tuple[str, ...]
    readings: int
    minutes: float


def coarse(chain: Chain, without: tuple[str, ...] = ()) -> ident.Parametrisation:
    """Parametrisation with few functions per curve: sufficient to test which components are identifiable."""
    return ident.Parametrisation.of(chain, modes=BENDS, without=without)


def analyse(chain: Chain, obs: Observations, *, noise: float = 1.0, without: tuple[str, ...] = ()) -> Observability:
    """Rank and unobserved combinations of a test (readings may be missing; only poses and set-up matter). noise: um."""
    model = coarse(chain, without)
    known, spread = information(model, obs, noise)
    posterior = np.linalg.inv(known + np.eye(len(spread)))
    values, vectors = np.linalg.eigh(posterior)
    rank = int((np.linalg.eigvalsh(known) > 1.0).sum())
    unobserved = tuple(_name(chain, model, vectors[:, i], values[i]) for i in np.flatnonzero(values > UNOBSERVED)[::-1])
    seen = {}
    for c, name in enumerate(chain.components):
        rows = model.prior.component == c
        if rows.any():
            seen[name] = float(1.0 - np.mean(np.diag(posterior)[rows]))
    return Observability(rank, len(spread), seen, _merged(unobserved))


def information(model: ident.Parametrisation, obs: Observations, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Fisher information of the scaled components, set-up eliminated (Schur complement), and their prior sd."""
    spread = model.prior.spreads(np.zeros(0)).of(np.r_[ident.TYPICAL, ident.SMOOTHNESS, 1.0])
    scale = (obs.noise * noise)[:, None]
    a = model.design(obs) * spread / scale
    if obs.nuisance.shape[1] == 0:
        return a.T @ a, spread
    n = obs.nuisance * obs.nuisance_spread / scale
    inner = cho_factor(n.T @ n + np.eye(n.shape[1]))
    cross = n.T @ a
    return a.T @ a - cross.T @ cho_solve(inner, cross), spread


def _name(chain: Chain, model: ident.Parametrisation, vector: np.ndarray, left: float) -> Unobserved:
    weight = np.sqrt(np.bincount(model.prior.component, weights=vector**2, minlength=len(chain.components)))
    ranked = np.argsort(-np.round(weight, 6), kind="stable")  # equal weights: the machine's order
    order = [int(i) for i in ranked if weight[i] > NAMED] or [int(ranked[0])]
    return Unobserved(tuple(chain.components[i] for i in order), float(left))


def _merged(unobserved: tuple[Unobserved, ...]) -> tuple[Unobserved, ...]:
    """One line for each set of components."""
    by_components: dict[tuple[str, ...], Unobserved] = {}
    for u in unobserved:
        by_components.setdefault(tuple(sorted(u.components)), u)
    return tuple(by_components.values())


def candidates(chain: Chain, obs: Observations) -> dict[str, Observations]:
    """Small measurements that could be added to a test, by name."""
    low, high = chain.travel.T
    middle = (low + high) / 2
    tip = obs.tip[:1]
    machine = chain.machine
    tool = np.asarray(machine.tool.direction)
    side = np.linalg.svd(tool[None])[2][1]
    by_name: dict[str, Observations] = {}
    for a, axis in enumerate(chain.axes):
        q = np.tile(middle, (9, 1))
        q[:, a] = np.linspace(low[a], high[a], 9)
        for i, about in enumerate("ABC"):
            unit = np.eye(3)[i]
            by_name[f"level or autocollimator along {axis}, about {about} (9 readings)"] = o.angle(
                chain, q, tip, unit, label=f"{axis}{about}", seconds=300
            )
        if machine.axes[axis].kind == "linear":
            by_name[f"laser along {axis} (9 readings)"] = o.along(
                chain, q, tip, machine.direction(axis), label=f"laser {axis}", seconds=900
            )
    for name, shift in (("a tool 100 mm longer", 100.0 * tool), ("a ball 80 mm off the spindle axis", 80.0 * side)):
        rows = np.linspace(0, len(obs) - 1, min(len(obs), 60)).astype(int)
        again = obs.take(rows)
        moved = o.Observations(**{**again.__dict__, "tip": again.tip + shift})
        by_name[f"the same test with {name} ({len(rows)} readings)"] = _with_tool_moved(chain, moved)
    for i, first in enumerate(chain.axes):
        for j, second in enumerate(chain.axes):
            both = {machine.axes[first].kind, machine.axes[second].kind} == {"linear"}
            if j <= i or not both or abs(np.dot(machine.direction(first), machine.direction(second))) > PARALLEL:
                continue
            angle = np.arange(24) * 2 * np.pi / 24
            radius = 0.3 * min(high[i] - low[i], high[j] - low[j])
            q = np.tile(middle, (24, 1))
            q[:, i] += radius * np.cos(angle)
            q[:, j] += radius * np.sin(angle)
            socket = synthesis.ideal_pose(chain, middle, tip)[0, 0]
            by_name[f"ball-bar circle {first}{second} (24 readings)"] = o.distance(
                chain, q, tip, socket, label=f"circle {first}{second}", seconds=240
            )
    return by_name


def _with_tool_moved(chain: Chain, obs: Observations) -> Observations:
    """The same readings with another tool: bar directions are recomputed, bars below MIN_BAR_LENGTH are dropped."""
    ray = synthesis.ideal_pose(chain, obs.q, obs.tip)[:, 0] - obs.socket
    length = np.linalg.norm(ray, axis=1)
    possible = ~(length < MIN_BAR_LENGTH)  # NaN if a reading is not a bar's
    obs, ray, length = obs.take(np.flatnonzero(possible)), ray[possible], length[possible]
    rows = ~np.isnan(length)
    weights = obs.weights.copy()
    weights[rows, :3] = ray[rows] / length[rows, None]
    return o.Observations(**{**obs.__dict__, "weights": weights, "seconds": 600.0})


def smallest_extra(
    chain: Chain, obs: Observations, *, noise: float = 1.0, without: tuple[str, ...] = ()
) -> tuple[Proposal, ...]:
    """Measurements to add, each the one that resolves most per minute, until all is observable.

    Stops early if no candidate helps any more.
    """
    model = coarse(chain, without)
    known, spread = information(model, obs, noise)
    offered = dict(candidates(chain, obs))
    gains = {name: information(model, extra, noise)[0] for name, extra in offered.items()}
    chosen: list[Proposal] = []
    one = np.eye(len(spread))
    for _ in range(MAX_EXTRA):
        values, vectors = np.linalg.eigh(np.linalg.inv(known + one))
        open_ = vectors[:, values > UNOBSERVED]
        if open_.shape[1] == 0:
            break
        best, score = "", 0.0
        for name, gain in gains.items():
            remaining = np.linalg.eigvalsh(np.linalg.inv(open_.T @ (known + gain) @ open_ + np.eye(open_.shape[1])))
            # combinations that become observable; if there are none, the variance removed
            resolved = float((remaining <= UNOBSERVED).sum()) + NEARLY * float(open_.shape[1] - remaining.sum())
            rate = resolved / max(offered[name].seconds, 60.0)
            if resolved > HELPS and rate > score:
                best, score = name, rate
        if not best:
            break
        before = _unobserved_components(chain, model, known)
        known = known + gains.pop(best)
        after = _unobserved_components(chain, model, known)
        extra = offered[best]
        chosen.append(Proposal(best, tuple(sorted(before - after)), len(extra), max(extra.seconds, 60.0) / 60.0))
    return tuple(chosen)


def _unobserved_components(chain: Chain, model: ident.Parametrisation, known: np.ndarray) -> set[str]:
    values, vectors = np.linalg.eigh(np.linalg.inv(known + np.eye(len(known))))
    numbers = np.flatnonzero(values > UNOBSERVED)
    return {c for i in numbers for c in _name(chain, model, vectors[:, i], values[i]).components}
