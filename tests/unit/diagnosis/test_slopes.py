"""Slopes that a simulation's own expansion does not explain; slopes made of a sensor that failed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from errpipe.diagnosis import diagnose, judge, prepare
from errpipe.terms.sensor_fault import step_between, steps, suspicious

from .machines import axis, recording


def slow(*values):
    """A case like a fast one, of another seed or side."""
    return pytest.param(*values, marks=pytest.mark.slow)


def grid(seed: int, lead: float):
    """A work space on a grid; the simulation holds an expansion from 22.5 degC and a squareness, with gains off."""
    rng = np.random.default_rng(seed)
    size = {"x": (600.0, 5), "y": (500.0, 5), "z": (400.0, 4)}
    at = {a: np.sort(rng.uniform(0, length, n)) for a, (length, n) in size.items()}
    z, y, x = (np.tile(v.ravel(), 5) for v in np.meshgrid(at["z"], at["y"], at["x"], indexing="ij"))
    run = np.repeat(np.arange(5), x.size // 5)
    t = np.arange(x.size) * 10.0 + run * 2500.0
    bed, air = 21.5 + 3 * (1 - np.exp(-t / 9000)), 21 + np.cos(t / 7000)
    expansion, square = -12e-3 * z * (bed - 22.5), 25e-3 * x
    error = 1.1 * expansion + 0.93 * square + lead * 1e-3 * z + 0.6 * rng.standard_normal(x.size)
    columns = {"run": run.astype(str), "t": t, "x": x, "y": y, "z": z, "T_bed": bed, "T_air": air}
    kinds = {"run": {"role": "run"}, "t": {"role": "time", "unit": "s"}}
    kinds |= {a: {"role": "position", "axis": a.upper(), "unit": "mm"} for a in "xyz"}
    for name, place in (("T_bed", "bed"), ("T_air", "air in the work space")):
        kinds[name] = {"role": "temperature", "unit": "degC", "location": place}
    columns |= {"EZ": np.round(error, 2), "EZ_sim": np.round(expansion + square, 3)}
    kinds |= {"EZ": {"role": "error", "component": "E_Z", "unit": "um"}}
    kinds |= {"EZ_sim": {"role": "simulated", "component": "E_Z", "unit": "um"}}
    return recording(columns, kinds)


def named(raw):
    (pair,), _ = prepare.pairs(raw)
    case = judge.diagnose(raw, prepare.followed(raw, prepare.condition(raw), pair), pair)
    return [f.hypothesis.effect for f in case.explanation.accepted]


@pytest.mark.parametrize(("seed", "lead"), [slow(0, 10.0), (1, -10.0), slow(2, 10.0), (1, 0.0)])
def test_a_lead_error_with_a_simulated_expansion_is_no_gain_of_it(seed, lead):
    assert named(grid(seed, lead)) == (["scale_error"] if lead else [])


@pytest.mark.parametrize(("along", "stuck"), [(True, True), slow(True, False), slow(False, True), (False, False)])
def test_a_sensor_failed_whose_reading_the_simulation_made_a_shift_or_a_slope_of(along, stuck):
    raw = axis(0)
    frame, rng = raw.frame.copy(), np.random.default_rng(100)
    true, rows = frame["T_nut"].to_numpy(), np.arange(len(frame))
    inside = (rows >= 211) & (rows < 369)
    read = np.where(inside, true[211] if stuck else true + 3.0, true)
    gain = 11.0e-3 * frame["x"] if along else 2.0
    frame["T_nut"] = np.round(read + 0.04 * rng.standard_normal(rows.size), 1)
    frame["EXX_sim"] += gain * (read - 20)
    frame["EXX"] += gain * (true - 20)
    assert named(replace(raw, frame=frame)) == ["sensor_fault"]


def test_stretches_are_seen_under_a_display_that_jitters_and_from_a_pause_on():
    t = np.arange(300) * 60.0 + np.where(np.arange(300) >= 200, 5000.0, 0.0)
    rng = np.random.default_rng(1)
    read = 24 + 3 * np.sin(t / 3000) + 0.05 * rng.standard_normal(300)
    stuck = read.copy()
    stuck[100:180] = 24.5 + 0.05 * rng.standard_normal(80)
    stuck[180:] += 4.0
    assert any(abs(a - 100) < 12 and b == 179 for a, b in suspicious(np.round(stuck, 1), t))
    stepped = np.round(read + np.where(np.arange(300) >= 200, 8.0, 0.0), 1)
    assert (200, 299) in suspicious(stepped, t)
    assert step_between(*steps(np.r_[np.zeros(20), np.full(30, 3.0), np.zeros(20)], t[:70]), 20, 49) == 3.0
    assert step_between(*steps(np.r_[np.zeros(20), np.full(30, 3.0), np.full(20, 6.0)], t[:70]), 20, 49) == 0.0


@pytest.mark.parametrize("seed", [1, 2])
def test_two_gains_of_expansion_and_lead_error_are_no_finding(seed):
    """Both are slopes, so the simulation is seen to hold one expansion, counted from another temperature."""
    rng = np.random.default_rng(seed)
    x = rng.permutation(np.tile(np.linspace(0, 900, 25), 12))
    bed = 22 + 4 * (1 - np.exp(-np.arange(x.size) / 90))
    grown, lead = 11e-3 * x * (bed - 20), -22e-3 * x
    columns = {"t": 10.0 * np.arange(x.size), "x": x, "T_bed": bed, "S": grown + lead}
    columns["E"] = 1.12 * grown + 0.95 * lead + 0.3 * rng.standard_normal(x.size)
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "T_bed": {"role": "temperature", "unit": "degC", "location": "bed"},
        "E": {"role": "error", "component": "EXX", "unit": "um"},
        "S": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    (response,) = diagnose(recording(columns, kinds))[0].responses
    assert response.verdict == "recalibrate", response.says
