"""Optimal experiment design: speeds, durations and stops of the next duty cycle, within a machine's limits.

The model is the usual one of spindle heat: growth = sum of gains x lag_tau(speed^power) over a few time constants and
powers, gains unknown with a prior. The Fisher information of a duty cycle is known before it is run, because it is
independent of the readings:

    D  largest determinant of the information: all gains at once
    I  smallest predictive variance averaged over reference duty cycles, i.e. where the machine will be used

Plans are improved segment by segment (coordinate exchange) from a few random starts; equal seeds give equal plans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import FrozenModel
from errpipe.errors import DataError
from errpipe.kernels import responses
from errpipe.yamlfile import quantity

SWEEPS = 3  # exchange sweeps per start (by judgement)


class DesignOptions(FrozenModel):
    """Permitted inputs of the machine, and candidate models."""

    highest_speed: float = quantity("rpm", "Of the spindle.", 6000.0, gt=0)
    levels: tuple[float, ...] = Field(
        (0.0, 0.25, 0.5, 0.75, 1.0), description="Speeds that a plan may use, as shares of the highest."
    )
    segment: float = quantity("s", "Shortest stretch of one speed.", 1800.0, gt=0)
    hours: float = quantity("h", "Length of one day; each starts cold.", 8.0, gt=0)
    standing: float = Field(0.0, ge=0, le=1, description="Smallest share of a day with the spindle at rest.")
    taus: tuple[float, ...] = quantity("s", "Time constants of the model.", (450.0, 1200.0, 3600.0, 9000.0))
    powers: tuple[float, ...] = Field((1.0, 2.0), description="Powers of the speed in the heat model.")
    prior: float = quantity("um", "Prior standard deviation of each gain.", 30.0, gt=0)
    noise: float = quantity("um", "Of a reading.", 1.0, gt=0)
    every: float = quantity("s", "Time between independent readings.", 600.0, gt=0)
    criterion: Literal["D", "I"] = Field("I", description="D: all gains; I: predictions for the reference duty cycles.")

    @property
    def segments(self) -> int:
        """Stretches of a day."""
        return max(1, round(self.hours * 3600.0 / self.segment))


@dataclass(frozen=True)
class Plan:
    """Speeds of the stretches of one day, shares of the highest, shape (segments,)."""

    speeds: tuple[float, ...]

    def table(self, options: DesignOptions) -> list[dict[str, float]]:
        """Stretches in minutes and rpm, with equal neighbours merged."""
        out: list[dict[str, float]] = []
        for speed in self.speeds:
            rpm, minutes = speed * options.highest_speed, options.segment / 60.0
            if out and out[-1]["rpm"] == rpm:
                out[-1]["minutes"] += minutes
            else:
                out.append({"minutes": minutes, "rpm": rpm})
        return out


def basis(plan: Plan, options: DesignOptions) -> np.ndarray:
    """Design matrix of a day, shape (readings, powers * taus); the day starts cold."""
    t = np.arange(0.0, options.hours * 3600.0 + 1e-9, options.every)
    which = np.minimum((t / options.segment).astype(int), len(plan.speeds) - 1)
    speed = np.asarray(plan.speeds)[which]
    run = np.zeros(t.size, dtype=np.int64)
    return np.column_stack(
        [responses.lag(run, t, speed**p, tau, tau, False) for p in options.powers for tau in options.taus]
    )


def information(plans: Sequence[Plan], options: DesignOptions) -> np.ndarray:
    """Inverse covariance of the gains after the prior and all plans, 1/um2."""
    size = len(options.powers) * len(options.taus)
    total = np.eye(size) / options.prior**2
    for plan in plans:
        x = basis(plan, options)
        total += x.T @ x / options.noise**2
    return total


def uncertainty(known: np.ndarray, reference: np.ndarray) -> float:
    """Root mean predictive variance over reference rows, um. known: information; reference: (rows, gains)."""
    covariance = np.linalg.inv(known)
    return float(np.sqrt(np.mean(np.einsum("ij,jk,ik->i", reference, covariance, reference))))


def usage(options: DesignOptions, days: int = 12, seed: int = 0) -> list[Plan]:
    """Reference duty cycles: random speeds held for random whole numbers of stretches."""
    rng = np.random.default_rng(seed)
    plans = []
    for _ in range(days):
        speeds: list[float] = []
        while len(speeds) < options.segments:
            speeds += [float(rng.choice(options.levels))] * int(rng.integers(1, 5))
        plans.append(Plan(tuple(speeds[: options.segments])))
    return plans


def propose(done: Sequence[Plan], options: DesignOptions | None = None, *, starts: int = 3) -> Plan:
    """The best next day by the criterion, given the days done. Raises DataError if no plan satisfies the limits."""
    options = options or DesignOptions()
    rows = np.vstack([basis(p, options) for p in usage(options)])
    weight = rows.T @ rows / len(rows)
    known = information(done, options)
    standing_segments = round(options.standing * options.segments)
    if standing_segments > options.segments or (standing_segments and 0.0 not in options.levels):
        raise DataError("experiment design: the spindle must rest, but 0 is not among the levels")
    rng = np.random.default_rng(0)
    best: tuple[float, tuple[float, ...]] = (np.inf, ())
    for _ in range(starts):
        speeds = list(map(float, rng.choice(options.levels, options.segments)))
        for k in range(standing_segments - speeds.count(0.0)):
            speeds[k] = 0.0
        value = _cost(known, speeds, options, weight)
        for _ in range(SWEEPS):
            before = value
            for place in range(options.segments):
                value = _exchange(known, speeds, place, standing_segments, value, options, weight)
            if value >= before - 1e-9:
                break
        if value < best[0]:
            best = (value, tuple(speeds))
    return Plan(best[1])


def _exchange(known, speeds: list[float], place: int, rest: int, value: float, options, weight) -> float:
    """Insert the best allowed speed in one place; returns the cost."""
    kept = speeds[place]
    for level in options.levels:
        speeds[place] = float(level)
        if speeds.count(0.0) >= rest:
            cost = _cost(known, speeds, options, weight)
            if cost < value - 1e-12:
                value, kept = cost, float(level)
    speeds[place] = kept
    return value


def _cost(known: np.ndarray, speeds: Sequence[float], options: DesignOptions, weight: np.ndarray) -> float:
    x = basis(Plan(tuple(speeds)), options)
    after = known + x.T @ x / options.noise**2
    if options.criterion == "D":
        return -float(np.linalg.slogdet(after)[1])
    return float(np.trace(np.linalg.solve(after, weight)))


def fit(plans: Sequence[Plan], readings: Sequence[np.ndarray], options: DesignOptions) -> np.ndarray:
    """Gains, um, from days and their readings ((readings,) um each), with the prior."""
    right = np.zeros(len(options.powers) * len(options.taus))
    for plan, y in zip(plans, readings, strict=True):
        right += basis(plan, options).T @ y / options.noise**2
    return np.linalg.solve(information(plans, options), right)
