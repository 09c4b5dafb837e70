import numpy as np

from errpipe.models.terms import Terms
from errpipe.simulation import spindle_drift
from tests.validation_document import held_out


def test_a_spindle_at_rest_in_its_room_only_follows_the_room():
    day = spindle_drift.Day("still", "winter", 20.0, 0.0, ((120, 0),))
    recording, exact = spindle_drift.simulate(1, days=(day,))
    assert np.abs(exact).max() < 1e-9
    assert abs(recording.array("T_front") - 20.0).max() < 0.2


def test_growth_is_bounded_by_the_warmest_and_coldest_piece():
    recording, exact = spindle_drift.simulate(1)
    assert 10 < np.ptp(exact) < 80
    assert set(recording.frame["season"]) == {"winter", "spring", "summer"}


def test_a_season_left_out_is_predicted():
    recording, _ = spindle_drift.simulate(1)
    terms = [
        {"term": "offset"},
        {"term": "thermal_drift", "sensor": "T_front"},
        {"term": "thermal_drift", "sensor": "T_rear"},
        {"term": "thermal_lag", "sensor": "T_room"},
    ]
    spec = Terms.model_validate({"components": [{"component": "E_Z", "terms": terms}]})
    figures = held_out(recording, spec, "leave-one-group-out:season")["components"][0]
    assert figures["rms_before"] > 10 and figures["rms_after"] < 1.0


def test_equal_seeds_give_equal_rows():
    one, two = spindle_drift.simulate(3)[0].frame, spindle_drift.simulate(3)[0].frame
    assert one.equals(two)
