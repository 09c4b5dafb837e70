"""Waves of few targets and of rotary tables, beside what the simulation holds; wear where the clock starts anew."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.diagnosis import diagnose
from errpipe.terms._lines import at_targets, periods
from errpipe.terms._place import direction_of
from errpipe.terms.scale_error import ScaleError
from errpipe.terms.squareness import Squareness
from errpipe.terms.straightness import Straightness

from .machines import recording

TARGETS = np.array([0.0, 13, 31, 48, 58, 79, 92, 108, 127, 143, 157, 177, 190, 209, 226, 241, 257, 272, 291, 308, 320])


def positioning(places: np.ndarray, axis: str, unit: str, component: str, missing, held, **known):
    """Five runs there and back; the missing and the simulated deviation as functions of the position."""
    x = np.tile(np.r_[places, places[::-1]], 5)
    sim, run = held(x), np.repeat(np.arange(1, 6), 2 * places.size).astype(str)
    read = sim + missing(x) + 0.4 * np.random.default_rng(5).normal(size=x.size)
    columns = {"run": run, "t": 10.0 * np.arange(x.size), "p": x, "E": read, "S": sim}
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "p": {"role": "position", "axis": axis, "unit": unit},
        "E": {"role": "error", "component": component, "unit": "um" if unit == "mm" else "urad"},
        "S": {"role": "simulated", "component": component, "unit": "um" if unit == "mm" else "urad"},
    }
    constants = {axis: {"role": "axis", "kind": "linear" if unit == "mm" else "rotary", "unit": unit} | known}
    return diagnose(recording(columns, kinds, constants))[0].responses[0]


@pytest.mark.parametrize("period", [190.0, 97.0, 23.0])  # of targets 16 mm apart: the last one falls between them
def test_a_wave_of_few_targets_is_named(period):
    said = positioning(
        TARGETS, "X", "mm", "EXX", lambda x: 2 * np.sin(2 * np.pi * x / period + 1), lambda x: 0.02 * x
    )  # fmt: skip
    by_name = {p.name: p.value for p in said.findings[0].parameters}
    assert said.findings[0].effect == "pitch_cyclic" and said.findings[0].confidence > 0.6
    assert 320 / by_name["period"] == pytest.approx(320 / period, abs=0.1)
    assert by_name["amplitude"] == pytest.approx(2.0, rel=0.15)


def test_a_wave_with_the_lead_that_is_no_sine_is_named_by_its_lead():
    """As the second multiple of a wave of two leads it would be a departure from that, and `unknown`."""
    places = 9.5 * np.arange(43) + np.random.default_rng(7).uniform(-4, 4, 43)  # nearer than two to a turn
    said = positioning(
        places, "X", "mm", "EXX", lambda x: 3 * np.sin(0.2 * np.pi * x) + 1.5 * np.sin(0.4 * np.pi * x + 1),
        lambda x: 0.02 * x, screw_lead=10.0,
    )  # fmt: skip
    assert said.findings[0].effect == "pitch_cyclic" and said.findings[0].confidence > 0.8
    by_name = {p.name: p.value for p in said.findings[0].parameters}
    assert by_name["amplitude"] == pytest.approx(3.0, rel=0.1) and by_name.get("period", 10.0) == pytest.approx(10.0)


def test_a_wave_of_three_turns_that_is_no_sine_is_one_finding():
    """At few targets, too, its multiples are orders of it and no departure from it, which would be `unknown`."""

    def wave(x):
        a = 2 * np.pi * x / 110.0
        return 2 * np.sin(a + 1) + 1.1 * np.sin(2 * a) + 0.4 * np.sin(3 * a + 2)

    said = positioning(TARGETS, "X", "mm", "EXX", wave, lambda x: 0.02 * x)
    first, by_name = said.findings[0], {p.name: p.value for p in said.findings[0].parameters}
    assert first.effect == "pitch_cyclic" and first.confidence > 0.8
    assert by_name["period"] == pytest.approx(110.0, rel=0.03)
    assert np.hypot(by_name["sine_2"], by_name["cosine_2"]) == pytest.approx(1.1, rel=0.15)


@pytest.mark.parametrize(
    "smooth",
    [
        pytest.param(lambda x: 3 * np.sin(1.6 * np.pi * x / 320), id="0.8 turns"),
        pytest.param(lambda x: 4 * ((x / 160 - 1) ** 2 - 1) ** 2, id="sag"),
        pytest.param(lambda x: 4 * np.tanh((x - 250.0) / 40.0), id="step near an end"),
        pytest.param(lambda x: 6 * np.exp(-x / 100.0), id="decay from an end"),
    ],
)
def test_a_smooth_curve_over_the_whole_travel_is_neither_a_wave_nor_a_worn_stretch(smooth):
    """They fit it best at the end of what is searched, or beyond."""
    said = positioning(TARGETS, "X", "mm", "EXX", smooth, lambda x: 0.02 * x)
    likely = [f.effect for f in said.findings if f.confidence > 0.5]
    assert not {"pitch_cyclic", "local_wear"} & {*likely}


def test_no_wave_of_fewer_turns_than_are_searched_is_estimated():
    """Its neighbours an eighth of a turn apart, and the best point between two of them, included."""
    few = np.linspace(0.0, 320.0, 21)
    for at in (few, np.linspace(0.0, 320.0, 200)):
        found = periods(at, (np.sin(2 * np.pi * at / 280.0),))
        assert found and max(found) <= 320 / 1.25 * (1 + 1e-9)


def test_a_wave_with_another_one_that_the_simulation_holds():
    """The simulation knows that the disc is off centre; that it is oval, too, is another wave and no gain of it."""
    turn = np.pi / 180
    said = positioning(
        np.arange(0.0, 361, 15), "C", "deg", "ECC", lambda c: 1.5 * np.cos(2 * turn * c + 0.4),
        lambda c: 15 * np.cos(turn * c + 1),
    )  # fmt: skip
    assert said.findings[0].effect == "pitch_cyclic" and said.holdout.rms_after_um < 0.5
    assert {p.name: p.value for p in said.findings[0].parameters}["period"] == pytest.approx(180.0)


@pytest.mark.parametrize("reach", [360.0, 270.0])
def test_two_orders_of_a_turn_are_one_wave_and_no_scale(reach):
    """A disc off centre and oval, of a table that need not make its whole turn."""
    turn = np.pi / 180
    said = positioning(
        np.arange(0.0, reach + 1, 10), "C", "deg", "ECC",
        lambda c: 10 * np.sin(turn * c + 0.7) + 5 * np.sin(2 * turn * c + 0.3), lambda c: 0.0 * c,
    )  # fmt: skip
    assert said.findings[0].effect == "pitch_cyclic" and said.findings[0].confidence > 0.8
    assert {p.name: p.value for p in said.findings[0].parameters}["period"] == pytest.approx(360.0)


@pytest.mark.slow
@pytest.mark.parametrize("turns", [6.3, 9.1])
def test_a_wave_of_one_pass_of_75_places_is_no_noise(turns):
    """Nor does what departs from its textbook form, which fits nothing here, make it dearer than noise that swings."""
    rng = np.random.default_rng(7)
    x = np.linspace(0, 200, 75) + rng.uniform(-0.8, 0.8, 75)
    known = 0.3 * np.sin(x / 60)
    columns = {"p": x, "S": known, "E": known + 2 * np.sin(2 * np.pi * turns * x / 200) + 0.7 * rng.normal(size=75)}
    kinds = {"p": {"role": "position", "axis": "X", "unit": "mm"}}
    kinds |= {n: {"role": r, "component": "EXX", "unit": "um"} for n, r in (("E", "error"), ("S", "simulated"))}
    axis = {"X": {"role": "axis", "kind": "linear", "unit": "mm"}}
    first = diagnose(recording(columns, kinds, axis))[0].responses[0].findings[0]
    assert first.effect == "pitch_cyclic"
    assert {p.name: p.value for p in first.parameters}["period"] == pytest.approx(200 / turns, rel=0.03)


def one_pass(component: str, unit: str, hidden, constants: dict | None = None, passes: int = 1, **more):
    """Passes of one axis one way, 0.2 s a row, with the deviation `hidden` of (position, temperature); the simulation
    holds nothing."""
    rng, count = np.random.default_rng(4), 240
    x = np.tile(np.linspace(0, 100, count), passes)
    t = 0.2 * np.arange(x.size)
    warm = 20 + 6 * (1 - np.exp(-t / 15)) + 0.5 * np.sin(t / 4) + 0.003 * rng.normal(size=x.size)
    columns = {"run": np.repeat(np.arange(passes), count).astype(str), "t": t, "p": x, "T": warm}
    columns["E"] = hidden(x, warm) + 0.3 * rng.normal(size=x.size)
    columns["S"] = 0 * x
    error = {"component": component, "unit": "urad" if unit == "deg" else "um"}
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "p": {"role": "position", "axis": component[2], "unit": unit},
        "T": {"role": "temperature", "unit": "degC", "location": "scale"},
        "E": {"role": "error", **error},
        "S": {"role": "simulated", **error},
    }
    return diagnose(recording(columns, kinds, constants))[0].responses[0].findings[0]


def test_a_straightness_that_goes_with_the_position_is_a_squareness():
    assert one_pass("EYX", "mm", lambda x, warm: 0.05 * x).effect == "squareness"


def test_a_straightness_with_a_wave_has_one():
    assert one_pass("EYX", "mm", lambda x, warm: 2 * np.sin(2 * np.pi * x / 7)).effect == "pitch_cyclic"


def test_passes_one_way_have_no_sides():
    """The returns between them are not recorded: what depends on the side is then what depends on the place."""
    assert one_pass("EXX", "mm", lambda x, warm: 0.05 * x, passes=3).effect == "scale_error"


def test_an_axis_in_degrees_turns_where_no_constant_says_so():
    one_pass_fit = one_pass("ECC", "deg", lambda x, warm: 5 * np.sin(2 * np.pi * x / 9))
    assert {p.name: p.unit for p in one_pass_fit.parameters}["period"] == "deg"


def test_an_expansion_within_a_minute_is_one():
    """Its departures, usual delays of minutes, must not take the place of the textbook form."""
    one_pass_fit = one_pass("EXX", "mm", lambda x, warm: 20e-3 * x * (warm - 20))
    assert one_pass_fit.effect == "scale_expansion" and one_pass_fit.confidence > 0.7
    low, high = one_pass_fit.parameters[0].ci95
    assert low < 20 < high and high - low < 20


def test_wear_is_no_drift_where_the_clock_starts_anew_with_each_tool():
    each, tools = np.arange(0.0, 60), 8
    t, tool = np.tile(each, tools), np.repeat(np.arange(tools), each.size).astype(str)
    force = 500 + 0.8 * t + 2 * np.random.default_rng(2).normal(size=t.size)
    columns = {"run": tool, "t": t, "cut": 3 * t, "F_Y": force, "F_sim": 0 * t + 500}
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "cut": {"role": "cut_length", "unit": "m"},
        "F_Y": {"role": "error", "component": "F_Y", "unit": "N"},
        "F_sim": {"role": "simulated", "component": "F_Y", "unit": "N"},
    }
    first = diagnose(recording(columns, kinds))[0].responses[0].findings[0]
    assert first.effect == "tool_wear" and "sensor_drift" in first.indistinguishable_from


def test_a_slope_at_even_places_is_no_wave_about_as_long_as_their_step():
    x = np.tile(np.linspace(-290, 290, 30), 4)
    bow = np.sin(3.1 * (x + 300) / 600) + 0.01 * np.random.default_rng(1).normal(size=x.size)
    assert not [p for p in periods(x, (bow,)) if abs(1 / p - 1 / 20) * 580 < 1 or abs(1 / p - 1 / 10) * 580 < 1]


@pytest.mark.parametrize(("places", "order"), [(2, None), (3, 2), (4, 3), (9, 4)])
def test_a_bow_has_as_many_degrees_as_its_places_determine(places, order):
    x = np.tile(np.linspace(0, 900, places), 3)
    kinds = {"x": {"role": "position", "axis": "X", "unit": "mm"}}
    bound = list(Straightness.bind(recording({"x": x}, kinds), "E_Y"))
    assert [term.order for term in bound] == ([] if order is None else [order])
    for term in bound:
        assert (
            np.linalg.matrix_rank(np.column_stack([np.ones(x.size), x, term.basis(recording({"x": x}, kinds))]))
            == order + 1
        )


def test_rows_of_one_target_are_one_place_wherever_the_axis_really_stood():
    rng, targets = np.random.default_rng(3), np.tile(np.linspace(22, 978, 25), 10)
    at = targets + 1e-3 * rng.normal(size=targets.size)
    wave = np.sin(2 * np.pi * targets / 149) + 0.1 * rng.normal(size=targets.size)
    assert all(140 < p < 160 for p in periods(at, (wave,)))
    assert np.unique(at_targets(at)).size == 25
    scanned = np.concatenate([90.0 * k + np.linspace(0, 10, 41) for k in range(5)])
    assert np.array_equal(at_targets(scanned), scanned)


@pytest.mark.parametrize(("axis", "component"), [("U", "EXU"), ("V", "EYV"), ("R", "EZR")])
def test_the_positioning_of_an_axis_parallel_to_another_is_its_own(axis, component):
    """ISO 841: U runs along X, so EXU is how far U goes, and no straightness."""
    made = recording({"u": np.linspace(0, 900, 31)}, {"u": {"role": "position", "axis": axis, "unit": "mm"}})
    assert [term.axis for term in ScaleError.bind(made, component)] == [axis]
    assert not list(Straightness.bind(made, component)) and not list(Squareness.bind(made, component))
    assert list(Straightness.bind(made, f"E{'Y' if component[1] == 'X' else 'X'}{axis}"))
    assert [direction_of(c) for c in ("EXX", "EYX", "ECC", "E_R", "E_D", "F_X")] == ["X", "Y", None, None, None, None]
