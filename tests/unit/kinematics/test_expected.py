"""The posterior of what an identification leaves: probability of harm in all and axis by axis."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from machines import ready

from errpipe.kinematics import identify, observability, protocols, residual_error
from errpipe.simulation import measuring_runs, metrology


def played(machine: str, protocol: str, seed: int):
    """Identification and readings of one simulated test."""
    chain = ready(machine)
    values = metrology.smooth_machine(chain, seed)
    recording = metrology.simulate_runs(
        chain, values, protocol, measuring_runs.PROTOCOLS[protocol](chain), seed, noise=0.5
    )
    obs = protocols.observations(chain, recording)
    return identify.identify(identify.Parametrisation.of(chain, 12), obs), obs


def rms(field: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(field**2, axis=0))


@pytest.mark.parametrize("whole", [True, False], ids=["whole", "what carries over"])
def test_the_probability_is_what_draws_from_the_posterior_say(whole):
    """Monte Carlo of a weak test, all of it compensated and only a part, less the workpiece's pose."""
    solved, _ = played("vertical-centre", "diagonal", 2)
    chain = solved.model.chain
    judged, q = (
        residual_error.expected(solved),
        residual_error.mirrored_places(chain, residual_error.JUDGED, residual_error.JUDGED_SEED),
    )
    rng = np.random.default_rng(0)
    jac = residual_error.synthesis.jacobian(chain, q, None)[:, :3]
    rows = (jac[:, :, solved.model.prior.component] * solved.model.functions(q)[:, None, :]).reshape(3 * len(q), -1)
    pose = residual_error._pose_columns(chain, q, residual_error.synthesis.ideal_pose(chain, q)[:, 0].mean(axis=0))
    base, _ = np.linalg.qr(pose.reshape(-1, 6))
    rows = rows - base @ (base.T @ rows)
    true = rng.multivariate_normal(solved.mean, solved.covariance, 4000, method="eigh").T
    factor = 1.0 if whole else np.array([(judged.factors or {}).get(c, 1.0) for c in chain.components])
    used = (factor * np.ones(len(chain.components)))[solved.model.prior.component] * solved.mean
    part = rows @ used
    before, after = rows @ true, rows @ true - part[:, None]
    output = residual_error._expected(solved, used, rows, len(q))
    assert output.harm == pytest.approx((rms(after) > rms(before)).mean(), abs=0.02)
    assert output.left_rms_um == pytest.approx(np.sqrt(3.0 * np.mean(after**2)), rel=0.05)
    for axis, shown in judged.axes.items():
        own = np.arange("XYZ".index(axis), len(rows), 3)
        output = residual_error._expected(solved, used, rows[own])
        assert output.harm == pytest.approx((rms(after[own]) > rms(before[own])).mean(), abs=0.02), axis
        if not whole:
            assert (
                shown.harm == pytest.approx(output.harm, rel=1e-6, abs=1e-12)
                and shown.harm <= residual_error.MAX_HARM_PROBABILITY
            )


def two_components(*errors):
    """Identified as 10 and 8 um, with these standard errors; one of 0 um has none."""
    mean = np.where(np.array(errors) > 0.0, (10.0, 8.0), 0.0)
    prior, chain = SimpleNamespace(component=np.array([0, 1])), SimpleNamespace(components=("EXX", "EYX"))
    model = SimpleNamespace(prior=prior, chain=chain)
    return SimpleNamespace(model=model, mean=mean, covariance=np.diag(np.square(errors)), noise=0.1)


def test_components_are_reduced_to_the_least_residual_without_harm():
    """Beside all factors on a lattice: two axes that take the components with different arms, and both together."""
    solved = two_components(3.0, 1.0)
    axes = [np.array([[1.0, 0.3]]), np.array([[-0.2, 1.0]])]
    fields = [np.vstack(axes), *axes]
    left = {}
    for factors in np.stack(np.meshgrid(*[np.arange(101) / 100] * 2), axis=-1).reshape(-1, 2)[1:]:
        each = [residual_error._expected(solved, factors * solved.mean, rows) for rows in fields]
        if max(one.harm for one in each) <= residual_error.AIMED_HARM_PROBABILITY:
            left[tuple(factors)] = each[0].left_rms_um
    best = min(left, key=left.get)
    assert 0.0 < best[0] < best[1]  # the one that is less certain
    assert residual_error._factors(solved, fields) == pytest.approx(best, abs=0.0151)


@pytest.mark.parametrize("errors", [(1.0, 0.5), (1.3, 0.0)], ids=["certain", "one of 0 um"])
def test_what_is_certain_is_not_reduced(errors):
    assert residual_error._factors(two_components(*errors), [np.eye(2)]).tolist() == [1.0, 1.0]


def test_nothing_is_reduced_where_nothing_helps():
    """Even the least correction may harm: the gate refuses the whole one, with its figures."""
    assert residual_error._factors(two_components(20.0, 20.0), [np.eye(2)]).tolist() == [1.0, 1.0]


def test_what_no_reading_knows_of_counts_at_its_prior_spread():
    """One line read at the tool in a corner: the angles that it cannot tell may outweigh what is corrected."""
    chain = ready("vertical-centre")
    q = np.tile(chain.travel[:, 0], (17, 1))
    q[:, 0] = np.linspace(*chain.travel[0], 17)
    line = residual_error.synthesis.ideal_pose(chain, q)[:, 0] - residual_error.synthesis.ideal_pose(chain, q)[8, 0]
    obs = protocols.o.along(chain, q, chain.tip(), (1.0, 0.0, 0.0), line[:, 0] * 0.02)
    weak = residual_error.expected(identify.identify(identify.Parametrisation.of(chain), obs))
    rest = tuple(c for c in chain.components if c != "EXX")
    sure = residual_error.expected(identify.identify(identify.Parametrisation.of(chain, without=rest), obs))
    assert weak.axes["X"].harm > 1e-4 > 1e-6 > sure.axes["X"].harm


@pytest.mark.parametrize(
    "machine", ["five-axis-table-table", pytest.param("five-axis-head-head", marks=pytest.mark.slow)]
)
def test_measurements_are_proposed_next_to_a_bar_that_would_have_no_length(machine):
    """ISO 230-7 bars: a tool moved by 100 mm puts the ball into the socket at some poses."""
    solved, obs = played(machine, "rotary_ballbar", 1)
    chain = solved.model.chain
    offered = observability.candidates(chain, obs)
    shifted = [o for n, o in offered.items() if n.startswith("the same test with")]
    assert shifted and all(np.isfinite(o.weights).all() for o in shifted)
    assert all(np.isfinite(observability.information(observability.coarse(chain), o, 1.0)[0]).all() for o in shifted)
