"""Files that leave an axis worse off than without them are not written, and states in which they do are reported."""

from __future__ import annotations

import json

import pytest

from bench.bench_tables import machine
from errpipe import jsonfile
from errpipe.domain import driver as d
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError
from errpipe.stages import _artefacts
from errpipe.stages import targets as stage
from errpipe.targets import TARGETS
from errpipe.verbs.verify import verify
from tests.unit.targets import machines
from tests.unit.targets.test_loss import at_temperatures

# The error of X is a curve in the middle of Z, and its opposite at both ends of Z.
TURNED = Lowered(
    d.Lookup(start=-300.0, step=150.0, values=(-1.0, 1.0, -1.0), of=d.Input(name="z")), "X", lambda x: 0.04 * x
)


def exported(table, name, tmp_path):
    _artefacts.write_table(tmp_path, table)
    answer = stage.export(tmp_path / "table.ect", [name], tmp_path / "out")
    return answer, (tmp_path / "out" / name / "CHECKLIST.md").read_text(), verify(tmp_path / "out")


def test_an_axis_that_files_leave_worse_off_is_left_out_of_them(tmp_path):
    table = machines.compile_(("EXX", [TURNED]), ("EYY", [machines.straight("Y", 20.0, span=400.0)]))
    answer, checklist, _ = exported(table, "sinumerik_lec", tmp_path)
    assert [row["file"] for row in answer["files"]] == ["sinumerik_lec/AX2_Y_EEC.INI"]
    losses = {x["axis"]: x for x in answer["files"][0]["losses"]}
    assert losses["X"]["rms_um"] == losses["X"]["table_rms_um"] > 5.0 and losses["Y"]["rms_um"] < 0.2
    (said,) = [x for x in answer["says"] if "worse with these files than without: X" in x]
    assert "left out of them" in said and said in checklist
    assert "| X |" not in checklist and "| Y |" in checklist


def test_a_format_that_does_nothing_but_harm_is_refused(tmp_path):
    table = machines.compile_(("EXX", [TURNED]))
    with pytest.raises(GateError, match=r"sinumerik_lec: worse .* X [\d.]+ um rms instead of .* compare-targets"):
        exported(table, "sinumerik_lec", tmp_path)
    assert not (tmp_path / "out").exists()


def scale(default):
    expansion = Lowered(d.above("T", 20.0), "X", lambda x: 0.008 * x)
    return at_temperatures(machines.compile_(("EXX", [expansion])), default)


def test_harm_in_some_thermal_states_is_stated_where_files_are_listed(tmp_path):
    answer, checklist, _ = exported(scale(24.0), "sinumerik_lec", tmp_path)
    (said,) = [x for x in answer["says"] if "worse than without these files where T = 16 degC" in x]
    assert said in checklist and said in answer["files"][0]["worse"]


def test_harm_in_the_mean_of_the_thermal_states_is_refused(tmp_path):
    """The curve of 31 degC, where 16 to 32 degC were recorded and the error is 0 at 20 degC."""
    with pytest.raises(GateError, match="worse with these files than without: X"):
        exported(scale(31.0), "sinumerik_lec", tmp_path)


def test_a_loss_that_is_not_assessed_is_not_printed_as_none(tmp_path):
    since_start = d.Affine(weights=(2.0, -2.0), of=(d.Input(name="T"), d.First(of=d.Input(name="T"))))
    table = machines.compile_(("EXX", [Lowered(since_start)]))
    free = (i.model_copy(update={"valid": None, "margin": None}) for i in table.inputs)
    table = table.model_copy(update={"inputs": tuple(free)})  # as of a model whose validity range is one of rises
    answer, _, _ = exported(table, "sinumerik_temperature", tmp_path)
    assert answer["files"][0]["error"] == "X not assessed"


def test_an_export_whose_losses_count_the_constant_is_still_verified(tmp_path):
    """As an errpipe before wrote them: the figures cannot be compared, the checksums can."""
    exported(machines.bent(), "fanuc_pitch", tmp_path)
    path = tmp_path / "out" / "export.json"
    document = json.loads(path.read_text())
    for row in document["files"]:
        for lost in row["losses"]:
            del lost["constant_um"], lost["assessed"]
            lost["rms_um"] += 20.0
    jsonfile.write(path, document)
    assert verify(tmp_path / "out")["checks"] >= 4


def test_a_control_with_too_few_tables_says_what_to_do():
    (cec,) = (t for t in TARGETS if t.name == "sinumerik_cec")
    with pytest.raises(GateError, match=r"tables are needed, 8 fit: correct fewer .* compare-targets"):
        cec.write(machine(thermal=False))


def test_files_that_are_loaded_together_are_judged_together(tmp_path):
    """The curves of one thermal state do harm alone; with the slope per kelvin beside them they do not."""
    _artefacts.write_table(tmp_path, scale(24.0))
    both = ["sinumerik_lec", "sinumerik_temperature"]
    rows = stage.export(tmp_path / "table.ect", both, tmp_path / "out")["files"]
    assert {r["file"].split("/")[0] for r in rows} == set(both) and not any("worse" in r for r in rows)
