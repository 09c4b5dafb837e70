"""What belongs to the form of a term and is no departure: where an angle or a temperature is counted from."""

import numpy as np
import pytest

from errpipe.diagnosis import hypotheses
from errpipe.drivers.evaluation import drive
from errpipe.terms.angular_abbe import AngularAbbe
from errpipe.terms.coolant_effect import CoolantEffect
from errpipe.terms.feed_heating import FeedHeating
from errpipe.terms.gravity_sag import GravitySag
from errpipe.terms.reversal_spike import ReversalSpike
from errpipe.terms.scale_expansion import ScaleExpansion
from errpipe.terms.thermal_interaction import ThermalInteraction
from tests.unit.diagnosis.machines import recording


def wet(reference: float):
    """A spindle nose that follows the coolant while it flows, counted from a temperature that is not measured."""
    t, rng = 60.0 * np.arange(600), np.random.default_rng(1)
    flow = np.repeat(rng.integers(0, 2, 60), 10).astype(float)
    coolant = 21.0 + 1.5 * np.sin(t / 9000)
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "flow": {"role": "coolant"},
        "T_c": {"role": "temperature", "unit": "degC", "location": "coolant tank"},
    }
    made = recording({"t": t, "flow": flow, "T_c": coolant}, kinds)
    return made, 3.0 * flow * (coolant - reference)


@pytest.mark.parametrize("reference", [20.0, 23.5])
def test_the_temperature_that_coolant_is_compared_with_need_not_be_known(reference):
    made, hidden = wet(reference)
    term = CoolantEffect(flow="flow", sensor="T_c", at_once=True)
    b, *_ = np.linalg.lstsq(term.basis(made), hidden, rcond=None)
    assert dict(zip((p.name for p in term.linear()), b, strict=True)) == pytest.approx(
        {"gain": 3.0, "shift": 3.0 * (20.0 - reference)}, abs=1e-9
    )


def test_the_compiled_form_holds_both_parameters_of_coolant():
    made, _ = wet(23.5)
    term = CoolantEffect(flow="flow", sensor="T_c")
    known = {"gain": 3.0, "shift": -10.5, "tau": 300.0}
    compiled = sum(drive(pair.driver, made) for pair in term.lower(known))
    np.testing.assert_allclose(compiled, term.value(made, known), rtol=1e-12, atol=1e-12)


def test_an_angle_may_be_zero_at_one_end():
    """Counted from there it holds a squareness, which is no second effect."""
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 600, (2, 300))
    kinds = {n: {"role": "position", "axis": n.upper(), "unit": "mm"} for n in "xy"}
    made = recording({"x": x, "y": y}, kinds)
    term = AngularAbbe(axis="X", lever="y", low=0.0, high=600.0)
    base = term.basis(made)
    hidden = 30.0 * (x / 600.0) * y * 1e-3
    columns, freedoms = zip(*term.slack(made, base), strict=True)
    strong = [c for c, f in zip(columns, freedoms, strict=True) if f >= 1.0]
    design = np.column_stack([base, *strong])
    left = hidden - design @ np.linalg.lstsq(design, hidden, rcond=None)[0]
    assert np.std(left) < 1e-9 * np.std(hidden)


def test_an_angle_has_no_more_degrees_than_its_places_determine_with_one_to_spare():
    """Four places left out one after the other do not tell a third degree from the other two."""
    for places, order in ((3, 1), (4, 2), (9, 3)):
        x, y = (v.ravel() for v in np.meshgrid(np.linspace(0, 600, places), np.linspace(0, 300, 20)))
        kinds = {n: {"role": "position", "axis": n.upper(), "unit": "mm"} for n in "xy"}
        (term, *_) = AngularAbbe.bind(recording({"x": x, "y": y}, kinds), "EXX")
        assert (term.axis, term.lever, term.order) == ("X", "y", order)


def test_a_screw_that_is_held_elsewhere_moves_at_its_fixed_end_too():
    t, x = 60.0 * np.arange(200), np.tile(np.linspace(0, 600, 10), 20)
    kinds = {"t": {"role": "time", "unit": "s"}, "x": {"role": "position", "axis": "X", "unit": "mm"}}
    made, term = recording({"t": t, "x": x}, kinds), FeedHeating(axis="X")
    elsewhere = FeedHeating(axis="X", fixed_end=600.0).basis(made, 3000.0)[:, 0]
    columns = np.column_stack([base := term.basis(made, 3000.0), *(c for c, _ in term.slack(made, base, 3000.0))])
    rest = elsewhere - columns @ np.linalg.lstsq(columns, elsewhere, rcond=None)[0]
    assert np.std(rest) < 1e-6 * np.std(elsewhere)


def test_an_expansion_may_grow_from_either_end_and_be_counted_from_any_temperature():
    """A screw held at -300 mm: that end and that temperature are part of its form, what bends it is not."""
    rng, x = np.random.default_rng(1), np.tile(np.linspace(-300.0, 300, 21), 20)
    warm = np.repeat(rng.uniform(21, 27, 20), 21)
    kinds = {
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "T": {"role": "temperature", "unit": "degC", "location": "screw"},
    }
    made = recording({"x": x, "T": warm}, kinds)
    library = hypotheses.build(made, "EXX", np.arange(x.size), made, (np.zeros(x.size), np.zeros(x.size)))
    (i,) = (k for k, h in enumerate(library.hypotheses) if isinstance(h.terms[0], ScaleExpansion))
    form = library.block(i, made, np.arange(x.size))[:, : library.textbook(i)]
    form = np.column_stack([np.ones(x.size), form])
    for hidden, left in ((11e-3 * (x + 300) * (warm - 18), 0.0), (1e-5 * x**2 * (warm - 18), 1.0)):
        rest = hidden - form @ np.linalg.lstsq(form, hidden, rcond=None)[0]
        assert (np.std(rest) > 0.05) == bool(left), np.std(rest)


def test_a_product_of_rises_may_be_counted_from_any_two_temperatures():
    t, rng = 60.0 * np.arange(300), np.random.default_rng(4)
    one, other = 24 + np.cumsum(rng.standard_normal((2, 300)), axis=1) / 5
    kinds = {"t": {"role": "time", "unit": "s"}}
    kinds |= {n: {"role": "temperature", "unit": "degC", "location": n} for n in ("spindle", "column")}
    made = recording({"t": t, "spindle": one, "column": other}, kinds)
    library = hypotheses.build(made, "E_Z", np.arange(300), made, (np.zeros(300), np.zeros(300)))
    both = ("spindle", "column")
    (i,) = (
        k for k, h in enumerate(library.hypotheses) if isinstance(h.terms[0], ThermalInteraction) and h.drivers == both
    )
    form = np.column_stack([np.ones(300), library.block(i, made, np.arange(300))[:, : library.textbook(i)]])
    hidden = (one - 20.0) * (other - 22.5)
    assert np.std(hidden - form @ np.linalg.lstsq(form, hidden, rcond=None)[0]) < 1e-9 * np.std(hidden)


def to_and_fro(pause: float):
    """An axis that swings once in 2 s, logged at 100 Hz in five runs with a pause between them."""
    t = np.tile(0.01 * np.arange(600), 5) + np.repeat(np.arange(5) * (6.0 + pause), 600)
    phase = np.pi * np.tile(0.01 * np.arange(600), 5)
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
    }
    values = {"run": np.repeat(list("12345"), 600), "t": t, "x": 10 * np.cos(phase), "v": -10 * np.pi * np.sin(phase)}
    return recording(values, kinds)


@pytest.mark.parametrize("pause", [0.0, 40.0])
def test_a_spike_dies_away_between_two_turns_of_the_same_run(pause):
    """With the pauses between runs counted as travel it could last 13 s, which is dry friction."""
    term = ReversalSpike(axis="X")
    (tau,) = (p for p in term.nonlinear() if p.name == "tau")
    assert tau.search.limits(term, to_and_fro(pause))[1] == pytest.approx(1.0 / 3.0, rel=0.05)


def test_a_ram_bends_under_its_own_weight_and_the_spindles():
    x = np.linspace(0.0, 600.0, 80)
    made = recording({"x": x}, {"x": {"role": "position", "axis": "X", "unit": "mm"}})
    term = GravitySag(column="x", length=600.0)
    base = term.basis(made, 3.0)
    columns = np.column_stack([base, *(c for c, _ in term.slack(made, base, 3.0))])
    hidden = -12.0 * (x / 600.0) ** 3 - 8.0 * (x / 600.0) ** 4  # load at the end, line load
    left = hidden - columns @ np.linalg.lstsq(columns, hidden, rcond=None)[0]
    assert np.std(left) < 1e-6 * np.std(hidden)


def test_a_screw_is_warmed_by_viscous_friction_where_the_nut_works():
    rng = np.random.default_rng(3)
    t, feed = 20.0 * np.arange(400), np.repeat(rng.choice([0.0, 6000.0, 24000.0], 20), 20)
    x = rng.uniform(0.0, 500.0, t.size)
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "feed": {"role": "feed", "axis": "X", "unit": "mm/min"},
    }
    made = recording({"t": t, "x": x, "feed": feed}, kinds)
    term = FeedHeating(axis="X", column="feed", cycled=True)
    base = term.basis(made, 2000.0)
    columns = np.column_stack([base, *(c for c, _ in term.slack(made, base, 2000.0))])
    keep, v = np.exp(-20.0 / 2000.0), feed / 6000.0
    for heat in (v**2, v * (x / 250.0 - 1.0)):
        warm = np.zeros(t.size)
        for k in range(1, t.size):
            warm[k] = keep * warm[k - 1] + (1.0 - keep) * heat[k - 1]
        left = warm * x - columns @ np.linalg.lstsq(columns, warm * x, rcond=None)[0]
        assert np.std(left) < 0.05 * np.std(warm * x)


@pytest.mark.parametrize(("second", "heats"), [(None, True), ("B", False)])
def test_a_feed_that_names_no_axis_heats_the_only_one(second, heats):
    kinds = {"x": {"role": "position", "axis": "X", "unit": "mm"}, "f": {"role": "feed", "unit": "mm/min"}}
    kinds |= {"b": {"role": "position", "axis": second, "unit": "deg"}} if second else {}
    made = recording({"x": [0.0, 9.0, 3.0], "f": [900.0, 0.0, 900.0], "b": [0.0, 1.0, 2.0]}, kinds)
    assert ("f" in [term.column for term in FeedHeating.bind(made, "EXX")]) is heats


def test_a_screw_warms_no_faster_than_its_axis_turns():
    """A faster memory of the way is the direction of approach: lost motion was taken for it."""
    stroke = np.linspace(0, 600, 20)
    kinds = {"t": {"role": "time", "unit": "s"}, "x": {"role": "position", "axis": "X", "unit": "mm"}}
    made = recording({"t": 6.0 * np.arange(400), "x": np.tile(np.r_[stroke, stroke[::-1]], 10)}, kinds)
    term = FeedHeating(axis="X")
    assert term.nonlinear()[0].search.limits(term, made)[0] > 100.0  # rows are 6 s apart


def test_a_product_of_rises_may_be_counted_from_one_value_on_two_days():
    """Bodies are not reset overnight: counted from each morning the square leaves a rise of the second day alone."""
    t = np.r_[60.0 * np.arange(200), 60.0 * np.arange(200) + 90000.0]
    warm = 20.0 + 3.0 * np.sin(t / 4000) ** 2 - 2.0 * (t > 50000.0)
    columns = {"run": np.repeat(["1", "2"], 200), "t": t, "T": warm}
    kinds = {"run": {"role": "run"}, "t": {"role": "time", "unit": "s"}, "T": {"role": "temperature", "unit": "degC"}}
    made = recording(columns, kinds)
    hidden = 0.4 * (warm - warm[0]) ** 2
    left = []
    for term in ThermalInteraction.hypotheses(made, made, "E_Z"):
        design = np.column_stack([np.ones(t.size), warm, term.basis(made)])
        left.append(np.std(hidden - design @ np.linalg.lstsq(design, hidden, rcond=None)[0]))
    assert len(left) == 2 and max(left) > 0.05 and min(left) < 1e-9


@pytest.mark.parametrize("runs", [1, 3, 6])
def test_the_fixed_end_of_a_heated_screw_belongs_to_its_form(runs):
    """Positions count from mid-travel, and the bearing is at an end: no departure, wherever the machine was started."""
    t, x = 60.0 * np.arange(240), np.tile(np.linspace(-250, 250, 12), 20)
    kinds = {"run": {"role": "run"}, "t": {"role": "time", "unit": "s"}}
    kinds["x"] = {"role": "position", "axis": "X", "unit": "mm"}
    run = np.arange(240) * runs // 240
    made = recording({"run": run.astype(str), "t": t + 20_000.0 * run, "x": x}, kinds)
    hidden = FeedHeating(axis="X", fixed_end=-250.0).basis(made, 3000.0)[:, 0]
    library = hypotheses.build(made, "EXX", np.arange(240), signals=(hidden,))
    heated = [i for i, h in enumerate(library.hypotheses) if h.effect == "feed_heating"]
    left = []
    for i in heated:
        own = FeedHeating(axis="X", fixed_end=-250.0).basis(made, *library.hypotheses[i].nonlinear[0])[:, 0]
        form = library.block(i, made, np.arange(240))[:, : library.textbook(i)]
        rest = own - form @ np.linalg.lstsq(form, own, rcond=None)[0]
        left.append(np.std(rest) / np.std(own))
    assert heated and max(left) < 1e-6
