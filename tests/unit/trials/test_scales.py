"""The sweep over scales: same bytes for a seed, readable recordings, keys that a perfect answer satisfies."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from errpipe.formats import manifest_folder
from tests.unit.trials.folders import assert_same_files
from trials import folder
from trials.claims import impossible
from trials.judge import judge
from trials.rivals import accepted, first_order
from trials.scales.__main__ import outcome
from trials.scales.draw import CORE, FURTHER, generate, read_keys
from trials.score import sealed_answers


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scales")
    generate(out, 3, 9)
    return out


def test_seed_gives_the_same_bytes(drawn: Path, tmp_path: Path) -> None:
    generate(tmp_path, 3, 9)
    assert_same_files(tmp_path, drawn)


def test_every_recording_is_read_by_the_project(drawn: Path) -> None:
    for case in sorted((drawn / "cases").iterdir()):
        recording = manifest_folder.read(case)
        assert len(recording.frame) > 50


def test_answers_are_sealed(drawn: Path) -> None:
    assert {k["case"] for k in sealed_answers(drawn)} == set(read_keys(drawn))


def perfect(key: dict) -> dict[str, dict]:
    """A diagnosis that says what the key holds."""
    out = {}
    for component, wanted in key["responses"].items():
        findings = []
        for group in wanted["effects"]:
            sizes = [v for k, v in wanted["params"].items() if k.startswith(group[0])]
            parameters = [
                {"value": p["value"], "unit": p["unit"], "ci95": [0.9 * p["value"], 1.1 * p["value"]]} for p in sizes
            ]
            drivers = wanted["drivers"][group[0]]
            findings.append({"effect": group[0], "confidence": 0.9, "drivers": drivers, "parameters": parameters})
        out[component] = {"verdict": "missing_physics", "findings": findings, "rms_after_um": wanted["noise_rms"]}
    return out


def test_a_perfect_answer_is_right_and_a_wrong_name_is_not(drawn: Path) -> None:
    for name, key in read_keys(drawn).items():
        good = perfect(key)
        judged = judge(drawn / "cases" / name, key, good)
        assert judged.correct and all(judged.params), name
        assert outcome(judged, key, good) == "right"
        wrong = json.loads(json.dumps(good))
        for response in wrong.values():
            response["findings"] = [{"effect": "clock_offset", "confidence": 0.95, "drivers": ["t"]}]
        assert outcome(judge(drawn / "cases" / name, key, wrong), key, wrong) == "confident wrong name"
        silent = {c: {"verdict": "unexplained", "findings": [{"effect": "unknown", "confidence": 0.9}]} for c in good}
        assert outcome(judge(drawn / "cases" / name, key, silent), key, silent) == "unknown"


def test_the_named_cases_are_the_first_three(drawn: Path) -> None:
    named = [k for k in read_keys(drawn).values() if k["protocol"] == "named"]
    truths = {t.split(":")[0] for k in named for r in k["responses"].values() for t in r["truth"]}
    assert truths == {"pitch_cyclic", "backlash", "thermal_lag"} and len(named) == 3


def test_the_hidden_effect_is_what_is_left_once_the_simulation_is_taken_off(drawn: Path) -> None:
    for name, key in read_keys(drawn).items():
        ((component, wanted),) = key["responses"].items()
        error, twin = folder.read(drawn / "cases" / name).responses()[component]
        sheet = folder.read(drawn / "cases" / name)
        assert np.std(sheet.values(error) - sheet.values(str(twin))) > 2 * wanted["noise_rms"]


def test_plan_holds_every_effect() -> None:
    effects = {e for _, places in CORE for _, e in places} | {e for _, e in FURTHER}
    assert len(effects) >= 22


def test_first_order_against_closed_form() -> None:
    t = np.linspace(0, 50, 400)
    ramp = 2.0 * t
    np.testing.assert_allclose(first_order(t, ramp, 7.0), 2 * (t - 7 * (1 - np.exp(-t / 7))), rtol=1e-9, atol=1e-9)


def test_rival_is_accepted_only_where_the_recording_cannot_tell(drawn: Path) -> None:
    import pandas as pd

    t = np.arange(400.0)
    slow, other = 20 + 0.01 * t, 20 + np.sin(t / 9)
    columns = {"t": {"role": "time", "unit": "s"}}
    columns |= {n: {"role": "temperature", "unit": "degC", "location": "frame"} for n in ("T_slow", "T_other")}
    sheet = folder.Sheet("", pd.DataFrame({"t": t, "T_slow": slow, "T_other": other}), columns)
    assert "sensor_drift" in accepted(sheet, "E_Z", "thermal_drift", slow - 20)[0]
    assert "sensor_drift" not in accepted(sheet, "E_Z", "thermal_drift", other - 20)[0]


def test_impossible_claims_are_counted(drawn: Path) -> None:
    for name, key in read_keys(drawn).items():
        ((component, _),) = key["responses"].items()
        sheet = folder.read(drawn / "cases" / name)
        finding = {"effect": "scale_error", "confidence": 0.9, "drivers": sheet.names("position")}
        span = {"value": 1.0, "unit": "s", "ci95": [-3.0, 5.0]}
        assert impossible(sheet, component, {"findings": [{**finding, "parameters": [span]}]}, 1.0)
        slope = {"value": 1.0, "unit": "um/m", "ci95": [0.5, 1.5]}
        rotary = any(sheet.columns[p].get("unit") == "deg" for p in sheet.names("position"))
        assert bool(impossible(sheet, component, {"findings": [{**finding, "parameters": [slope]}]}, 1.0)) == rotary
