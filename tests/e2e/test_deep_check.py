"""Configuration faults that `run` refuses: `check` finds each of them, at its line, without running anything."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from errpipe.cli.app import main
from errpipe.simulation import folder
from tests.unit.validation.wrong_declarations import axis_test

PIPELINE = """pipeline: 1
title: Axis test
stages:
  - kind: ingest
    recording: rec
  - kind: clean
    rules: [{rule: unit_slips, trust: [T_nut]}]
  - kind: fit
    components:
      - component: EXX
        terms:
          - {term: offset}
          - {term: chebyshev, axis: X, degree: 5}
          - {term: backlash, axis: X}
          - {term: scale_expansion, axis: X, sensor: T_nut}
    holdout: {scheme: leave-one-run-out}
  - kind: validate
    iso230_2: true
  - kind: export
    targets: [linuxcnc_screw]
  - kind: report
"""

# what is wrong: (in the pipeline or the manifest: text, its replacement, words that the message holds)
UNJUDGED = "an export that nothing judges"  # a run gets as far as its gate, and writes the report of a refusal
PIPELINE_FAULTS = {
    "recording not there": ("recording: rec", "recording: rek", "rek does not exist"),
    "no manifest in the folder": ("recording: rec", "recording: empty", "holds no recording.yaml"),
    "a table in place of a recording": ("recording: rec", "recording: rec/t.csv", "is a table, no recording"),
    "sensor is the error": ("sensor: T_nut", "sensor: EXX", "'EXX' is no temperature (role error)"),
    "a component twice": (
        "    holdout:",
        "      - {component: EXX, terms: [{term: offset}]}\n    holdout:",
        "listed twice",
    ),
    "a slot that no stage has": ("    iso230_2: true", "    from: {model: fit}", "has no such source"),
    "a limit in the wrong unit": ("targets: [", "limit: 3 degC\n    targets: [", "found unit 'degC'"),
    "no such format": ("recording: rec", "recording: rec\n    format: ecmc", "no format is named 'ecmc'"),
    "component not recorded": ("component: EXX", "component: EYY", "no error of EYY (it has: EXX)"),
    "component misspelt": ("component: EXX", "component: EXY", "no error of EXY"),
    "axis without a position": ("chebyshev, axis: X", "chebyshev, axis: Z", "no position of axis Z"),
    "backlash of another axis": ("backlash, axis: X", "backlash, axis: B", "direction of axis B"),
    "sensor misspelt": (
        "sensor: T_nut",
        "sensor: T_nutt",
        "'T_nutt' (temperatures: T_nut, T_air). Did you mean T_nut?",
    ),
    "sensor is a position": ("sensor: T_nut", "sensor: x", "'x' is no temperature (role command)"),
    "sensor is a direction": ("sensor: T_nut", "sensor: dir", "is no temperature (role direction)"),
    "the same term twice": ("{term: backlash, axis: X}", "{term: offset}", "the same term twice"),
    "velocity not recorded": ("backlash, axis: X", "following_error, axis: X, column: v", "no column 'v'"),
    "gradient of one sensor": ("backlash, axis: X", "gradient_bending, first: T_nut, second: T_bed", "'T_bed'"),
    "unknown term": ("term: backlash", "term: backlsh", "backlash"),
    "unknown option of a term": ("degree: 5", "degre: 5", "degre"),
    "more parameters than targets": ("degree: 5", "degree: 40", "40 parameters over x, which has 21 different values"),
    "degree as text": ("degree: 5", "degree: five", "degree"),
    "negative degree": ("degree: 5", "degree: -5", "degree"),
    "unknown stage": ("kind: validate", "kind: valdate", "validate"),
    "unknown option of a stage": ("iso230_2: true", "iso230: true", "iso230"),
    "a word for a truth value": ("iso230_2: true", "iso230_2: yes", "iso230_2"),
    "unknown target": ("[linuxcnc_screw]", "[linuxcnc_scrw]", "no target 'linuxcnc_scrw'"),
    "a target twice": ("[linuxcnc_screw]", "[linuxcnc_screw, linuxcnc_screw]", "listed twice"),
    "one unknown of two targets": ("[linuxcnc_screw]", "[linuxcnc_screw, siemens]", "no target 'siemens'"),
    "group not recorded": ("scheme: leave-one-run-out", "scheme: leave-one-group-out, of: day", "epoch"),
    "group misspelt": ("scheme: leave-one-run-out", "scheme: leave-one-group-out, of: sesaon", "no group 'sesaon'"),
    "unknown scheme": ("leave-one-run-out", "leave-one-out", "leave-one-run-out"),
    "trusted column not there": ("trust: [T_nut]", "trust: [T_oil]", "no column 'T_oil'"),
    "unknown rule": ("rule: unit_slips", "rule: unit_slip", "unit_slips"),
    "unknown allowance": ("targets: [", "allow: [everything]\n    targets: [", "allow"),
    "negative limit": ("targets: [", "limit: -5\n    targets: [", "limit"),
    "error bound in the wrong unit": ("targets: [", "error_bound: 1 degC\n    targets: [", "error_bound"),
    "a model from a stage that gives none": (
        "    iso230_2: true",
        "    iso230_2: true\n    from: {error_model: clean}",
        "no earlier stage 'clean' gives an error model",
    ),
    "two stages of one name": ("  - kind: report\n", "  - kind: report\n  - kind: report\n", "second stage"),
    "from an unknown stage": ("  - kind: report\n", "  - {kind: report, from: {recording: ingst}}\n", "ingst"),
    "title given twice": ("title: Axis test", "title: Axis test\ntitle: Test", "title"),
    "another version": ("pipeline: 1", "pipeline: 2", "pipeline"),
    "unknown key": ("title: Axis test", "titel: Axis test", "titel"),
    "season of a missing response": (
        "    components:\n      - component: EXX",
        "    family: season\n    component: E_Z\n#",
        "",
    ),
    "unknown family": ("  - kind: fit\n", "  - kind: fit\n    family: neural\n", "family"),
    "simulated values not recorded": (
        "  - kind: report\n",
        "  - {kind: twin, name: beside, by: {kind: recorded}}\n  - {kind: diagnose}\n",
        "no column of role simulated",
    ),
    "a CSV simulation without a file": (
        "  - kind: report\n",
        "  - {kind: twin, by: {kind: csv, columns: {EXX: {column: a, unit: um}}}}\n  - {kind: diagnose}\n",
        "needs `file`",
    ),
    UNJUDGED: (
        "  - kind: validate\n    iso230_2: true\n  - kind: export\n    targets: [linuxcnc_screw]\n",
        "  - kind: export\n  - kind: validate\n",
        "nothing before it judges its model",
    ),
    "a component without terms": (
        PIPELINE[PIPELINE.index("        terms:") : PIPELINE.index("    holdout:")],
        "        terms: []\n",
        "no term is named",
    ),
    "sensor is a time": ("{term: backlash, axis: X}", "{term: thermal_lag, sensor: t}", "'t' is no temperature"),
    "a machine file that is none": (
        "  - kind: report\n",
        "  - {kind: identify, machine: p.yaml}\n  - {kind: export_volumetric, name: volumetric}\n",
        "machine",
    ),
}
MANIFEST_FAULTS = {
    "unit of another role": ("unit: degC", "unit: mm", "not a unit of role temperature"),
    "unknown role": ("role: direction", "role: directon", "direction"),
    "unknown component": ("component: EXX", "component: EXQ", "EXQ"),
    "component in another unit": ("component: EXX", "component: EBX", "EBX is measured in urad"),
    "axis missing": ("role: direction, axis: X", "role: direction", "needs an axis"),
    "column misspelt": ("  T_air:", "  T_aire:", "no such column"),
    "column not declared": ("  T_air:", "  #T_air:", "'T_air' that is not declared"),
    "table not there": ("t.csv", "u.csv", "no such file next to the manifest"),
    "a word where numbers are": ("  run: ", "  x1: ", ""),
    "derived of nothing": ("component: EXX", "component: EXX, derived: {minus: [x, actual]}", "'actual'"),
    "derived in two ways": ("component: EXX", "component: EXX, derived: {of: x, constant: 1}", "one of minus"),
}


@pytest.fixture
def where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    folder.write(tmp_path / "rec", axis_test())
    (tmp_path / "empty").mkdir()
    (tmp_path / "p.yaml").write_text(PIPELINE)
    return tmp_path


def plant(where: Path, file: str, old: str, new: str) -> None:
    text = (where / file).read_text()
    assert old in text, f"the fault cannot be planted: {old!r} is not in {file}"
    (where / file).write_text(text.replace(old, new, 1))


def test_there_are_forty_and_more() -> None:
    assert len(PIPELINE_FAULTS) + len(MANIFEST_FAULTS) >= 40


def test_the_pipeline_itself_is_fine(where: Path) -> None:
    assert main(["check", "p.yaml", "rec"]) == 0


@pytest.mark.parametrize("rows", [0, 1], ids=["empty", "header only"])
def test_a_table_that_is_just_being_written(rows: int, where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = where / "rec/t.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:rows]))
    assert main(["check", "p.yaml"]) == 2
    assert capsys.readouterr().err.count("t.csv has no rows") == 1


CASES = [("p.yaml", name) for name in PIPELINE_FAULTS] + [("rec/recording.yaml", name) for name in MANIFEST_FAULTS]


@pytest.mark.parametrize(("file", "name"), CASES, ids=[name for _, name in CASES])
def test_check_finds_it(file: str, name: str, where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, words = (PIPELINE_FAULTS if file == "p.yaml" else MANIFEST_FAULTS)[name]
    plant(where, file, old, new)
    assert main(["check", "p.yaml"]) == 2, name
    heard = capsys.readouterr()
    assert re.match(rf"{'' if file == 'p.yaml' else '.*'}(p|rec.recording)[.]yaml:\d+:\d+  ", heard.err), heard.err
    assert words in heard.err and "internal error" not in heard.err


HARMLESS = ("a target twice", "trusted column not there")  # `run` writes the target once, and trusts nobody
REFUSED = [case for case in CASES if case[1] not in HARMLESS]


@pytest.mark.slow
@pytest.mark.parametrize(("file", "name"), REFUSED, ids=[name for _, name in REFUSED])
def test_run_refuses_it_in_the_same_way(file: str, name: str, where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, _ = (PIPELINE_FAULTS if file == "p.yaml" else MANIFEST_FAULTS)[name]
    plant(where, file, old, new)
    code = main(["run", "p.yaml", "--out", "../out"])
    heard = capsys.readouterr()
    shutil.rmtree(where.parent / "out", ignore_errors=True)
    assert code in (2, 3) or (code, name) == (4, UNJUDGED), (code, heard.err)
    assert "internal error" not in heard.err and "KeyError" not in heard.err


def test_all_at_once(where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for old, new in (
        ("sensor: T_nut", "sensor: T_nu"),
        ("chebyshev, axis: X", "chebyshev, axis: Q"),
        ("[linuxcnc_", "[hal_"),
    ):
        plant(where, "p.yaml", old, new)
    assert main(["check", "p.yaml"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(":")[1] for line in lines] == ["13", "15", "20"]


def test_a_missing_sensor_is_no_internal_error(where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant(where, "p.yaml", "sensor: T_nut", "sensor: T_bed")
    assert main(["run", "p.yaml", "--out", "../out"]) == 2
    heard = capsys.readouterr().err
    assert "p.yaml:15:" in heard and "no column 'T_bed' (temperatures: T_nut, T_air)" in heard


def test_a_check_imports_nothing_heavy(where: Path) -> None:
    code = (
        "import sys; from errpipe.cli.app import main; main(['check', 'p.yaml']); "
        "print(*(n for n, m in sys.modules.items() if getattr(m, '__spec__', None)), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in run.stderr.split()}
    assert not loaded & {"pandas", "scipy", "sklearn", "numba", "matplotlib", "pyarrow", "jinja2", "http"}


@pytest.mark.parametrize("family", ["auto", "lagged", "season"])
def test_a_thermal_family_without_a_temperature(family: str, where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stages = f"  - {{kind: ingest, recording: rec}}\n  - kind: fit\n    family: {family}\n    component: EXX\n"
    (where / "p.yaml").write_text(f"pipeline: 1\nstages:\n{stages}")
    assert main(["check", "p.yaml"]) == 0
    manifest = where / "rec" / "recording.yaml"
    manifest.write_text(re.sub(r"\{role: temperature[^}]*\}", "{role: ignore}", manifest.read_text()))
    capsys.readouterr()
    assert main(["check", "p.yaml"]) == 2
    assert re.search(r"p[.]yaml:5:\d+  .*has no temperature", capsys.readouterr().err)
    assert main(["run", "p.yaml", "--out", "../out"]) == 2
    assert "has no temperature" in capsys.readouterr().err


def test_push_tests_without_their_force_or_place_and_a_diameter_without_an_axis(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(Path(__file__).parents[2] / "examples" / "cutting-force", tmp_path / "lathe")
    pipeline, manifest = tmp_path / "lathe" / "pipeline.yaml", tmp_path / "lathe" / "push-tests" / "recording.yaml"
    assert main(["check", str(pipeline)]) == 0
    manifest.write_text(manifest.read_text("utf-8").replace('"E_X"}', '"E_D"}'), encoding="utf-8")
    text = pipeline.read_text("utf-8").replace("component: E_X", "component: E_D")
    faults = {
        "no axis corrects E_D": ("", ""),
        "'E_Q' is not exported (E_D)": ("- kind: export", "- kind: export\n    acts_on: {E_Q: {axis: X}}"),
        "no column 'G'": ("force: F ", "force: G "),
        "axis X": ("axis: Z", "axis: X"),
    }
    for words, (old, new) in faults.items():
        pipeline.write_text(text.replace(old, new), encoding="utf-8")
        capsys.readouterr()
        assert main(["check", str(pipeline)]) == 2
        assert words in re.sub(r"\s+", " ", "".join(capsys.readouterr()))
