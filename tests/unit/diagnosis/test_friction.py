"""Friction that differs by direction is reported, with the figures of each direction; one law for both is kept."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from errpipe.diagnosis import diagnose, friction, prepare
from errpipe.domain.diagnosis import Finding, FoundParameter

from .machines import trace


def both_ways(dry: tuple[float, float], damping: tuple[float, float]):
    """Drive force of an axis whose friction is (forwards, backwards)."""

    def force(c):
        ahead = c["v"] > 0
        return np.where(ahead, dry[0], -dry[1]) + 1e-3 * c["v"] * np.where(ahead, *damping)

    return force


def found(seed: int, **friction_):
    response = diagnose(trace(seed, hidden=both_ways(**friction_)))[0].responses[0]
    return response, {p.name: p for f in response.findings for p in f.parameters}


def test_each_way_gets_its_own_figures():
    response, output = found(0, dry=(18.0, 22.0), damping=(160.0, 236.0))
    assert response.findings[0].effect in ("coulomb_friction", "viscous_friction")
    for name, true in (("force_forward", 18.0), ("force_backward", 22.0)):
        assert output[name].unit == "N" and output[name].ci95[0] <= true <= output[name].ci95[1]
    assert any("Friction differs by direction" in f.says for f in response.findings)


def test_the_intervals_of_both_ways_cover():
    """12 seeds, 4 parameters each at 95 %: of 48 intervals at least 42 (chance of fewer: 1 %)."""
    inside = 0
    for seed in range(12):
        case = trace(seed, hidden=both_ways((18.0, 22.0), (160.0, 236.0)))
        (pair,), _ = prepare.pairs(case)
        law = friction.by_direction(SimpleNamespace(recording=prepare.condition(case), pair=pair))  # all that it needs
        for p, true in zip((*law.damping(), *law.force()), (160.0, 236.0, 18.0, 22.0), strict=True):
            inside += p.ci95[0] <= true <= p.ci95[1]
    assert inside >= 42


def test_one_law_both_ways_is_left_alone():
    response, output = found(1, dry=(20.0, 20.0), damping=(200.0, 200.0))
    assert {f.effect for f in response.findings} >= {"coulomb_friction", "viscous_friction"}
    assert not any("direction" in f.says for f in response.findings)
    assert not [name for name in output if name.endswith(("forward", "backward"))]


def test_a_damping_that_would_drive_the_axis_is_no_law_of_friction():
    for backward, is_law in ((236.0, True), (-90.0, False)):
        case = trace(2, hidden=both_ways((18.0, 22.0), (160.0, backward)))
        (pair,), _ = prepare.pairs(case)
        law = friction.by_direction(SimpleNamespace(recording=prepare.condition(case), pair=pair))
        assert (law is not None) == is_law


def test_only_a_stribeck_part_against_the_dry_friction_gives_way():
    def of(effect, name, value):
        parameter = FoundParameter(name=name, value=value, unit="N", ci95=(value - 1, value + 1))
        return Finding(effect=effect, confidence=0.8, parameters=(parameter,))

    law = friction.ByDirection(
        "X",
        "v",
        friction.Fitted(np.array([95.0, 160.0, 236.0, 20.0, 21.0]), np.eye(5), 2.2),
        friction.Fitted(np.ones(4), np.eye(4), 2.8),
    )
    dry = of("coulomb_friction", "force", 20.0)
    against = friction.with_directional_law([dry, of("stribeck_friction", "extra", -8.0)], law, set())
    assert [f.effect for f in against] == ["coulomb_friction", "viscous_friction"]
    assert [p.name for p in against[1].parameters] == ["damping_forward", "damping_backward"]
    adding = friction.with_directional_law([dry, of("stribeck_friction", "extra", 8.0)], law, set())
    assert [f.effect for f in adding] == ["coulomb_friction", "stribeck_friction"]
    slope = of("viscous_friction", "slope", 30.0)  # what the simulation's damping is off by, beside the damping itself
    (missing,) = friction.with_directional_law([slope], law, {"viscous_friction"})
    assert [p.name for p in missing.parameters] == ["slope", "damping_forward", "damping_backward"]
