"""Curves, waves, profile times driver, and datums: what is no effect but needed to say one."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.evaluation import drive
from errpipe.terms import _profiles as shapes
from errpipe.terms import plain
from errpipe.terms.chebyshev import Chebyshev
from errpipe.terms.harmonics import Harmonics
from errpipe.terms.offset import Offset
from errpipe.terms.profile_driver import ProfileDriver
from errpipe.terms.run_offset import RunOffset
from errpipe.terms.run_pose import RunPose
from errpipe.terms.smooth_curve import SmoothCurve


@pytest.fixture
def rows():
    n = 120
    frame = pd.DataFrame(
        {
            "run": np.repeat(["a", "b"], n // 2),
            "t": np.arange(n) * 60.0,
            "x": np.tile(np.linspace(0.0, 400.0, n // 2), 2),
            "y": np.linspace(-100.0, 100.0, n),
            "c": np.linspace(0.0, 360.0, n),
            "T": 20.0 + 5.0 * (1 - np.exp(-np.arange(n) / 30.0)),
            "dir": np.where(np.arange(n) % 20 < 10, 1.0, -1.0),
            "EXX": 0.0,
        }
    )
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "y": Column(role="position", axis="Y", unit="mm"),
        "c": Column(role="position", axis="C", unit="deg"),
        "T": Column(role="temperature", unit="degC"),
        "dir": Column(role="direction", axis="X"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    return Recording(Manifest(recording=1, tables=("r.csv",), columns=columns), frame)


LATE = {"input": "T", "reference": "first", "lag": True}
TERMS = [
    Offset(),
    Chebyshev(axis="X", degree=5),
    Chebyshev(axis="X", degree=3, lowest=0),
    SmoothCurve(axis="X", segments=12),
    SmoothCurve(axis="X", segments=12, line=False),
    Harmonics(axis="X", period=37.0, orders=(1, 3)),
    Harmonics(axis="X", search=(20.0, 60.0)),
    ProfileDriver(axis="X", profile=shapes.Line(origin=100.0), driver=({"input": "T", "reference": 20.0},)),
    ProfileDriver(axis="X", profile=shapes.Polynomial(degree=2), driver=(LATE, {"op": "direction", "axis": "X"})),
    ProfileDriver(driver=({"input": "T", "reference": 20.0, "power": 2.0},)),
    ProfileDriver(driver=(LATE, {"input": "T", "reference": 20.0})),
    ProfileDriver(axis="C", profile=shapes.Line(), driver=()),
]


def named(term):
    return f"{term.term}-{len(plain(term))}"


def values_of(term, seed=0):
    rng = np.random.default_rng(seed)
    out = {p.name: float(rng.normal()) for p in term.linear()}
    return out | {p.name: float(np.sqrt(p.bounds[0] * p.bounds[1])) for p in term.nonlinear()}


@pytest.mark.parametrize("term", TERMS, ids=named)
def test_lowered_form_says_the_same_as_the_term(term, rows):
    term = term.settled(rows)
    values = values_of(term)
    total = np.zeros(len(rows))
    for pair in term.lower(values):
        profile = 1.0 if pair.profile is None else pair.profile(rows.array({"X": "x", "C": "c"}[pair.axis]))
        total = total + profile * drive(pair.driver, rows)
    assert_allclose(total, term.value(rows, values), atol=1e-10)


@pytest.mark.parametrize("term", TERMS, ids=named)
def test_plain_data_give_the_term_back(term, rows):
    term = term.settled(rows)
    assert type(term).model_validate(plain(term)) == term


@pytest.mark.parametrize("term", TERMS, ids=named)
def test_no_parameters_no_deviation_and_one_column_per_parameter(term, rows):
    term = term.settled(rows)
    zero = {**values_of(term), **{p.name: 0.0 for p in term.linear()}}
    assert_allclose(term.value(rows, zero), 0.0, atol=0)
    assert term.basis(rows, *term.nonlinear_values(zero)).shape == (len(rows), len(term.linear()))


@pytest.mark.parametrize("term", [TERMS[6], TERMS[8], TERMS[10]], ids=named)
def test_a_basis_changes_smoothly_with_its_parameters(term, rows):
    term = term.settled(rows)
    at = [v for p, v in zip(term.nonlinear(), term.nonlinear_values(values_of(term)), strict=True)]
    for j, value in enumerate(at):
        slopes = []
        for step in (1e-7 * value, 1e-4 * value):
            up, down = [*at], [*at]
            up[j], down[j] = value + step, value - step
            slopes.append((term.basis(rows, *up) - term.basis(rows, *down)) / (2 * step))
        narrow, wide = slopes
        assert_allclose(narrow, wide, rtol=1e-3, atol=1e-6 * np.abs(wide).max())


def test_what_a_span_is_is_written_down_once(rows):
    settled = Chebyshev(axis="X").settled(rows)
    assert settled.span == (0.0, 400.0)
    part = rows.take(rows.array("x") < 200)
    assert settled.settled(part).span == (0.0, 400.0)


def test_curves_hold_their_end_values_beyond_the_span():
    for profile in (shapes.Polynomial(degree=4, span=(0.0, 100.0)), shapes.Curve(segments=8, span=(0.0, 100.0))):
        gains = np.linspace(1, 2, len(profile.names()))
        value = shapes.curve(profile, gains, rotary=False)
        assert_allclose(value(np.array([-50.0, 150.0])), value(np.array([0.0, 100.0])), rtol=1e-12)


def test_a_curve_leaves_the_level_out_and_the_line_on_request():
    x = np.linspace(0, 100, 300)
    for line, rank in ((True, 11), (False, 10)):
        profile = shapes.Curve(segments=8, line=line, span=(0.0, 100.0))
        basis = profile.basis(x)
        assert basis.shape[1] == len(profile.names()) == np.linalg.matrix_rank(basis) == rank - 1
        assert np.linalg.matrix_rank(np.column_stack([basis, np.ones(300)])) == rank
    straight = shapes.Curve(segments=8, span=(0.0, 100.0))
    slope = np.linalg.lstsq(np.column_stack([np.ones(300), straight.basis(x)]), x, rcond=None)[0][1:]
    assert slope @ straight.penalty() @ slope < 1e-12 * slope @ slope


def test_a_quadratic_is_a_quadratic():
    # T_2(u) = 2u^2 - 1 at u = -1, 0, 1
    profile = shapes.Polynomial(degree=2, lowest=2, span=(0.0, 10.0))
    assert_allclose(profile.basis(np.array([0.0, 5.0, 10.0]))[:, 0], [1.0, -1.0, 1.0])


def test_units_say_what_they_multiply():
    warm = {"input": "T", "reference": 20.0}
    assert ProfileDriver(axis="X", profile={"kind": "line"}, driver=(warm,)).linear()[0].unit == "um/m/K"
    assert ProfileDriver(driver=(warm, {"input": "n", "unit": "rpm"})).linear()[0].unit == "um/K/rpm"


def test_a_line_over_a_rotary_axis_counts_degrees(rows):
    term = ProfileDriver(axis="C", profile={"kind": "line"}).settled(rows)
    assert term.rotary and term.linear()[0].unit == "um/deg"
    assert_allclose(term.basis(rows)[:, 0], rows.array("c"))


def test_trial_periods_miss_none_over_the_travel(rows):
    term = Harmonics(axis="X", search=(5.0, 50.0)).settled(rows)
    steps = np.diff(1.0 / np.array(term.starts("period")))
    assert np.abs(steps).max() <= 0.26 / 400.0


def test_a_datum_per_run(rows):
    term = RunOffset().settled(rows)
    assert [p.name for p in term.linear()] == ["level_a", "level_b"]
    assert_allclose(term.basis(rows).sum(axis=1), 1.0)
    assert term.lower({}) is None and not term.compensable


def test_a_pose_turns_both_deviations(rows):
    term = RunPose().settled(rows)
    first, second = term.shared(rows, "E_X"), term.shared(rows, "E_Y")
    # 100 urad counter-clockwise: a point at x = 400 mm moves by +40 um along Y, one at y = 100 mm by -10 um along X
    turn = np.array([0, 0, 100.0, 0, 0, 100.0])
    assert (second @ turn)[np.argmax(rows.array("x"))] == pytest.approx(40.0)
    assert (first @ turn)[-1] == pytest.approx(-10.0)
