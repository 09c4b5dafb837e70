"""Level, size and rms of a response beside what a model predicts: what changed, since when, and what is no change."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.validation import response_drift

OLD, NEW, ROWS = 10, 8, 30
RUN = np.repeat(np.arange(OLD + NEW), ROWS)
REFERENCE = RUN < OLD


def changed(
    factor: np.ndarray,
    offset: np.ndarray,
    seed: int = 1,
    least_noise: float = 0.0,
    lost: float = 0.0,
    moving: float = 1.0,
    cycle: np.ndarray | None = None,
) -> dict[str, list]:
    """Drifts of 18 runs of which each is read by a factor and with an offset, um; lost: motion lost in new ones, um.

    moving: share of what the old runs move that a new one moves.
    """
    rng = np.random.default_rng(seed)
    prediction = 10.0 * np.sin(np.linspace(0.0, 40.0, RUN.size)) + rng.normal(0.0, 1.0, RUN.size)
    prediction *= np.where(REFERENCE, 1.0, moving)
    noise = rng.normal(0.0, 0.5, RUN.size) * np.clip(np.abs(factor[RUN]), least_noise, 1.0)
    measured = (
        factor[RUN] * prediction
        + offset[RUN]
        + noise
        + np.where(REFERENCE, 0.0, lost / 2.0) * (-1.0) ** np.arange(RUN.size)
    )
    columns = {"run": Column(role="run"), "e": Column(role="error", component="E_Z", unit="um")}
    frame = pd.DataFrame({"run": RUN.astype(str), "e": measured})
    if cycle is not None:
        columns["cycle"], frame["cycle"] = Column(role="group", of="duty_cycle"), cycle[RUN]
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)
    return response_drift.drifts(recording, REFERENCE, {"E_Z": prediction})


def test_nothing_changed() -> None:
    """Three figures, each with the false-alarm rate of a level: 2 % of series."""
    alarms = [any(changed(np.ones(OLD + NEW), np.zeros(OLD + NEW), seed).values()) for seed in range(60)]
    assert sum(alarms) <= 7  # 3.6 expected


def test_runs_that_hardly_move_raise_no_alarm() -> None:
    """Their slopes scatter by more: for 17 of 60 series another size was reported."""
    still = np.ones(OLD + NEW), np.zeros(OLD + NEW)
    assert sum(bool(changed(*still, seed, moving=0.3)["sizes"]) for seed in range(60)) <= 4


@pytest.mark.parametrize(
    "factor, means", [(0.05, "switched on"), (-1.0, "sign"), (1000.0, "1000"), (0.001, "1/1000"), (1.3, "")]
)
def test_what_a_factor_means(factor: float, means: str) -> None:
    (size,) = changed(np.where(np.arange(OLD + NEW) < OLD + 2, 1.0, factor), np.zeros(OLD + NEW))["sizes"]
    assert size["factor"] == pytest.approx(factor, rel=0.1)
    assert int(size["since"]) in range(OLD, OLD + 3)
    assert means in size["meaning"] and bool(size["meaning"]) == bool(means)


def test_compensated_readings_of_1_in_25_are_not_taken_for_inches() -> None:
    """A unit scales the noise too, a table does not."""
    factor = np.where(np.arange(OLD + NEW) < OLD, 1.0, 1 / 25.4)
    (size,) = changed(factor, np.zeros(OLD + NEW), least_noise=1.0)["sizes"]
    assert "switched on" in size["meaning"]


def test_a_level_that_moved_is_no_size() -> None:
    drifts = changed(np.ones(OLD + NEW), np.where(np.arange(OLD + NEW) < OLD, 0.0, 3.0))
    (level,) = drifts["residuals"]
    assert drifts["sizes"] == []
    assert level["size_um"] == pytest.approx(3.0, abs=0.3) and level["since"] == str(OLD)


def test_lost_motion_moves_the_rms_alone() -> None:
    drifts = changed(np.ones(OLD + NEW), np.zeros(OLD + NEW), lost=1.6)
    (rms,) = drifts["rms"]
    assert drifts["residuals"] == drifts["sizes"] == [] and rms["since"] == str(OLD)
    assert rms["before_um"] == pytest.approx(0.5, abs=0.1) and rms["after_um"] == pytest.approx(0.94, abs=0.15)


def test_one_outlying_run_is_no_change() -> None:
    factor = np.ones(OLD + NEW)
    factor[OLD + 2] = -0.5
    assert changed(factor, np.zeros(OLD + NEW))["sizes"] == []


def test_a_level_that_moved_in_one_duty_cycle_alone_says_which() -> None:
    cycle = np.array(["milling", "idle", "milling"] * 6)
    shift = np.where((np.arange(OLD + NEW) >= OLD) & (cycle == "milling"), 8.0, 0.0)
    still = np.ones(OLD + NEW)
    (level,) = changed(still, shift, cycle=cycle)["residuals"]
    assert level["regime"] == "duty_cycle milling"
    (level,) = changed(still, np.where(np.arange(OLD + NEW) >= OLD, 8.0, 0.0), cycle=cycle)["residuals"]
    assert level["regime"] == ""


def test_a_level_that_moved_in_a_third_of_the_runs_is_no_outlying_run() -> None:
    number = np.arange(OLD + NEW)
    cycle = np.where(number % 3 == 1, "milling", "idle")
    shift = np.where((number >= OLD) & (cycle == "milling"), 8.0, 0.0)
    (level,) = changed(np.ones(OLD + NEW), shift, cycle=cycle)["residuals"]
    assert level["regime"] == "duty_cycle milling" and level["size_um"] == pytest.approx(8.0, abs=0.5)
    one = np.where(number == 13, 8.0, 0.0)
    assert not changed(np.ones(OLD + NEW), one, cycle=cycle)["residuals"]
