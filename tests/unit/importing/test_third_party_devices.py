"""Logs of several devices, and drifts of several days, as a shop has them."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import imported

EVENING = datetime(2025, 3, 1, 18, 0)
DAY, STEP, PROBED = 86400.0, 60.0, 600.0  # s
NIGHTS, LENGTH = 4, 7200.0  # LENGTH: s of a night's test


def clock(second: float) -> datetime:
    return EVENING + timedelta(seconds=second)


def temperature(second: np.ndarray) -> np.ndarray:
    return np.round(20.0 + 5.0 * (1.0 - np.exp(-(second % DAY) / 2000.0)) + second / DAY, 3)


def seconds(step: float, offset: float = 0.0) -> np.ndarray:
    return np.concatenate([night * DAY + np.arange(0.0, LENGTH, step) + offset for night in range(NIGHTS)])


def temperatures(tmp_path: Path, shift: float = 0.0, name: str = "temps.csv") -> Path:
    rows = [
        f"{clock(t + shift):%d.%m.%Y %H:%M:%S};{v}"
        for t, v in zip(seconds(STEP), temperature(seconds(STEP)), strict=True)
    ]
    (tmp_path / name).write_text("\n".join(["Time;T front [°C]", *rows, ""]), encoding="utf-8")
    return tmp_path / name


def probe(tmp_path: Path, dated: bool = True) -> Path:
    t = seconds(PROBED, 7.0)
    stamps = [f"{clock(s):%Y-%m-%d};{clock(s):%H:%M:%S}" if dated else f"{i};{s}" for i, s in enumerate(t)]
    rows = [f"{stamp};{3.0 * v:.1f}" for stamp, v in zip(stamps, temperature(t), strict=True)]
    (tmp_path / "probe.csv").write_text(
        "\n".join([f"{'Date' if dated else 'No'};Time;Z [µm]", *rows, ""]), encoding="utf-8"
    )
    return tmp_path / "probe.csv"


def test_a_drift_of_several_evenings_is_a_run_each(tmp_path: Path) -> None:
    recording = imported(tmp_path, probe(tmp_path))
    runs = recording.frame[recording.name("run")]
    assert runs.unique().tolist() == [f"2025-03-0{n}" for n in range(1, 1 + NIGHTS)]


@pytest.mark.parametrize("order", [0, 1])
def test_a_log_of_temperatures_stands_with_the_readings_of_a_probe(tmp_path: Path, order: int) -> None:
    files = [temperatures(tmp_path), probe(tmp_path)]
    recording = imported(tmp_path, files[::-1] if order else files)
    frame = recording.frame.assign(at=recording.array(recording.name("time")))
    drift, hot = recording.names("error")[0], recording.name("temperature")
    probed = frame[frame[drift].notna()]
    assert len(probed) == seconds(PROBED).size and len(frame) == len(probed) + seconds(STEP).size
    before = frame[hot].ffill()[probed.index]  # the reading of the log 7 s before
    assert probed[drift].to_numpy() == pytest.approx(3.0 * before.to_numpy(), abs=0.2)
    assert frame.groupby(frame[recording.name("run")])["at"].apply(lambda s: s.is_monotonic_increasing).all()


def test_a_log_a_day_is_one_log(tmp_path: Path) -> None:
    """The logger began a new file after the second night."""
    whole = temperatures(tmp_path).read_text(encoding="utf-8").splitlines()
    half = 1 + len(seconds(STEP)) // 2
    (tmp_path / "a.csv").write_text("\n".join(whole[:half]), encoding="utf-8")
    (tmp_path / "b.csv").write_text("\n".join([whole[0], *whole[half:]]), encoding="utf-8")
    recording = imported(tmp_path, [tmp_path / "a.csv", tmp_path / "b.csv", probe(tmp_path)])
    (hot,) = recording.names("temperature")
    assert recording.frame[hot].notna().sum() == seconds(STEP).size


def test_readings_at_a_position_take_the_last_temperature(tmp_path: Path) -> None:
    """A laser test with times, a logger beside it: the recording keeps the laser's rows."""
    t = seconds(STEP, 20.0)
    rows = [
        f"{clock(s):%Y-%m-%dT%H:%M:%S},{50 * (i % 9)},{0.01 * (i % 9) + 0.003 * np.sin(i):.4f}" for i, s in enumerate(t)
    ]
    (tmp_path / "laser.csv").write_text("\n".join(["Time,Target X [mm],Deviation [mm]", *rows, ""]), encoding="utf-8")
    recording = imported(tmp_path, [tmp_path / "laser.csv", temperatures(tmp_path)])
    assert len(recording) == t.size
    assert recording.array(recording.name("temperature")) == pytest.approx(temperature(seconds(STEP)))


def test_no_common_time_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="2025-04-30 18:00 to "):
        imported(tmp_path, [temperatures(tmp_path, shift=60 * DAY), probe(tmp_path)])


def test_clocks_without_dates_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="by date and time"):
        imported(tmp_path, [temperatures(tmp_path), probe(tmp_path, dated=False)])


def test_only_logs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no column holds a deviation"):
        imported(tmp_path, [temperatures(tmp_path), temperatures(tmp_path, 1.0, "more.csv")])


def test_dates_of_files_count_from_the_first(tmp_path: Path) -> None:
    """Two evenings, a file each: the second begins a day later, not at 0 again."""
    lines = probe(tmp_path).read_text(encoding="utf-8").splitlines()
    count = int(LENGTH / PROBED)
    for night in range(2):
        rows = lines[1 + night * count : 1 + (night + 1) * count]
        (tmp_path / f"n{night}.csv").write_text("\n".join([lines[0], *rows]), encoding="utf-8")
    recording = imported(tmp_path, [tmp_path / "n0.csv", tmp_path / "n1.csv"])
    t = recording.array(recording.name("time"))
    assert t[count] - t[0] == pytest.approx(DAY)
