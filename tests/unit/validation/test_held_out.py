import numpy as np
import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.models.terms import Terms
from errpipe.simulation import spindle_drift
from errpipe.validation.held_out import summarise_reasons
from tests.validation_document import held_out


@pytest.fixture(scope="module")
def drift():
    return spindle_drift.simulate(1)[0]


def spec(*terms, **more):
    return Terms.model_validate({"components": [{"component": "E_Z", "terms": list(terms)}], **more})


GOOD = ({"term": "offset"}, {"term": "thermal_drift", "sensor": "T_front"}, {"term": "thermal_lag", "sensor": "T_room"})


def with_response(recording, values):
    return Recording(recording.manifest, recording.frame.assign(E_Z=values))


def test_every_figure_is_given_with_the_uncompensated_one_and_the_noise_floor(drift):
    judged = held_out(drift, spec(*GOOD))
    figures = judged["components"][0]
    assert judged["scheme"] == "leave-one-run-out"
    assert figures["noise_floor"] == pytest.approx(0.7, rel=0.1)
    assert figures["rms_after"] < 0.1 * figures["rms_before"]
    assert [g["label"] for g in figures["groups"]] == ["w1", "w2", "w3", "p1", "p2", "s1", "s2", "s3"]
    squares = sum(g["rms_after"] ** 2 * g["rows"] for g in figures["groups"]) / figures["rows"]
    assert figures["rms_after"] == pytest.approx(np.sqrt(squares))
    for g in figures["groups"]:
        assert g["rms_after"] ** 2 == pytest.approx(g["bias_after"] ** 2 + g["scatter_after"] ** 2)


def test_doing_nothing_wins_on_noise(drift):
    noise = np.random.default_rng(0).normal(0, 1.0, len(drift))
    figures = held_out(with_response(drift, noise), spec(*GOOD))["components"][0]
    assert figures["verdict"] == "do nothing" and figures["gain"] == 0.0


def test_a_partial_gain_wins_where_the_model_overdoes_it(drift):
    """Runs whose slope is drawn anew around a small mean: applying all of the mean slope is no better than half."""
    rise = drift.array("T_front") - drift.array("T_room")
    slope = np.array([4.0, -2.0, 1.0, 3.0, -1.5, 2.0, -2.5, 1.0])[drift.run_codes()]
    bending = {"term": "gradient_bending", "first": "T_front", "second": "T_room"}
    figures = held_out(with_response(drift, slope * rise), spec(bending))
    gains = figures["components"][0]["rms_by_gain"]
    assert figures["components"][0]["gain"] < 1.0 and gains["1"] > min(gains.values())


def test_the_interval_covers_groups_it_has_not_seen(drift):
    figures = held_out(drift, spec(*GOOD))["components"][0]
    assert 0.8 < figures["coverage90"] <= 1.0


def test_an_overlap_is_refused(drift):
    everything = np.ones(len(drift), dtype=bool)
    with pytest.raises(DataError, match=r"hold-out mine: \d+ rows are both fitted and tested"):
        held_out(drift, spec(*GOOD), folds=[("mine", everything, everything)])


def test_nuisance_is_taken_from_both_sides_alike(drift):
    level = np.array([30.0, -20, 5, 60, -80, 12, 7, 1])[drift.run_codes()]
    shifted = with_response(drift, drift.array("E_Z") + level)
    terms = ({"term": "thermal_drift", "sensor": "T_front"}, {"term": "thermal_lag", "sensor": "T_room"})
    figures = held_out(shifted, spec(*terms, nuisance=[{"term": "run_offset"}]))["components"][0]
    assert figures["rms_before"] < 15  # without the datum it would be 40
    assert figures["rms_after"] < 1.2


def test_the_document_is_plain_json(drift):
    from errpipe import jsonfile

    assert jsonfile.dumps(held_out(drift, spec(*GOOD))) == jsonfile.dumps(held_out(drift, spec(*GOOD)))


def test_a_sensor_that_died_is_one_sentence() -> None:
    """Not one for every night since: that of a year of nights would bury all else."""
    why = "no judged row has a value (empty in all of them: screw)"
    said = summarise_reasons([f"hold-out night {n}: {why}" for n in range(45, 84)] + ["hold-out day 3: another"])
    assert said == [f"hold-out night 45 to night 83 (39): {why}", "hold-out day 3: another"]
