"""A machined part as observations: features beside paths gone through densely, set-up, weights, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from machines import ready

from errpipe.domain.recording import Column
from errpipe.errors import DataError
from errpipe.kinematics import held_out, identify, observability, protocols, synthesis
from errpipe.kinematics.errors import MachineErrors
from errpipe.simulation import measuring_runs, metrology

CHAIN = ready("vertical-centre")


def part(values, noise=1e-6, setup=0.0, seed=1):
    return metrology.simulate_runs(CHAIN, values, "part", measuring_runs.part(CHAIN), seed, noise=noise, setup=setup)


def said(obs, values):
    """What the rows read on a machine of known components."""
    errors = MachineErrors.of(CHAIN, values, 801)
    every = [np.einsum("nk,nk->n", w, synthesis.first_order(CHAIN, q, errors.at(q), obs.tip)) for q, w in obs.places()]
    return np.sum(every, axis=0)


@pytest.mark.parametrize("seed", [1, 2])
def test_every_feature_reads_what_its_path_was(seed):
    """No noise, no set-up: centres, offsets, normals and diameters of a machine with every error, signs and all."""
    values = metrology.smooth_machine(CHAIN, seed)
    obs = protocols.observations(CHAIN, part(values))
    np.testing.assert_allclose(said(obs, values), obs.value, atol=0.15)
    assert len(obs) == 2 * 54 + 54 + 2 * 54 + 27  # centres, offsets, normals, diameters


def test_a_machine_10_um_too_long_at_plus_x():
    """Deviation grows to +10 um over X: bores lie too far at +X, and milled ones are larger across X."""
    span = CHAIN.travel[CHAIN.axes.index("X"), 1]
    recording = part({"EXX": lambda x: 10.0 * np.asarray(x) / span})
    obs = protocols.observations(CHAIN, recording)
    np.testing.assert_allclose(said(obs, {"EXX": lambda x: 10.0 * np.asarray(x) / span}), obs.value, atol=0.01)
    x = recording.array("x")
    np.testing.assert_allclose(recording.array("E_X")[::4], 10.0 * x[::4] / span, atol=1e-4)
    np.testing.assert_allclose(recording.array("E_D")[2::4], 0.5 * 10.0 / span * 40.0, atol=1e-4)


def test_how_a_part_lay_and_how_warm_it_was_is_set_up():
    """A perfect machine: the readings, set-up solved for, are those of nothing."""
    obs = protocols.observations(CHAIN, part({}, noise=0.01, setup=300.0))
    assert np.abs(obs.value).max() > 50
    model = identify.Parametrisation.of(CHAIN)
    left = held_out._without_setup(model, obs, np.zeros(len(model.prior.names)), 0.01)
    assert np.abs(left).max() < 0.5


def test_an_uncertain_feature_counts_less():
    """One bore is 300 um off: with its uncertainty stated, the machine hardly follows; without, it does."""
    values = metrology.smooth_machine(CHAIN, 3)
    recording = part(values, noise=0.5, setup=50.0)
    wrong = recording.array("E_X").copy()
    wrong[20] += 300.0
    loose = recording.array("u_X").copy()
    loose[20] = 300.0
    model = identify.Parametrisation.of(CHAIN)
    where = recording.frame[["x", "y", "z"]].to_numpy()[20:21]
    clean = identify.identify(model, protocols.observations(CHAIN, recording)).predict(where)[0][0, 0]
    moved = []
    for u in (loose, recording.array("u_X")):
        obs = protocols.observations(CHAIN, recording.with_columns({"E_X": wrong, "u_X": u}, {}))
        moved.append(abs(identify.identify(model, obs).predict(where)[0][0, 0] - clean))
    assert moved[0] < 0.25 * moved[1] and moved[1] > 1.0


def test_normals_show_angles_that_centres_do_not():
    """What a part cannot see is named; with normals of its faces, less of it is."""
    recording = part({}, noise=0.5)
    every = observability.analyse(CHAIN, protocols.observations(CHAIN, recording))
    plain = recording.with_columns({}, {n: Column(role="ignore") for n in ("E_A", "E_B")})
    points = observability.analyse(CHAIN, protocols.observations(CHAIN, plain))
    assert every.unobserved and every.rank > points.rank
    assert all(every.seen[c] >= points.seen[c] - 1e-6 for c in every.seen)


def test_features_sit_out_whole():
    obs = protocols.observations(CHAIN, part({}, noise=0.5))
    group, labels = held_out.groups(CHAIN, obs)
    assert len(labels) == held_out.FEATURE_GROUPS
    feature = np.unique(obs.q, axis=0, return_inverse=True)[1].reshape(-1)
    assert all(len(set(group[feature == f])) == 1 for f in range(feature.max() + 1))


def test_what_is_missing_is_named():
    recording = part({}, noise=0.5)
    with pytest.raises(DataError, match="needs its feature's size"):
        protocols.observations(CHAIN, recording.with_columns({}, {"size": Column(role="ignore")}))
    tilted = recording.with_columns({"E_A": np.ones(len(recording))}, {})
    with pytest.raises(DataError, match="E_A is the turn of a face"):
        protocols.observations(CHAIN, tilted)
    with pytest.raises(DataError, match="uncertainty of a feature is not above 0"):
        protocols.observations(CHAIN, recording.with_columns({"u_X": np.zeros(len(recording))}, {}))
