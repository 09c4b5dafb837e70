"""The third generator: same bytes for a seed, readable files, sealed keys, real noise that keeps its nature."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from errpipe.formats import manifest_folder
from tests.unit.trials.folders import assert_same_files
from trials.judge import judge
from trials.score import sealed_answers
from trials.third import noise
from trials.third.generate import TIERS, generate


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("third")
    generate(out, 4, 14)
    return out


def test_seed_gives_the_same_bytes(drawn: Path, tmp_path: Path) -> None:
    generate(tmp_path, 4, 14)
    assert_same_files(tmp_path, drawn)


def test_cases_are_readable_and_of_every_tier(drawn: Path) -> None:
    keys = sealed_answers(drawn)
    assert {k["tier"] for k in keys} == set(TIERS)
    for k in keys:
        recording = manifest_folder.read(drawn / "cases" / k["case"])
        assert set(recording.components()) == set(k["responses"])


def test_the_key_itself_is_judged_right(drawn: Path) -> None:
    for key in sealed_answers(drawn):
        answers = {}
        for component, wanted in key["responses"].items():
            findings = [
                {"effect": g[0], "confidence": 0.9, "drivers": wanted["drivers"][g[0]], "where": wanted["where"]}
                for g in wanted["effects"]
            ]
            answers[component] = {"verdict": wanted["verdict"][0], "findings": findings}
        judged = judge(drawn / "cases" / key["case"], key, answers)
        assert judged.correct, (key["tier"], judged.missed)
        loud = json.loads(json.dumps(answers))
        for response in loud.values():
            response["findings"] = [{"effect": "clock_offset", "confidence": 0.9, "drivers": []}]
        assert not judge(drawn / "cases" / key["case"], key, loud).correct


def test_noise_has_rms_one_and_synthetic_kinds_differ() -> None:
    kinds = {}
    for seed in range(60):
        values, name = noise.noise(np.random.default_rng(seed), 3000)
        assert np.std(values) == pytest.approx(1, rel=1e-6) and values.shape == (3000,)
        kinds[name] = values
    assert {"coloured", "heavy-tailed", "uneven"} <= set(kinds)
    tails = kinds["heavy-tailed"]
    assert np.mean(np.abs(tails - np.median(tails)) > 4) > 1e-4
    near = kinds["coloured"]
    assert np.corrcoef(near[1:], near[:-1])[0, 1] > 0.1


def test_without_real_recordings_noise_is_synthetic(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(noise, "REAL", tmp_path / "absent")
    noise.pools.cache_clear()
    try:
        assert noise.pools() == ()
        assert {noise.noise(np.random.default_rng(s), 300)[1] for s in range(30)} == {
            "coloured",
            "heavy-tailed",
            "uneven",
        }
        assert noise.kept_rows(np.random.default_rng(1), 500).size == 500
    finally:
        noise.pools.cache_clear()


@pytest.mark.realdata
def test_real_noise_keeps_its_colour_and_its_steps() -> None:
    if not noise.REAL.is_dir():
        pytest.skip(f"no real recordings at {noise.REAL}")
    colours = {}
    for pool in noise.pools():
        values = noise._blocks(np.random.default_rng(2), pool.gaps, 4000)
        colours[pool.name] = np.corrcoef(values[1:], values[:-1])[0, 1]
    assert colours["positioning-axis-force, periods"] > 0.9
    assert abs(colours["turning-centre-thermal, interleaved"]) < 0.3
