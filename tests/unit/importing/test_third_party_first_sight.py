"""Files as devices write them, at first sight: packed files, tags, line protocols, several clocks, labels aside."""

from __future__ import annotations

import gzip
import zipfile
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared

START = datetime(2025, 3, 12, 10)
SECONDS = np.arange(0, 1800, 60)
DRIFT = np.round(8 * (1 - np.exp(-SECONDS / 600)), 2)
WARM = np.round(20 + 6 * (1 - np.exp(-SECONDS / 600)), 2)


def table(mark: str = ",") -> str:
    header = mark.join(("run", "X [mm]", "direction", "deviation [um]"))
    return "\n".join([header, *(mark.join(map(str, row)) for row in long_rows())]) + "\n"


def written(path: Path, lines: list[str]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def has_drifted(recording: Recording) -> None:
    """The recording holds the drift in Z and the temperature, a row per minute."""
    (error,), (sensor,) = recording.names("error", component="E_Z"), recording.names("temperature")
    assert recording.array(error) == pytest.approx(DRIFT)
    assert recording.array(sensor) == pytest.approx(WARM)
    assert np.diff(recording.array(recording.name("time"))) == pytest.approx(60.0)


def clock(k: int, form: str = "%Y-%m-%d %H:%M:%S", shift: float = 0.0) -> str:
    return (START + timedelta(seconds=float(SECONDS[k]) + shift)).strftime(form)


def test_a_packed_table_is_unpacked(tmp_path: Path) -> None:
    (tmp_path / "x.csv.gz").write_bytes(gzip.compress(table().encode()))
    holds_the_truth(imported(tmp_path, tmp_path / "x.csv.gz"))
    with zipfile.ZipFile(tmp_path / "x.zip", "w") as archive:
        archive.writestr("data/x.csv", table())
        archive.writestr("__MACOSX/._x.csv", "of a system")
    holds_the_truth(imported(tmp_path / "zip", tmp_path / "x.zip"))


def test_a_packed_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "cut.csv.gz").write_bytes(gzip.compress(table().encode())[:-9])
    with pytest.raises(DataError, match=r"cut\.csv\.gz: not an archive that can be read"):
        prepared([tmp_path / "cut.csv.gz"])
    (tmp_path / "twice.gz").write_bytes(gzip.compress(gzip.compress(table().encode())))
    with pytest.raises(DataError, match="a compressed archive: extract it first"):
        prepared([tmp_path / "twice.gz"])
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("x.txt", "no table\n")
    with pytest.raises(DataError, match=r"a\.zip, x\.txt: x: no row with two numbers"):
        prepared([tmp_path / "a.zip"])


def test_yaml_with_a_table(tmp_path: Path) -> None:
    rows = [f"  - {{run: {r}, target_mm: {x}, direction: {s}, deviation_um: {d}}}" for r, x, s, d in long_rows()]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.yaml", ["axis: X", "points:", *rows])))
    with pytest.raises(DataError, match=r"y\.yaml:2:1 "):
        prepared([written(tmp_path / "y.yaml", ["a: 1", "a: 2"])])


def test_series_of_a_line_protocol(tmp_path: Path) -> None:
    lines = []
    for k, (z, t) in enumerate(zip(DRIFT, WARM, strict=True)):
        ns = (1741773600 + 60 * k) * 10**9
        lines += [f"probe,mill=a drift_z_um={z} {ns}", f"temperature,mill=a,sensor=bearing degC={t} {ns}"]
    has_drifted(imported(tmp_path, written(tmp_path / "dump.lp", lines)))


def test_a_list_of_tags_with_their_history(tmp_path: Path) -> None:
    tags = written(tmp_path / "tags.csv", ["TagId,TagName,Unit", "101,PROBE_Z,um", "102,TE_BEARING,degC"])
    rows = [(k, z, t) for k, (z, t) in enumerate(zip(DRIFT, WARM, strict=True))]
    lines = [f"{tag},{clock(k)},{v}" for k, z, t in rows for tag, v in ((101, z), (102, t))]
    history = written(tmp_path / "history.csv", ["TagId,Timestamp,Value", *lines])
    has_drifted(imported(tmp_path, [tags, history]))
    with pytest.raises(DataError, match=r"tags\.csv: it only names channels, and none of the other files"):
        prepared([tags, written(tmp_path / "x.csv", table().splitlines())])
    with pytest.raises(DataError):
        prepared([tags, written(tmp_path / "other.csv", ["TagId,TagName,Unit", "1,PROBE_X,um", "2,TE_1,degC"])])


def test_a_target_merged_over_several_runs(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Target X [mm]", "Run", "Up [um]", "Down [um]"])
    for i, x in enumerate(TARGETS):
        for run in (1, 2, 3):
            sheet.append([float(x) if run == 1 else None, run, *(float(deviation(run, s)[i]) for s in (1.0, -1.0))])
        sheet.merge_cells(start_row=3 * i + 2, end_row=3 * i + 4, start_column=1, end_column=1)
    book.save(tmp_path / "x.xlsx")
    holds_the_truth(imported(tmp_path, tmp_path / "x.xlsx"))


def test_names_and_units_with_a_label_before_them(tmp_path: Path) -> None:
    """DIAdem: the rows of numbers have an empty first cell, and rows of lengths are between the names and them."""
    head = ["DIADEM Export;;;", "Kanalname;Zeit;Verlagerung_Z;T_Motor", "Einheit;s;µm;°C", "Länge;30;30;30"]
    rows = [f";{s};{z};{t}".replace(".", ",") for s, z, t in zip(SECONDS, DRIFT, WARM, strict=True)]
    has_drifted(imported(tmp_path, written(tmp_path / "d.csv", [*head, *rows])))


def test_partitions_with_files_of_one_name_are_runs(tmp_path: Path) -> None:
    files = []
    for run in ("1", "2", "3"):
        (tmp_path / f"run={run}").mkdir()
        files.append(tmp_path / f"run={run}" / "part-0.parquet")
        own = [(x, s, d) for r, x, s, d in long_rows() if r == run]
        pd.DataFrame(own, columns=["X_mm", "dir", "EXX_um"]).to_parquet(files[-1])
    recording = imported(tmp_path, files)
    assert set(recording.frame[recording.name("run")]) == {f"run={r}_part-0" for r in "123"}


@pytest.mark.parametrize("swapped", ["log", "readings"])
def test_day_and_month_of_two_devices(tmp_path: Path, swapped: str) -> None:
    forms = {"log": ("%d.%m.%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S"), "readings": ("%d/%m/%Y %H:%M:%S", "%Y-%m-%d %H:%M:%S")}
    own, other = forms[swapped]
    probe = written(tmp_path / "probe.csv", ["time;E_Z [um]", *(f"{clock(k, own)};{z}" for k, z in enumerate(DRIFT))])
    log = written(tmp_path / "log.csv", ["time;T bed [degC]", *(f"{clock(k, other)};{t}" for k, t in enumerate(WARM))])
    proposal, _ = prepared([probe, log])
    assert any("day and month of 2025-12-03 are exchanged" in note for note in proposal.notes)
    assert proposal.entries[proposal.first("time")]["epoch"].startswith("2025-03-12")


def with_speeds(tmp_path: Path, shift: float) -> list[Path]:
    speed = np.where((SECONDS // 300) % 2 == 0, 0, 8000)
    rows = [f"{clock(k)};{z};{n}" for k, (z, n) in enumerate(zip(DRIFT, speed, strict=True))]
    own = [f"{clock(k, shift=shift)};{t};{n}" for k, (t, n) in enumerate(zip(WARM, speed, strict=True))]
    probe = written(tmp_path / "probe.csv", ["time;E_Z [um];spindle [rpm]", *rows])
    return [probe, written(tmp_path / "log.csv", ["time;T bed [degC];spindle [rpm]", *own])]


@pytest.mark.parametrize(("shift", "way"), [(120.0, "120 s later"), (-240.0, "240 s earlier")])
def test_two_clocks_that_differ(tmp_path: Path, shift: float, way: str) -> None:
    with pytest.raises(DataError, match=f"agrees best {way} there: the clocks differ"):
        prepared(with_speeds(tmp_path, shift))


def test_two_clocks_that_agree(tmp_path: Path) -> None:
    prepared(with_speeds(tmp_path, 0.0))


def log_of_a_servo(tmp_path: Path, header: str) -> Path:
    x = np.round(100 + 50 * np.sin(np.arange(40) / 8), 4)
    return written(tmp_path / "t.csv", [header, *(f"{k},{v},{0.003 * np.cos(v):.4f}" for k, v in enumerate(x))])


def test_an_error_sampled_in_milliseconds_is_asked_about(tmp_path: Path) -> None:
    """FANUC's ERR is commanded minus actual, and 40 rows were taken for a positioning test."""
    with pytest.raises(DataError, match="controls then show commanded minus actual"):
        prepared([log_of_a_servo(tmp_path, "TIME(msec),X POSF(mm),X ERR(mm)")])


@pytest.mark.parametrize(
    "header",
    [
        "time [s];$AA_IM[X] [mm];deviation [um]",  # SINUMERIK: set point of the axis
        "unix_s;X [mm];deviation [um]",
    ],
)
def test_names_of_controls_and_clocks(tmp_path: Path, header: str) -> None:
    start = 1741773600 if "unix" in header else 0
    rows = [f"{start + 10 * k};{x};{d}" for k, (_, x, _, d) in enumerate(long_rows())]
    proposal, options = prepared([written(tmp_path / "a.csv", [header, *rows])])
    roles = {e["role"]: e.get("axis") for e in proposal.entries.values()}
    assert roles["position"] == "X"
    assert {"time", "error"} <= {*roles}
    assert options.axis is None


@pytest.mark.parametrize("header", ["t [ms];s nom X [mm];s act X [mm]", "t [ms];$AA_IM[X] [mm];$VA_IM[X] [mm]"])
def test_set_point_and_actual_position_of_an_axis(tmp_path: Path, header: str) -> None:
    rows = [f"{k};{x};{x + d / 1e3:.4f}" for k, (_, x, _, d) in enumerate(long_rows())]
    proposal, _ = prepared([written(tmp_path / "a.csv", [header, *rows])])
    (minus,) = (e["derived"]["minus"] for e in proposal.entries.values() if e["role"] == "error")
    first, second = [proposal.names[h.partition(" [mm]")[0]] for h in header.split(";")[1:]]
    assert minus == [second, first]


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("timestamp,dataItemId,name,subType,value", "{t}Z,x{n},Xpos,{kind},{v}"),
        ("NodeId;DisplayName;Value;SourceTimestamp;ServerTimestamp", '"ns=4;s=Axis.X.{kind}";{kind};{v};{t}Z;{t}Z'),
    ],
)
def test_one_row_per_value_with_identifiers_and_two_clocks(tmp_path: Path, header: str, row: str) -> None:
    lines = [header]
    for k, (_, x, _, d) in enumerate(long_rows()):
        t = (START + timedelta(seconds=k)).isoformat()
        for n, (kind, v) in enumerate((("Commanded", x), ("Actual", x + d / 1e3)), 1):
            lines.append(row.format(t=t, n=n, kind=kind, v=f"{v:.4f}"))
    recording = imported(tmp_path, written(tmp_path / "a.csv", lines), sets=[])
    (error,) = recording.names("error", component="EXX")
    assert recording.array(error) == pytest.approx([d for *_, d in long_rows()], abs=1e-6)


def test_two_channels_with_a_clock_are_no_runs_over_time(tmp_path: Path) -> None:
    """The times became targets in s: an internal error. Without a word for a deviation the file is refused."""
    rows = [f"{k + 1},{z},{s},{t}" for k, (s, z, t) in enumerate(zip(SECONDS, DRIFT, WARM, strict=True))]
    header = "Index,Reading 101 (DCV) Z um,Relative Time s,Reading 102 (TC K) C"
    with pytest.raises(DataError, match="no column holds a deviation"):
        prepared([written(tmp_path / "k.csv", [header, *rows])], component="E_Z")
