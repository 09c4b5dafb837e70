"""`errpipe compare`: what changed, where, by how many um; figures are known by hand."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.domain import driver as d
from errpipe.domain.diagnosis import Diagnosis, Finding, HoldOutFigures, ResponseDiagnosis
from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedParameter, FittedTerm, Validity
from errpipe.drivers.lowered import Lowered
from errpipe.tables import ect
from errpipe.verbs import compare as verb
from tests.e2e.retrain.test_retrain import PIPELINE, record
from tests.unit.targets import machines


def asked(*words: str | Path, capsys: Any) -> tuple[int, dict[str, Any]]:
    """Exit code and result document of one comparison."""
    capsys.readouterr()
    code = main(["compare", *map(str, words), "--json"])
    return code, json.loads(capsys.readouterr().out)["result"]


def table(path: Path, *pairs: Lowered) -> Path:
    ect.write(machines.compile_(("EXX", list(pairs))), path)
    return path


def test_a_machine_10_um_too_long_at_plus_x_becomes_14(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """The difference is a straight line: 4 um at x = 500, 4 / sqrt(3) rms; the sign is that of the deviation."""
    old = table(tmp_path / "old.ect", machines.straight("X", 10.0))
    new = table(tmp_path / "new.ect", machines.straight("X", 14.0))
    code, answer = asked(old, new, "--max-um", "4.1", capsys=capsys)
    (change,) = answer["changes"]
    assert code == 0 and answer["within"] is True
    assert change["largest"] == pytest.approx(4.0, abs=0.01) and change["rms"] == pytest.approx(4 / 3**0.5, rel=0.03)
    assert change["at"]["x"] == pytest.approx(500.0) and change["new"] - change["old"] == pytest.approx(4.0, abs=0.01)
    assert change["goes_with"] == "x" and change["share"] > 0.97
    code, answer = asked(old, new, "--max-um", "3.9", capsys=capsys)
    assert code == 4 and answer["within"] is False
    assert asked(old, old, "--max-um", "0", capsys=capsys)[0] == 0


def test_directions_and_time_constants_count_although_places_at_rest_agree(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    def gap(um: float) -> Lowered:
        return Lowered(d.Direction(axis="X"), None, lambda x: np.full(np.shape(x), um / 2))

    def slow(tau: float) -> Lowered:
        lag = d.Lag(of=d.Affine(offset=-20.0, weights=(1.0,), of=(d.Input(name="T"),)), tau_up=tau, tau_down=tau)
        return Lowered(lag, None, lambda x: np.full(np.shape(x), 2.0))

    _, answer = asked(table(tmp_path / "s.ect", slow(60.0)), table(tmp_path / "f.ect", slow(600.0)), capsys=capsys)
    assert answer["changes"][0]["settled"] < 0.1 * answer["largest_um"]
    assert main(["compare", str(tmp_path / "s.ect"), str(tmp_path / "f.ect")]) == 0
    assert "once settled" in capsys.readouterr().out
    _, answer = asked(table(tmp_path / "a.ect", gap(6.0)), table(tmp_path / "b.ect", gap(2.0)), capsys=capsys)
    assert answer["largest_um"] == pytest.approx(2.0, abs=0.01)
    _, answer = asked(table(tmp_path / "c.ect", slow(600.0)), table(tmp_path / "d.ect", slow(1200.0)), capsys=capsys)
    (change,) = answer["changes"]
    # 7.5 K beyond the middle of 15..30 degC: 15 um, of which the slower one lacks exp(-1/2) - exp(-1) after 600 s
    assert change["largest"] == pytest.approx(15.0 * (np.exp(-0.5) - np.exp(-1.0)), rel=0.1)
    assert change["at"]["seconds after a step"] == 600.0


def model(path: Path, alpha: float, ci: tuple[float, float], top: float = 30.0) -> Path:
    term = {"term": "scale_expansion", "axis": "X", "sensor": "T"}
    parameter = FittedParameter(name="coefficient", value=alpha, unit="um/m/K", ci95=ci)
    columns = {"x": {"role": "position", "axis": "X", "unit": "mm"}, "T": {"role": "temperature", "unit": "degC"}}
    outcome = ErrorModel(
        components=(ComponentModel(component="EXX", terms=(FittedTerm(term=term, parameters=(parameter,)),)),),
        columns=columns,
        validity=Validity(ranges={"x": (0.0, 1000.0), "T": (20.0, top)}),
    )
    path.write_text(outcome.model_dump_json(), encoding="utf-8")
    return path


def test_models_say_which_parameter_moved_and_how_far(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    old, new = model(tmp_path / "a.json", 11.0, (10.5, 11.5)), model(tmp_path / "b.json", 13.0, (12.5, 13.5), top=35.0)
    assert main(["compare", str(old), str(new)]) == 0
    text = capsys.readouterr().out
    assert "coefficient: 11 -> 13 um/m/K, outside its 95 % interval" in text
    assert "validity of T: 20 .. 30 -> 20 .. 35" in text
    _, answer = asked(old, new, "--figure", tmp_path / "f.svg", capsys=capsys)
    assert answer["largest_um"] == pytest.approx(2.0 * 15.0)  # um/m/K times 1 m times 15 K: over the wider box
    assert (tmp_path / "f.svg").read_text(encoding="utf-8").startswith("<svg")


def test_an_axis_whose_column_has_another_name_is_asked_at_one_place(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """The same model from a recording that calls X `x_pos` differs by nothing, not by what two places differ by."""
    old, new = model(tmp_path / "a.json", 11.0, (10.5, 11.5)), model(tmp_path / "b.json", 11.0, (10.5, 11.5))
    new.write_text(new.read_text(encoding="utf-8").replace('"x"', '"x_pos"'), encoding="utf-8")
    code, answer = asked(old, new, "--max-um", "0", capsys=capsys)
    assert code == 0 and answer["largest_um"] == 0.0
    assert main(["compare", str(old), str(new)]) == 0
    assert "x in the old one and x_pos in the new one are one axis: evaluated as one" in capsys.readouterr().out
    other = model(tmp_path / "c.json", 13.0, (12.5, 13.5))
    other.write_text(other.read_text(encoding="utf-8").replace('"x"', '"x_pos"'), encoding="utf-8")
    _, answer = asked(old, other, capsys=capsys)
    assert answer["largest_um"] == pytest.approx(2.0 * 10.0)  # um/m/K times 1 m times 10 K


def test_a_figure_of_another_kind_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    old = model(tmp_path / "a.json", 11.0, (10.5, 11.5))
    assert main(["compare", str(old), str(old), "--figure", str(tmp_path / "f.png")]) == 2
    assert "is drawn as SVG" in capsys.readouterr().err and not (tmp_path / "f.png").exists()


def test_a_changed_reading_a_new_run_and_a_lost_column(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    record(tmp_path / "old", 5)
    record(tmp_path / "new", 6)
    file = tmp_path / "new" / "recording.csv"
    lines = file.read_text(encoding="utf-8").splitlines()
    *cells, last = lines[30].split(",")
    lines[30] = ",".join([*cells, f"{float(last) + 7:.3f}"])
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")
    code, answer = asked(tmp_path / "old", tmp_path / "new", "--max-um", "5", capsys=capsys)
    assert code == 4 and answer["largest_um"] == pytest.approx(7.0)
    assert answer["columns"] == {"EXX": {"rows": 1, "largest": pytest.approx(7.0), "rms": pytest.approx(7 / 110**0.5)}}
    assert answer["only_in_new"]["run"] == ["day 5"] and answer["only_in_old"]["run"] == []


def test_a_shift_of_a_recording_is_drawn_and_where_it_stands_is_reported(tmp_path: Path, capsys: Any) -> None:
    """From run day 3 on 5 um more: no column of the recording explains it, the number of the run does."""
    record(tmp_path / "old", 6)
    record(tmp_path / "new", 6, read_from=3, as_read=lambda um: um + 5.0)
    figure = tmp_path / "f.svg"
    assert main(["compare", str(tmp_path / "old"), str(tmp_path / "new"), "--figure", str(figure)]) == 0
    said = capsys.readouterr().out
    assert "100% of it correlates with run number: on average +0 um near 1, +5 near" in said
    assert "run number" in figure.read_text(encoding="utf-8")
    for name, reading in (("low", 1.0), ("high", 6.0)):
        record(tmp_path / name, 2, as_read=lambda um, r=reading: r)
    main(["compare", str(tmp_path / "low"), str(tmp_path / "high"), "--figure", str(figure)])
    assert "new - old, um" in figure.read_text(encoding="utf-8")
    main(["compare", str(tmp_path / "old"), str(tmp_path / "old"), "--figure", str(figure)])
    assert "no difference" in figure.read_text(encoding="utf-8")


@pytest.mark.parametrize("change", [("EXX", "Abw", 1), ("component: EXX", "component: EYX", -1)])
def test_deviations_that_the_other_does_not_hold_are_within_no_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture, change: tuple[str, str, int]
) -> None:
    """A column of another name, or of another component under the same one."""
    record(tmp_path / "old", 3)
    record(tmp_path / "new", 3)
    for file in (tmp_path / "new" / "recording.yaml", tmp_path / "new" / "recording.csv"):
        file.write_text(file.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    code, answer = asked(tmp_path / "old", tmp_path / "new", "--max-um", "1000", capsys=capsys)
    assert code == 4 and answer["within"] is False and answer["largest_um"] is None


def test_tables_of_separate_stretches_state_it(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    def model_of(name: str, low: float, high: float) -> Path:
        path = model(tmp_path / name, 11.0, (10.5, 11.5))
        path.write_text(path.read_text().replace("[0.0,1000.0]", f"[{low},{high}]"), encoding="utf-8")
        return path

    assert main(["compare", str(model_of("a.json", 0.0, 500.0)), str(model_of("b.json", -500.0, 0.0))]) == 0
    assert "validity of x: 0 .. 500 -> -500 .. 0, apart" in capsys.readouterr().out


def diagnosis(path: Path, **size: float) -> Path:
    matches = [Finding(effect=effect, confidence=0.9, rms_um=um) for effect, um in size.items()]
    held = HoldOutFigures(scheme="runs", rms_before_um=9.0, rms_after_um=1.0)
    response = ResponseDiagnosis(
        component="EXX",
        verdict="missing_physics" if matches else "no_mismatch",
        rms_before_um=9.0,
        rms_after_um=1.0,
        noise_floor_um=0.8,
        holdout=held,
        findings=tuple(matches),
    )
    path.write_text(json.dumps(Diagnosis(responses=(response,)).document()), encoding="utf-8")
    return path


def test_a_finding_that_is_new_counts_with_its_whole_size(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    old, new = diagnosis(tmp_path / "a.json", backlash=3.0), diagnosis(tmp_path / "b.json", backlash=3.5, sag=6.0)
    code, answer = asked(old, new, "--max-um", "5", capsys=capsys)
    assert code == 4 and answer["largest_um"] == 6.0
    assert answer["responses"]["EXX"]["effects"] == [["backlash"], ["backlash", "sag"]]
    assert main(["compare", str(old), str(new), "--figure", str(tmp_path / "f.svg")]) == 0
    assert "EXX: sag" in (tmp_path / "f.svg").read_text(encoding="utf-8")


def test_a_response_that_is_gone_counts_with_what_was_found_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    old, new = diagnosis(tmp_path / "a.json", backlash=3.0), diagnosis(tmp_path / "b.json", backlash=6.0)
    new.write_text(new.read_text().replace('"EXX"', '"EYY"'), encoding="utf-8")
    code, answer = asked(old, new, "--max-um", "5", capsys=capsys)
    assert code == 4 and answer["largest_um"] == 6.0


def test_two_runs_of_a_pipeline_and_two_kinds(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "axis.yaml").write_text(PIPELINE, encoding="utf-8")
    for name, changed in (("old", None), ("new", 0)):
        record(tmp_path / "recording", 12, changed_from=changed)
        assert main(["run", str(tmp_path / "axis.yaml"), "--out", str(tmp_path / name)]) == 0
    code, answer = asked(tmp_path / "old", tmp_path / "new", "--max-um", "5", capsys=capsys)
    # 6 um/m/K more over 0.6 m and a few kelvin
    assert code == 4 and 10.0 < answer["largest_um"] < 60.0
    artefacts = answer["stages"]["fit"]["artefacts"]["error_model.json"]
    moved = {p["parameter"]: p["new"] - p["old"] for p in artefacts["parameters"]}
    assert moved["EXX scale_expansion(X, T_nut).coefficient"] == pytest.approx(6.0, abs=0.6)
    assert "EXX" in answer["stages"]["validate"]["artefacts"]["validation.json"]
    assert asked(tmp_path / "old", tmp_path / "old", "--max-um", "0", capsys=capsys)[0] == 0
    assert main(["compare", str(tmp_path / "old"), str(tmp_path / "recording")]) == 3
    assert "is a run folder and" in capsys.readouterr().err


def test_two_retrainings_and_two_fleets_are_compared_by_their_runs(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "axis.yaml").write_text(PIPELINE, encoding="utf-8")
    for name, changed in (("old", None), ("new", 0)):
        record(tmp_path / "recording", 12, changed_from=changed)
        assert main(["run", str(tmp_path / "axis.yaml"), "--out", str(tmp_path / name / "run")]) == 0
        (tmp_path / name / "retrain.json").write_text("{}", encoding="utf-8")
        for machine in ("m1", "m2") if name == "old" else ("m2", "m3"):
            shutil.copytree(tmp_path / name / "run", tmp_path / name / "fleet/machines" / machine)
        (tmp_path / name / "fleet/fleet.json").write_text("{}", encoding="utf-8")
    whole = asked(tmp_path / "old/run", tmp_path / "new/run", capsys=capsys)
    assert asked(tmp_path / "old", tmp_path / "new", capsys=capsys) == whole
    code, answer = asked(tmp_path / "old/fleet", tmp_path / "new/fleet", "--max-um", "5", capsys=capsys)
    assert code == 4 and answer["kind"] == "fleet" and answer["largest_um"] == whole[1]["largest_um"]
    assert answer["only_in_old"]["machine"] == ["m1"] and answer["only_in_new"]["machine"] == ["m3"]
    assert list(answer["machines"]) == ["m2"] and answer["machines"]["m2"]["largest_um"] == whole[1]["largest_um"]
    assert main(["compare", str(tmp_path), str(tmp_path)]) == 3
    assert "without errpipe.lock, recording.yaml, fleet.json, export.json or retrain.json" in capsys.readouterr().err


def test_the_rounding_of_a_grids_end_is_no_difference_of_validity() -> None:
    out = verb.Comparison("table")
    verb._ranges(out, {"Z": (-500.0, 5.7e-14), "X": (0.0, 5.7e-14)}, {"Z": (-500.0, 0.0), "X": (0.0, 8.0)})
    assert out.lines == ["validity of X: 0 .. 0 -> 0 .. 8"]
