import hashlib

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.recording import Recording
from errpipe.fitting.model import fit
from errpipe.models.terms import Terms
from errpipe.simulation import ball_screw_axis, folder, heat
from tests.validation_document import held_out


@pytest.fixture(scope="module")
def simulated():
    return ball_screw_axis.simulate(1)


def test_a_uniformly_warm_screw_grows_by_alpha_l_dt():
    theta = np.full((3, heat.PIECES), 30.0)
    # 11.5 um/m/K x 10 K x 0, 0.45, 0.9 m
    assert_allclose(heat.growth(heat.Screw(), theta, np.array([0.0, 450.0, 900.0])), [0.0, 51.75, 103.5])


def test_an_axis_at_rest_in_a_steady_room_stays_as_it_is():
    still = np.zeros(500)
    warm = heat.simulate_temperatures(heat.Screw(), still, still, still + 10.0, np.full(500, 20.0), 20.0)
    assert_allclose(warm.screw, 20.0, atol=1e-12)
    assert_allclose(warm.nut, 20.0, atol=1e-12)


def test_heat_stays_where_the_nut_runs():
    steps = 900
    low, high = np.full(steps, 100.0), np.full(steps, 250.0)
    warm = heat.simulate_temperatures(heat.Screw(), np.full(steps, 200.0), low, high, np.full(steps, 20.0), 20.0)
    rise = warm.screw[-1] - 20.0
    middle = (np.arange(heat.PIECES) + 0.5) * 900.0 / heat.PIECES
    assert rise[(middle > 100) & (middle < 250)].min() > 4 * rise[middle > 600].max()


def test_a_piece_cools_by_its_own_time_constant():
    """Closed form for a screw without neighbours: rho c d / (4 h)."""
    screw = heat.Screw(conductivity=0.0)
    still = np.zeros(1800)
    air = np.full(1800, 20.0)
    warm = heat.simulate_temperatures(screw, still, still + 860.0, still + 860.0, air, 30.0)
    tau = screw.heat_capacity * screw.diameter * 1e-3 / (4 * screw.still_air)
    assert_allclose(warm.screw[:, 10] - 20.0, 10.0 * np.exp(-warm.time / tau), rtol=2e-3)


def test_nine_states_both_directions_three_cycles(simulated):
    measured = simulated.recording.frame.dropna(subset="EXX")
    assert measured["run"].nunique() == 9
    assert (measured.groupby(["run", "dir"]).size() == 75).all()
    assert measured["x"].between(0, 800).all()
    assert (simulated.recording.frame["t"].diff().dropna() >= 0).all()


def test_logs_between_the_runs_measure_nothing(simulated):
    frame = simulated.recording.frame
    assert frame.loc[frame["run"].str.startswith("log"), "EXX"].isna().all()


def test_equal_seeds_give_equal_bytes_and_others_do_not(tmp_path, simulated):
    sums = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        folder.write(tmp_path / name, ball_screw_axis.simulate(seed).recording)
        sums.append(
            [
                hashlib.sha256((tmp_path / name / f).read_bytes()).hexdigest()
                for f in ("recording.csv", "recording.yaml")
            ]
        )
    assert sums[0] == sums[1] and sums[0][0] != sums[2][0]
    assert folder.write(tmp_path / "a", simulated.recording) is False


def test_the_folder_is_a_recording_that_can_be_read(tmp_path, simulated):
    from errpipe.formats import manifest_folder

    folder.write(tmp_path, simulated.recording)
    back = manifest_folder.read(tmp_path)
    pd.testing.assert_frame_equal(back.frame, simulated.recording.frame, check_dtype=False)
    assert back.manifest.axis("X").screw_lead == 10.0


DEMO = Terms.model_validate(
    {
        "components": [
            {
                "component": "EXX",
                "terms": [
                    {"term": "offset"},
                    {"term": "chebyshev", "axis": "X", "degree": 6},
                    {"term": "harmonics", "axis": "X", "period": 10.0, "orders": [1, 2]},
                    {"term": "backlash", "axis": "X"},
                    {"term": "thermal_drift", "sensor": "T_bearing"},
                    {"term": "thermal_lag", "sensor": "T_nut", "along": "X"},
                    {"term": "scale_expansion", "axis": "X", "sensor": "T_nut"},
                ],
            }
        ]
    }
)


@pytest.mark.slow
def test_terms_reach_the_noise_of_an_axis_that_is_not_made_of_them():
    """The axis conducts heat, the model knows a lag: held-out residual within 1.1 of the noise (median of 3 seeds)."""
    ratios = []
    for seed in range(1, 4):
        axis = ball_screw_axis.simulate(seed)
        figures = held_out(axis.recording, DEMO)["components"][0]
        assert figures["verdict"] == "model" and figures["rms_before"] > 25
        ratios.append(figures["rms_after"] / np.nanstd(axis.noise))
    assert np.median(ratios) < 1.1 and max(ratios) < 1.15


TRUTH = (
    {"level": 8.0},
    {"c1": 5.0, "c2": -2.0, "c3": 0.5, "c4": -0.3},
    {"sin1": 1.2, "cos1": 0.8},
    {"lost_motion": 6.0},
    {"gain": 0.8},
    {"gain": 10.0, "tau": 900.0},
    {"slope": -2.0},
)


def known_axis(**more):
    terms = [
        {"term": "offset"},
        {"term": "chebyshev", "axis": "X", "degree": 4, "span": [0.0, 800.0]},
        {"term": "harmonics", "axis": "X", "period": 10.0},
        {"term": "backlash", "axis": "X"},
        {"term": "thermal_drift", "sensor": "T_bearing"},
        {"term": "thermal_lag", "sensor": "T_nut", "along": "X"},
        {
            "term": "profile_driver",
            "axis": "X",
            "profile": {"kind": "line"},
            "driver": [{"input": "T_air", "reference": 20.0}],
        },
    ]
    return Terms.model_validate({"components": [{"component": "EXX", "terms": terms}], **more})


def drawn_from(recording, spec, memory, seed):
    """The recording with the sum of the terms and noise as its response (a share `memory` is correlated by 0.8)."""
    parts = zip(spec.components[0].terms, TRUTH, strict=True)
    exact = sum((term.value(recording, values) for term, values in parts), np.zeros(len(recording)))
    truth = ball_screw_axis.Truth(noise=0.8, noise_memory=memory)
    noise = ball_screw_axis._noise(np.random.default_rng(seed), recording.run_codes(), truth)
    measured = np.where(np.isfinite(recording.array("EXX")), exact + noise, np.nan)
    return Recording(recording.manifest, recording.frame.assign(EXX=measured))


def hits(recording, spec, seeds, memory, outliers=0.0):
    """For every seed and parameter: does the 95 % interval hold the truth?"""
    out = []
    for seed in range(seeds):
        drawn = drawn_from(recording, spec, memory, seed)
        if outliers:
            rng = np.random.default_rng(seed + 1000)
            y = drawn.array("EXX") + (rng.random(len(drawn)) < outliers) * rng.uniform(-30, 30, len(drawn))
            drawn = type(drawn)(drawn.manifest, drawn.frame.assign(EXX=y))
        model = fit(drawn, spec, calibrate=False)
        out.append(
            [
                p.ci95[0] <= truth[p.name] <= p.ci95[1]
                for fitted, truth in zip(model.components[0].terms, TRUTH, strict=True)
                for p in fitted.parameters
            ]
        )
    return np.array(out)


def test_true_parameters_lie_in_their_intervals(simulated):
    assert 0.90 < hits(simulated.recording, known_axis(), 20, 0.2).mean() <= 0.995


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "memory", "outliers"), [("linear", 0.2, 0.0), ("linear", 0.8, 0.0), ("robust", 0.2, 0.01)]
)
def test_true_parameters_lie_in_their_intervals_in_about_95_of_100_seeds(simulated, method, memory, outliers):
    counted = hits(simulated.recording, known_axis(method=method), 100, memory, outliers)
    assert 0.93 <= counted.mean() <= 0.975
    assert counted.mean(axis=0).min() >= 0.88  # a fair 95 % interval falls below 88 of 100 once in 400 parameters


def test_held_out_residual_is_the_noise_put_in(simulated):
    spec = known_axis()
    drawn = drawn_from(simulated.recording, spec, 0.2, 4)
    figures = held_out(drawn, spec)["components"][0]
    assert figures["rms_after"] < 1.1 * 0.8
    assert 0.85 < figures["coverage90"] < 0.95
