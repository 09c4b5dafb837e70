"""Readings on held-out rows: never ahead, no better than they are, and refused where they do not help."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.error_model import ComponentModel, ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import GateError
from errpipe.fitting import recalibration as rc


def days(runs: int = 6, rows: int = 240) -> Recording:
    frames = [
        pd.DataFrame({"run": f"r{k}", "t": np.arange(rows) * 120.0 + k * 86400.0, "T": 20.0}) for k in range(runs)
    ]
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "T": Column(role="temperature", unit="degC"),
    }
    return Recording(Manifest(recording=1, tables=("x",), columns=columns), pd.concat(frames, ignore_index=True))


def figures(left: np.ndarray) -> dict:
    """Each of six days left out; the deviation is what is left and a warm-up that the model knows."""
    recording = days()
    rows = [np.flatnonzero(recording.run_codes() == k) for k in range(6)]
    before = left + 20.0 * (1 - np.exp(-(recording.time() % 86400.0) / 5000.0))
    return rc.by_readings(
        recording, rows, [f"r{k}" for k in range(6)], [before[r] for r in rows], [left[r] for r in rows]
    )


def test_a_row_never_sees_its_own_reading_nor_a_later_one_nor_another_runs():
    run = np.array([0, 0, 0, 0, 1, 1])
    values = np.array([1.0, 2.0, np.nan, 4.0, 5.0, 6.0])
    assert rc.last_reading(run, values, np.ones(6, dtype=bool)).tolist() == [0, 1, 2, 2, 0, 5]
    assert rc.last_reading(run, values, np.zeros(6, dtype=bool)).tolist() == [0] * 6


def test_schedule_counts_from_the_start_of_each_run():
    recording = days(2)
    probed = rc.schedule(recording, 3600.0)
    assert recording.time()[probed & (recording.run_codes() == 1)][0] - 86400.0 == 1800.0 and probed.sum() == 2 * 8


def test_an_offset_of_the_day_is_taken_whole_and_the_model_is_worth_most_with_few_readings():
    rng = np.random.default_rng(1)
    values = figures(np.repeat(rng.normal(0, 5, 6), 240) + rng.normal(0, 0.2, 6 * 240))
    levels = values["levels"]
    assert [level["per_shift"] for level in levels] == [0, 1, 2, 4, 8, 16]
    assert levels[3]["share"] > 0.98 and levels[3]["rms"] < 0.5 * levels[0]["rms"]
    assert levels[2]["rms"] < 0.9 * levels[2]["rms_readings_alone"]


def test_readings_of_noise_get_no_share_and_cost_nothing():
    """A share of 1 would add a reading's noise to every row: 1.41 times what is left."""
    values = figures(np.random.default_rng(2).normal(0, 1, 6 * 240))
    assert all(level["share"] < 0.3 and level["rms"] < 1.06 * values["levels"][0]["rms"] for level in values["levels"])


def test_a_group_has_no_say_in_its_own_share():
    """Five days keep their offset: share 1. The sixth, whose error is noise and the largest, is judged with it."""
    left = np.repeat([3.0, -3.0, 3.0, -3.0, 3.0, 0.0], 240)
    own = left[5 * 240 :] = np.random.default_rng(3).normal(0, 30, 240)
    level = figures(left)["levels"][4]
    last = rc.last_reading(np.zeros(240), own, rc.schedule(days(1), 3600.0))
    assert level["groups"][5]["rms"] == pytest.approx(np.sqrt(np.mean((own - last) ** 2)))
    assert level["share"] < 0.5


def test_the_export_takes_the_judged_share_and_refuses_where_readings_do_not_help():
    model = ErrorModel(components=(ComponentModel(component="E_X", terms=()),))
    good = figures(np.repeat(np.random.default_rng(1).normal(0, 5, 6), 240))
    bad = figures(np.random.default_rng(2).normal(0, 1, 6 * 240))

    def exported(readings, number=8):
        validation = {"components": [{"component": "E_X", "readings": readings}]}
        return rc.with_readings(model, [validation], number).components[0].readings

    taken = exported(good)
    assert_allclose((taken.share, taken.hold_s, taken.bound), (1.0, 7200.0, good["bound"]))
    with pytest.raises(GateError, match="E_X: held-out rows were not better with 8 readings per shift"):
        exported(bad)
    with pytest.raises(GateError, match="E_X: no validation includes 8 readings per shift"):
        exported(None)


def test_a_recording_whose_axis_moves_is_no_run_over_time():
    recording = days(1)
    assert rc.is_thermal(recording)
    x = {"x": np.arange(240.0)}
    assert not rc.is_thermal(recording.with_columns(x, {"x": Column(role="position", axis="X", unit="mm")}))
