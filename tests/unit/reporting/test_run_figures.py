"""Figures of held-out rows: what they show, in order, without a line over a pause."""

from __future__ import annotations

import re
import warnings

import numpy as np

from errpipe.reporting import run_figures


def test_the_worst_group_comes_first_and_a_pause_breaks_the_line() -> None:
    time = np.tile(np.r_[np.arange(50.0), 5000.0 + np.arange(50.0)], 2)
    groups = ["day 1"] * 100 + ["day 2"] * 100
    deviation = np.sin(time / 30)
    predicted = deviation + np.r_[np.full(100, 0.1), np.full(100, 3.0)]
    widths = {"day 1": 0.25, "day 2": 4.0}
    text = run_figures.against_time(time, deviation, predicted, groups, widths, "E_Z", "um")
    assert text == run_figures.against_time(time, deviation, predicted, groups, widths, "E_Z", "um")
    titles = re.findall(r">left out: (day \d)<", text)
    assert titles == ["day 2", "day 1"] and "90 % band" in text
    strokes = [
        path.count("M ") for path in re.findall(r'<path d="([^"]*)" [^>]*stroke: #1f5fa8; stroke-width: 1.4', text)
    ]
    assert strokes[0] == 2, "one stroke on each side of the pause"


def test_a_plane_averages_readings_at_one_place() -> None:
    x, y = (g.ravel() for g in np.meshgrid(np.arange(4.0) * 100, np.arange(3.0) * 100))
    places = (np.tile(x, 2), np.tile(y, 2))
    values = np.r_[np.full(12, 4.0), np.full(12, 6.0)]
    text = run_figures.plane(places, ("X", "Y"), {"before": values, "after": 0.0 * values}, "um")
    assert "before: 5.1 um rms" in text and "after: 0 um rms" in text
    assert len(re.findall(r'<g clip-path="[^"]*">\s*<use [^>]*style="fill: #[^"]*"', text)) == 24, (
        "twelve places in two panels"
    )


def test_a_grid_shows_every_figure_and_marks_what_is_used() -> None:
    values = [[20.0, 10.0], [5.0, None], [4.0, 3.0], [0.5, 0.5]]
    rows = ["nothing", "rises", "mixture", "noise floor"]
    text = run_figures.grid(["every run", "winter"], rows, values, ["", "tie", "", ""], "mixture", "Competition")
    for said in (*rows, "every", "winter", "20", "–", "0.5", "tie"):
        assert f">{said}<" in text, said
    assert text == run_figures.grid(
        ["every run", "winter"], rows, values, ["", "tie", "", ""], "mixture", "Competition"
    )


def test_a_group_of_one_row_is_drawn_without_a_warning() -> None:
    """A run of five rows, left out row by row: numpy's warnings stood among what `run` said."""
    one = np.zeros(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "<svg" in run_figures.against_time(one, one, one, ["1"], {"1": 0.5}, "E_Z", "um")


def test_each_group_has_the_band_of_its_own_interval() -> None:
    """One width for all groups held 18 % of a season whose intervals were said to cover 100 %."""
    time = np.tile(np.arange(50.0), 2)
    groups, still = ["spring"] * 50 + ["summer"] * 50, np.zeros(100)
    draw = lambda widths: run_figures.against_time(time, still, still, groups, widths, "E_Z", "um")  # noqa: E731
    assert draw({"spring": 1.0, "summer": 5.0}) != draw({"spring": 1.0, "summer": 1.0})
    assert "90 % band" in draw({"spring": 1.0}) and "90 % band" not in draw({})
