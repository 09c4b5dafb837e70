"""The proposed day keeps the limits, teaches more than the customary one, and its promise is kept."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.errors import DataError
from errpipe.fitting import experiment_design as design
from errpipe.kernels import responses

OPTIONS = design.DesignOptions(segment=3600.0)


def machine(plan: design.Plan, options: design.DesignOptions) -> np.ndarray:
    """A spindle whose time constants and exponent are none of the model's, um."""
    t = np.arange(0.0, options.hours * 3600.0 + 1e-9, options.every)
    which = np.minimum((t / options.segment).astype(int), len(plan.speeds) - 1)
    speed = np.asarray(plan.speeds)[which]
    run = np.zeros(t.size, dtype=np.int64)
    return 18 * responses.lag(run, t, speed**1.4, 700.0, 700.0, False) + 40 * responses.lag(
        run, t, speed**1.4, 5200.0, 5200.0, False
    )


def one_speed(level: float) -> design.Plan:
    """The usual day: one speed for half of it, then cooling."""
    half = OPTIONS.segments // 2
    return design.Plan((level,) * half + (0.0,) * (OPTIONS.segments - half))


def hours_until(plans, options, goal: float) -> int:
    """Hours of measuring until random duty cycles are predicted within `goal` um rms."""
    rng = np.random.default_rng(3)
    done, readings = [], []
    for plan in plans(done):
        done.append(plan)
        readings.append(machine(plan, options) + rng.normal(0, options.noise, len(design.basis(plan, options))))
        gains = design.fit(done, readings, options)
        left = [machine(p, options) - design.basis(p, options) @ gains for p in design.usage(options, 8, seed=7)]
        if np.sqrt(np.mean(np.concatenate(left) ** 2)) <= goal:
            return round(options.hours) * len(done)
    return 10**6


def test_the_proposed_plan_saves_days():
    def custom(done):
        yield from [one_speed(level) for level in OPTIONS.levels if level > 0] * 2

    def proposed(done):
        for _ in range(6):
            yield design.propose(done, OPTIONS, starts=2)

    assert 2 * hours_until(proposed, OPTIONS, 1.2) <= hours_until(custom, OPTIONS, 1.2)


def test_each_criterion_wins_its_own_game():
    i = design.propose([], OPTIONS)
    d = design.propose([], OPTIONS.model_copy(update={"criterion": "D"}))
    rows = np.vstack([design.basis(p, OPTIONS) for p in design.usage(OPTIONS)])
    usual = one_speed(OPTIONS.levels[-1])
    assert (
        design.uncertainty(design.information([i], OPTIONS), rows)
        <= design.uncertainty(design.information([d], OPTIONS), rows) + 1e-9
    )
    assert design.uncertainty(design.information([i], OPTIONS), rows) < 0.7 * design.uncertainty(
        design.information([usual], OPTIONS), rows
    )
    volume = [np.linalg.slogdet(design.information([p], OPTIONS))[1] for p in (d, i, usual)]
    assert volume[0] >= volume[1] - 1e-9 > volume[2]


def test_limits_are_kept_and_equal_seeds_give_equal_plans():
    options = OPTIONS.model_copy(update={"standing": 0.5, "levels": (0.0, 0.6)})
    plan = design.propose([], options)
    assert plan == design.propose([], options)
    assert plan.speeds.count(0.0) >= 4 and set(plan.speeds) <= {0.0, 0.6}
    assert sum(row["minutes"] for row in plan.table(options)) == 480.0
    with pytest.raises(DataError):
        design.propose([], OPTIONS.model_copy(update={"standing": 0.5, "levels": (0.5, 1.0)}))


def test_the_promised_uncertainty_is_the_one_that_comes():
    plans = [design.propose([], OPTIONS)]
    rng = np.random.default_rng(0)
    rows = np.vstack([design.basis(p, OPTIONS) for p in design.usage(OPTIONS)])
    missed = []
    for _ in range(200):
        gains = rng.normal(0, OPTIONS.prior, rows.shape[1])
        readings = [
            design.basis(p, OPTIONS) @ gains + rng.normal(0, OPTIONS.noise, len(design.basis(p, OPTIONS)))
            for p in plans
        ]
        missed.append(rows @ (design.fit(plans, readings, OPTIONS) - gains))
    promised = design.uncertainty(design.information(plans, OPTIONS), rows)
    assert_allclose(np.sqrt(np.mean(np.square(missed))), promised, rtol=0.1)
