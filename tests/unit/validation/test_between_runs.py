"""Two machines in one recording: validation says from which run on an axis differs, and what is a drift instead."""

import json

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.judging import HeldOut
from errpipe.formats import manifest_folder
from errpipe.validation import between_runs

RUNS, TARGETS, COLLISION = 10, 21, 5  # runs before the collision
X = np.linspace(0.0, 800.0, TARGETS)
ORDER = np.arange(RUNS)[:, None]
BENT = 40.0 * (X / 800.0) ** 2  # um


def recorded(errors: np.ndarray) -> Recording:
    """Deviations in um, (runs, targets), every run from 0 to 800 mm and back."""
    there_and_back = np.hstack([errors, errors[:, ::-1] + 3.0])
    runs, rows = there_and_back.shape
    kinds = {"run": Column(role="run"), "x": Column(role="position", axis="X", unit="mm")}
    kinds |= {"direction": Column(role="direction", axis="X")}
    kinds |= {"EXX": Column(role="error", component="EXX", unit="um")}
    frame = pd.DataFrame(
        {
            "run": np.repeat([f"file-{k + 1}" for k in range(runs)], rows),
            "x": np.tile(np.r_[X, X[::-1]], runs),
            "direction": np.tile(np.repeat([1.0, -1.0], TARGETS), runs),
            "EXX": there_and_back.ravel(),
        }
    )
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=kinds), frame)


def found(errors: np.ndarray, per_group: int = 1) -> dict:
    """The finding, the residuals being those of runs predicted by the mean of the runs of all other groups."""
    recording = recorded(errors)
    y, run = recording.array("EXX").reshape(len(errors), -1), recording.run_codes()
    folds = []
    for k in range(0, len(errors), per_group):
        own = np.isin(np.arange(len(errors)), range(k, k + per_group))
        rows = np.flatnonzero(own[run])
        left = (y[own] - y[~own].mean(axis=0)).ravel()
        folds.append(HeldOut(str(k), rows, y[own].ravel(), left, np.zeros(rows.size), 0.0))
    return between_runs.changed_from(recording, folds)


def noise(seed: int, runs: int = RUNS) -> np.ndarray:
    """White noise of 0.4 um, and a level of every run of 1 um."""
    rng = np.random.default_rng(seed)
    return 0.4 * rng.standard_normal((runs, TARGETS)) + rng.standard_normal((runs, 1))


@pytest.mark.parametrize("per_group", [1, 5])
def test_a_collision_is_found_with_its_run_size_and_place(per_group: int) -> None:
    change = found(noise(1) + np.where(ORDER >= COLLISION, BENT, 0.0), per_group)
    assert (change["kind"], change["run"]) == ("step", "file-6")
    assert change["size"] == pytest.approx(np.sqrt(np.mean(BENT**2)), abs=2.0)
    assert change["worst"] == pytest.approx(40.0, abs=3.0) and change["at"]["x"] == pytest.approx(800.0, abs=20.0)
    words = between_runs.in_words({"component": "EXX", "unit": "um", "between_runs": change})
    assert 'since_run: "file-6"' in words


def test_sound_runs_differ_less_often_than_stated() -> None:
    assert [found(noise(seed)) for seed in range(100)] == [{}] * 100


@pytest.mark.parametrize("constant", [0.3, 1.0, 4.0])
def test_a_machine_that_warms_up_drifts_and_takes_no_step(constant: float) -> None:
    change = found(0.3 * noise(2) + 30.0 * (1.0 - np.exp(-ORDER / constant)) * X / 800.0)
    assert change.get("kind") != "step"
    if constant == 4.0:
        assert (change["kind"], change["run"]) == ("drift", "file-10")
        assert change["worst"] == pytest.approx(27.0, abs=5.0)  # 30 um (1 - exp(-9 / 4)), straight
        assert "drifts from run to run" in between_runs.in_words(
            {"component": "EXX", "unit": "um", "between_runs": change}
        )


@pytest.mark.slow
def test_random_walks_take_no_step() -> None:
    def walk(seed: int) -> np.ndarray:
        return noise(seed) + np.cumsum(3.0 * np.random.default_rng(seed).standard_normal((RUNS, 1)), axis=0) * X / 800.0

    assert sum(found(walk(seed)).get("kind") == "step" for seed in range(200)) <= 1


def test_a_jump_among_waves_as_large_is_no_step() -> None:
    order = np.arange(40)[:, None]
    waves = 60.0 * np.sin(4 * np.pi * order / 40) + 0.0 * X
    assert found(noise(6, 40) + waves + np.where(order >= 20, 70.0, 0.0)).get("kind") != "step"


def test_neighbours_held_out_in_two_groups_differ_as_measured() -> None:
    measured = noise(7)
    left = measured - np.repeat([measured[5:].mean(axis=0), measured[:5].mean(axis=0)], 5, axis=0)
    apart = between_runs._differences(left, [0] * 5 + [1] * 5, 2)[4]
    steady = noise(7) + np.where(ORDER >= COLLISION, BENT, 0.0)
    left = steady - np.repeat([steady[5:].mean(axis=0), steady[:5].mean(axis=0)], 5, axis=0)
    assert apart < 2.0 * np.mean(np.diff(measured, axis=0) ** 2)
    assert between_runs._differences(left, [0] * 5 + [1] * 5, 2)[4] == pytest.approx(np.mean(BENT**2), rel=0.2)


def test_one_odd_run_and_too_few_runs_are_no_change() -> None:
    assert found(noise(3) + np.where(ORDER == COLLISION, BENT, 0.0)) == {}
    assert found(noise(4, 4) + np.where(ORDER[:4] >= 2, BENT, 0.0)) == {}


def test_a_collision_between_two_files_is_in_the_summary_and_the_report_and_the_line_to_copy_works(
    tmp_path, capsys
) -> None:
    manifest_folder.write(recorded(noise(5) + np.where(ORDER >= COLLISION, BENT, 0.0)), tmp_path / "recording")
    text = (
        "pipeline: 1\nstages:\n  - kind: ingest\n    recording: recording\n"
        "  - kind: fit\n    components:\n      - component: EXX\n        terms:\n"
        "          - {term: measured_points, axis: X}\n  - {kind: validate}\n  - {kind: report}\n"
    )
    line = 'since_run: "file-6"'
    (tmp_path / "p.yaml").write_text(text)
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 0
    assert line in " ".join(capsys.readouterr().out.split())
    assert "differs from run file-6 on by" in (tmp_path / "out/report/report.html").read_text()
    (tmp_path / "later.yaml").write_text(text.replace("recording: recording\n", f"recording: recording\n    {line}\n"))
    assert main(["run", str(tmp_path / "later.yaml"), "--out", str(tmp_path / "later")]) == 0
    (figures,) = json.loads((tmp_path / "later/validate/validation.json").read_text())["components"]
    assert figures["between_runs"] == {} and figures["rms_after"] < 2.0
