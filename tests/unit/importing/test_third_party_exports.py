# ruff: noqa: E501  (a table of files, one a line)
"""Exports as instruments, controllers and spreadsheets write them: the same known test, or a refusal that asks."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing.sheet import ReaderOptions, number, of_one_mark
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows
from tests.unit.importing.test_first_hour import PAIRS, RUNS, SIDES, de, headers, long, mark, wide

ROWS = long_rows()
AT = {
    (r, x, s): datetime.datetime(2026, 3, 31, 8) + datetime.timedelta(seconds=20 * i)
    for i, (r, x, s, _) in enumerate(ROWS)
}
EPOCH = datetime.datetime(1970, 1, 1)


def ticks(r: str, x: float, s: float, each: float) -> int:
    return round((AT[r, x, s] - EPOCH).total_seconds() / each)


def points(header: str, above: str = "", below: str = "", sep: str = ",") -> str:
    return long(header, lambda r, x, s, d: sep.join([r, mark(s), f"{x:g}", f"{d}"]), above, below)


def blank_separated(header: str) -> str:
    return long(header, lambda r, x, s, d: f"{r:>3}  {mark(s, 'pos', 'neg')}  {x:9.3f}  {x + d / 1000:11.5f}")


FILES: dict[str, str] = {
    "arrows before the number of the run": wide("Target [mm];" + headers("{w} {r} (um)", "→", "←")),
    "runs and letters": wide("Target_mm;" + headers("R{r}{w}_um", "f", "r")),
    "hin und her": wide("mm;" + headers("{r}. {w} [µm]", "hin", "her")),
    "a table of Markdown": wide(
        "|Target [mm]|".replace("|", "")
        + ";"
        + headers("Run {r} {w} [um]", "+", "-")
        + "\n---;"
        + ";".join(["---"] * 6)
    ),
    "thousands of micrometres beside decimal commas": "\n".join(
        [
            "Soll [µm];" + headers("Lauf {r} {w} [µm]", "auf", "ab"),
            *(";".join([de(1000 * x, 0), *(de(c[i]) for c in PAIRS)]) for i, x in enumerate(TARGETS)),
        ]
    ),
    "points and commas in one file": long(
        "Run;Dir;Target [mm];Error [µm]", lambda r, x, s, d: f"{r};{mark(s)};{x:.1f};{de(d)}"
    ),
    "Ziel": long("Lauf;Ziel [mm];Abw. [µm];T Luft [°C]", lambda r, x, s, d: f"{r};{x};{d};20"),
    "sides as X+ and X-": "\n".join(
        [
            "run;Richtung;Soll mm;Abw. µm",
            *(f"{r};{mark(s, 'X+', 'X-')};{x};{d}" for r, x, s, d in sorted(ROWS, key=lambda t: t[1])),
        ]
    ),
    "numbers of the targets beside their positions": long(
        "Target,Position (mm),Direction,Run,Error (µm)",
        lambda r, x, s, d: (
            f"{TARGETS.index(x) + 1 if isinstance(TARGETS, list) else list(TARGETS).index(x) + 1},{x},{mark(s)},{r},{d}"
        ),
    ),
    "figures below, as wide as the rows": points(
        "Run,Dir,Target mm,Error um", below="Mean,,400,8.1\nMax,,600,19.2\nBi-directional accuracy A,,14.2,um"
    ),
    "names that hold blanks": blank_separated("Run  Richtung  Soll [mm]    Ist [mm]"),
    "names that hold blanks and brackets": blank_separated("Run Dir Nominal (mm) Actual (mm)"),
    "blocks with commas in their titles": "\n".join(
        "\n".join(
            [
                f"Run,{r},{mark(s, 'Forward', 'Backward')}",
                "Target,Error",
                *(f"{x},{d}" for x, d in zip(TARGETS, deviation(r, s), strict=True)),
                "",
            ]
        )
        for r in RUNS
        for s in SIDES
    ),
    "a line of units above": long(
        "Run,Dir,Target,Error", lambda r, x, s, d: f"{r},{mark(s)},{x},{d / 1000:.6f}", above="Units,-,mm,mm\n"
    ),
    "Xcmd and Xact": long("run,Xcmd,Xact", lambda r, x, s, d: f"{r},{x},{x + d / 1000:.5f}"),
    "xsoll and xist": long("lauf;xsoll;xist", lambda r, x, s, d: f"{r};{x};{x + d / 1000:.5f}"),
    "Cmd and Fbk": long("Run;Cmd;Fbk", lambda r, x, s, d: f"{r};{x};{x + d / 1000:.5f}"),
    "a component of ISO 230-1": long("run,X,EXX", lambda r, x, s, d: f"{r},{x},{d}"),
    "metres with underscores": long("run,x_m,dev_m", lambda r, x, s, d: f"{r},{x / 1000:.6e},{d * 1e-6:.6e}"),
    "a dial in thou that is set to nothing": long(
        "run,target_in,dial_thou", lambda r, x, s, d: f"{r},{float(x) / 25.4!r},{float(d) / 25.4!r}"
    ),
    "a laser beside the encoder": long(
        "Run,Command mm,Encoder mm,Laser mm", lambda r, x, s, d: f"{r},{x},{x + 0.0005:.5f},{x + d / 1000:.5f}"
    ),
    "an encoder beside the laser": long(
        "Run,Command mm,Laser mm,Encoder mm", lambda r, x, s, d: f"{r},{x},{x + d / 1000:.5f},{x + 0.0005:.5f}"
    ),
    "Schleppfehler": long("Lauf;Sollposition [mm];Schleppfehler [µm]", lambda r, x, s, d: f"{r};{x};{-d}"),
    "f-error": long("run,x pos-cmd,x f-error [mm]", lambda r, x, s, d: f"{r},{x},{-d / 1000:.6f}"),
    "Fehlerkompensation": long("Lauf;Pos;Fehlerkompensation", lambda r, x, s, d: f"{r};{x};{-d}"),
    "a current called nominal": long(
        "Run,s nominal X [mm],s actual X [mm],I nominal [A]", lambda r, x, s, d: f"{r},{x},{x + d / 1000:.5f},0.7"
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_an_export(tmp_path: Path, name: str) -> None:
    (tmp_path / "f.csv").write_text(FILES[name], encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


TIMES = {
    "milliseconds since 1970": lambda r, x, s: ticks(r, x, s, 1e-3),
    "microseconds since 1970": lambda r, x, s: ticks(r, x, s, 1e-6),
    "ticks of Windows since 1601": lambda r, x, s: ticks(r, x, s, 1e-7) + 116444736000000000,
    "the day first": lambda r, x, s: f"{AT[r, x, s]:%d/%m/%Y %H:%M:%S}",
    "the month first": lambda r, x, s: f"{AT[r, x, s]:%m/%d/%Y %I:%M:%S %p}",
    "the year in two digits": lambda r, x, s: f"{AT[r, x, s]:%d.%m.%y %H:%M:%S}",
    "with a time zone": lambda r, x, s: f"{AT[r, x, s].isoformat()}+02:00",
}


@pytest.mark.parametrize("name", TIMES)
def test_times_are_seconds(tmp_path: Path, name: str) -> None:
    (tmp_path / "f.csv").write_text(
        long("timestamp;soll mm;ist mm", lambda r, x, s, d: f"{TIMES[name](r, x, s)};{x};{x + d / 1000:.5f}")
    )
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert np.diff(recording.array(recording.name("time"))) == pytest.approx(20.0, abs=1e-3)


@pytest.mark.parametrize("form", ["%Y-%m-%d;%H:%M:%S", "%d.%m.%Y;%H:%M:%S"])
def test_a_date_with_a_clock(tmp_path: Path, form: str) -> None:
    (tmp_path / "f.csv").write_text(
        long("Datum;Uhrzeit;soll mm;ist mm", lambda r, x, s, d: f"{AT[r, x, s]:{form}};{x};{x + d / 1000:.5f}")
    )
    recording = imported(tmp_path, tmp_path / "f.csv")
    column = recording.name("time")
    assert np.diff(recording.array(column)) == pytest.approx(20.0)
    assert recording.manifest.columns[column].epoch == "2026-03-31T08:00:00"


def test_a_remark_or_a_sensor_that_ends_costs_no_row(tmp_path: Path) -> None:
    """`max` in a remark is no figure over the runs; words in place of the last temperatures are empty cells."""
    end = (ROWS[-1][0], ROWS[-1][1], ROWS[-1][2])
    text = long(
        "Run;Dir;Target mm;Error um;T air;Remark",
        lambda r, x, s, d: (
            f"{r};{mark(s)};{x};{d};{'n.c.' if (r, x, s) == end else 20.5};{'max speed' if x == TARGETS[2] else ''}"
        ),
    )
    (tmp_path / "f.csv").write_text(text)
    recording = imported(tmp_path, tmp_path / "f.csv")
    holds_the_truth(recording)
    assert len(recording) == len(ROWS)


ASKED = {
    "a unit that is none of an error": (long("x mm,error (ppm)", lambda r, x, s, d: f"{x},{d}"), "readings per length"),
    "an error in volts": (long("x mm,error [V]", lambda r, x, s, d: f"{x},{d}"), "'V' is not a known unit"),
    "thousands or decimals": (long("Soll [mm];Abw. [µm]", lambda r, x, s, d: f"{100 + x:.3f};{de(d)}"), "ambiguous thousands or decimal separator"),
    "um or mm": (long("target,error", lambda r, x, s, d: f"{x},{d / 30:.4f}"), "um or mm"),
    "a place that is not understood": (long("Stelle [mm],error [um]", lambda r, x, s, d: f"{x},{d}"), "'Stelle' .mm. is unknown"),
    "angles of no axis": (long("Target (deg),Deviation (arcsec)", lambda r, x, s, d: f"{x},{d}"), "--axis C"),
    "a gap between blanks": (long("Run Target Error Temp", lambda r, x, s, d: f"{r} {x} {'' if x == TARGETS[3] else d} 20.1"), "a gap between blanks"),
    "two readings of an axis": (long("cmd mm,actual mm,feedback mm", lambda r, x, s, d: f"{x},{x + d / 1000},{x + d / 500}"), "both contain actual positions"),
    "targets of two tables": ("\n".join(["Target +;R1;R2;Target -;R3;R4", *(f"{TARGETS[i]};1;2;{TARGETS[-1 - i]};3;4" for i in range(len(TARGETS)))]), "both contain command positions"),
    "days of a spreadsheet": (long("Time,target mm,actual mm", lambda r, x, s, d: f"{46112 + ticks(r, x, s, 1) % 9999 / 86400:.6f},{x},{x + d / 1000}"), "days since a date"),
    "a row a signal": ("\n".join(f"Axis.X.{n},2026-03-31T08:00:{i:02d}Z,{i},Good" for i in range(9) for n in ("Cmd", "Act")), "may be inches"),
    "XML of another kind": ("<?xml version='1.0'?><Trace><rec t='0' v='1'/></Trace>", "without a table"),
}  # fmt: skip


@pytest.mark.parametrize("name", ASKED)
def test_what_may_be_either_is_asked(tmp_path: Path, name: str) -> None:
    text, says = ASKED[name]
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=says):
        imported(tmp_path, tmp_path / "f.csv")
    assert not (tmp_path / "rec").exists()


def test_columns_that_alternate_are_given_no_side(tmp_path: Path) -> None:
    """Runs 1 to 6 without a word on the side: passes that start again at the first target say nothing of it."""
    (tmp_path / "f.csv").write_text(
        wide("Target [mm];" + ";".join(f"Run {k} [um]" for k in range(1, 7))), encoding="utf-8"
    )
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.name("direction", axis="X") is None and len(set(recording.frame["run"])) == 6


def test_names_of_a_person_replace_those_of_the_file(tmp_path: Path) -> None:
    """TwinCAT's scope writes its names far above the numbers, and facts in between that are as wide."""
    facts = "Name\tAxis 1.SetPos\tName\tAxis 1.ActPos\nSampleTime[ms]\t2\tSampleTime[ms]\t2\nOffset\t0\tOffset\t0\nBit-Mask\t0\tBit-Mask\t0\n"
    rows = "\n".join(f"{2 * i}\t{x}\t{2 * i}\t{x + d / 1000:.5f}" for i, (_, x, _, d) in enumerate(ROWS))
    (tmp_path / "scope.csv").write_text(facts + "\n" + rows)
    reader = ReaderOptions(names=("t [ms]", "x_cmd [mm]", "t2 [ms]", "x_act [mm]"))
    holds_the_truth(imported(tmp_path, tmp_path / "scope.csv", reader))
    with pytest.raises(DataError, match="--names gives 3 names, the table has 4 columns"):
        imported(tmp_path, tmp_path / "scope.csv", ReaderOptions(names=("a", "b", "c")))


def test_labview_measurement(tmp_path: Path) -> None:
    """Time in X_Value, units in a line far above the names."""
    head = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\nChannels\t2\t\t\nY_Unit_Label\tmm\tum\t\nX_Dimension\tTime\tTime\t\nDelta_X\t20\t20\t\n***End_of_Header***\t\t\t\nX_Value\tX commanded\tX actual\tComment\n"
    rows = "\n".join(f"{20 * i}\t{x}\t{1000 * x + d:.3f}" for i, (_, x, _, d) in enumerate(ROWS))
    (tmp_path / "f.lvm").write_text(head + rows)
    recording = imported(tmp_path, tmp_path / "f.lvm")
    holds_the_truth(recording)
    assert recording.name("time") is not None


def test_merged_cells_and_hidden_sheets_by_openpyxl(tmp_path: Path) -> None:
    """Run and side in the first row of each block; an old sheet is hidden."""
    from openpyxl import Workbook

    book = Workbook()
    old = book.active
    old.title, old.sheet_state = "old", "hidden"
    for r, x, _, d in [("Run", "Target (mm)", 0, "Error (um)"), *ROWS]:
        old.append([r, x, d if isinstance(d, str) else 3 * d])
    new = book.create_sheet("Achse X")
    new.append(["Run", "Dir", "Target (mm)", "Error (µm)"])
    for r, x, s, d in ROWS:
        first = x == (TARGETS[0] if s > 0 else TARGETS[-1])
        new.append([int(r) if first else None, mark(s, "fwd", "rev") if first else None, float(x), float(d)])
    book.save(tmp_path / "f.xlsx")
    holds_the_truth(imported(tmp_path, tmp_path / "f.xlsx"))


def test_the_axis_in_the_name_of_a_sheet(tmp_path: Path) -> None:
    (tmp_path / "y-axis_2026.csv").write_text(points("Run,Dir,Target mm,Error um"))
    assert imported(tmp_path, tmp_path / "y-axis_2026.csv").components() == ("EYY",)


def test_tdms_channels_of_several_samplings(tmp_path: Path) -> None:
    """A feedback that starts 0.5 s later and a temperature once a second are read at the times of the command."""
    from nptdms import ChannelObject, TdmsWriter

    t = np.arange(0, 6, 0.01)

    def channel(name: str, values: np.ndarray, unit: str, step: float, offset: float = 0.0) -> ChannelObject:
        return ChannelObject(
            "log", name, values, {"unit_string": unit, "wf_increment": step, "wf_start_offset": offset}
        )

    with TdmsWriter(str(tmp_path / "f.tdms")) as writer:
        later = 100 * np.sin(t[:-50] + 0.5) + 0.01
        parts = [channel("x_cmd", 100 * np.sin(t), "mm", 0.01), channel("x_fb", later, "mm", 0.01, 0.5)]
        writer.write_segment([*parts, channel("T motor", 30 + np.arange(6.0), "degC", 1.0)])
    recording = imported(tmp_path, tmp_path / "f.tdms")
    error, time = recording.array("EXX"), recording.array("time")
    assert error[time > 0.505] == pytest.approx(10.0, abs=1e-6) and np.isnan(error[time < 0.495]).all()
    assert recording.array("T_motor")[[0, 250, 500]] == pytest.approx([30.0, 32.5, 35.0])


def test_mtconnect_of_two_axes_and_whole_seconds(tmp_path: Path) -> None:
    """`08:00:01Z` comes after `08:00:00.998Z`; items of one name in two components are two columns."""
    from errpipe.importing.readers import mtconnect

    moments = [f"2026-03-31T08:00:0{k // 500}" + (f".{k % 500 * 2:03d}" if k % 500 else "") + "Z" for k in range(1000)]
    streams = ""
    for axis in "XY":
        items = "".join(
            f'<Position dataItemId="{axis}a" name="act" subType="ACTUAL" timestamp="{m}">{k}.5</Position>'
            for k, m in enumerate(moments)
        )
        streams += f'<ComponentStream component="Linear" name="{axis}"><Samples>{items}</Samples></ComponentStream>'
    file = tmp_path / "f.xml"
    file.write_text(
        f'<MTConnectStreams xmlns="urn:mtconnect.org:MTConnectStreams:1.4"><Streams>{streams}</Streams></MTConnectStreams>'
    )
    (sheet,) = mtconnect.read(file, ReaderOptions())
    assert sheet.header == ["time", "X act actual [mm]", "Y act actual [mm]"]
    assert [row[1] for row in sheet.rows] == [k + 0.5 for k in range(1000)]


@pytest.mark.parametrize(
    ("cells", "comma", "values"),
    [
        (["0", "75.000", "1,5"], True, [0, 75000, 1.5]),
        (["1.234.567", "75.000"], True, [1234567, 75000]),
        (["75.5", "100.250"], True, [75.5, 100.25]),
        (["0,5", "1,25"], False, [0.5, 1.25]),
        (["0", "75,000"], False, [0, 75000]),
        (["31.03.2026", "12.5"], False, [None, 12.5]),
    ],
)  # fmt: skip
def test_marks_of_thousands(cells: list[str], comma: bool, values: list[float | None]) -> None:
    assert [number(c, comma) for c in of_one_mark(cells, comma)] == values


@pytest.mark.parametrize("comma", [True, False])
def test_usual_numbers_are_read_by_the_first_rule_alone(comma: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    texts = ["12", "-0.5", "+3.", "007", "1.234"]
    by_all = [number(f"{t} ", comma) for t in texts]
    monkeypatch.setattr("errpipe.importing.sheet._PLAIN", None)  # the last of the other rules
    assert [number(t, comma) for t in texts] == by_all == [12.0, -0.5, 3.0, 7.0, 1.234]


@pytest.mark.parametrize(("text", "value"), [("12 345", 12345.0), ("- 5.2", -5.2), ("12 13", None), ("1 2 3", None)])
def test_blanks_within_a_number(text: str, value: float | None) -> None:
    assert number(text, comma=False) == value


def test_the_same_file_twice_is_refused(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(points("Run,Dir,Target mm,Error um"))
    with pytest.raises(DataError, match="the same as"):
        imported(tmp_path, [tmp_path / "a.csv", tmp_path / "b.csv"])
