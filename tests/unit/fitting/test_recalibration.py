"""Recalibration: finds what it is allowed to find, never looks ahead, never beyond its bound."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain import driver as d
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import recalibration as rc

OPTIONS = rc.RecalibrationOptions(noise=0.3)


def day(rows: int = 240, runs: int = 2) -> Recording:
    row = np.arange(rows)
    frames = [
        pd.DataFrame({"run": f"r{k}", "t": row * 120.0 + k * 86400.0, "on": (row > 60) * 1000.0}) for k in range(runs)
    ]
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "on": Column(role="spindle_speed", unit="rpm"),
    }
    return Recording(Manifest(recording=1, tables=("x",), columns=columns), pd.concat(frames, ignore_index=True))


@pytest.fixture
def recording() -> Recording:
    return day()


def test_an_offset_and_a_wrong_gain_are_learnt(recording):
    hours = (recording.time() % 86400.0) / 3600.0
    model = 4.0 * hours
    truth = 3.0 + 1.3 * model
    told = rc.apply(recording, model, truth, rc.schedule(recording, 1800.0), rc.Recalibration(OPTIONS))
    late = hours > 5
    assert np.abs((truth - told)[late]).max() < 0.5 < 3.0 < np.abs((truth - model)[late]).min()


def test_no_reading_no_change(recording):
    model = np.linspace(0, 5, len(recording))
    none = np.zeros(len(recording), dtype=bool)
    assert_allclose(rc.apply(recording, model, model + 9.0, none, rc.Recalibration(OPTIONS)), model, atol=0)


def test_a_reading_changes_only_later_rows_of_its_own_run(recording):
    model, truth = np.zeros(len(recording)), np.full(len(recording), 5.0)
    one = np.zeros(len(recording), dtype=bool)
    one[100] = True
    told = rc.apply(recording, model, truth, one, rc.Recalibration(OPTIONS))
    assert (told[:101] == 0).all() and (told[101:240] > 4.0).all() and (told[240:] == 0).all()


def test_a_wild_reading_is_bounded_and_a_missing_one_ignored(recording):
    model, truth = np.zeros(len(recording)), np.full(len(recording), 1e5)
    probed = rc.schedule(recording, 3600.0)
    told = rc.apply(recording, model, truth, probed, rc.Recalibration(OPTIONS))
    assert told.max() == OPTIONS.bound
    assert (rc.apply(recording, model, np.full_like(truth, np.nan), probed, rc.Recalibration(OPTIONS)) == 0).all()
    with pytest.raises(DataError):
        rc.apply(recording, model[:5], truth, probed, rc.Recalibration(OPTIONS))


def test_the_running_state_is_told_from_an_offset(recording):
    running = d.Switch(of=d.Input(name="on"), on=10.0, off=1.0)
    how = rc.Recalibration(OPTIONS.model_copy(update={"wander": 0.5}), running)
    basis = how.basis(recording, np.zeros(len(recording)))
    truth = 7.0 * basis[:, 2]
    told = rc.apply(recording, np.zeros(len(recording)), truth, rc.schedule(recording, 1200.0), how)
    assert np.abs((truth - told)[120:240]).max() < 1.0


def test_schedule_counts_from_the_start_of_each_run(recording):
    probed = rc.schedule(recording, 3600.0)
    first = recording.time()[probed & (recording.run_codes() == 1)][0] - 86400.0
    assert first == 1800.0 and probed.sum() == 2 * 8


def test_more_readings_never_much_worse_and_the_spec_is_plain(recording):
    rng = np.random.default_rng(0)
    truth = np.cumsum(rng.normal(0, 0.3, len(recording)))
    found = rc.residual_by_readings(recording, np.zeros_like(truth), truth, rc.Recalibration(OPTIONS))
    size = [e["rms"] for e in found]
    assert size[-1] < 0.5 * size[0] and found[0]["every_s"] is None
    spec = rc.Recalibration(OPTIONS, d.Constant(value=1.0)).spec()
    assert json.loads(json.dumps(spec)) == spec and [s["name"] for s in spec["states"]] == ["offset", "gain", "late"]
