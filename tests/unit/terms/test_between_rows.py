"""What drives an effect between two rows, and where a circle begins: the recording's rows are not all there is."""

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.terms.gravity_sag import GravitySag
from errpipe.terms.reversal_spike import ReversalSpike
from errpipe.terms.spindle_growth import SpindleGrowth
from errpipe.terms.thermal_lag import ThermalLag

KINDS = {
    "t": Column(role="time", unit="s"),
    "T": Column(role="temperature", unit="degC"),
    "rpm": Column(role="spindle_speed", unit="rpm"),
    "overhang": Column(role="overhang", unit="mm"),
    "E_D": Column(role="error", component="E_D", unit="um"),
}


def rows(t: np.ndarray, between: str) -> Recording:
    """A room that warms and cools in a day; the spindle starts after an hour."""
    columns = {"t": t, "T": 20 + 4 * np.sin(t / 9000), "rpm": 6000.0 * (t >= 3600), "overhang": 80 + 40 * (t > 7000)}
    frame = pd.DataFrame(columns | {"E_D": np.zeros(t.size)})
    return Recording(Manifest(recording=1, tables=("r.csv",), columns=KINDS), frame, between)


OFTEN = np.arange(0.0, 30001.0, 10.0)
SELDOM = np.r_[np.arange(0.0, 3600.0, 60.0), np.arange(9000.0, 30001.0, 1000.0)]


def test_a_temperature_interpolated_between_sparse_rows_is_followed_as_with_dense_rows():
    term = ThermalLag(sensor="T")
    often = term.basis(rows(OFTEN, "held"), 2000.0)[:, 0]
    wanted = np.interp(SELDOM, OFTEN, often)
    assert_allclose(term.basis(rows(SELDOM, "inferred"), 2000.0)[:, 0], wanted, atol=0.1)
    held = term.basis(rows(SELDOM, "held"), 2000.0)[:, 0]
    assert np.abs(held - wanted).max() > 0.8  # a value held over the pause is late by the pause


def test_a_speed_is_held_where_no_parts_are_made():
    term = SpindleGrowth(column="rpm", full_speed=6000.0)
    assert_allclose(term.basis(rows(SELDOM, "inferred"), 1800.0, 1.0), term.basis(rows(SELDOM, "held"), 1800.0, 1.0))


def test_an_overhanging_bar_may_sag_in_a_series_of_bores():
    (term,) = GravitySag.bind(rows(OFTEN, "held"), "E_D")
    assert term.column == "overhang"
    assert_allclose(term.basis(rows(OFTEN, "held"), 2.0)[[0, -1], 0], [(80 / 120) ** 2, 1.0])


def test_between_the_parts_of_a_series_the_spindle_rests():
    """Parts every 2 minutes and a pause of an hour: after it the spindle has cooled, and has run for one part."""
    t = np.r_[np.arange(0.0, 3601.0, 120.0), np.arange(7200.0, 9000.0, 120.0)]
    frame = pd.DataFrame({"t": t, "rpm": 6000.0, "cut": t / 100, "E_D": np.zeros(t.size)})
    columns = {n: KINDS[n] for n in ("t", "rpm", "E_D")} | {"cut": Column(role="cut_length", unit="m")}
    made = Recording(Manifest(recording=1, tables=("r.csv",), columns=columns), frame, "inferred")
    y = SpindleGrowth(column="rpm", full_speed=6000.0).basis(made, 1000.0, 1.0)[:, 0]
    before, after = y[30], y[31]
    assert_allclose(before, 1 - np.exp(-3.6), rtol=1e-9)
    assert_allclose(after, 1 + (before * np.exp(-3.48) - 1) * np.exp(-0.12), rtol=1e-9)


def circle(first: float) -> Recording:
    """Two turns of a circle of 50 mm that begin at the angle `first` (rad)."""
    t = np.arange(0.0, 8.0, 0.004)
    angle = first + 2 * np.pi * t / 4
    x, y = 50 * np.cos(angle), 50 * np.sin(angle)
    frame = pd.DataFrame({"t": t, "x": x, "y": y, "vx": -np.pi / 2 * y, "E_R": np.zeros(t.size)})
    columns = {
        "t": KINDS["t"],
        "x": Column(role="position", axis="X", unit="mm"),
        "y": Column(role="position", axis="Y", unit="mm"),
        "vx": Column(role="velocity", axis="X", unit="mm/s"),
        "E_R": Column(role="error", component="E_R", unit="um"),
    }
    return Recording(Manifest(recording=1, tables=("r.csv",), columns=columns), frame)


def test_a_circle_that_begins_where_an_axis_turns_may_begin_with_its_spike():
    plain, begun = ReversalSpike.bind(circle(0.01), "E_R")
    assert (plain.from_start, begun.from_start) == (False, True)
    spike = begun.basis(circle(0.01), 0.03)[:, 0]
    assert_allclose(spike[:20], np.exp(-0.004 * np.arange(20) / 0.03), atol=0.01)
    assert np.abs(plain.basis(circle(0.01), 0.03)[:490]).max() < 0.01
    (only,) = ReversalSpike.bind(circle(1.0), "E_R")  # the axis is under way
    assert not only.from_start
