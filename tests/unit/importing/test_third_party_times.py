"""Logs of a drift as loggers write them: times in every form, units behind a blank or an underscore."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing.sheet import ReaderOptions
from tests.unit.importing.known_test import imported

STEP = 60.0  # s
START = datetime(2025, 3, 1, 11, 58)
TIMES = STEP * np.arange(40)
TEMPERATURES = np.round(20.0 + np.cumsum(np.random.default_rng(3).normal(0.0, 0.2, TIMES.size)), 2)
DRIFTS = np.round(3.0 * (TEMPERATURES - 20.0) + np.sin(TIMES / 200.0), 2)


def drift(tmp_path: Path, header: str, written: Callable[[float], str], rise: str = "T [°C]") -> Path:
    """A log of time, temperature and drift along Z."""
    rows = [f"{written(t)},{a},{z}" for t, a, z in zip(TIMES, TEMPERATURES, DRIFTS, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([f"{header},{rise},Z drift um", *rows, ""]), encoding="utf-8")
    return tmp_path / "log.csv"


def dated(form: str) -> Callable[[float], str]:
    return lambda t: (START + timedelta(seconds=t)).strftime(form)


@pytest.mark.parametrize(
    "header, written",
    [
        ("t_s", lambda t: f"{t:.1f}"),
        ("t s", lambda t: f"{t:.1f}"),
        ("time h", lambda t: f"{t / 3600:.8f}"),
        ("t_h", lambda t: f"{t / 3600:.8f}"),
        ("Date/Time", dated("%m/%d/%Y %I:%M %p")),
        ("DateTime", dated("%d-%m-%Y %H:%M:%S")),
        ("DateTime", dated("%d-%b-%Y %H:%M:%S")),
        ("DateTime", dated("%Y/%m/%d %H:%M")),
        ("DateTime", dated("%Y%m%d%H%M%S")),
        ("DateTime", dated("%Y%m%d_%H%M%S")),
        ("Elapsed", lambda t: f"0 days {timedelta(seconds=t)}"),
        ("Elapsed", lambda t: f"{24 + int(t // 3600)}:{int(t // 60) % 60:02d}:{int(t) % 60:02d}"),
        ("Elapsed", lambda t: f"1.{int(t // 3600):02d}:{int(t // 60) % 60:02d}:{int(t) % 60:02d}"),
    ],
)
def test_times_in_seconds(tmp_path: Path, header: str, written: Callable[[float], str]) -> None:
    recording = imported(tmp_path, drift(tmp_path, header, written))
    time = recording.array(recording.name("time"))
    assert time - time[0] == pytest.approx(TIMES, abs=0.1)
    assert recording.array(recording.name("temperature")) == pytest.approx(TEMPERATURES)


def test_day_and_month_are_not_exchanged_over_a_month(tmp_path: Path) -> None:
    """1 to 13 March, day first with dashes: as months the time would fall, and a thirteenth is none."""
    rows = [f"{day:02d}-03-2025 07:00:00,{20 + day % 3},{3.5 * (day % 3)}" for day in range(1, 13)]
    (tmp_path / "log.csv").write_text("\n".join(["DateTime,T [°C],Z drift um", *rows, ""]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "log.csv")
    assert np.diff(recording.array(recording.name("time"))) == pytest.approx(86400.0)


@pytest.mark.parametrize(
    "header, written",
    [("datenum", lambda t: f"{739000.5 + t / 86400:.6f}"), ("Date", lambda t: f"day {t:.0f} of the week")],
)
def test_times_that_are_asked_about(tmp_path: Path, header: str, written: Callable[[float], str]) -> None:
    with pytest.raises(DataError, match=f"--set '?{header}"):
        imported(tmp_path, drift(tmp_path, header, written))


@pytest.mark.parametrize("header", ["T_K", "T [K]", "T1 K", "temperature K", "temp_F", "T_amb F", "T1 [°F]"])
def test_temperatures_become_degrees_celsius(tmp_path: Path, header: str) -> None:
    written = 32.0 + 1.8 * TEMPERATURES if "F" in header else TEMPERATURES + 273.15
    rows = [f"{t},{a:.3f},{z}" for t, a, z in zip(TIMES, written, DRIFTS, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([f"time s,{header},Z drift um", *rows, ""]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "log.csv")
    assert recording.array(recording.name("temperature")) == pytest.approx(TEMPERATURES, abs=0.006)


@pytest.mark.parametrize("header", ["dZ [µm]", "dz_um", "ΔZ [µm]"])
def test_a_difference_names_its_axis(tmp_path: Path, header: str) -> None:
    rows = [f"{t},{a},{z}" for t, a, z in zip(TIMES, TEMPERATURES, DRIFTS, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([f"time s,T [°C],{header}", *rows, ""]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "log.csv")
    assert [c.component for c in recording.manifest.columns.values() if c.role == "error"] == ["E_Z"]


def test_metres_or_measured(tmp_path: Path) -> None:
    rows = [f"{r},{x / 1000},{0.01 * x:.2f}" for r in (1, 2) for x in range(0, 500, 40)]
    (tmp_path / "f.csv").write_text("\n".join(["run,x_pos_m,dev_um", *rows, ""]), encoding="utf-8")
    with pytest.raises(DataError, match="metres, or measured"):
        imported(tmp_path, tmp_path / "f.csv")
    recording = imported(tmp_path, tmp_path / "f.csv", sets=["x_pos_m.unit=m"])
    assert np.ptp(recording.array(recording.name("position"))) == pytest.approx(480.0)


def test_parts_of_a_log_that_overlap_are_read_once(tmp_path: Path) -> None:
    """A logger that begins each part with the last rows of the part before: time went back, the file was refused."""
    file = drift(tmp_path, "t_s", lambda t: f"{t:.1f}")
    lines = file.read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join([*lines[:20], *lines[16:], ""]), encoding="utf-8")
    recording = imported(tmp_path, file)
    assert recording.time() == pytest.approx(TIMES)
    assert recording.array(recording.names("error")[0]) == pytest.approx(DRIFTS)


def test_a_run_that_begins_like_the_one_before_is_no_copy(tmp_path: Path) -> None:
    file = drift(tmp_path, "t_s", lambda t: f"{t:.1f}")
    lines = file.read_text(encoding="utf-8").splitlines()
    other = [f"{line.rsplit(',', 1)[0]},9.99" for line in lines[2:]]
    file.write_text("\n".join([*lines, lines[1], *other, ""]), encoding="utf-8")
    with pytest.raises(DataError, match=r"recording.csv:42  t: 0 s comes after"):
        imported(tmp_path, file)


def log_of_an_axis(header: str, row: Callable[[int, float, float], str]) -> str:
    """A log at 2 ms: 600 rows of command and actual position, 10 um apart and more."""
    time = 0.002 * np.arange(600)
    command = 100.0 + 80.0 * np.sin(1.3 * time)
    actual = command + 0.01 * np.cos(1.3 * time)
    return "\n".join([header, *(row(i, x, y) for i, (x, y) in enumerate(zip(command, actual, strict=True)))])


@pytest.mark.parametrize(
    ("header", "row", "period"),
    [
        ("time_ns,X cmd (mm),X act (mm)", lambda i, x, y: f"{2_000_000 * i},{x:.6f},{y:.6f}", None),
        (
            "t [ns],X cmd (mm),X act (mm)",
            lambda i, x, y: f"{1772438280000000000 + 2_000_000 * i},{x:.6f},{y:.6f}",
            None,
        ),
        ("Sample,X cmd (mm),X act (mm)", lambda i, x, y: f"{i},{x:.6f},{y:.6f}", 0.002),
        ("Time (ms)\ts noml X (mm)\ts actl X (mm)", lambda i, x, y: f"{2 * i}\t{x:.6f}\t{y:.6f}", None),
    ],
)
def test_nanoseconds_and_a_period_that_a_person_says(
    tmp_path: Path, header: str, row: Callable[[int, float, float], str], period: float | None
) -> None:
    """Nanoseconds were seconds, and --period of a CSV was ignored."""
    (tmp_path / "f.csv").write_text(log_of_an_axis(header, row), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv", ReaderOptions(period=period))
    assert np.diff(recording.array(recording.name("time"))) == pytest.approx(0.002, abs=1e-6)
    assert np.abs(recording.array(recording.name("error", component="EXX"))).max() == pytest.approx(10.0, abs=0.01)


def test_a_scale_with_an_encoder_is_no_command(tmp_path: Path) -> None:
    """Which of them is right is not stated; as a command it would turn the sign."""
    text = log_of_an_axis(
        "t [s],X motor encoder [mm],X linear scale [mm]", lambda i, x, y: f"{0.002 * i},{x:.6f},{y:.6f}"
    )
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match="no two contain an actual and a commanded position"):
        imported(tmp_path, tmp_path / "f.csv")
