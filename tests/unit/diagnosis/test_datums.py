"""An instrument that is zeroed anew at each start of the machine: set right, proved on starts that sat out."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.diagnosis import diagnose
from errpipe.diagnosis.hypotheses import FOLDS, folds

from .machines import mornings

TAU = 5000.0


def late(c: dict) -> np.ndarray:
    """3 um/K of a body that follows the bearing late, each day in step with it at first."""
    out, y = np.empty(c["t"].size), 0.0
    for k, u in enumerate(c["T_bearing"]):
        fresh = k == 0 or c["day"][k] != c["day"][k - 1]
        y = u if fresh else y + (1 - np.exp(-150.0 / TAU)) * (c["T_bearing"][k - 1] - y)
        out[k] = y
    return 3.0 * (out - 20)


def zeros(c: dict, size: float = 6.0) -> np.ndarray:
    """Where the probe was zeroed, day by day."""
    return size * np.random.default_rng(7).standard_normal(int(c["day"].max()) + 1)[c["day"]]


def output(recording):
    (response,) = diagnose(recording)[0].responses
    return response, [f.effect for f in response.findings if f.effect != "recalibration"]


def levels(response) -> dict[str, float]:
    return {p.name: p.value for f in response.findings for p in f.parameters if p.name.startswith("datum of run")}


def test_what_is_missing_is_found_behind_datums_that_differ():
    case = mornings(hidden=lambda c: late(c) + zeros(c))
    response, effects = output(case)
    assert response.verdict == "missing_physics" and effects[0] == "thermal_lag"
    tau = next(p for p in response.findings[0].parameters if p.name == "tau")
    assert tau.ci95[0] <= TAU <= tau.ci95[1] < 2 * TAU
    assert "separate datum" in response.says and response.between_runs > 0.3
    assert len(levels(response)) == 10


def test_it_is_proved_on_whole_starts_that_sat_out():
    response, _ = output(mornings(hidden=lambda c: late(c) + zeros(c)))
    held = response.holdout
    assert held.scheme.startswith("10 whole runs in 5 groups") and "first 5 rows, which do not count" in held.scheme
    assert held.rms_after_um < 0.3 * held.rms_before_um and held.rms_after_um < 1.0


def test_datums_alone_are_no_missing_physics():
    response, effects = output(mornings(hidden=zeros))
    assert effects == [] and response.verdict == "recalibrate"


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_a_cause_that_steps_from_day_to_day_keeps_its_name(seed: int):
    """What creeps on over the days is cheaper as one rate than as ten datums."""
    response, effects = output(mornings(seed, hidden=lambda c: 12 * c["t"] / c["t"].max()))
    assert effects == ["sensor_drift"] and not levels(response)
    assert response.between_runs > 0.9 and "separate datum" not in response.says


@pytest.mark.parametrize("seed", [0, 1])
def test_another_gain_on_a_sensor_that_the_static_model_holds_is_a_recalibration(seed: int):
    """Mornings differ by their room: no datum of each, and nothing missing."""
    response, effects = output(mornings(seed, hidden=lambda c: 2.0 * (c["T_room"] - 20)))
    assert effects == [] and response.verdict == "recalibrate" and not levels(response)
    gains = {p.name: p for f in response.findings for p in f.parameters}
    room = gains["gain of thermal_drift on T_room less 1"]
    assert 1.5 * room.value == pytest.approx(2.0, abs=0.2)
    assert 1.5 * room.ci95[0] < 2.0 < 1.5 * room.ci95[1] and "gain of simulation less 1" not in gains


def test_runs_without_a_pause_between_them_share_a_datum():
    response, _ = output(mornings(hidden=lambda c: late(c) + zeros(c), pause=600.0))
    assert not levels(response)
    assert "blocks of neighbouring rows" in response.holdout.scheme


def test_few_starts_are_left_out_by_blocks():
    session = np.repeat(np.arange(FOLDS - 1), 50)
    assert "blocks" in folds(session, session)[1]
    fold, scheme = folds(np.repeat(np.arange(7), 50), np.repeat(np.arange(7), 50))
    assert scheme == "7 whole runs in 5 groups"
    assert all(np.unique(fold[k * 50 : (k + 1) * 50]).size == 1 for k in range(7))


def test_held_out_blocks_do_not_come_in_step_with_what_is_repeated():
    """Four turns of a circle, ten blocks each: dealt in turn, a fold would lose the same two in every turn."""
    fold, _ = folds(np.zeros(2000, dtype=int))
    block = np.arange(2000) // 50
    assert all(np.bincount(fold[block == b], minlength=FOLDS).max() == 50 for b in range(40))
    for f in range(FOLDS):
        held = np.unique(block[fold == f])
        assert held.size == 8 and np.unique(held % 10).size >= 5
