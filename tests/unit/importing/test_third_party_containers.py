"""Nested MATLAB structures, pages and XML, and logs of probing cycles: known truth in unfamiliar containers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from errpipe.cli.app import main
from errpipe.errors import DataError
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows, prepared

MADE, MEASURED = "actual-minus-commanded", "commanded-minus-actual"
RUN, TARGET, SIDE, ERROR = (np.array([float(row[k]) for row in long_rows()]) for k in range(4))
COLUMNS = {"run": RUN, "target_mm": TARGET, "direction": SIDE, "error_um": ERROR}


def runs_of_structures() -> np.ndarray:
    out = np.zeros((3,), dtype=[("name", "O"), *((n, "O") for n in COLUMNS if n != "run")])
    for k in range(3):
        out[k] = (f"run{k + 1}", *(c[k + 1 == RUN] for n, c in COLUMNS.items() if n != "run"))
    return out


def by_side() -> dict[str, Any]:
    up, down = (np.stack([ERROR[(r == RUN) & (s == SIDE)][:: int(s)] for r in (1, 2, 3)], axis=1) for s in (1.0, -1.0))
    return {"target_mm": TARGET[:13], "error_um": {"forward": up, "backward": down}}


NESTED: dict[str, Any] = {
    "rows": {"result": {"axisX": COLUMNS, "info": {"date": "2025"}}},
    "structures within": {"meas": {"info": {"axis": "X"}, "data": by_side()}},
    "array of structures": {"X": runs_of_structures()},
    "matrix and names": {
        "data": np.stack([*COLUMNS.values()], axis=1),
        "names": np.array([*COLUMNS], dtype=object),
        "axis": "X",
    },
}


@pytest.mark.parametrize("form", NESTED)
def test_nested_structures(tmp_path: Path, form: str) -> None:
    savemat(tmp_path / "a.mat", NESTED[form])
    holds_the_truth(imported(tmp_path, tmp_path / "a.mat"))


def test_a_structure_that_states_its_sign_is_asked_about_or_turned(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"X": {**COLUMNS, "error_um": -ERROR, "note": "error = nominal - measured"}})
    holds_the_truth(imported(tmp_path, tmp_path / "a.mat"))


def test_signals_of_one_clock(tmp_path: Path) -> None:
    t = np.arange(500) * 0.004
    x = 100 + 120 * np.sin(t)
    savemat(tmp_path / "a.mat", {"logs": {n: {"Time": t, "Data": v} for n, v in (("x_cmd", x), ("x_act", x + 0.01))}})
    recording = imported(tmp_path, tmp_path / "a.mat")
    assert recording.array("EXX") == pytest.approx(np.full(500, 10.0), abs=1e-6)
    assert recording.array(recording.names("time")[0]) == pytest.approx(t)


def test_sheets_of_two_axes_are_distinguished(tmp_path: Path) -> None:
    other = {**COLUMNS, "error_um": ERROR + 7}
    savemat(tmp_path / "a.mat", {"laser": {"Y": other, "X": COLUMNS}})
    from errpipe.importing.sheet import ReaderOptions

    holds_the_truth(imported(tmp_path, tmp_path / "a.mat", ReaderOptions(sheet="X")))


def page(tag: str) -> str:
    rows = [["Run", "Direction", "Target [mm]", "Error [µm]"]]
    rows += [[r, "+" if s > 0 else "-", f"{x:.3f}", f"{d:g}"] for r, x, s, d in long_rows()]
    if tag == "page without ends":
        cells = "".join("<tr>" + "".join(f"<td>{c}" for c in row) + "\n" for row in rows)
        return f"<!DOCTYPE html><html><table><tr><td>Axis<td>X</table><table>{cells}</table></html>"
    if tag == "html":
        cells = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>\n" for row in rows)
        return f"<html><meta charset='utf-8'><h2>Axis: X</h2><table>{cells}</table></html>"
    if tag == "workbook":
        cells = "".join("<Row>" + "".join(f"<Cell><Data>{c}</Data></Cell>" for c in row) + "</Row>\n" for row in rows)
        return f"<?xml version='1.0'?><Workbook><Worksheet Name='X axis'><Table>{cells}</Table></Worksheet></Workbook>"
    names = ("run", "direction", "target_mm", "error_um")
    cells = "".join(
        "<point>" + "".join(f"<{n}>{c}</{n}>" for n, c in zip(names, row, strict=True)) + "</point>\n"
        for row in rows[1:]
    )
    return f"<?xml version='1.0'?><test Achse='X'><points>{cells}</points></test>"


@pytest.mark.parametrize("tag", ["html", "page without ends", "workbook", "records"])
def test_pages_and_xml(tmp_path: Path, tag: str) -> None:
    file = tmp_path / "a.xls"
    file.write_text(page(tag), encoding="utf-8")
    holds_the_truth(imported(tmp_path, file))


def test_a_trace_that_does_not_repeat_a_value(tmp_path: Path) -> None:
    """A SINUMERIK writes the signals of a record that changed; names stand in elements with the same id."""
    x = np.round(100 + 50 * np.sin(np.arange(500) / 60), 2)
    lines = ["<?xml version='1.0'?><traceSession><traceData><dataFrame>"]
    lines += ['<dataSignal id="f1" description="Position setpoint (64 bit) X1" unitsType="position"/>']
    lines += ['<dataSignal id="f2" description="Actual position (64 bit) X1" unitsType="position"/>']
    last = None
    for k, a in enumerate(x):
        lines.append(f'<rec time="{k / 500:.3f}"' + ("" if a == last else f' f1="{a}" f2="{a + 0.01:.2f}"') + "/>")
        last = a
    assert sum("f1=" not in line for line in lines) > 5
    file = tmp_path / "trace.xml"
    file.write_text("\n".join([*lines, "</dataFrame></traceData></traceSession>"]), encoding="utf-8")
    assert imported(tmp_path, file).array("EXX") == pytest.approx(np.full(500, 10.0), abs=1e-6)


HOLES = [(x, y) for y in (50.0, 150.0, 250.0) for x in (50.0, 200.0, 350.0)]
ENGLISH = ("NOMINAL VALUES", "ACTUAL VALUES", "DEVIATIONS", "CENTER IN REFERENCE AXIS", "CENTER IN MINOR AXIS")
GERMAN = ("SOLLWERTE", "ISTWERTE", "ABWEICHUNGEN", "MITTE HAUPTACHSE", "MITTE NEBENACHSE")


def probing_log(made: bool, words: tuple[str, ...]) -> list[str]:
    """TCHPR421.TXT: each hole between headings. The machine is 10 um too long at X = 350 mm."""
    out = []
    for n, (x, y) in enumerate(HOLES):
        dx = 0.010 * x / 350 * (1 if made else -1)
        out += ["MEASURING LOG TOUCH PROBE CYCLE 421", f"TIME: 8:0{n}:04", f"{words[0]}:"]
        out += [f"{words[3]}: {x:.4f}", f"{words[4]}: {y:.4f}", "DIAMETER: 12.0000", "GIVEN LIMIT VALUES:"]
        out += [f"MAXIMUM LIMIT FOR {words[3]}: {x + 0.1:.4f}", f"{words[1]}:", f"{words[3]}: {x + dx:.4f}"]
        out += [f"{words[4]}: {y:.4f}", f"{words[2]}:", f"{words[3]}: {dx:.4f}", f"{words[4]}: 0.0000"]
        out += ["FURTHER MEASURING RESULTS: MEASURING HEIGHT: -5.0000", "END OF MEASURING LOG"]
    return out


@pytest.mark.parametrize("words", [ENGLISH, GERMAN])
@pytest.mark.parametrize("made", [True, False])
def test_the_log_of_a_probing_cycle(tmp_path: Path, words: tuple[str, ...], made: bool) -> None:
    file = tmp_path / "TCHPR421.TXT"
    file.write_text("\n".join(probing_log(made, words)), encoding="utf-8")
    with pytest.raises(DataError, match="was a part or an artefact measured") as asked:
        prepared([file])
    assert "lacks rows" not in str(asked.value)
    recording = imported(tmp_path, file, sign=MADE if made else MEASURED)
    assert recording.array("X") == pytest.approx([x for x, _ in HOLES])
    assert recording.array("E_X") == pytest.approx([10.0 * x / 350 for x, _ in HOLES], abs=0.06)


PRINTED = [(350 * k / 10, round(0.001 * k + 0.0006 * np.sin(2 * (10 - k)), 4)) for k in range(11)]  # mm


def printed(sign: str) -> None:
    """Three prints of eleven bores; a machine that measured the bores of another shows minus its deviations."""
    turn = 1.0 if sign == MADE else -1.0
    rows = [f"H{k};X;{x:.3f};{x + turn * d:.4f}" for k, (x, d) in enumerate(PRINTED)]
    Path("a.csv").write_text("\n".join(["Feature;Axis;Nominal [mm];Actual [mm]", *rows] * 3), encoding="utf-8")


def nested(sign: str) -> None:
    """The deviations of the other tests, made smaller: 10 um too long at the end."""
    read = ERROR * (10.0 / ERROR[TARGET == 600.0].mean()) * (1.0 if sign == MADE else -1.0)
    savemat("a.mat", {"meas": {"X": {**COLUMNS, "error_um": read}}})


@pytest.mark.parametrize("sign", [MADE, MEASURED])
@pytest.mark.parametrize("write, name, end", [(printed, "a.csv", 350.0), (nested, "a.mat", 600.0)])
def test_a_machine_that_is_too_long_to_a_controller_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Any, name: str, end: float, sign: str
) -> None:
    """10 um too long at +X: the screw file takes them away there, whichever sign the file has."""
    monkeypatch.chdir(tmp_path)
    write(sign)
    assert main(["import", name, "--sign", sign, "--out", "recording", "--yes"]) == 0
    assert main(["init", "--template", "laser-iso230", "work", "--recording", "recording"]) == 0
    text, targets = Path("work/pipeline.yaml").read_text("utf-8"), "sinumerik_lec, linuxcnc_screw, heidenhain_com"
    assert targets in text
    Path("work/pipeline.yaml").write_text(text.replace(targets, "linuxcnc_screw"), "utf-8")
    assert main(["run", "work/pipeline.yaml", "--out", "out", "--to", "export"]) == 0
    steps = np.loadtxt("out/export/linuxcnc_screw/x.comp")
    at = steps[np.argmin(np.abs(steps[:, 0] - end)), 1:].mean()
    assert 1e3 * (at if abs(at) < 1.0 else at - end) == pytest.approx(-10.0, abs=1.0)


def test_a_sign_that_both_positions_contradict_is_refused(tmp_path: Path) -> None:
    """It was ignored: the error is actual less commanded, which the declaration contradicts."""
    rows = [f"{x:g},{x + d / 1e3:.4f}" for _, x, s, d in long_rows()]
    (tmp_path / "a.csv").write_text("\n".join(["X commanded [mm],X actual [mm]", *rows]), encoding="utf-8")
    with pytest.raises(DataError, match="--sign would be ignored"):
        prepared([tmp_path / "a.csv"], sign=MEASURED)


def test_a_print_along_one_axis_is_asked_about(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was a table of positions: a step gauge that the machine read would have doubled its error."""
    monkeypatch.chdir(tmp_path)
    printed(MADE)
    with pytest.raises(DataError, match="was a part or an artefact measured"):
        prepared([Path("a.csv")])


PRINTS = {
    "words before all coordinates": lambda x, y, a, b: [f"NOM X{x:.4f} Y{y:.4f} ACT X{a:.4f} Y{b:.4f}"],
    "columns per axis": lambda x, y, a, b: [f"B;{x:.4f};{y:.4f};{a:.4f};{b:.4f}"],
}


@pytest.mark.parametrize("form", PRINTS)
def test_prints_of_other_layouts(tmp_path: Path, form: str) -> None:
    lines = ["Ball;X calibrated [mm];Y calibrated [mm];X measured [mm];Y measured [mm]"] if "columns" in form else []
    for x, y in HOLES:
        lines += PRINTS[form](x, y, x - 0.010 * x / 350, y)
    (tmp_path / "a.txt").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(DataError, match="was a part or an artefact measured"):
        prepared([tmp_path / "a.txt"])
    recording = imported(tmp_path, tmp_path / "a.txt", sign=MEASURED)
    assert recording.array("E_X") == pytest.approx([10.0 * x / 350 for x, _ in HOLES], abs=0.06)
