"""The second generator of blind trials: same bytes for a seed, readable files, keys that the judge agrees with."""

from __future__ import annotations

import importlib.util
import json
import os
import sys
import types
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ruamel.yaml import YAML

from errpipe.formats import manifest_folder
from tests.unit.trials.folders import assert_same_files
from trials.second import generate, perfect
from trials.second.compare import figures, spread
from trials.second.contact import dahl, maxwell_slip, play
from trials.second.heat import bodies, lagged, refractivity, rod

ROOT = Path(__file__).parents[3]
PUBLIC = Path(os.environ.get("ERRPIPE_BLIND_TRIALS", ROOT.parent / "shared" / "blind-trials"))
EFFECTS = PUBLIC.parent / "contracts" / "effects.yaml"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven cases: one of each tier and one more."""
    out = tmp_path_factory.mktemp("second")
    assert generate.main([str(out), "--seed", "41", "--cases", "7"]) == 0
    return out


@pytest.fixture(scope="module")
def judge():
    """The public judge; its YAML reader replaced by the project's where PyYAML is absent."""
    script = PUBLIC / "score.py"
    if not script.exists():
        pytest.skip(f"no public judge at {script}")
    if importlib.util.find_spec("yaml") is None:
        sys.modules["yaml"] = types.SimpleNamespace(safe_load=YAML(typ="safe").load)
    spec = importlib.util.spec_from_file_location("public_score", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def keys(folder: Path) -> dict[Path, dict]:
    return {a.parent: json.loads(a.read_text()) for a in sorted(folder.glob("*/answer.json"))}


def verdict(judge, case: Path, key: dict, diagnosis: dict, tmp_path: Path) -> dict:
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(diagnosis))
    return judge.judge(case, key, judge.read_diagnosis(path))


def test_seed_gives_the_same_bytes(drawn: Path, tmp_path: Path) -> None:
    generate.main([str(tmp_path), "--seed", "41", "--cases", "7"])
    assert_same_files(drawn, tmp_path, count=21)


def test_another_seed_gives_other_cases(drawn: Path, tmp_path: Path) -> None:
    generate.main([str(tmp_path), "--seed", "42", "--cases", "1"])
    assert not {p.name for p in drawn.iterdir()} & {p.name for p in tmp_path.iterdir()}


def test_the_reader_accepts_every_recording(drawn: Path) -> None:
    for case, key in keys(drawn).items():
        recording = manifest_folder.read(case)
        for component, k in key["responses"].items():
            (name,) = recording.names("error", component=component)
            mismatch = recording.array(name) - recording.array(f"{component}_sim")
            quiet = np.sort(np.abs(mismatch[np.isfinite(mismatch)]))[: int(0.985 * np.isfinite(mismatch).sum())]
            assert np.sqrt(np.mean(quiet**2)) < 1.05 * k["before_rms"]


def test_the_judge_agrees_with_the_key_and_catches_a_wrong_one(drawn: Path, judge, tmp_path: Path) -> None:
    for case, key in keys(drawn).items():
        right = verdict(judge, case, key, perfect.diagnosis(key), tmp_path)
        assert right["correct"] and all(right["drivers"]) and all(right["params"])
        wrong = perfect.diagnosis(key)
        for r in wrong["responses"]:
            r["findings"] = [{"effect": "worm_in_the_works", "confidence": 0.9, "drivers": []}]
            r["verdict"] = "missing_physics"
        assert not verdict(judge, case, key, wrong, tmp_path)["correct"]


def test_an_exact_simulation_leaves_noise_and_nothing_else(tmp_path: Path) -> None:
    """The noise of the key is what an exact simulation leaves; a key with half of it would be found out here."""
    generate.main([str(tmp_path), "--seed", "3", "--cases", "2", "--tiers", "null", "--protocols", "spindle drift"])
    for case, key in keys(tmp_path).items():
        frame = pd.read_csv(case / "recording.csv")
        for component, k in key["responses"].items():
            left = (frame[component] - frame[f"{component}_sim"]).dropna()
            robust = 1.4826 * np.median(np.abs(np.diff(left))) / np.sqrt(2)
            assert robust == pytest.approx(k["noise_rms"], rel=0.25)
            if k["verdict"] == ["no_mismatch"]:
                assert k["before_rms"] == pytest.approx(k["noise_rms"], rel=0.01)


def test_every_effect_of_the_vocabulary_has_a_mechanism() -> None:
    if not EFFECTS.exists():
        pytest.skip(f"no vocabulary at {EFFECTS}")
    wanted = set(YAML(typ="safe").load(EFFECTS.read_text()))
    made, novel = {"clock_offset"}, set()
    for protocol, scene in generate.SCENES.items():
        for k in range(8):
            for response in scene(np.random.default_rng(k)).responses:
                made |= set(response.makers)
                novel |= {(protocol, n) for n in response.novel}
    assert wanted <= made
    assert len({n for _, n in novel}) >= 20


def test_figures_lie_in_the_neighbourhood_of_the_public_sample(drawn: Path) -> None:
    if not PUBLIC.exists():
        pytest.skip(f"no public sample at {PUBLIC}")
    public, ours = spread(figures(PUBLIC), "protocol"), spread(figures(drawn), "protocol")
    for protocol, match in ours.items():
        for name, margin in (("rows", 2.0), ("noise", 5.0)):
            low, _, high = public[protocol][name]
            assert match[name][0] > low / margin and match[name][2] < high * margin, (protocol, name)
        assert match["oracle/noise"][2] <= 1.15
        assert match["largest gain off"][2] <= 0.1501


def test_a_heated_rod_keeps_its_energy_and_levels_out() -> None:
    source = np.zeros((2000, 12))
    source[:100, 3] = 0.01
    rise = rod(10.0, 12, 0.3, 1.3e-5, source, np.zeros(2000))
    assert rise[-1].sum() == pytest.approx(0.01 * 10.0 * 100)
    assert np.ptp(rise[-1]) < 0.02 * rise[99].max()


def test_a_single_body_follows_the_exponential() -> None:
    n, step = 400, 30.0
    power = np.full((n, 1), 20.0)
    air = np.full(n, 20.0)
    temp = bodies(step, np.array([3000.0]), np.zeros((1, 1)), power, air, np.array([1.5]), np.array([20.0]))[:, 0]
    t = step * np.arange(n)
    assert np.allclose(temp, 20 + 20 / 1.5 * (1 - np.exp(-t / 2000)), atol=1e-6)
    assert np.allclose(lagged(t, np.r_[0.0, np.ones(n - 1)], 600.0)[50:], 1 - np.exp(-(t[50:] - 15) / 600), atol=0.02)


def test_slipping_contacts_close_their_loops() -> None:
    x = np.r_[np.linspace(0, 2, 400), np.linspace(2, 0, 400), np.linspace(0, 2, 400)]
    for force in (dahl(x, 0.1), maxwell_slip(x, np.array([0.05, 0.2]), np.array([12.0, 2.0]))):
        assert force[399] == pytest.approx(1.0, abs=0.01)
        assert force[799] == pytest.approx(-1.0, abs=0.01)
        assert force[1199] == pytest.approx(1.0, abs=0.01)
    assert np.ptp(play(x, 0.5)[:399] - x[:399]) <= 0.25 + 1e-9


def test_air_has_the_published_refractivity() -> None:
    """NIST's table: 20 degC, 101325 Pa, 50 % humidity (11.7 hPa of water): n - 1 = 2.7138e-4 at 632.99 nm."""
    n = refractivity(np.array([20.0, 21.0]), np.array([1013.25, 1013.25]), 11.7)
    assert n[0] == pytest.approx(2.7138e-4, rel=2e-4)
    assert 1e6 * (n[1] - n[0]) == pytest.approx(-0.93, abs=0.02)
