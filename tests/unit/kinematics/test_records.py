"""Direct identification: curves, squares, parts that move, intervals and exports from records of single components."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines import corrected, ready, volume_points
from numpy.testing import assert_allclose
from records_played import ABBE, AIR, COSINE, WAVELENGTH, largest_gap, of_axis, played_x, solve

from errpipe.domain.machine import Machine
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError, GateError
from errpipe.kinematics import direct, identify, observability, protocols, readings, records, summary, synthesis
from errpipe.kinematics import observations as o
from errpipe.kinematics.chain import compile_chain
from errpipe.models import direct as direct_family
from errpipe.simulation import direct_records as played
from errpipe.simulation import measuring_runs, metrology
from errpipe.stages.export_volumetric import curve_misfit
from errpipe.targets import TARGETS

SEEDS = 200


def test_both_ways_are_one_curve_and_a_reversal():
    chain, values, recording = played_x({}, reversal=6.0)
    solution = solve(chain, recording)
    reversal = records.reversals(chain, solution.setup)["EXX"]
    side = recording.array("dir_x")
    raw = recording.array("EXX")
    seen = np.mean(raw[side > 0]) - np.mean(raw[side < 0])
    assert reversal["value"] == pytest.approx(seen, abs=0.1) and abs(seen) > 1.0
    assert abs(reversal["per_metre"]) < 3 * reversal["per_metre_half_width95"]
    assert largest_gap(chain, values, solution) < 0.12
    assert records.reversal_line(reversal)[0] == reversal["value"]


def test_squareness_from_two_straightness_records_and_the_square_s_own_error():
    chain = ready("vertical-centre")
    values = metrology.smooth_machine(chain, 6)
    truth = {n: values[n] for n in ("C0Y", "A0Z", "B0Z")}
    own = {"C0Y": 5.0, "A0Z": -4.0, "B0Z": 6.0}
    setup = played.SetUp(targets=11, cycles=2, noise=0.05, angle_noise=0.1, squares=own)
    recording = played.record(chain, values, setup, 6)
    without = tuple(n for n in chain.components if n[2:] == "S")
    model = identify.Parametrisation.of(chain, 8, without)
    fitted = identify.identify(model, records.observations(chain, {"": recording}, squares=own))
    wrong = identify.identify(model, records.observations(chain, {"": recording}, squares=dict.fromkeys(own, 0.0)))
    for name, value in truth.items():
        assert fitted.component(name)[0][0] == pytest.approx(value, abs=1.0)
        assert wrong.component(name)[0][0] == pytest.approx(value - own[name], abs=1.0)


def test_without_a_square_the_squareness_is_named_as_unseen():
    chain = ready("cmm")
    values = metrology.smooth_machine(chain, 2)
    recording = played.record(chain, values, played.SetUp(targets=9, cycles=1), 2)
    seen = observability.analyse(chain, records.observations(chain, {"": recording}), noise=1.0)
    assert {c for u in seen.unobserved for c in u.components} == {"C0Y", "A0Z", "B0Z"}
    extra = observability.smallest_extra(chain, records.observations(chain, {"": recording}), noise=1.0)
    assert {c for e in extra for c in e.resolves} == {"C0Y", "A0Z", "B0Z"}


@pytest.mark.slow
def test_records_and_a_ball_bar_together_give_what_neither_gives():
    """Lasers and levels for the axes, one ball-bar test for the squareness: solved as one."""
    chain = ready("cmm")
    values = metrology.smooth_machine(chain, 4)
    single = records.observations(chain, {"": played.record(chain, values, played.SetUp(targets=11, cycles=2), 4)})
    bar = metrology.simulate_runs(chain, values, "ballbar_circle", measuring_runs.circles(chain), 4, noise=0.3)
    both = o.concatenate([protocols.observations(chain, bar), single])
    fitted = identify.identify(identify.Parametrisation.of(chain, 8), both)
    for row in fitted.table():
        assert row["value"] == pytest.approx(values[row["component"]], abs=2.5)
    assert observability.analyse(chain, both, noise=1.0).unobserved == ()


@pytest.mark.parametrize("definition", [{}, {"errors_of": "carriage"}, {"reference_on": "guideway"}])
def test_a_machine_too_long_is_too_long_whichever_part_moves(definition):
    """A record counts as coordinates do: +10 um at +X is +10 um at the tool, however the machine file counts."""
    axes = {a: {"kind": "linear", "travel": [-500, 500]} for a in "XYZ"}
    axes["X"] |= definition
    chain = compile_chain(
        Machine.model_validate(
            {"machine": 1, "name": "m", "chain": ["workpiece", "X'", "bed", "Y", "Z", "tool"], "axes": axes}
        )
    )
    x = np.tile(np.linspace(-500, 500, 11), 2)
    columns = {
        "run": Column(role="run"),
        "x": Column(role="position", axis="X", unit="mm"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    frame = pd.DataFrame({"run": np.repeat(["1", "2"], 11).astype(object), "x": x, "EXX": 10.0 * x / 500.0})
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)
    solution = solve(chain, recording)
    q = np.array([[500.0, 0.0, 0.0], [-500.0, 0.0, 0.0]])
    assert_allclose(synthesis.first_order(chain, q, solution.errors().at(q))[:, 0], [10.0, -10.0], atol=0.02)


def test_guideway_reference_reads_its_own_straightness():
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZ"}
    axes["X"]["reference_on"] = "guideway"
    given = {"machine": 1, "name": "m", "chain": ["workpiece", "bed", "X", "Y", "Z", "tool"], "axes": axes}
    chain = compile_chain(Machine.model_validate(given))
    values = metrology.smooth_machine(chain, 9)
    recording = of_axis(played.record(chain, values, played.SetUp(noise=0.05, angle_noise=0.05), 9), "X")
    solution = solve(chain, recording)
    assert largest_gap(chain, values, solution, "EYX") < 0.15


def test_readings_that_sat_out_are_left_with_the_noise():
    chain, _, recording = played_x(ABBE, noise=0.3, angle_noise=0.5)
    name, folds = direct_family.direct_folds(recording)
    assert name == "leave-one-run-out" and len(folds) == 3
    left = [
        x
        for _, train, test in folds
        for x in direct_family.validate_fold(chain, recording, train, test, lasers={"EXX": direct.Laser(**ABBE)})
    ]
    exx = np.concatenate([x.after for x in left if x.component == "EXX"])
    before = np.concatenate([x.before for x in left if x.component == "EXX"])
    assert np.sqrt(np.mean(exx**2)) < 0.3 * 1.2 < 0.1 * np.sqrt(np.mean(before**2))


def test_a_record_made_once_is_judged_on_every_fifth_target():
    chain, _, recording = played_x({}, cycles=1, noise=0.3)
    name, folds = direct_family.direct_folds(recording)
    assert name == "every 5th target" and len(folds) == 5
    x = recording.array("x")
    for _, train, test in folds:
        assert not set(x[train]) & set(x[test])
    left = direct_family.validate_fold(chain, recording, *folds[1][1:])
    assert {r.component for r in left} == set(chain.of_axis("X"))


@pytest.mark.parametrize(
    ("lasers", "stated"),
    [
        ({"EXX": {"dead_path": 100.0}}, "to correct the dead path, record the air"),
        ({"EBX": {"offset": (1, 0, 0)}}, "lasers.EBX: an angle has no dead path"),
        ({"EYX": {"dead_path": 5.0}}, "lasers.EYX: a straightness has an offset alone"),
        ({"EXY": {}}, "lasers.EXY: no recording holds EXY"),
    ],
)
def test_a_set_up_that_does_not_fit_is_refused(lasers, stated):
    chain, _, recording = played_x({})
    kept = {n: c for n, c in recording.manifest.columns.items() if c.role not in ("temperature", "pressure")}
    bare = Recording(recording.manifest.model_copy(update={"columns": kept}), recording.frame[list(kept)])
    with pytest.raises(DataError, match=stated):
        records.observations(chain, {"": bare}, lasers={n: direct.Laser(**s) for n, s in lasers.items()})


@pytest.mark.parametrize(
    ("squares", "stated"),
    [({"C0X": 0.0}, "no such squareness.*Did you mean C0Y"), ({"C0Y": 0.0}, "EXY was not recorded")],
)
def test_a_square_needs_both_its_records(squares, stated):
    chain, _, recording = played_x({})
    with pytest.raises(DataError, match=stated):
        records.observations(chain, {"": recording}, squares=squares)


@pytest.mark.parametrize(("shift", "refused"), [(0.05, False), (0.3, True), (-0.3, True)])
def test_a_record_that_leaves_the_travel_of_its_axis_is_refused(shift, refused):
    chain, _, recording = played_x({})
    name, travel = direct.position_of(recording, "EXX"), chain.travel[chain.axes.index("X")]
    moved = recording.with_values({name: recording.array(name) + shift * np.ptp(travel)})
    if refused:
        with pytest.raises(DataError, match=r"L: EXX was recorded from .* but the travel of X in the machine file is"):
            readings.of_tests(chain, {"L": moved})
    else:
        assert len(readings.of_tests(chain, {"L": moved})[0])


def test_a_component_the_machine_does_not_have_is_named():
    _, _, recording = played_x({})
    with pytest.raises(DataError, match="EXX was recorded, but turning"):
        records.observations(_without_x(), {"": recording})


def _without_x():
    given = {
        "machine": 1,
        "name": "turning",
        "chain": ["workpiece", "bed", "Z", "tool"],
        "axes": {"Z": {"kind": "linear", "travel": [0, 100]}},
    }
    return compile_chain(Machine.model_validate(given))


def coverage(seeds) -> tuple[float, float, float]:
    """Share of curves and of squarenesses inside their 95 % intervals; volumetric gap over its standard error."""
    chain = ready("vertical-centre")
    without = tuple(n for n in chain.components if n[2:] == "S")
    model = identify.Parametrisation.of(chain, 10, without)
    beams = {"EXX": AIR | COSINE | ABBE, "EYY": WAVELENGTH | ABBE, "EZZ": AIR | COSINE, "EYX": ABBE}
    lasers = {n: direct.Laser(**b) for n, b in beams.items()}
    squares = {"C0Y": 5.0, "A0Z": -4.0, "B0Z": 6.0}
    setup = played.SetUp(beams={n: played.Laser(**b) for n, b in beams.items()}, squares=squares)
    inside, constants, volume = [], [], []
    q = volume_points(chain, [4, 4, 4], 0.1)
    for seed in seeds:
        values = metrology.smooth_machine(chain, seed)
        recording = played.record(chain, values, setup, seed + 900)
        fitted = identify.identify(model, records.observations(chain, {"": recording}, lasers=lasers, squares=squares))
        for name in (n for n in chain.components if n[0] == "E"):
            p = np.linspace(*chain.travel[chain.axes.index(name[2:])], 33)
            value, error = fitted.component(name, p)
            inside.append(np.mean(np.abs(values[name](p) - value) < 1.96 * error))
        constants += [r["ci95"][0] < values[r["component"]] < r["ci95"][1] for r in fitted.table()]
        true = {n: v for n, v in values.items() if n not in without}
        gap = synthesis.exact(chain, q, metrology.components_at(chain, true, q))[:, :3] - fitted.predict(q)[0]
        volume.append((np.mean(gap**2), np.mean(fitted.predict(q)[1] ** 2)))
    left, stated = np.sqrt(np.mean(volume, axis=0))
    return float(np.mean(inside)), float(np.mean(constants)), float(left / stated)


@pytest.mark.slow
def test_intervals_of_direct_records_cover():
    """200 machines out of the fitted basis, each with its own zeros, askew squares and beam errors."""
    inside, constants, ratio = coverage(range(SEEDS))
    assert 0.92 <= inside <= 0.98
    assert 0.92 <= constants <= 0.98
    assert ratio < 1.2


def wave(targets: int) -> Recording:
    """EXX of a wave of 50 mm and 2 um along 800 mm, three times up and down."""
    rng = np.random.default_rng(4)
    up = np.linspace(0.0, 800.0, targets)
    x = np.tile(np.r_[up, up[::-1]], 3)
    side = np.tile(np.r_[np.ones(targets), -np.ones(targets)], 3)
    value = 2.0 * np.sin(2 * np.pi * x / 50.0) + rng.normal(0, 0.05, x.size)
    columns = {
        "run": Column(role="run"),
        "x": Column(role="position", axis="X", unit="mm"),
        "side": Column(role="direction", axis="X"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    frame = pd.DataFrame({"run": np.repeat(["1", "2", "3"], 2 * targets), "x": x, "side": side, "EXX": value})
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)


@pytest.mark.parametrize("most, followed", [(None, True), (20, False)])
def test_the_curve_follows_what_the_targets_show_or_says_what_it_misses(most, followed):
    """81 targets 10 mm apart show a wave of 50 mm; twenty waves of the basis miss it, and the interval says so."""
    chain = ready("vertical-centre")
    assert tuple(chain.travel[chain.axes.index("X")]) == (0.0, 800.0)
    recording = wave(81)
    obs, _ = readings.of_tests(chain, {"x": recording})
    modes = readings.modes({"x": recording}) if most is None else most
    rest = tuple(c for c in chain.components if c != "EXX")
    fitted = identify.identify(identify.Parametrisation.of(chain, modes, rest), obs)
    missed, largest = readings.curve_misfit(chain, obs, fitted.residual)
    curve = summary.document(fitted, obs, extra=False, missed=missed)["curves"]["EXX"]
    at = curve["start"] + curve["step"] * np.arange(len(curve["value"]))
    off = np.array(curve["value"]) - 2.0 * np.sin(2 * np.pi * at / 50.0)
    off -= off.mean()
    assert (np.sqrt(np.mean(off**2)) < 0.25) == followed
    assert np.mean(np.abs(off) <= curve["half_width95"]) > 0.9
    assert bool(missed.get("EXX", 0.0) > 1.0) != followed
    stated = curve_misfit(chain, {"unfollowed_largest": largest})  # of a table of these curves, at the tool
    assert (stated == 0.0) if followed else (np.quantile(np.abs(off), 0.95) < stated < 2.5)


AXES = {"tool": ["workpiece", "bed", "X", "Y", "Z", "tool"], "workpiece": ["workpiece", "X'", "bed", "Y", "Z", "tool"]}
AGAINST = {"direction": [-1.0, 0.0, 0.0]}
DEFINITIONS = [{}, {"errors_of": "carriage"}, AGAINST, {**AGAINST, "errors_of": "carriage"}]


def too_long(moved, definition, low):
    """20 um too long where X is 500 above `low`, approached from above 4 um more: chain, recording, identification."""
    axes = {a: {"kind": "linear", "travel": [low, low + 500]} for a in "XYZ"}
    axes["X"] |= definition
    given = {"machine": 1, "name": "m", "chain": AXES[moved], "left_handed": True, "axes": axes}
    chain = compile_chain(Machine.model_validate(given))
    up = np.linspace(0, 500, 11)
    x, side = np.tile(np.r_[up, up[::-1]], 2), np.tile(np.repeat([1.0, -1.0], 11), 2)
    columns = {
        "run": Column(role="run"),
        "x": Column(role="position", axis="X", unit="mm"),
        "dir": Column(role="direction", axis="X"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    run = np.repeat(["1", "2"], 22).astype(object)
    frame = pd.DataFrame({"run": run, "x": x + low, "dir": side, "EXX": 20.0 * x / 500.0 - 2.0 * side})
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)
    return chain, recording, solve(chain, recording)


@pytest.mark.parametrize("moved", AXES)
@pytest.mark.parametrize("definition", DEFINITIONS, ids=str)
def test_a_machine_too_long_is_commanded_less_far_by_every_export(moved, definition):
    """Both tables of an identification say so."""
    from errpipe.kinematics import direct_model
    from errpipe.validation.predict import predict

    chain, recording, solution = too_long(moved, definition, 0.0)
    document = summary.document(solution, records.observations(chain, {"": recording}), extra=False)
    document["reversal"] = records.reversals(chain, solution.setup)
    model = direct_model.error_model(chain, recording, document, {"EXX": 0.1})
    left = predict(model, recording)["EXX_predicted"].to_numpy() - recording.array("EXX")
    assert np.ptp(left) < 0.2
    q = np.zeros((2, 3))
    q[:, chain.axes.index("X")] = 0.0, 500.0
    deviation = synthesis.first_order(chain, q, solution.errors().at(q))
    moved_to = corrected(chain, q, deviation)[:, chain.axes.index("X")] - q[:, chain.axes.index("X")]
    assert 1e3 * (moved_to[1] - moved_to[0]) == pytest.approx(-20.0, abs=0.1)


@pytest.mark.parametrize("low", [-500.0, 40.0, -180.0], ids=["home at +X", "home beyond -X", "home in between"])
@pytest.mark.parametrize("moved", AXES)
@pytest.mark.parametrize("definition", DEFINITIONS, ids=str)
def test_a_machine_too_long_is_commanded_less_far_by_every_file(moved, definition, low):
    """From the machine file to what each control makes of its file, read by its manual alone."""
    from errpipe.stages.export_volumetric import compile_machine, reversals
    from tests.unit.targets import manual_readers

    chain, _, solution = too_long(moved, definition, low)
    lines = reversals({"reversal": records.reversals(chain, solution.setup)})
    table = compile_machine(chain, solution.errors(), "0" * 64, "too long", 0.01, lines, ("X",))
    read = 0
    for target in (t for t in TARGETS if hasattr(manual_readers, t.name)):
        try:
            by_control = getattr(manual_readers, target.name)(target.write(table), "X")
        except GateError as err:
            assert target.name == "beckhoff_volumetric" and "counts against the motion" in str(err)
            continue
        read += 1
        ends = np.array([[by_control(x, side) for x in (low + 5.0, low + 495.0)] for side in (1, -1)]) * 1e3
        if "screw" in target.holds:
            assert np.diff(ends.mean(axis=0)) == pytest.approx(-19.6, abs=0.2 + target.rounding_um), target.name
        if {"both directions", "reversal"} & set(target.holds):
            assert np.diff(ends.mean(axis=1)) == pytest.approx(-4.0, abs=0.2 + target.rounding_um), target.name
    assert read >= 18


def test_an_axis_inclined_to_its_letter_is_not_measured_component_by_component():
    """What a laser reads along a slanted Y is no EYY of the machine's frame: as such it would move Y and Z too far."""
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZ"}
    axes["Y"]["direction"] = [0.0, 0.866, 0.5]
    given = {"machine": 1, "name": "m", "chain": AXES["tool"], "axes": axes}
    chain = compile_chain(Machine.model_validate(given))
    with pytest.raises(DataError, match=r"EYY: Y runs along 0, 0.866, 0.5, inclined to Y"):
        records.component_sign(chain, "EYY")
    assert records.component_sign(chain, "EXX") == 1.0


@pytest.mark.parametrize("datum", [None, 90.0])
def test_positioning_of_an_axis_that_turns_on_is_zero_at_its_datum(datum):
    """A fork head's C that was aligned at its zero stays there, whatever the mean of its record over the turn."""
    machine = ready("five-axis-head-head").machine
    c = machine.axes["C"].model_copy(update={"datum": datum})
    chain = compile_chain(machine.model_copy(update={"axes": {**machine.axes, "C": c}}))
    model = identify.Parametrisation.of(chain, 8)
    q = np.tile(chain.travel.mean(axis=1), (2, 1))
    q[:, chain.axes.index("C")] = [datum or 0.0, 30.0]
    functions = model.functions(q)[:, model.prior.component == chain.index("ECC")]
    assert_allclose(functions[0], 0.0, atol=1e-12)
    assert np.abs(functions[1]).max() > 0.1
