"""Judging: our reading of the rules, and agreement with the public sample's own judge where it is present."""

import importlib.util
import json
import os
import random
import shutil
import sys
import types
from dataclasses import asdict
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from trials.first.generate import generate
from trials.judge import covers, judge, read
from trials.score import Tampered, figures, markdown, score, sealed_answers

SAMPLE = Path(os.environ.get("ERRPIPE_BLIND_TRIALS", "../shared/blind-trials"))
NAMES = [
    "backlash",
    "thermal_drift",
    "thermal_lag",
    "unknown",
    "recalibration",
    "scale_error",
    "tool_wear",
    "squareness",
]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    out = tmp_path_factory.mktemp("trials") / "drawn"
    generate(out, seed=5, cases=20)
    return out


def perfect(key: dict) -> dict:
    """What an oracle would say."""
    responses = []
    for component, k in key["responses"].items():
        findings = [
            {
                "effect": group[0],
                "confidence": 0.95,
                "drivers": k["drivers"].get(group[0], []),
                "where": k["where"],
                "parameters": [
                    {"name": n, "value": p["value"], "unit": p["unit"], "ci95": [p["value"] * 0.9, p["value"] * 1.1]}
                    for n, p in k["params"].items()
                    if n.split(".")[0] == group[0]
                ],
            }
            for group in k["effects"]
        ]
        holdout = {"scheme": "x", "rms_before_um": 1.0, "rms_after_um": k["noise_rms"]}
        responses.append({"component": component, "verdict": k["verdict"][0], "holdout": holdout, "findings": findings})
    return {"diagnosis": 1, "recording": "x", "responses": responses}


def noisy(key: dict, rng: random.Random) -> dict:
    """An answer with mistakes of every kind."""
    document = perfect(key)
    for response in document["responses"]:
        if rng.random() < 0.3:
            response["verdict"] = rng.choice(["no_mismatch", "recalibrate", "missing_physics", "unexplained"])
        if rng.random() < 0.4:
            extra = {
                "effect": rng.choice(NAMES),
                "confidence": round(rng.random(), 2),
                "drivers": ["x", "t"],
                "parameters": [],
            }
            response["findings"].insert(rng.randrange(len(response["findings"]) + 1), extra)
        for finding in response["findings"]:
            if rng.random() < 0.3:
                finding["confidence"] = round(rng.random(), 2)
            if rng.random() < 0.3:
                finding["drivers"] = rng.choice([[], ["x"], ["x", "y", "t"], None])
            if rng.random() < 0.3:
                finding["where"] = rng.choice([None, {"runs": ["1", "2"]}, {"ranges": {"x": [0, 300]}}])
    return document


def write(folder: Path, name: str, document: dict) -> None:
    (folder / name).mkdir(parents=True)
    (folder / name / "diagnosis.json").write_text(json.dumps(document))


def test_an_oracle_gets_everything_right(drawn, tmp_path):
    for key in sealed_answers(drawn):
        write(tmp_path, key["case"], perfect(key))
    judged = score(drawn, tmp_path)
    values = figures(judged)
    assert values["correct"] == 1.0
    assert values["alarms_on_quiet_responses"] == 0.0
    assert values["coverage"] == 1.0
    assert values["location"] == 1.0
    assert values["residual_over_noise"] == pytest.approx(1.0)
    assert "| all | 20 | 100 % |" in markdown(judged, "20 cases")


def test_silence_is_wrong_but_no_alarm(drawn, tmp_path):
    for key in sealed_answers(drawn):
        document = {"responses": [{"component": c, "verdict": "no_mismatch", "findings": []} for c in key["responses"]]}
        write(tmp_path, key["case"], document)
    values = figures(score(drawn, tmp_path))
    assert values["correct"] < 0.2
    assert values["alarms_on_quiet_responses"] == 0.0
    assert values["abstained_on_known"] == 1.0


def test_a_bold_name_for_a_novel_mechanism_is_a_miss(tmp_path):
    response = {"unit": "um", "verdict": ["unexplained", "missing_physics"], "effects": [["unknown"]], "drivers": {}}
    response |= {"truth": ["outside the vocabulary: doors"], "where": None, "params": {}, "noise_rms": 1.0}
    key = {"case": "c", "tier": "novel", "protocol": "p", "responses": {"E_Z": response}}
    unknown = {"effect": "unknown", "confidence": 0.9}
    shy = {"E_Z": {"verdict": "unexplained", "findings": [unknown, {"effect": "thermal_lag", "confidence": 0.5}]}}
    bold = {"E_Z": {"verdict": "unexplained", "findings": [unknown, {"effect": "thermal_lag", "confidence": 0.9}]}}
    assert judge(tmp_path, key, shy).correct
    assert not judge(tmp_path, key, bold).correct


def test_intervals_are_compared_in_the_unit_of_the_key():
    true = {"value": 7.5, "unit": "um"}
    assert covers(true, [{"name": "b", "value": 0.0075, "unit": "mm", "ci95": [0.007, 0.008]}]) is True
    assert covers(true, [{"name": "b", "value": -7.4, "unit": "um", "ci95": [-7.6, -7.0]}]) is True
    assert covers(true, [{"name": "b", "value": 9, "unit": "um", "ci95": [8, 10]}]) is False
    assert covers(true, [{"name": "b", "value": 9, "unit": "N", "ci95": [8, 10]}]) is None


def test_changed_answers_are_refused(drawn, tmp_path):
    shutil.copytree(drawn, tmp_path / "copy")
    victim = next((tmp_path / "copy" / "answers").glob("*.json"))
    victim.write_text(victim.read_text().replace("plain", "null "))
    with pytest.raises(Tampered):
        sealed_answers(tmp_path / "copy")


def test_a_broken_diagnosis_counts_as_none(tmp_path):
    (tmp_path / "diagnosis.json").write_text('{"responses": [{"component": "EXX", "verdict": "perhaps"}]}')
    assert read(tmp_path / "diagnosis.json") is None


@pytest.mark.skipif(not (SAMPLE / "score.py").exists(), reason="the public sample's judge is not beside the project")
def test_agrees_with_the_public_judge(drawn, tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("public_score", SAMPLE / "score.py")
    public = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(
        sys.modules, "yaml", types.SimpleNamespace(safe_load=YAML(typ="safe").load)
    )  # it asks for PyYAML
    spec.loader.exec_module(public)
    rng = random.Random(1)
    for key in sealed_answers(drawn):
        folder = drawn / "cases" / key["case"]
        for k in range(4):
            name = f"{key['case']}-{k}"
            write(tmp_path, name, noisy(key, rng))
            path = tmp_path / name / "diagnosis.json"
            ours = asdict(judge(folder, key, read(path)))
            theirs = public.judge(folder, key, public.read_diagnosis(path))
            assert ours["correct"] == theirs["correct"], name
            assert ours["top1"] == theirs["top1"], name
            assert ours["alarms"] == theirs["wrong"], name
            assert ours["drivers"] == theirs["drivers"], name
            assert ours["params"] == theirs["params"], name
            assert ours["location"] == pytest.approx(theirs["location"]), name
            assert ours["recovered"] == pytest.approx(theirs["recovered"]), name


def test_a_greedy_regression_finds_the_easy_half_only(drawn, tmp_path):
    from trials.baseline import diagnose

    for key in sealed_answers(drawn):
        write(tmp_path, key["case"], diagnose(drawn / "cases" / key["case"]))
    values = figures(score(drawn, tmp_path))
    assert 0.35 < values["correct"] < 0.9
