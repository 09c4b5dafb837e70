"""Real twins: the repetitions that are found are repetitions, and the judge counts as the page says."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe.formats import manifest_folder
from tests.unit.trials.folders import assert_same_files
from trials.folder import Sheet, write
from trials.real.__main__ import figures, judge_all, markdown
from trials.real.draw import additions, generate
from trials.real.recordings import sources
from trials.real.repetitions import Twin, trajectory_period, twins, window

SHARED = Path(os.environ.get("ERRPIPE_REAL_DATA", Path(__file__).parents[4] / "shared" / "real-data"))


def strokes(rows: int = 4000, noise: float = 0.1) -> Sheet:
    """A drive force along a trajectory that comes again every 4 s."""
    rng = np.random.default_rng(0)
    t = np.arange(rows) / 200
    x = 100 * np.sin(2 * np.pi * t / 4) + 20 * np.sin(6 * np.pi * t / 4)
    v = np.gradient(x, t)
    table = pd.DataFrame({"t": t, "x": x, "v": v, "F_X": 5 * np.sign(v) + 0.1 * v + noise * rng.normal(size=rows)})
    columns = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
        "F_X": {"role": "error", "component": "F_X", "unit": "N"},
    }
    return Sheet("strokes", table, columns)


def warm_up(rows: int = 1200, noise: float = 0.5, bent: float = 0.0) -> Sheet:
    """A drift read once a minute; bent: a ripple as fast as the readings, which no interpolation can follow."""
    rng = np.random.default_rng(1)
    t = 60.0 * np.arange(rows)
    temperature = 20 + 8 * (1 - np.exp(-t / 9000)) + 2 * np.sin(t / 7000)
    drift = 4 * (temperature - 20) + bent * np.sin(2 * np.pi * t / 400) + noise * rng.normal(size=rows)
    table = pd.DataFrame({"t": t, "T_head": temperature, "T_room": 20 + np.cos(t / 11000), "E_Z": drift})
    columns = {
        "t": {"role": "time", "unit": "s"},
        "T_head": {"role": "temperature", "unit": "degC", "location": "head"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room"},
        "E_Z": {"role": "error", "component": "E_Z", "unit": "um"},
    }
    return Sheet("warm-up", table, columns)


def plate_twice() -> Sheet:
    """The same holes measured twice: shifted, turned and at another temperature the second time."""
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 600, (2, 150))
    shape = 8 * np.sin(x / 90)
    second = shape + 40 + 0.05 * x - 0.1 * y
    noise = 1.5 * rng.normal(size=(2, 150))
    table = pd.DataFrame({"plate": ["a"] * 150 + ["b"] * 150, "x": np.tile(x, 2), "y": np.tile(y, 2)})
    table["E_X"] = np.concatenate([shape + noise[0], second + noise[1]])
    columns = {
        "plate": {"role": "run"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "y": {"role": "position", "axis": "Y", "unit": "mm"},
        "E_X": {"role": "error", "component": "E_X", "unit": "um"},
    }
    return Sheet("plate", table, columns)


def one(sheet: Sheet) -> Twin:
    (twin,) = twins("source", sheet)
    return twin


def test_period_of_a_trajectory() -> None:
    sheet = strokes()
    assert trajectory_period(sheet.values("t"), sheet.values("x")) == pytest.approx(4.0, abs=0.01)
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.normal(size=4000))
    assert trajectory_period(sheet.values("t"), walk) is None


@pytest.mark.parametrize(
    ("sheet", "kind", "noise"),
    [(strokes(), "periods", 0.1 * 2**0.5), (warm_up(), "interleaved", 0.5 * 1.5**0.5), (plate_twice(), "runs", 2.1)],
    ids=["periods", "interleaved", "runs"],
)
def test_twin_leaves_the_scatter_of_two_readings(sheet: Sheet, kind: str, noise: float) -> None:
    twin = one(sheet)
    assert twin.kind == kind
    middle = np.clip(twin.gap(), -4 * noise, 4 * noise)  # a row beside a reversal may match the other side of it
    assert np.std(middle) == pytest.approx(noise, rel=0.12)


def test_no_twin_where_neighbours_do_not_predict_the_rows_between() -> None:
    assert twins("source", warm_up(bent=6.0)) == []


def test_no_twin_of_motions_faster_than_the_rows() -> None:
    """A servo that steps between two readings: where it was meanwhile is another thing each time."""
    fast = strokes()
    fast.table["x"] = 50 * np.sign(fast.table["x"])
    thin = Sheet("steps", fast.table.iloc[::20].reset_index(drop=True), fast.columns)
    assert [t.kind for t in twins("steps", thin)] == []


def test_additions_of_a_torque_are_those_of_a_drive() -> None:
    sheet = strokes()
    sheet.columns = {
        **sheet.columns,
        "x": {"role": "position", "axis": "C", "unit": "deg"},
        "v": {"role": "velocity", "axis": "C", "unit": "deg/s"},
        "F_C": {"role": "error", "component": "F_C", "unit": "N m"},
    }
    del sheet.columns["F_X"]
    sheet.table = sheet.table.rename(columns={"F_X": "F_C"})
    names = {a[0] for twin in twins("robot", sheet) for a in additions(np.random.default_rng(3), twin)}
    assert {"stribeck_friction", "torque_ripple"} <= names
    assert not names & {"backlash", "following_error", "pitch_cyclic", "scale_error"}


def test_additions_are_of_the_component_and_no_gain_plays_them() -> None:
    rng = np.random.default_rng(4)
    names = {a[0] for a in additions(rng, one(strokes()))}
    assert {"torque_ripple", "stribeck_friction"} <= names and "backlash" not in names
    assert "coulomb_friction" not in names  # most of the force: another gain on the repetition would play it
    warm = {(a[0], a[2]) for a in additions(rng, one(warm_up()))}
    assert ("thermal_drift", ("T_head",)) not in warm  # the whole drift follows that sensor: a gain would play it
    assert ("thermal_drift", ("T_room",)) in warm
    assert {a[0] for a in additions(rng, one(plate_twice()))} >= {"scale_error", "squareness", "straightness"}


def test_windows_keep_enough_rows() -> None:
    twin = one(strokes())
    for seed in range(20):
        assert len(window(np.random.default_rng(seed), twin).sheet.table) >= 40


def test_cases_are_readable_sealed_and_counted(tmp_path: Path) -> None:
    sheets = [("strokes", strokes()), ("warm-up", warm_up()), ("plate", plate_twice())]
    generate(tmp_path / "a", sheets, 5, 4, 5)
    generate(tmp_path / "b", sheets, 5, 4, 5)
    assert_same_files(tmp_path / "a", tmp_path / "b")
    for case in sorted((tmp_path / "a" / "cases").iterdir()):
        manifest_folder.read(case)
        key = json.loads((tmp_path / "a" / "answers" / f"{case.name}.json").read_text())
        ((component, wanted),) = key["responses"].items()
        findings = [{"effect": g[0], "confidence": 0.9} for g in wanted["effects"]]
        if key["tier"] == "null":
            findings = [{"effect": "unknown", "confidence": 0.97}]  # always wrong: no null is quiet
        answer = {"component": component, "verdict": "missing_physics", "findings": findings}
        (tmp_path / "a" / "diagnoses" / case.name).mkdir(parents=True)
        text = json.dumps({"diagnosis": 1, "responses": [answer]})
        (tmp_path / "a" / "diagnoses" / case.name / "diagnosis.json").write_text(text)
    rows = judge_all(tmp_path / "a")
    values = figures(rows)
    assert (values["nulls"], values["quiet"], values["unknown_alarms"]) == (4, 0, 4)
    assert (values["additions"], values["named"], values["confident_wrong"]) == (5, 5, 0)
    assert "| all | 0 of 4 (0 %) | 5 of 5 (100 %) | 0 of 9 (0 %) |" in markdown(rows, "title")


def test_no_repetition_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="none of these recordings has a repetition"):
        generate(tmp_path, [("bent", warm_up(bent=6.0))], 1, 1, 1)


@pytest.mark.realdata
def test_real_recordings_have_the_repetitions_that_their_sources_tell_of() -> None:
    if not SHARED.is_dir():
        pytest.skip(f"no real recordings at {SHARED}")
    kinds = {(t.source, t.kind) for name, sheet in sources([SHARED]) for t in twins(name, sheet)}
    assert ("positioning-axis-force", "periods") in kinds
    assert ("damper-hysteresis", "periods") in kinds
    assert ("drilled-plates", "runs") in kinds and ("psi", "runs") in kinds
    assert ("turning-centre-thermal", "interleaved") in kinds


def test_answers_are_hidden_from_the_diagnosis_and_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from trials.real import answers

    folder = tmp_path / "motor"
    folder.mkdir()
    (folder / "recording.yaml").write_text("recording: 1\n")
    (folder / "ANSWER.yaml").write_text("effect: torque_ripple\naccept: [torque_ripple]\ndriver: [c]\nsize: 2 N\n")

    def diagnose(case: str, out: str) -> tuple[str, float, str]:
        assert not (Path(case) / "ANSWER.yaml").exists()
        finding = {"effect": said, "confidence": 0.9, "drivers": ["c"], "parameters": []}
        response = {"component": "F_X", "verdict": "missing_physics", "findings": [finding]}
        Path(out).mkdir()
        (Path(out) / "diagnosis.json").write_text(json.dumps({"responses": [response]}))
        return "motor", 0.0, ""

    monkeypatch.setattr(answers, "diagnose", diagnose)
    assert answers.answered([tmp_path]) == [folder]
    said = "torque_ripple"
    assert answers.judge_one(folder)["right"]
    said = "unknown"
    assert not answers.judge_one(folder)["right"]


def test_gaps_and_damaged_recordings_do_no_harm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(6)
    holed = warm_up()
    for name in ("E_Z", "T_head", "T_room"):
        holed.table.loc[rng.random(len(holed.table)) < 0.02, name] = np.nan
    moving = strokes()
    for name in ("F_X", "x"):
        moving.table.loc[rng.random(len(moving.table)) < 0.01, name] = np.nan
    write(tmp_path / "in" / "holed", holed)
    write(tmp_path / "in" / "moving", moving)
    write(tmp_path / "in" / "damaged", strokes())
    (tmp_path / "in" / "damaged" / "recording.csv").write_text("t,x\n1,2\n")
    files = sources([tmp_path / "in"])
    assert [name for name, _ in files] == ["holed", "moving"]
    assert "damaged is left out" in capsys.readouterr().err
    assert {t.kind for name, sheet in files for t in twins(name, sheet)} == {"interleaved", "periods"}
    generate(tmp_path / "out", files, 1, 4, 4)
