"""Faults that begin within a recording: exchanged sensors, another unit, a new zero, a direction turned in one run."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.validation import plausibility

RUNS, TARGETS = 24, np.arange(0.0, 501.0, 100.0)
COLUMNS = {
    "run": Column(role="run"),
    "x": Column(role="command", axis="X", unit="mm"),
    "dir": Column(role="direction", axis="X"),
    **{n: Column(role="temperature", unit="degC") for n in ("T_nut", "T_bed", "T_air")},
    "EXX": Column(role="error", component="EXX", unit="um"),
}


def warming_axis(seed: int) -> pd.DataFrame:
    """An axis in duty cycles, its scale held 200 mm beyond the travel, so that heat shifts every target."""
    rng = np.random.default_rng(seed)
    nut, bed, rows = 20.0, 20.0, list[list[object]]()
    for run in range(RUNS):
        if run % 6 == 0:  # a day begins cold
            nut, bed = 20.0 + 0.3 * rng.normal(size=2)
        duty = rng.choice([0.0, 0.5, 1.0])
        nut += 0.4 * (20.0 + 10.0 * duty - nut)
        bed += 0.1 * (20.0 + 4.0 * duty - bed)
        air = 20.0 + 0.4 * np.sin(run / 5) + 0.05 * rng.normal()
        for side, order in ((1.0, TARGETS), (-1.0, TARGETS[::-1])):
            grown = 11.5e-3 * (nut - 20.0) * (order + 200.0) * 0.5
            exx = order / 50 - 2.0 * side + grown + 0.3 * rng.normal(size=order.size)
            temperatures = [nut, bed, air] + 0.03 * rng.normal(size=(order.size, 3))
            rows += [[str(run + 1), x, side, *t, e] for x, t, e in zip(order, temperatures, exx, strict=True)]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def codes_of(frame: pd.DataFrame) -> dict[str, str]:
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=COLUMNS), frame)
    return {f.code: f.found for f in plausibility.findings(recording)}


def late(frame: pd.DataFrame) -> pd.Series:
    return frame.run.astype(int) > RUNS // 2


def exchanged(f: pd.DataFrame) -> None:
    f.loc[late(f), ["T_nut", "T_air"]] = f.loc[late(f), ["T_air", "T_nut"]].to_numpy()


def in_fahrenheit(f: pd.DataFrame) -> None:
    f.loc[late(f), "T_nut"] = 1.8 * f.T_nut + 32.0


def zeroed(f: pd.DataFrame) -> None:
    f.loc[late(f), "EXX"] += 40.0


def zeroed_within_a_run(f: pd.DataFrame) -> None:
    f.loc[99:107, "EXX"] += 40.0  # run 9, from its fourth reading on


def turned(f: pd.DataFrame) -> None:
    f.loc[f.run == "9", "dir"] *= -1.0


FAULTS: list[tuple[Callable[[pd.DataFrame], None], str, str]] = [
    (exchanged, "exchanged-sensors", "from run 1[3-9] on"),
    (in_fahrenheit, "temperature-range", "degF instead of degC from run 13 on"),
    (zeroed, "new-zero", r"run 13 by \+(3[5-9]|4)"),
    (zeroed_within_a_run, "new-zero", r"run 9: \+(3[5-9]|4)[\d.]* um after row 99"),
    (turned, "reversed-direction", "in run 9 it is the opposite"),
]


@pytest.mark.parametrize(("fault", "code", "says"), FAULTS)
def test_a_fault_that_begins_within_a_recording_is_named(
    fault: Callable[[pd.DataFrame], None], code: str, says: str
) -> None:
    """Seeds 11 to 20; of 31 to 60, which chose nothing, 28, 29, 30 and 30 of 30 are named."""
    named = 0
    for seed in range(11, 21):
        frame = warming_axis(seed)
        fault(frame)
        named += re.search(says, codes_of(frame).get(code, "")) is not None
    assert named >= 8


def test_a_gauge_that_was_touched_for_two_readings_has_no_new_zero() -> None:
    frame = warming_axis(11)
    frame.loc[99:100, "EXX"] += 40.0
    assert "new-zero" not in codes_of(frame)


def test_a_sound_axis_has_none_of_them() -> None:
    """100 axes that chose no threshold."""
    named = {code for _, code, _ in FAULTS}
    assert [(s, f) for s in range(500, 600) if (f := codes_of(warming_axis(s))).keys() & named] == []


def test_lost_motion_without_a_column_of_directions_is_no_new_zero() -> None:
    """The step at each turn was to be subtracted: what remains has no lost motion left to compensate."""
    rng = np.random.default_rng(41)
    x = np.tile(np.r_[0.0:4001.0:100.0, 4000.0:-1.0:-100.0], 5)
    side = np.tile(np.repeat([1.0, -1.0], 41), 5)
    run = np.repeat([str(r) for r in range(5)], 82)
    exx = -25.0 * x / 4000.0 + 2.0 * np.sin(x / 300.0) - 3.0 * side + rng.normal(0.0, 0.4, x.size)
    columns = {name: COLUMNS[name] for name in ("run", "x", "EXX")}
    recording = Recording(
        Manifest(recording=1, tables=("t.csv",), columns=columns), pd.DataFrame({"run": run, "x": x, "EXX": exx})
    )
    assert "new-zero" not in {f.code for f in plausibility.findings(recording)}
    frame = recording.frame.assign(EXX=recording.frame.EXX + 40.0 * ((recording.frame.index >= 20) & (run == "0")))
    zeroed_once = Recording(recording.manifest, frame)
    assert "new-zero" in {f.code for f in plausibility.findings(zeroed_once)}, "between turns"
