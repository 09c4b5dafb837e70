"""The figures of a diagnosis: time in seconds, each finding in one colour of its own with its label."""

from __future__ import annotations

import re

import numpy as np
import pytest

from errpipe.domain.diagnosis import Diagnosis, Finding, HoldOutFigures, ResponseDiagnosis
from errpipe.reporting.diagnosis_report import FINDINGS, Trace, _clock, render
from errpipe.reporting.svg import with_gaps

ROWS = 400


def response(*effects: str, drivers: tuple[str, ...] = ("x",)) -> ResponseDiagnosis:
    return ResponseDiagnosis(
        component="EXX",
        verdict="missing_physics",
        rms_before_um=5.0,
        rms_after_um=1.0,
        noise_floor_um=1.0,
        holdout=HoldOutFigures(scheme="", rms_before_um=5.0, rms_after_um=1.0),
        findings=tuple(Finding(effect=e, confidence=0.9, drivers=drivers) for e in effects),
    )


def trace(*effects: str, **more) -> Trace:
    rng = np.random.default_rng(0)
    x = np.linspace(0, 500, ROWS)
    inputs = {"when": np.arange(ROWS) * 2.0, "x": x}
    carried = {e: (k + 1.0) * np.sin(x / (40.0 + 20 * k)) for k, e in enumerate(effects)}
    before = sum(carried.values()) + rng.normal(0, 1, ROWS)
    output = {"contributions": carried, "inputs": inputs, "clock": "when", "units": {"x": "mm", "when": "s"}}
    return Trace(before, before - sum(carried.values()), np.zeros(ROWS, dtype=int), **(output | more))


def page(*effects: str) -> str:
    return render(Diagnosis(responses=(response(*effects),)), [trace(*effects)])


@pytest.mark.parametrize("count", [3, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))])
def test_each_finding_has_its_own_colour_and_label_in_both_figures(count: int) -> None:
    effects = ("one_effect", "another_effect", "unknown")[:count]
    figures = re.findall(r"<svg.*?</svg>", page(*effects), re.S)
    over_time = next(f for f in figures if "against time" in f)
    over_driver = next(f for f in figures if "against its driver" in f)
    for k, effect in enumerate(effects):
        name = "a shape without a name" if effect == "unknown" else effect.replace("_", " ")
        for figure in (over_time, over_driver):
            assert FINDINGS[k] in figure and f"{name}, " in figure and "um rms" in figure
    assert len(set(FINDINGS)) == len(FINDINGS)
    assert "when in s" in over_time and "x in mm" in over_driver


def test_time_is_seconds_whatever_the_column_is_called() -> None:
    label, x = _clock(trace("one"))
    assert label == "when in s" and x[-1] == 2.0 * (ROWS - 1)
    label, x = _clock(trace("one", clock=""))
    assert label == "row" and x[-1] == ROWS - 1


def test_runs_that_each_start_at_zero_stand_one_after_the_other() -> None:
    t = np.tile(np.arange(ROWS // 2) * 2.0, 2)
    label, x = _clock(trace("one", inputs={"when": t, "x": t}))
    assert label == "when in s, runs one after the other"
    assert np.all(np.diff(x) == 2.0)


def test_equal_input_gives_equal_bytes() -> None:
    assert page("one_effect") == page("one_effect")


def test_no_line_leads_from_one_run_to_the_next() -> None:
    """A pause of weeks was crossed by a straight line."""
    x, y = with_gaps(np.arange(5.0), np.arange(5.0) ** 2, np.array([0, 0, 1, 1, 2]))
    assert np.isnan(x).tolist() == [False, False, True, False, False, True, False]
    assert np.isnan(y).tolist() == np.isnan(x).tolist() and x[~np.isnan(x)].tolist() == [0, 1, 2, 3, 4]


def test_the_next_step_stands_before_the_figures() -> None:
    text = page("backlash")
    assert text.index('<div class="next">') < text.index('<div class="figures">')
