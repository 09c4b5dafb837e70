"""The band drawn around a prediction is the interval whose coverage stands in the table beside it."""

import pytest

from errpipe.stages.report import _bands, _low_coverage, _scheme_in_words

FIGURES = {"component": "E_Z", "half_width90": 1.3, "groups": [{"label": "spring"}, {"label": "summer"}]}
SEASONS = {"component": "E_Z", "groups": [{"left_out": "summer", "half_width": 5.2}]}


def test_intervals_of_the_model_come_before_one_width_for_all() -> None:
    assert _bands({"seasons": SEASONS}, FIGURES) == {"spring": 1.3, "summer": 5.2}
    assert _bands({"seasons": SEASONS | {"component": "E_X"}}, FIGURES) == {"spring": 1.3, "summer": 1.3}
    assert _bands({}, FIGURES | {"half_width90": None}) == {}


def test_a_hold_out_is_named_by_its_group() -> None:
    assert _scheme_in_words("leave-one-group-out:season") == "leave-one-season-out"
    assert _scheme_in_words("leave-one-run-out") == "leave-one-run-out"
    assert _scheme_in_words("blocks:5") == "blocks:5"


@pytest.mark.parametrize(("coverage", "noted"), [(0.47, True), (0.86, False), (None, False)])
def test_a_group_of_which_the_interval_contains_too_little_is_noted(coverage, noted) -> None:
    notes = _low_coverage([{"label": "winter", "coverage90": coverage}, {"label": "spring", "coverage90": 0.93}])
    assert notes == ["The 90 % interval is too narrow in held-out groups: it contains 47 % of winter."] * noted
