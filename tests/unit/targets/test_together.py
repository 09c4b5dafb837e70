"""Files that one controller adds up: no part says what another one says, and together they lose less than apart."""

from __future__ import annotations

import re

import numpy as np
import pytest

from errpipe import jsonfile, tables
from errpipe.domain import driver as d
from errpipe.domain.table import CompensationTable
from errpipe.drivers.lowered import Lowered
from errpipe.errors import VerifyError
from errpipe.stages import targets as stage
from errpipe.tables import ect
from errpipe.targets import TARGETS, _loss, _sample
from errpipe.verbs.verify import verify
from tests.unit.targets import machines

BY_NAME = {t.name: t for t in TARGETS}
SINUMERIK = ("sinumerik_cec", "sinumerik_lec", "sinumerik_temperature")
BECKHOFF = ("beckhoff_crosscomp", "beckhoff_ssfk", "beckhoff_temperature")


def bent_and_warm():
    """A screw error, a bow of Y over X, a lean of X over Y, and a screw that grows."""
    lean = tables.MonomialSource(-1e-3, "C0Y", (d.Input(name="y"),))
    screw = (machines.straight("X", 10.0), machines.straight("X", 5.5, driver=d.above("T", 20.0)))
    bow = Lowered(d.ONE, "X", lambda x: 8.0 * np.sin(np.pi * x / 500.0))
    return tables.compile_table(
        [
            tables.ComponentSource("EXX", "um", screw),
            tables.ComponentSource("EYX", "um", (bow,)),
            tables.ComponentSource("C0Y", "urad", (Lowered(d.Constant(value=25.0)),)),
        ],
        outputs=[
            tables.OutputSource("X", (tables.MonomialSource(1.0, "EXX"), lean), "X"),
            tables.OutputSource("Y", (tables.MonomialSource(1.0, "EYX"),), "Y"),
        ],
        inputs=machines.INPUTS,
        travel=machines.AXES,
        error_bound=0.002,
        machine="test",
    )


@pytest.mark.parametrize("names", [SINUMERIK, BECKHOFF], ids=lambda n: n[0].split("_")[0])
def test_together_they_say_nearly_everything(names):
    table = bent_and_warm()
    _, read = stage.write_together(table, [BY_NAME[n] for n in names])
    whole = {x.axis: x for x in _loss.losses(table, read)}
    assert max(x.largest for x in whole.values()) < 0.6  # rounding, and the settled slope at the edge of its fade
    for name in names:
        alone = {x.axis: x for x in _loss.losses(table, BY_NAME[name].read_back(BY_NAME[name].write(table)))}
        assert max(x.rms for x in alone.values()) > 5 * max(x.rms for x in whole.values()), name


def test_the_screw_is_not_compensated_twice():
    """Leadscrew table and cross table each hold X over X when written alone; beside each other only one does."""
    table, cec = bent_and_warm(), BY_NAME["sinumerik_cec"]
    alone = {(c.axis, c.over) for c in cec.read_back(cec.write(table)).curves}
    beside = {(c.axis, c.over) for c in cec.read_back(cec.write_with(table, ["sinumerik_lec"])).curves}
    assert alone - beside == {("X", "X")}


def test_only_files_of_one_controller_are_added_up():
    for parts in stage.target_combinations(TARGETS):
        assert len({p.name.split("_")[0] for p in parts}) == 1
    assert tuple(BY_NAME[n] for n in SINUMERIK) in stage.target_combinations(TARGETS)
    assert tuple(BY_NAME[n] for n in BECKHOFF) in stage.target_combinations(TARGETS)


def test_names_of_companions_exist():
    for target in TARGETS:
        assert set(target.goes_with) <= set(BY_NAME) - {target.name}


def test_compare_targets_shows_the_best_choice(tmp_path):
    ect.write(bent_and_warm(), tmp_path / "table.ect")
    says = stage.compare_targets(tmp_path / "table.ect")["comparison"]
    names = {row["target"] for row in says if " + " in row["target"]}
    # The cross tables can hold the screw too, so the leadscrew table is not needed here.
    assert names == {"sinumerik_cec + sinumerik_temperature", " + ".join(BECKHOFF)}
    assert all(row["rms_um"] < 0.3 for row in says if " + " in row["target"])


def test_an_export_of_companions_writes_one_folder_each(tmp_path):
    table = bent_and_warm()
    files = stage.write_targets(table, ["sinumerik_lec", "sinumerik_cec"], tmp_path)
    assert {f["file"].split("/")[0] for f in files} == {"sinumerik_lec", "sinumerik_cec"}
    text = (tmp_path / "sinumerik_cec" / "NC_CEC.INI").read_text()
    curves = BY_NAME["sinumerik_cec"].read_back({"NC_CEC.INI": text}).curves
    assert {(c.axis, c.over) for c in curves} == {("X", "Y"), ("Y", "X")}
    output = (tmp_path / "sinumerik_cec" / "CHECKLIST.md").read_text()
    assert "only together with those of sinumerik_lec" in output


def test_what_is_left_together_counts_the_numbers_entered_by_hand(tmp_path):
    """9 um of lost motion are MD32450, in no file: as a loss of both files they would look lost for good."""
    lost_motion = Lowered(d.Direction(axis="X"), "X", lambda x: np.full(np.shape(x), -4.5))
    parts = (machines.straight("X", 10.0), machines.straight("X", 5.5, driver=d.above("T", 20.0)), lost_motion)
    sources = [tables.ComponentSource("EXX", "um", parts)]
    outputs, travel = tables.outputs_of(sources), machines.AXES
    table = tables.compile_table(
        sources, outputs=outputs, inputs=machines.INPUTS, travel=travel, error_bound=0.002, machine="test"
    )
    rows = stage.write_targets(table, ["sinumerik_lec", "sinumerik_temperature"], tmp_path)
    for row in rows:
        left = re.search(r"with the numbers entered by hand, they lack X ([\d.e-]+) rms", row["sibling"])
        assert left and float(left[1]) < 0.1
        assert row["sibling"] in (tmp_path / row["file"]).with_name("CHECKLIST.md").read_text()


@pytest.mark.parametrize("name", ["sinumerik_cec", "beckhoff_crosscomp", "heidenhain_com"])
def test_a_cross_curve_that_stands_alone_holds_its_constant(name):
    """Y moves over X only: nothing else would hold the height of the bow in the middle of X."""
    table = bent_and_warm()
    by_name = {x.axis: x for x in _loss.losses(table, BY_NAME[name].read_back(BY_NAME[name].write(table)))}
    assert by_name["Y"].largest < 0.15


def test_a_sensor_may_have_a_space_in_its_name():
    text = machines.warm().model_dump_json()
    for key in ("name", "input"):
        text = text.replace(f'"{key}":"T"', f'"{key}":"T nut"')
    table = CompensationTable.model_validate_json(text)
    for name in ("sinumerik_temperature", "beckhoff_temperature", "klipper_sections"):
        read = BY_NAME[name].read_back(BY_NAME[name].write(table))
        assert {line.sensor for line in read.lines} == {"T nut"}, name


def test_files_exported_together_are_verified_together(tmp_path):
    ect.write(bent_and_warm(), tmp_path / "table.ect")
    stage.export(tmp_path / "table.ect", list(SINUMERIK), tmp_path / "out")
    assert sum("read back" in line for line in verify(tmp_path / "out")["says"]) == 3


def test_verify_notices_any_changed_byte_and_a_loss_of_another_fifth_digit(tmp_path):
    """Checksums of all files, checklists too; beneath them the evaluation, to more digits than words have."""
    ect.write(bent_and_warm(), tmp_path / "table.ect")
    out = tmp_path / "out"
    stage.export(tmp_path / "table.ect", list(SINUMERIK), out)
    document = jsonfile.read(out / "export.json")
    files = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    assert set(document["sha256"]) == files - {"export.json"}
    for name in sorted(document["sha256"]):
        data = (out / name).read_bytes()
        (out / name).write_bytes(data + b" ")
        with pytest.raises(VerifyError):
            verify(out)
        (out / name).write_bytes(data)
    verify(out)
    cec = out / "sinumerik_cec" / "NC_CEC.INI"
    lines = cec.read_text().splitlines(keepends=True)
    at = next(n for n, line in enumerate(lines) if line.startswith("$AN_CEC[0,1]"))
    name, value = lines[at].split("=")
    lines[at] = f"{name}={float(value) + 2e-6:.6f}\n"  # two nanometres at one point of one table
    cec.write_text("".join(lines))
    with pytest.raises(VerifyError, match="was changed after it was exported"):
        verify(out)
    jsonfile.write(out / "export.json", {**document, "sha256": {}})
    with pytest.raises(VerifyError, match="now loses"):
        verify(out)


def test_the_move_list_says_what_the_axis_does_in_all(tmp_path):
    """Sums of all tables of an axis, other axes at mid travel, and the corners of a product."""
    table = machines.tilting()
    stage.write_targets(table, ["sinumerik_cec"], tmp_path)
    output = (tmp_path / "sinumerik_cec" / "CHECKLIST.md").read_text()
    for x, z in ((0.0, -300.0), (500.0, -300.0), (500.0, 0.0)):
        want = 1e3 * float(_sample.corrections(table, "X", {"x": np.array([x]), "z": np.array([z])}, np.ones(1))[0])
        row = next(line for line in output.splitlines() if line.startswith(f"| X | X and Z | {x:.3f}, {z:.3f} |"))
        assert float(row.split("|")[4]) == pytest.approx(want, abs=0.02)
    assert "products" in output and "SD41300 = 0" in output


def test_files_of_one_axis_say_that_others_are_exported_with_them(tmp_path):
    """Made apart, points and tables of X and of Y have the same numbers."""
    stage.write_targets(machines.too_long_at_plus_x(), ["fanuc_pitch"], tmp_path)
    assert "the files hold X alone" in (tmp_path / "fanuc_pitch" / "CHECKLIST.md").read_text()
    stage.write_targets(bent_and_warm(), ["sinumerik_cec"], tmp_path)
    assert "the files hold" not in (tmp_path / "sinumerik_cec" / "CHECKLIST.md").read_text()
