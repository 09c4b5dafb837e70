"""What a test cannot see, and the plan that sees everything."""

from __future__ import annotations

import numpy as np
import pytest
from machines import ready, volume_points

from errpipe.errors import DataError
from errpipe.kinematics import identify, measuring_program, observability, plan, protocols, synthesis
from errpipe.kinematics import observations as o
from errpipe.kinematics.chain import compile_chain
from errpipe.simulation import metrology


def cloud(chain, tools):
    q = volume_points(chain, [5, 5, 5])
    parts = [o.points(chain, q, chain.tip(length, offset), label=str(i)) for i, (length, offset) in enumerate(tools)]
    return o.concatenate(parts)


def test_one_tool_cannot_show_the_roll_of_the_last_axis():
    chain = ready("cmm")
    examination = observability.analyse(chain, cloud(chain, [(120.0, (0, 0, 0))]))
    assert examination.seen["ECZ"] < 0.05 < 0.9 < examination.seen["EXX"]
    assert any("ECZ" in u.components for u in examination.unobserved)
    assert examination.rank < examination.parameters


def test_three_tools_show_everything():
    chain = ready("cmm")
    examination = observability.analyse(
        chain, cloud(chain, [(80.0, (0, 0, 0)), (200.0, (0, 0, 0)), (120.0, (60.0, 40.0, 0))])
    )
    assert examination.unobserved == ()
    assert examination.rank == examination.parameters
    assert min(examination.seen.values()) > 0.9


def test_rank_of_constants_with_one_and_three_tools_at_the_papers_machine():
    """Were all 32 components constants, one tool would show 9 combinations and three tools and offsets T 14."""
    chain = ready("horizontal-centre-ni-1997")
    q = volume_points(chain, [4, 4, 4])
    one = synthesis.jacobian(chain, q)[:, :3].reshape(-1, 32)
    rows = []
    for length, shift in ((150.0, (0, 0, 0)), (250.0, (90.0, 0, 40)), (100.0, (0, 60.0, -30))):
        nose = tuple(float(a + b) for a, b in zip(chain.machine.spindle.position, shift, strict=True))
        spindle = chain.machine.spindle.model_copy(update={"position": nose})
        moved = compile_chain(chain.machine.model_copy(update={"spindle": spindle}))
        rows.append(synthesis.jacobian(moved, q, moved.tip(length))[:, :3].reshape(-1, 32))
    assert np.linalg.matrix_rank(one, tol=1e-9) == 9
    assert np.linalg.matrix_rank(np.vstack(rows), tol=1e-9) == 14


def test_the_smallest_extra_measurement_makes_the_roll_visible():
    chain = ready("cmm")
    extra = observability.smallest_extra(chain, cloud(chain, [(80.0, (0, 0, 0)), (200.0, (0, 0, 0))]))
    assert 1 <= len(extra) <= 4
    assert any("ECZ" in e.resolves for e in extra)


def test_a_level_is_offered_for_an_angle_that_circles_cannot_see():
    chain = ready("cmm")
    runs = metrology.circles(chain, chain.travel.mean(axis=1), 150.0, 120.0, 36)
    test = protocols.observations(chain, metrology.simulate_runs(chain, {}, "ballbar_circle", runs, 1))
    examination = observability.analyse(chain, test)
    assert examination.seen["ECX"] < 0.05
    extra = observability.smallest_extra(chain, test)
    assert any("along X, about C" in e.name for e in extra)


@pytest.mark.parametrize(
    "name", ["cmm", *(pytest.param(m, marks=pytest.mark.slow) for m in ("vertical-centre", "gantry"))]
)
def test_a_plan_shows_all_components(name):
    chain = ready(name)
    growth = tuple(c for c in chain.components if c[2:] == "S")
    equipment = plan.Equipment(reach=(150.0, 3500.0), tools=plan.default_tools(chain))
    proposed = plan.propose(chain, equipment=equipment, without=growth)
    assert proposed.open == ()
    assert proposed.minutes < 180


@pytest.fixture(scope="module")
def cmm_plan():
    return plan.propose(ready("cmm"))


def test_a_plan_is_a_program_that_stays_within_travel(cmm_plan):
    chain, proposed = ready("cmm"), cmm_plan
    text = measuring_program.program(proposed)
    assert text.startswith("%\n(measuring plan for cmm") and text.endswith("M2\n%\n")
    assert text.count("M0") >= 2 and text.count("G4 P") == sum(len(b.q) for b in proposed.blocks)
    for b in proposed.blocks:
        assert (b.q >= chain.travel[:, 0]).all() and (b.q <= chain.travel[:, 1]).all()
        span = np.linalg.norm(synthesis.ideal_pose(chain, b.q, chain.tip(b.length, b.offset))[:, 0] - b.socket, axis=1)
        assert (span >= proposed.equipment.reach[0]).all() and (span <= proposed.equipment.reach[1]).all()
    assert measuring_program.program(plan.propose(chain)) == text


def test_a_planned_test_identifies_the_machine(cmm_plan):
    chain = ready("cmm")
    values = metrology.smooth_machine(chain, 12)
    runs = [
        metrology.Run(str(i), b.q, b.length, b.offset, socket=np.array(b.socket)) for i, b in enumerate(cmm_plan.blocks)
    ]
    test = protocols.observations(chain, metrology.simulate_runs(chain, values, "telescoping_bar", runs, 3))
    fitted = identify.identify(identify.Parametrisation.of(chain), test)
    q = np.random.default_rng(0).uniform(chain.travel[:, 0], chain.travel[:, 1], (200, 3))
    truth = synthesis.exact(chain, q, metrology.components_at(chain, values, q))[:, :3]
    left = truth - fitted.predict(q)[0]
    assert np.sqrt(np.mean(left**2)) < 0.12 * np.sqrt(np.mean(truth**2))


def test_a_bar_too_short_is_refused():
    with pytest.raises(DataError, match="reaches no position"):
        plan.propose(ready("gantry"), equipment=plan.Equipment(reach=(1.0, 2.0)))
