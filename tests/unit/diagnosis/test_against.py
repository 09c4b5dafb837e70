"""Earlier findings on later recordings: unchanged ones are kept; changed, vanished or reversed ones are reported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from errpipe.diagnosis import diagnose
from errpipe.diagnosis.against import against, clustered, contribution_rms, larger_residuals
from errpipe.domain.diagnosis import Diagnosis
from errpipe.errors import DataError
from errpipe.simulation import folder
from tests.unit.diagnosis.machines import axis, bare, trace


def machine(seed: int, lost: float = 8.0, warm: float = 9e-3, noise: float = 0.5):
    return axis(seed, hidden=lambda c: -lost / 2 * c["dir"] + warm * c["x"] * (c["T_nut"] - 20), noise=noise)


@pytest.fixture(scope="module")
def earlier() -> Diagnosis:
    diagnosis, _ = diagnose(machine(4))
    assert [f.effect for f in diagnosis.responses[0].findings[:2]] == ["backlash", "scale_expansion"]
    return diagnosis


def states(recording, earlier) -> dict[str, str]:
    return {h.effect: h.state for h in against(recording, earlier)}


def test_an_unchanged_machine_is_called_unchanged_19_times_of_20(earlier) -> None:
    """Also where neighbouring rows go together; the level is 5 % over both effects."""
    alarms = 0
    for seed in range(40):
        later = machine(100 + seed)
        rng, wander = np.random.default_rng(seed), np.zeros(len(later))
        for k in range(1, wander.size):
            wander[k] = 0.8 * wander[k - 1] + 0.2 * rng.standard_normal()
        later.frame["EXX"] += wander
        comparison = against(later, earlier)
        alarms += any(h.changed for h in comparison)
        assert all(h.state in ("unchanged", "larger", "smaller") for h in comparison)
    assert alarms <= 5  # 2 are expected; 6 or more of 40 have a chance of 1 % at 5 %


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"lost": 10.0}, {"backlash": "larger", "scale_expansion": "unchanged"}),
        ({"lost": 5.0}, {"backlash": "smaller", "scale_expansion": "unchanged"}),
        ({"lost": 0.0}, {"backlash": "gone", "scale_expansion": "unchanged"}),
        ({"lost": -8.0}, {"backlash": "reversed", "scale_expansion": "unchanged"}),
        ({"warm": 12e-3}, {"backlash": "unchanged", "scale_expansion": "larger"}),
    ],
)
def test_a_parameter_that_changed_is_reported(earlier, change, wanted) -> None:
    assert states(machine(7, **change), earlier) == wanted


def test_sizes_are_those_of_the_later_machine_within_their_intervals(earlier) -> None:
    held = {h.effect: h for h in against(machine(8, lost=10.0), earlier)}
    (size,) = held["backlash"].parameters
    assert size["name"] == "lost_motion" and size["now_ci95"][0] < 10.0 < size["now_ci95"][1]
    assert size["now_ci95"][1] - size["now_ci95"][0] < 1.0


def test_a_larger_residual_is_reported(earlier) -> None:
    later = machine(10)
    assert larger_residuals(against(later, earlier)) == []
    later.frame["EXX"] += 5 * np.sin(later.frame["x"] / 20)
    (said,) = larger_residuals(against(later, earlier))
    assert "the residual is" in said and "again" in said


def test_a_wave_that_moved_has_not_gone() -> None:
    """A quarter of a turn leaves nothing of its old form; noise that goes together moves it in at most 5 of 100."""
    x = np.arange(2000) / 12.0
    own, session = np.column_stack([np.sin(x), np.cos(x)]), np.zeros(2000, dtype=int)
    whole = np.column_stack([12 * own[:, 0], np.ones(2000)])
    alarms = 0
    for seed in range(100):
        noise = np.convolve(np.random.default_rng(seed).standard_normal(2019), 0.8 ** np.arange(20), mode="valid")
        alarms += contribution_rms(own, whole, 12 * np.sin(x) + noise, session, 0.05) > 0
        if seed < 5:
            assert contribution_rms(own, whole, 12 * np.cos(x) + noise, session, 0.05) == pytest.approx(8.5, rel=0.1)
    assert alarms <= 10
    assert contribution_rms(own[:, :1], whole, 12 * np.sin(x), session, 0.05) == 0.0


@pytest.mark.slow
def test_where_positions_alone_are_recorded() -> None:
    """Speeds that the first recording implied are implied by the later one, too."""
    wave = lambda turn: lambda c: 30 * np.sign(c["v"]) + 12 * np.sin(2 * np.pi * c["x"] / 24 + turn)  # noqa: E731
    diagnosis, _ = diagnose(bare(trace(1, hidden=wave(0.0))))
    assert states(bare(trace(2, hidden=wave(0.0))), diagnosis) == {
        "coulomb_friction": "unchanged",
        "torque_ripple": "unchanged",
    }
    assert states(bare(trace(3, hidden=wave(1.5))), diagnosis) == {
        "coulomb_friction": "unchanged",
        "torque_ripple": "moved",
    }


def test_what_a_recording_cannot_tell_is_not_called_changed(earlier) -> None:
    later = machine(9)
    few = later.take(np.flatnonzero(later.frame["dir"] > 0))  # one direction: lost motion never acts
    by_name = {h.effect: h for h in against(few, earlier)}
    assert by_name["backlash"].state == "not judged" and not by_name["backlash"].changed
    loud = against(machine(9, noise=60.0), earlier)
    assert {h.state for h in loud} <= {"undecided", "unchanged"}


def test_a_recording_of_something_else_is_refused(earlier) -> None:
    with pytest.raises(DataError, match="no recorded or no simulated column"):
        against(trace(1), earlier)
    with pytest.raises(DataError, match="names no effect"):
        against(machine(1), earlier.model_copy(update={"responses": ()}))


def test_intervals_cover_where_rows_go_together() -> None:
    """A slope in noise with a memory of 20 rows: 95 % intervals hold it in 88 to 99 of 100 (plain ones in about 50)."""
    inside = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        x = np.sin(np.arange(2000) / 40.0)
        noise = np.zeros(2000)
        for k in range(1, 2000):
            noise[k] = 0.95 * noise[k - 1] + rng.standard_normal()
        b, sd, degrees = clustered(np.column_stack([x, np.ones(2000)]), 2.0 * x + noise, np.zeros(2000, dtype=int))
        inside += abs(b[0] - 2.0) < 2.02 * sd[0]
        assert degrees == 39
    assert 85 <= inside <= 99


def test_the_command(earlier, tmp_path: Path, capsys) -> None:
    from errpipe.cli.app import main

    (tmp_path / "then.json").write_text(json.dumps(earlier.document()))
    folder.write(tmp_path / "same", machine(11))
    folder.write(tmp_path / "worn", machine(11, lost=12.0))
    order = ["--against", str(tmp_path / "then.json"), "--json"]
    assert main(["diagnose", str(tmp_path / "same"), "--out", str(tmp_path / "a"), *order]) == 0
    assert json.loads(capsys.readouterr().out)["result"]["changed"] == []
    assert main(["diagnose", str(tmp_path / "worn"), "--out", str(tmp_path / "b"), *order]) == 4
    said = json.loads(capsys.readouterr().out)
    assert said["exit_code"] == 4 and said["result"]["changed"] == ["backlash (EXX)"]
    assert json.loads((tmp_path / "b/against.json").read_text())["findings"] == said["result"]["findings"]
    (tmp_path / "no.json").write_text('{"table": 1}')
    order[1] = str(tmp_path / "no.json")
    assert main(["diagnose", str(tmp_path / "same"), "--out", str(tmp_path / "c"), *order]) == 6
    order[1] = str(tmp_path / "absent.json")
    assert main(["diagnose", str(tmp_path / "same"), "--out", str(tmp_path / "c"), *order]) == 2
    assert not (tmp_path / "c").exists()
