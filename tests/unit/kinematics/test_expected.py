"""The posterior of what an identification leaves: probability of harm in all and axis by axis."""

from __future__ import annotations

import numpy as np
import pytest
from machines import ready

from errpipe.kinematics import identify, observability, protocols, remaining
from errpipe.simulation import measuring_runs, metrology


def played(machine: str, protocol: str, seed: int):
    """Identification and readings of one simulated test."""
    chain = ready(machine)
    values = metrology.smooth_machine(chain, seed)
    recording = metrology.record(chain, values, protocol, measuring_runs.PROTOCOLS[protocol](chain), seed, noise=0.5)
    obs = protocols.observations(chain, recording)
    return identify.identify(identify.Parametrisation.of(chain, 12), obs), obs


def test_the_probability_is_what_draws_from_the_posterior_say():
    """Monte Carlo of |e| > |m + e| for a weak test, less the workpiece's pose, beside the closed form."""
    solved, _ = played("vertical-centre", "diagonal", 2)
    chain = solved.model.chain
    judged, q = remaining.expected(solved), remaining.places(chain, remaining.JUDGED)
    rng = np.random.default_rng(0)
    jac = remaining.synthesis.jacobian(chain, q, None)[:, :3]
    rows = (jac[:, :, solved.model.prior.component] * solved.model.functions(q)[:, None, :]).reshape(3 * len(q), -1)
    pose = remaining._pose_columns(chain, q, None, remaining.synthesis.ideal_pose(chain, q)[:, 0].mean(axis=0))
    base, _ = np.linalg.qr(pose.reshape(-1, 6))
    rows = rows - base @ (base.T @ rows)
    mean = (rows @ solved.mean)[:, None]
    off = rows @ rng.multivariate_normal(np.zeros(len(solved.mean)), solved.covariance, 4000, method="eigh").T
    worse = np.linalg.norm(off, axis=0) > np.linalg.norm(mean + off, axis=0)
    assert judged.harm == pytest.approx(worse.mean(), abs=0.02)
    assert judged.left_rms_um == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=0)) / len(q)), rel=0.05)
    for axis, told in judged.axes.items():
        own = np.arange("XYZ".index(axis), len(rows), 3)
        worse = np.linalg.norm(off[own], axis=0) > np.linalg.norm(mean[own] + off[own], axis=0)
        assert told.harm == pytest.approx(worse.mean(), abs=0.02), axis


def test_what_no_reading_knows_of_counts_at_its_prior_spread():
    """One line read at the tool: the angles that it cannot tell may outweigh what is corrected."""
    chain = ready("vertical-centre")
    q = np.tile(chain.travel.mean(axis=1), (17, 1))
    q[:, 0] = np.linspace(*chain.travel[0], 17)
    line = remaining.synthesis.ideal_pose(chain, q)[:, 0] - remaining.synthesis.ideal_pose(chain, q)[8, 0]
    obs = protocols.o.along(chain, q, chain.tip(), (1.0, 0.0, 0.0), line[:, 0] * 0.02)
    weak = remaining.expected(identify.identify(identify.Parametrisation.of(chain), obs))
    rest = tuple(c for c in chain.components if c != "EXX")
    sure = remaining.expected(identify.identify(identify.Parametrisation.of(chain, without=rest), obs))
    assert weak.axes["X"].harm > 0.01 > 1e-6 > sure.axes["X"].harm


@pytest.mark.parametrize("machine", ["five-axis-table-table", "five-axis-head-head"])
def test_measurements_are_proposed_beside_a_bar_that_would_have_no_length(machine):
    """ISO 230-7 bars: a tool moved by 100 mm puts the ball into the socket at some poses."""
    solved, obs = played(machine, "rotary_ballbar", 1)
    chain = solved.model.chain
    offered = observability.candidates(chain, obs)
    shifted = [o for n, o in offered.items() if n.startswith("the same test with")]
    assert shifted and all(np.isfinite(o.weights).all() for o in shifted)
    assert all(np.isfinite(observability.information(observability.coarse(chain), o, 1.0)[0]).all() for o in shifted)
