"""Every target moves a machine that is 10 um too long at +X the right way, says its sign in words, and is read back."""

import re

import numpy as np
import pytest

from errpipe.domain import driver as d
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError, VerifyError
from errpipe.stages._checklist import checklist
from errpipe.targets import TARGETS, _loss, _sample
from tests.faults.test_random_machines import machine as any_machine
from tests.unit.targets import machines

every = pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)


def holding(*what, but=()):
    """Targets that hold all of `what`."""
    chosen = [t for t in TARGETS if set(what) <= set(t.holds) and not set(but) & set(t.holds)]
    assert chosen
    return pytest.mark.parametrize("target", chosen, ids=lambda t: t.name)


def read(target, table):
    return target.read_back(target.write(table))


def correction(found, axis, side=1.0, sensors=None, **at):
    one = {k: np.full(1, v) for k, v in ({"X": 250.0, "Y": 0.0, "Z": -150.0} | at).items()}
    warm = {k: np.full(1, v) for k, v in (sensors or {"T": 20.0}).items()}
    return 1e3 * float(found.correction(axis, one, np.array([side]), warm)[0])


@holding("both directions")
def test_both_directions_stay_apart(target):
    """Lost motion 6 um: approached from below the axis stops 3 um short, so it is pushed 3 um further there."""
    recording = read(target, machines.wavy_both_directions())
    up, down = (correction(recording, "X", side=s, X=321.0) for s in (1.0, -1.0))
    assert up - down == pytest.approx(6.0, abs=max(target.rounding_um, 0.2))


def test_fanuc_pulses_do_not_add_up_their_rounding():
    """Whole pulses between points: their running sum stays within half a pulse of the curve at every point."""
    (target,) = [t for t in TARGETS if t.name == "fanuc_pitch"]
    table = machines.wavy_both_directions()
    (read,) = target.read_back(target.write(table)).curves
    want = _sample.at_nodes(table, "X", "X", read.positions)
    assert read.positions.size > 15
    start = float(_sample.curve(table, "X", "X", np.zeros(1)).up[0])  # the reference position
    for made, true, pulses in ((read.up, want.up, 0.5), (read.down, want.down, 1.0)):  # the offset is rounded too
        assert np.abs(made - (true - start)).max() <= 1.001e-3 * pulses
        steps = np.diff(made)
        assert np.allclose(steps, np.round(steps * 1e3) / 1e3, atol=1e-12) and np.abs(steps).max() <= 7.001e-3


@holding("screw")
def test_what_is_read_back_is_the_table_within_the_stated_rounding(target):
    table = machines.wavy_both_directions()
    recording = read(target, table)
    x = np.linspace(0.0, 500.0, 777)
    want = _sample.curve(table, "X", "X", x)
    side = np.ones(x.size)
    at = {"X": x, "Y": 0 * x, "Z": 0 * x}
    up, down = (1e3 * recording.correction("X", at, s, {"T": 20 + 0 * x}) for s in (side, -side))
    gaps = [up - 500 * (want.up + want.down)]
    if "both directions" in target.holds:
        gaps = [up - 1e3 * want.up, down - 1e3 * want.down]
    level = 0.0 if target.keeps_level else np.mean(gaps)
    for gap in gaps:
        gap = gap - level
        assert np.abs(gap).max() < max(target.rounding_um, 0.25)


@holding("cross")
def test_cross_curves_move_the_right_axis_the_right_way(target):
    recording = read(target, machines.bent())
    bow = correction(recording, "Y", X=250.0) - correction(recording, "Y", X=0.0)
    assert bow == pytest.approx(-8.0, abs=0.25)
    lean = correction(recording, "X", Y=400.0) - correction(recording, "X", Y=0.0)
    assert lean == pytest.approx(+10.0, abs=0.25)  # pushed by -25 urad * 400 mm = -10 um, so moved +10


@holding("temperature")
def test_a_warm_scale_is_commanded_less_far(target):
    recording = read(target, machines.warm())
    growth = correction(recording, "X", X=500.0, sensors={"T": 30.0}) - correction(recording, "X", X=500.0)
    assert growth == pytest.approx(-55.0, rel=2e-3)
    assert correction(recording, "Z", sensors={"T": 30.0}) - correction(recording, "Z") == pytest.approx(
        -20.0, rel=2e-3
    )


def test_klipper_lifts_z_over_a_low_bed_and_straightens_the_skew():
    (target,) = [t for t in TARGETS if t.name == "klipper_sections"]
    recording = read(target, machines.bent())
    assert correction(recording, "Z", X=500.0) - correction(recording, "Z", X=0.0) == pytest.approx(-20.0, abs=0.05)
    assert correction(recording, "X", Y=400.0) - correction(recording, "X", Y=0.0) == pytest.approx(10.0, abs=0.01)
    warm = read(target, machines.warm())
    assert correction(warm, "Z", sensors={"T": 30.0}) == pytest.approx(-20.0, rel=2e-3)


@every
def test_a_target_says_all_that_a_person_needs(target):
    assert (target.sign.startswith("a ") or target.sign.startswith("values")) and target.limits and target.source
    assert getattr(target, "activation", ()), "`activation` lists what a person at the machine sets and reads back"
    doc = __import__(target.__module__, fromlist=["x"]).__doc__
    assert "Value" in doc or "Mesh" in doc
    if target.confidence == "experimental":
        assert "prove" in target.sign


@pytest.mark.parametrize("target", [t for t in TARGETS if t.confidence == "experimental"], ids=lambda t: t.name)
def test_what_rests_on_experience_says_so_in_the_file(target):
    table = machines.sample(target)
    assert all("experimental" in text.lower() for text in target.write(table).values())


@every
def test_equal_tables_give_equal_bytes(target):
    table = machines.sample(target)
    assert target.write(table) == target.write(table)


@pytest.mark.parametrize("seed", [200, 211])
def test_any_machine_is_written_and_read_back_or_refused_before_anything_is_written(seed):
    """The last one rises by more between two points of a coarse grid than one number of some formats holds."""
    table = any_machine(seed).table
    written = 0
    for target in TARGETS:
        try:
            files = target.write(table)
        except GateError:
            continue
        target.read_back(files)
        written += 1
    assert written > 5


def said_nothing_of():
    """Each format beside a table that holds nothing it could say."""
    still = [(t, machines.bent) for t in TARGETS if set(t.holds) <= {"temperature", "reversal"}]
    cold = [(t, machines.warm) for t in TARGETS if set(t.holds) == {"cross"}]
    assert still and cold
    return pytest.mark.parametrize(("target", "table"), still + cold, ids=lambda x: getattr(x, "name", ""))


@said_nothing_of()
def test_what_the_format_cannot_say_is_refused(target, table):
    with pytest.raises(GateError, match=target.name):
        target.write(table())


@holding("screw")
def test_a_truncated_file_is_refused_or_ends_earlier(target):
    """Formats that are read line by line take half a file for a short table: never for the whole one."""
    table = machines.wavy_both_directions()
    files = target.write(table)
    name = next(iter(files))
    lines = files[name].splitlines(keepends=True)
    broken = {**files, name: "".join(lines[: len(lines) // 2])}
    try:
        (short,) = target.read_back(broken).curves
    except (VerifyError, KeyError):
        return
    assert short.positions[-1] < 0.6 * _sample.span(table, "X")[1]


def test_linuxcnc_stops_at_the_first_invalid_line_without_a_message():
    (target,) = [t for t in TARGETS if t.name == "linuxcnc_screw"]
    files = target.write(machines.too_long_at_plus_x())
    assert not files["x.comp"].startswith("#")
    longer = {"x.comp": files["x.comp"].replace("\n", "\n# a comment\n", 2)}
    with pytest.raises(VerifyError, match="1 rows"):
        target.read_back(longer)


def test_loss_is_reported_in_micrometres():
    """A format that cannot say the temperature loses it, and says how much."""
    (lec,) = [t for t in TARGETS if t.name == "sinumerik_lec"]
    (warm,) = [t for t in TARGETS if t.name == "sinumerik_temperature"]
    table = machines.warm()
    by_curve = {x.axis: x for x in _loss.losses(table, read(lec, table))}
    by_line = {x.axis: x for x in _loss.losses(table, read(warm, table))}
    assert by_curve["X"].rms > 5.0
    assert by_line["X"].largest < 0.6
    assert by_line["Z"].largest < 0.1


def test_a_component_that_counts_against_its_axis_is_not_given_to_the_control_as_it_is():
    """Of a machine file with errors_of: carriage: the control would move the axis the wrong way."""
    (target,) = [t for t in TARGETS if t.name == "beckhoff_volumetric"]
    table = machines.too_long_at_plus_x()
    (output,) = table.outputs
    (term,) = output.terms
    turned = output.model_copy(update={"terms": (term.model_copy(update={"weight": -term.weight}),)})
    assert "EXX" in target.write(table)["volumetric.csv"]
    with pytest.raises(GateError, match="EXX of this machine file counts against the motion of X"):
        target.write(table.model_copy(update={"outputs": (turned,)}))


@pytest.mark.parametrize(
    "target", [t for t in TARGETS if "per kelvin" in t.limits or "sensor" in t.limits], ids=lambda t: t.name
)
def test_a_file_per_kelvin_says_where_its_table_counts_from_the_start(target):
    """Started at 28 degC, where the table is 0, the file's fixed 20 degC moved Z by 16 um, and nothing said so."""
    for driver, said in ((d.rise("T"), ["Z"]), (d.above("T", 20.0), [])):
        drift = Lowered(d.Affine(weights=(2.0,), of=(driver,)))
        growth = machines.straight("X", 5.5, driver=d.above("T", 20.0))
        table = machines.compile_(("EXX", [growth]), ("EZZ", [drift]))
        text = checklist(target, read(target, table), [], table)
        assert re.findall(r"- (\w): the table counts T from its reading at the start", text) == said


def test_a_mesh_that_fades_out_with_height_is_no_compensation():
    """Marlin keeps the fade height it was built with, 10 mm, unless it is set to 0: above, nothing was corrected."""
    (target,) = [t for t in TARGETS if t.name == "marlin_gcode"]
    files = target.write(machines.bent())
    (name,) = files
    assert "\nM420 S1 Z0\n" in files[name]
    with pytest.raises(VerifyError, match="fades out the mesh with height"):
        target.read_back({name: files[name].replace("M420 S1 Z0", "M420 S1")})
