"""Counts, names and conventions, each in words and as a number."""

from __future__ import annotations

import numpy as np
import pytest
from machines import READY, ready
from numpy.testing import assert_allclose
from pydantic import ValidationError

from errpipe import yamlfile
from errpipe.domain import components
from errpipe.domain.machine import Machine
from errpipe.errors import ConfigError
from errpipe.kinematics.chain import compile_chain
from errpipe.kinematics.synthesis import exact, first_order

RIGID = {
    "cmm": 21,
    "gantry": 21,
    "vertical-centre": 21,
    "horizontal-centre-ni-1997": 21,
    "turning-centre": 13,
    "five-axis-table-table": 43,
    "five-axis-head-head": 43,
}


def three_axes(**changes) -> Machine:
    """X and Y carry the work, Z the tool; all errors at the origin."""
    axes = {a: {"kind": "linear", "travel": [-500, 500]} for a in "XYZ"}
    given = {"machine": 1, "name": "m", "chain": ["workpiece", "X'", "bed", "Y", "Z", "tool"], "axes": axes}
    return Machine.model_validate(given | changes)


def deviation(chain, q, tip=None, **values) -> np.ndarray:
    """First-order deviation for some components, and a check that the exact one agrees."""
    comps = np.zeros(len(chain.components))
    for name, value in values.items():
        comps[chain.index(name)] = value
    out = first_order(chain, [q], comps, tip)[0]
    assert_allclose(exact(chain, [q], comps, tip)[0], out, atol=0.2)
    return out


def test_seven_machines_are_ready():
    assert {p.stem for p in READY} == set(RIGID)


@pytest.mark.parametrize("name", RIGID)
def test_rigid_body_components_are_counted_from_the_chain(name):
    counts = ready(name).counts()
    assert counts["error_motions"] + counts["location"] == RIGID[name]


def test_the_paper_counts_thirty_two():
    assert ready("horizontal-centre-ni-1997").counts() == {
        "error_motions": 18,
        "location": 3,
        "drift": 6,
        "spindle": 5,
        "total": 32,
    }


@pytest.mark.parametrize("name", RIGID)
def test_the_names_are_those_of_the_machine_s_axes(name):
    """Chain and naming agree, machine by machine, component by component."""
    chain = ready(name)
    machine, counts = chain.machine, chain.counts()
    rigid = components.of_machine(machine.linear_axes(), machine.rotary_axes())
    drifts = [n for n in chain.components if components.parse(n).kind == "drift"]
    assert set(chain.components) - set(drifts) == set(rigid)
    assert len(rigid) == RIGID[name]
    assert len(drifts) == counts["drift"] + counts["spindle"]


def test_the_thirty_two_of_the_paper_are_named_alike():
    spindle = ("X0S", "Y0S", "Z0S", "A0S", "B0S")
    drift = (f"{d}0{axis}" for axis in "XY" for d in "XYZ")  # of the origins of two frames
    names = {*components.of_machine(("Z", "X", "Y")), *drift, *spindle}
    assert names == set(ready("horizontal-centre-ni-1997").components)


@pytest.mark.parametrize("path", READY, ids=lambda p: p.stem)
def test_every_component_has_a_name_of_iso_230_1(path):
    for name in ready(path.stem).components:
        assert components.parse(name).name == name


def test_squareness_of_y_to_x_leans_plus_y_towards_minus_x():
    chain = compile_chain(three_axes())
    assert_allclose(deviation(chain, [0, 300, 0], C0Y=10.0)[:3], [-3.0, 0, 0], atol=1e-12)
    assert_allclose(deviation(chain, [300, 0, 200], C0Y=10.0)[:3], 0.0, atol=1e-12)


def test_squareness_of_z_leans_about_x_and_y():
    chain = compile_chain(three_axes())
    assert_allclose(deviation(chain, [0, 0, 200], B0Z=10.0)[:3], [2.0, 0, 0], atol=1e-12)
    assert_allclose(deviation(chain, [0, 0, 200], A0Z=10.0)[:3], [0, -2.0, 0], atol=1e-12)


def test_squareness_turns_no_tool_and_no_work():
    chain = compile_chain(three_axes())
    for tip in ([0.0, 0, 0], [50.0, 30, -200]):
        assert_allclose(deviation(chain, [0, 0, 0], tip, C0Y=10.0, A0Z=5.0, B0Z=-7.0), 0.0, atol=1e-12)


def test_the_datum_axis_has_no_squareness():
    names = compile_chain(three_axes(datum_axes=("Z", "X", "Y"))).components
    assert {n for n in names if n[1] == "0"} == {"B0X", "A0Y", "C0Y"}


@pytest.mark.parametrize(
    "links", [["workpiece", "bed", "X", "Y", "Z", "tool"], ["workpiece", "X'", "Y'", "Z'", "bed", "tool"]]
)
def test_errors_of_the_tools_side_count_alike_whoever_moves(links):
    chain = compile_chain(three_axes(chain=links))
    got = deviation(chain, [100, 50, 20], EXX=1.0, EYY=2.0, EZZ=3.0)
    assert_allclose(got[:3], [1.0, 2.0, 3.0], atol=1e-12)


def test_errors_of_a_carriage_that_holds_the_work_count_the_other_way():
    axes = {a: {"kind": "linear", "travel": [-500, 500]} for a in "XYZ"}
    axes["X"]["errors_of"] = "carriage"
    chain = compile_chain(three_axes(axes=axes))
    assert_allclose(deviation(chain, [0, 0, 0], EXX=4.0)[:3], [-4.0, 0, 0], atol=1e-12)


def test_ten_micrometres_too_far_at_plus_x_is_plus_ten():
    """The golden case of every target: a machine that is 10 um too long at +X has deviation E_X = +10."""
    chain = ready("vertical-centre")
    assert_allclose(deviation(chain, [800, 0, 0], EXX=10.0)[:3], [10.0, 0, 0], atol=1e-12)


def test_a_tilt_moves_the_tool_by_its_arm():
    """EBX = 20 urad about +Y; the tip 300 mm below the carriage's reference: 20e-6 * -300 mm = -6 um along X."""
    chain = compile_chain(three_axes(chain=["workpiece", "bed", "X", "Y", "Z", "tool"]))
    got = deviation(chain, [0, 0, 0], [0, 0, -300], EBX=20.0)
    assert_allclose(got, [-6.0, 0, 0, 0, 20.0, 0], atol=1e-12)


def test_errors_on_the_guideway_do_not_travel_along():
    chain = compile_chain(three_axes(chain=["workpiece", "bed", "X", "Y", "Z", "tool"]))
    axes = {a: {"kind": "linear", "travel": [-500, 500]} for a in "XYZ"}
    axes["X"]["reference_on"] = "guideway"
    fixed = compile_chain(three_axes(chain=["workpiece", "bed", "X", "Y", "Z", "tool"], axes=axes))
    assert_allclose(deviation(chain, [200, 0, 0], ECX=10.0)[:3], [0, 0, 0], atol=1e-12)
    assert_allclose(deviation(fixed, [200, 0, 0], ECX=10.0)[:3], [0, 2.0, 0], atol=1e-12)


@pytest.mark.parametrize(("reference_on", "seen"), [(None, -5.0), ("guideway", -5.0), ("carriage", 5.0)])
def test_error_motions_of_a_rotary_axis_stand_in_the_machine(reference_on, seen):
    """EXC = 5 um as a standing probe reads it (ISO 230-7): along the workpiece's -X once the table is half round."""
    machine = ready("five-axis-table-table").machine
    turned = machine.axes["C"].model_copy(update={"reference_on": reference_on})
    chain = compile_chain(machine.model_copy(update={"axes": {**machine.axes, "C": turned}}))
    q = np.zeros(5)
    q[chain.axes.index("C")] = 180.0
    assert_allclose(deviation(chain, q, EXC=5.0)[:3], [seen, 0, 0], atol=1e-9)


def test_offset_of_a_rotary_table_appears_as_it_turns():
    """X0C = 5 um: the table's axis lies 5 um further along +X; the work comes to stand 10 um off after half a turn."""
    chain = ready("five-axis-table-table")
    c = chain.axes.index("C")
    q = np.zeros(5)
    assert_allclose(deviation(chain, q, X0C=5.0)[:3], 0.0, atol=1e-9)
    q[c] = 180.0
    assert_allclose(np.abs(deviation(chain, q, X0C=5.0)[:3]), [10.0, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"chain": ["workpiece", "X", "bed", "Y", "Z", "tool"]}, "is written X'"),
        ({"chain": ["workpiece", "X'", "bed", "Y", "Z'", "tool"]}, "is written Z"),
        ({"chain": ["workpiece", "X'", "Y", "Z", "tool"]}, "names the bed once"),
        ({"chain": ["workpiece", "bed", "X", "Y", "tool"]}, "axes Z are not in the chain"),
        ({"chain": ["workpiece", "bed", "X", "Y", "Z", "W", "tool"]}, "axes has no W"),
        ({"chain": ["bed", "X", "Y", "Z", "tool"]}, "from workpiece to tool"),
        ({"chain": ["workpiece", "bed", "X", "Y", "Z", "X", "tool"]}, "X more than once"),
        ({"datum_axes": ["X", "Y"]}, "every linear axis once"),
        ({"tool": {"direction": [0, 0, 0]}}, "cannot be 0, 0, 0"),
    ],
)
def test_a_chain_that_does_not_hold_together_is_refused(changes, says):
    with pytest.raises(ValidationError, match=says):
        three_axes(**changes)


def test_axes_that_count_left_handed_are_refused_unless_it_is_stated():
    """ISO 841; of a lathe whose X points down, Y is turned round with it. A table may count its own motion."""
    given = {a: {"kind": "linear", "travel": [-500, 500]} for a in "XYZ"}
    down, back = ({**given["X"], "direction": d} for d in ([-1, 0, 0], [0, -1, 0]))
    with pytest.raises(ValidationError, match=r"left-handed \(X against ISO 841\)"):
        three_axes(axes=given | {"X": down})
    with pytest.raises(ValidationError, match=r"left-handed \(X, Y, Z against"):
        three_axes(axes={a: {**given[a], "direction": [-float(a == b) for b in "XYZ"]} for a in "XYZ"})
    three_axes(axes=given | {"X": down}, left_handed=True)
    three_axes(axes=given | {"X": {**down, "errors_of": "carriage"}})
    three_axes(axes=given | {"X": down, "Y": back})
    with pytest.raises(ValidationError, match=r"1 validation error"):  # of the statement alone
        three_axes(axes=given | {"X": down}, left_handed="ja")


def test_reversed_travel_is_refused():
    axes = {a: {"kind": "linear", "travel": [500, -500]} for a in "XYZ"}
    with pytest.raises(ValidationError, match="lowest then highest"):
        three_axes(axes=axes)


@pytest.mark.parametrize("path", READY, ids=lambda p: p.stem)
def test_the_ready_files_are_read_by_the_projects_own_reader(path):
    assert yamlfile.load(path, Machine).name == path.stem


def test_a_wrong_machine_file_says_where_and_what(tmp_path):
    text = (
        next(p for p in READY if p.stem == "cmm")
        .read_text()
        .replace("kind: linear, travel: [0, 700]", "kind: liner, travle: [0, 700]")
    )
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ConfigError) as refused:
        yamlfile.load(tmp_path / "m.yaml", Machine)
    output = str(refused.value)
    assert "m.yaml:7:" in output and "liner" in output and "travle" in output and "Did you mean travel?" in output
