"""A name needs its textbook form: what goes with the right inputs in another form has none; order of ruling out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from errpipe.diagnosis import diagnose, hypotheses, judge, unnamed
from errpipe.diagnosis.holdout import HeldOut
from errpipe.diagnosis.search import Explanation
from errpipe.domain.recording import Recording

from .machines import axis, recording


def held(bare: float, textbook: float, named: float) -> HeldOut:
    return HeldOut("40 blocks of neighbouring rows in 5 groups", 3.0, named, 1.0, named, named, named, bare, textbook)


@pytest.mark.parametrize(
    ("textbook", "alone", "unsized", "departs"),
    [
        *((1.0, 0.2, False, False), (2.8, 0.2, False, True), (2.8, 0.9, False, False), (1.6, 0.2, False, False)),
        *((3.5, 0.2, False, True), (8.0, 0.2, False, False), (2.8, 0.9, True, True), (1.0, 0.9, True, False)),
    ],
)
def test_a_form_that_the_textbook_does_not_carry_is_not_its_name(monkeypatch, textbook, alone, unsized, departs):
    """Rows that sat out must be predicted by the departures, and the textbook form must do badly on its own as well,
    or have no significant size beside them.

    One that does far worse than no name was not determined by the rows that it was fitted on, and says nothing.
    """

    terms = (SimpleNamespace(form="textbook"),)
    explained, in_part = (
        SimpleNamespace(explanation=Explanation((SimpleNamespace(hypothesis=h),), np.zeros(1)))  # type: ignore[arg-type]
        for h in (SimpleNamespace(mask=m, terms=terms) for m in ((), ("range", "t", 0.0, 60.0)))
    )
    monkeypatch.setattr(unnamed, "textbook_alone", lambda case: alone)
    monkeypatch.setattr(unnamed.model, "fit_finding", lambda case, k: None)
    monkeypatch.setattr(unnamed.plausible, "is_insignificant", lambda made: unsized)
    assert unnamed.departures_predict_held_out(explained, held(3.0, textbook, 1.0)) == departs
    assert unnamed.departures_predict_held_out(in_part, held(3.0, textbook, 1.0)) == departs
    assert not unnamed.departures_predict_held_out(
        SimpleNamespace(explanation=Explanation((), np.zeros(0))), held(3.0, textbook, 1.0)
    )


def test_the_weakest_of_several_impossible_findings_is_ruled_out_first(monkeypatch):
    """Beside a loop's lag a dead time has nearly the same form: neither has a possible size while both are there."""
    out, left = [], [["lag", "dead time"], []]
    monkeypatch.setattr(judge, "_best_explanation", lambda *_: None)
    monkeypatch.setattr(judge.plausible, "impossible", lambda case: left.pop(0))
    monkeypatch.setattr(judge.plausible, "doubtful", lambda case: [])
    monkeypatch.setattr(judge, "_best_without", lambda made, m: out.append(m))
    judge._without_impossible(None, None)  # type: ignore[arg-type]
    assert out == ["dead time"]


def grown(form) -> Recording:
    """An axis that warms up, measured both ways; `form`: deviation (rows,) at positions and temperatures (rows,)."""
    rng, i = np.random.default_rng(3), np.arange(320)
    x = np.tile(np.r_[np.linspace(0, 900, 10), np.linspace(900, 0, 10)], 16)
    warm = 20 + 9 * (1 - np.exp(-i / 80.0)) + 2 * np.sin(i / 25)
    columns = {"t": 60.0 * i, "x": x, "T": warm, "E": form(x, warm) + 0.5 * rng.standard_normal(320), "S": 0.0 * x}
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "T": {"role": "temperature", "unit": "degC", "location": "scale"},
        "E": {"role": "error", "component": "EXX", "unit": "um"},
        "S": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    return recording(columns, kinds)


@pytest.mark.slow
def test_the_right_inputs_in_a_form_of_their_own_have_no_name():
    """A scale that buckles from 27 degC on goes with temperature and place, but does not expand in proportion."""
    for form, named in (
        (lambda x, warm: 0.004 * (x - 450) * (warm - 20), True),
        (lambda x, warm: 0.02 * (x - 450) * np.clip(warm - 27, 0, None) * np.sin(x / 140), False),
    ):
        (response,) = diagnose(grown(form))[0].responses
        first = response.findings[0]
        assert (first.effect == "scale_expansion") == named
        assert (response.verdict == "unexplained") != named
        assert named or "no effect of the vocabulary" in first.says
        assert {"x", "T"} <= {driver for f in response.findings for driver in f.drivers}
        assert named or all(f.confidence < 0.5 for f in response.findings[1:] if f.effect != "recalibration")


def test_states_at_the_start_and_shapes_of_a_guideway_are_no_departures():
    """Of a lag the decay of what a body brought along is its own form, of a guideway every smooth curve."""
    made = axis()
    library = hypotheses.build(made, "EYX", np.arange(len(made)))
    sizes = zip(library.hypotheses, library.cores, library.places, strict=True)
    forms = {h.effect: (core, library.textbook(i), place.size) for i, (h, core, place) in enumerate(sizes)}
    core, own, every = forms["straightness"]
    assert core < own == every
    core, own, every = forms["ambient_drift"]
    assert own == core + library.starts < every
    core, own, every = forms["backlash"]
    assert own == core < every
