"""The band drawn around a prediction is the interval whose coverage stands in the table beside it."""

from errpipe.stages.report import _bands, _scheme_in_words

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
