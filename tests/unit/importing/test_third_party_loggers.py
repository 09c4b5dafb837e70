"""Loggers, dumps and traces as their programs write them: clocks, zones, names, signs."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing.sheet import of_one_mark
from tests.unit.importing.known_test import deviation, holds_the_truth, imported, long_rows, prepared

START = datetime(2026, 5, 14, 11, 40)
STEP = 30  # s between readings of the laser
PLACES = np.linspace(-150, 150, 600)


def laser(tmp_path: Path) -> Path:
    rows = [f"{START + timedelta(seconds=STEP * k)};{r};{x:g};{d}" for k, (r, x, _, d) in enumerate(long_rows())]
    (tmp_path / "laser.csv").write_text("\n".join(["Time;Run;X target [mm];Deviation [um]", *rows]), "utf-8")
    return tmp_path / "laser.csv"


@pytest.mark.parametrize(
    ("head", "form"),
    [
        ("Date,Time,Nut (C)", "%m/%d/%Y,%I:%M:%S %p"),
        ("Time,Nut (C)", "%m/%d/%Y %I:%M:%S%p"),
        ("Time,Nut (C)", "%Y-%m-%dT%H:%M:%S.000"),
        ("Date,Time,Nut\nYYYY/MM/DD,hh:mm:ss,°C", "%Y/%m/%d,%H:%M:%S"),
    ],
    ids=["AM and PM", "without a blank", "ISO", "a line of forms"],
)
def test_a_logger_of_one_sensor_joins_the_laser(tmp_path: Path, head: str, form: str) -> None:
    """Its dates hold letters: no row had two numbers."""
    times = [START + timedelta(seconds=10 * k) for k in range(260)]
    rows = [f"{t.strftime(form)},{20 + k / 300:.3f}" for k, t in enumerate(times)]
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]), "utf-8")
    recording = imported(tmp_path, [laser(tmp_path), tmp_path / "log.csv"])
    holds_the_truth(recording)
    read = recording.array(recording.name("temperature"))
    assert read == pytest.approx(20 + STEP * np.arange(read.size) / 3000, abs=0.01)


def test_temperatures_have_no_thousands() -> None:
    assert of_one_mark(["20.125", "20.250"], comma=True, thousands=False) == ["20.125", "20.250"]
    with pytest.raises(ValueError, match=r"20\.125"):
        of_one_mark(["20.125", "20.250"], comma=True)


def drift(tmp_path: Path, header: str, times: list[str]) -> Path:
    rows = [f"{t};{0.2 * k + 0.1 * np.sin(k):.2f};{20 + 0.2 * k**0.8:.2f}" for k, t in enumerate(times)]
    (tmp_path / "f.csv").write_text("\n".join([f"{header};Z drift [um];Spindle [°C]", *rows]), "utf-8")
    return tmp_path / "f.csv"


@pytest.mark.parametrize(("header", "seconds"), [("minutes", 60.0), ("Stunden", 3600.0), ("seconds", 1.0)])
def test_a_time_is_called_by_its_unit(tmp_path: Path, header: str, seconds: float) -> None:
    recording = imported(tmp_path, drift(tmp_path, header, [str(k) for k in range(40)]))
    assert np.ptp(recording.time()) == pytest.approx(39 * seconds)


def test_the_end_of_summer_time_is_asked_about(tmp_path: Path) -> None:
    clock = [datetime(2026, 10, 25, 2, 40) + timedelta(minutes=k - (60 if k > 19 else 0)) for k in range(40)]
    with pytest.raises(DataError, match="'2026-10-25 02:00:00' follows '2026-10-25 02:59:00'"):
        prepared([drift(tmp_path, "Time", [str(t) for t in clock])])


def dumped(k: int, x: float, d: float) -> list[tuple[str, float]]:
    return [("Axis.X.SetPos", x), ("Axis.X.ActPos", x + d / 1000)]


@pytest.mark.parametrize(
    ("header", "line"),
    [
        ("Timestamp,NodeId,Value", "{t:%Y-%m-%dT%H:%M:%S}Z,ns=2;s={n},{v:.5f}"),
        ("id,ts,signal,value", "{k},{t:%Y-%m-%d %H:%M:%S},{n},{v:.5f}"),
        ("entity_id,state,last_changed", "sensor.{n},{v:.5f},{t:%Y-%m-%dT%H:%M:%S}Z"),
        ("timestamp,dataItemId,type,subType,value", "{t:%Y-%m-%dT%H:%M:%S}Z,X1,POSITION,{n},{v:.5f}"),
    ],
    ids=["OPC UA", "SQL", "state", "MTConnect"],
)
def test_a_row_per_value(tmp_path: Path, header: str, line: str) -> None:
    rows = [
        line.format(t=START + timedelta(seconds=STEP * k), k=2 * k + j, n=n, v=v)
        for k, (_, x, _, d) in enumerate(long_rows())
        for j, (n, v) in enumerate(dumped(k, x, d))
    ]
    (tmp_path / "f.csv").write_text("\n".join([header, *rows]), "utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    read = recording.array(recording.name("error", component="EXX"))
    assert read == pytest.approx([d for *_, d in long_rows()], abs=0.02)


def test_a_log_of_the_control_does_not_say_its_sign(tmp_path: Path) -> None:
    """`ERR` was taken as actual minus commanded: in a servo trace it is the other way round."""
    rows = [f"{4 * k},{x:.4f},{np.sign(k - 300) * 1.52:.2f}" for k, x in enumerate(PLACES)]
    (tmp_path / "f.csv").write_text("\n".join(["Time[ms],POSF X[mm],ERR X[um]", *rows]), "utf-8")
    with pytest.raises(DataError, match="controls then show commanded minus actual"):
        prepared([tmp_path / "f.csv"])
    recording = imported(tmp_path, tmp_path / "f.csv", sign="commanded-minus-actual")
    assert recording.array(recording.name("error", component="EXX"))[-1] == pytest.approx(-1.52)


@pytest.mark.parametrize("title", ["Pitch of axis Y", "Achse Y, Nicken"])
def test_a_line_above_says_what_turned(tmp_path: Path, title: str) -> None:
    rows = [f"{x};{0.05 * x + np.sin(x):.2f};{0.05 * x + np.sin(x) + 1:.2f}" for x in range(0, 500, 50)]
    (tmp_path / "f.csv").write_text("\n".join([title, "Position [mm];up [urad];down [urad]", *rows]), "utf-8")
    assert imported(tmp_path, tmp_path / "f.csv").components() == ("EAY",)


@pytest.mark.parametrize("kind", ["lines", "list", "columns", "parquet"])
def test_records(tmp_path: Path, kind: str) -> None:
    rows = [{"run": int(r), "x": {"target_mm": x, "dir": s}, "dev_um": float(d)} for r, x, s, d in long_rows()]
    flat = {"run": [int(r) for r, *_ in long_rows()], "x_target_mm": [x for _, x, *_ in long_rows()]}
    flat |= {"dir": [s for *_, s, _ in long_rows()], "dev_um": [float(d) for *_, d in long_rows()]}
    file = tmp_path / ("f.parquet" if kind == "parquet" else "f.json")
    if kind == "parquet":
        import pandas as pd

        pd.DataFrame(flat).to_parquet(file)
    else:
        text = {
            "lines": "\n".join(map(json.dumps, rows)),
            "list": json.dumps({"data": rows}),
            "columns": json.dumps(flat),
        }
        file.write_text(text[kind], "utf-8")
    holds_the_truth(imported(tmp_path, file))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('{"a": 1', ":1  not a JSON record"),
        ('{"a": 1}', "JSON or YAML without a table"),
        ("PAR1 none PAR1", "not a Parquet file"),
    ],
)
def test_damaged_records(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "f.json").write_text(text, "utf-8")
    with pytest.raises(DataError, match=match):
        prepared([tmp_path / "f.json"])


def test_metres_of_a_target(tmp_path: Path) -> None:
    rows = [f"{x / 1000:g};{d}" for x, d in zip(range(0, 601, 50), deviation(1, 0.0), strict=True)]
    (tmp_path / "f.csv").write_text("\n".join(["Axis X", "Target m;Deviation um", *rows]), "utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array(recording.name("position"))[-1] == pytest.approx(600.0)


def test_the_mark_of_an_open_workbook(tmp_path: Path) -> None:
    (tmp_path / "~$laser.xlsx").write_bytes(b"\x05owner" + b" " * 50)
    with pytest.raises(DataError, match="name the workbook"):
        prepared([tmp_path / "~$laser.xlsx"])


def test_an_answer_to_who_read_a_gauge_is_heard(tmp_path: Path) -> None:
    """Of a column per run the answer was ignored, and the sign was the wrong one."""
    x = np.arange(0.0, 401.0, 50.0)
    rows = [f"{t:.4f};{t - 0.01 * t / 400:.4f};{t - 0.01 * t / 400:.4f}" for t in x]
    (tmp_path / "f.csv").write_text("\n".join(["Axis Y", "Gauge block [mm];Run 1 [mm];Run 2 [mm]", *rows]), "utf-8")
    with pytest.raises(DataError, match=r"--set actual_Y\.role=command --set Gauge_block\.role=actual"):
        prepared([tmp_path / "f.csv"])
    recording = imported(tmp_path, tmp_path / "f.csv", sets=["actual_Y.role=command", "Gauge_block.role=actual"])
    read = recording.array(recording.name("error", component="EYY"))
    assert read == pytest.approx(np.tile(10 * x / 400, 2), abs=0.06)


def test_readings_at_one_place_are_no_positioning(tmp_path: Path) -> None:
    rows = [f"0.000;{0.001 * (k % 5):.3f}" for k in range(12)]
    (tmp_path / "f.csv").write_text("\n".join(["Axis Z, heights", "Nominal [mm];Actual [mm]", *rows]), "utf-8")
    with pytest.raises(DataError, match="at which positions of Z"):
        prepared([tmp_path / "f.csv"])


@pytest.mark.parametrize(
    ("header", "factor"), [("Bed [0.1 °C]", 10.0), ("bed 0.1 °C", 10.0), ("Bed [°C];Air [°C]", 1.0)]
)
def test_tenths_of_a_degree_and_an_open_sensor(tmp_path: Path, header: str, factor: float) -> None:
    rows = [
        f"{START + timedelta(seconds=10 * k)};{factor * (20 + k / 100):.1f}{';OPEN' if ';' in header else ''}"
        for k in range(260)
    ]
    (tmp_path / "log.csv").write_text("\n".join([f"Time;{header}", *rows]), "utf-8")
    recording = imported(tmp_path, [laser(tmp_path), tmp_path / "log.csv"])
    read = recording.array(recording.name("temperature"))
    assert read == pytest.approx(20 + STEP * np.arange(read.size) / 1000, abs=0.06)


@pytest.mark.parametrize("header", ["ts_ms", "Zeitstempel"])
def test_two_files_with_ticks_or_days_are_joined(tmp_path: Path, header: str) -> None:
    def tick(t: datetime) -> str:
        day = (t - datetime(1899, 12, 30)).total_seconds() / 86400
        return f"{(t - datetime(1970, 1, 1)).total_seconds() * 1000:.0f}" if header == "ts_ms" else f"{day:.8f}"

    times = [START + timedelta(seconds=STEP * k) for k in range(len(long_rows()))]
    rows = [f"{tick(t)};{r};{x:g};{d}" for t, (r, x, _, d) in zip(times, long_rows(), strict=True)]
    (tmp_path / "laser.csv").write_text("\n".join([f"{header};Run;X target [mm];Deviation [um]", *rows]), "utf-8")
    log = [f"{tick(START + timedelta(seconds=10 * k))};{20 + k / 100:.2f}" for k in range(260)]
    (tmp_path / "log.csv").write_text("\n".join([f"{header};Bed [°C]", *log]), "utf-8")
    recording = imported(tmp_path, [tmp_path / "laser.csv", tmp_path / "log.csv"])
    holds_the_truth(recording)
    read = recording.array(recording.name("temperature"))
    assert read == pytest.approx(20 + STEP * np.arange(read.size) / 1000, abs=0.02)


@pytest.mark.parametrize(
    ("head", "form"),
    [
        (
            '"TOA5","CR1000"\n"TIMESTAMP","RECORD","T_bed"\n"TS","RN","Deg C"\n"","","Avg"',
            "{t:%Y-%m-%d %H:%M:%S},{k},{c:.2f}",
        ),
        ("time,bed_K", "{t:%Y-%m-%d %H:%M:%S},{k273:.2f}"),
        ("Date,Time,Temp bed [°C]", "{t:%d-%b-%Y},{t:%H:%M:%S},{c:.2f}"),
    ],
    ids=["TOA5", "kelvin", "names of months"],
)
def test_loggers_of_laboratories(tmp_path: Path, head: str, form: str) -> None:
    """The sensor was left out, or the file was refused."""
    degrees = [20 + k / 100 for k in range(260)]
    rows = [form.format(t=START + timedelta(seconds=10 * k), k=k, c=c, k273=c + 273.15) for k, c in enumerate(degrees)]
    (tmp_path / "log.dat").write_text("\n".join([head, *rows]), "utf-8")
    recording = imported(tmp_path, [laser(tmp_path), tmp_path / "log.dat"])
    read = recording.array(recording.name("temperature"))
    assert read == pytest.approx(20 + STEP * np.arange(read.size) / 1000, abs=0.02)


def test_seconds_of_arc_below_a_title_of_a_turn(tmp_path: Path) -> None:
    """`"` was read as inch, and the readings as positions."""
    rows = [f"{x};{0.01 * x - 1 + 0.1 * np.sin(x):.2f}" for x in range(0, 500, 50)]
    (tmp_path / "f.csv").write_text("\n".join(["Rollwinkel Achse X", 'Position [mm];Anzeige ["]', *rows]), "utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array(recording.name("error", component="EAX"))[0] == pytest.approx(-4.848, abs=0.01)
