"""A fold has fewer rows than the whole recording: a name brings less there, and is asked for less."""

from types import SimpleNamespace

import pytest

from errpipe.diagnosis.holdout import FIXED, _without_fold


def test_a_fold_asks_a_name_for_what_its_rows_can_bring():
    data = SimpleNamespace(n=100, hold_out=lambda fold: SimpleNamespace(n=80))
    known = dict.fromkeys(("library", "nuisance", "sigma", "prior", "rows"))
    search = SimpleNamespace(**known, data=data, threshold=10.0, threshold_more=12.0, weighed=True)
    part = _without_fold(search, 0)
    brought = 0.8 * (search.threshold + FIXED) - FIXED  # a log Bayes factor grows with the rows, less what is fixed
    assert part.threshold == pytest.approx(brought)
    assert search.threshold_more - part.threshold_more == pytest.approx(search.threshold - brought)
