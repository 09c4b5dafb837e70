"""Files of controls, loggers and laboratories that were read wrongly, or refused, at first contact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows, prepared

MADE, MEASURED = "actual-minus-commanded", "commanded-minus-actual"
TIMES = np.arange(0.0, 2400.0, 60.0)
WARM = np.round(21.0 + 15.0 * (1 - np.exp(-TIMES / 900.0)), 2)
GROWTH = np.round(3.0 * (WARM - WARM[0]), 1)


def written(tmp_path: Path, lines: list[str], name: str = "a.csv") -> Path:
    file = tmp_path / name
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def drift(recording: Recording, temperature: np.ndarray = WARM) -> None:
    """The recording holds the known growth in um and, as its only temperature, the known one in degC."""
    assert recording.array("E_Z" if "E_Z" in recording else recording.names("error")[0]) == pytest.approx(GROWTH)
    (name,) = recording.names("temperature")
    assert recording.array(name) == pytest.approx(temperature, abs=0.01, nan_ok=True)


@pytest.mark.parametrize("header", ["Spindle Temp (F)", "T spindle [F]", "Spindle temperature Fahrenheit", "Bed (F)"])
def test_fahrenheit_by_its_letter_or_name(tmp_path: Path, header: str) -> None:
    """They were degC, with a remark that 70 degC is implausible."""
    rows = [f"{t:g},{1.8 * w + 32:.3f},{z}" for t, w, z in zip(TIMES, WARM, GROWTH, strict=True)]
    drift(imported(tmp_path, written(tmp_path, [f"time [s],{header},Z growth [um]", *rows])))


def test_warm_temperatures_without_a_unit_are_asked_about(tmp_path: Path) -> None:
    rows = [f"{t:g},{1.8 * w + 32:.3f},{z}" for t, w, z in zip(TIMES, WARM, GROWTH, strict=True)]
    file = written(tmp_path, ["time [s],T spindle,Z growth [um]", *rows])
    with pytest.raises(DataError, match=r"T_spindle\.unit=degF"):
        prepared([file])
    drift(imported(tmp_path, file, sets=["T_spindle.unit=degF"]))


def test_a_rise_in_kelvin_is_no_temperature(tmp_path: Path) -> None:
    """It was -273 degC."""
    rows = [f"{t:g};{w - WARM[0]:.2f};{z}" for t, w, z in zip(TIMES, WARM, GROWTH, strict=True)]
    file = written(tmp_path, ["time [s];dT spindle [K];Z growth [um]", *rows])
    with pytest.raises(DataError, match="a rise, counted from the start"):
        prepared([file])
    drift(imported(tmp_path, file, sets=["dT_spindle.unit=degC"]), WARM - WARM[0])


@pytest.mark.parametrize("broken", [850.0, -999.0, -127.0, -200.0, 1372.0])
def test_a_temperature_that_no_machine_has_is_no_reading(tmp_path: Path, broken: float) -> None:
    warm = np.where((TIMES > 600) & (TIMES < 900), broken, WARM)
    rows = [f"{t:g};{w};{z}" for t, w, z in zip(TIMES, warm, GROWTH, strict=True)]
    file = written(tmp_path, ["time [s];T spindle [°C];Z growth [um]", *rows])
    drift(imported(tmp_path, file), np.where(warm == broken, np.nan, WARM))


@pytest.mark.parametrize("good, not_good", [("Good", "Bad"), (192, 0), (0, 2147483648)])
@pytest.mark.parametrize("layout", ["wide", "long"])
def test_values_of_bad_quality_are_no_readings(tmp_path: Path, layout: str, good: object, not_good: object) -> None:
    bad = (TIMES > 600) & (TIMES < 900)
    moments = [f"2025-03-04T08:{t // 60:02d}:00Z" for t in TIMES.astype(int)]
    lines = ["time;T spindle [°C];Quality;Z growth [um];Quality"]
    cells = list(zip(moments, np.where(bad, 0.0, WARM), np.where(bad, not_good, good), GROWTH, strict=True))
    lines += [f"{m};{w};{q};{z};{good}" for m, w, q, z in cells]
    if layout == "long":
        lines = ["NodeId,SourceTimestamp,Value,StatusCode"]
        for m, w, q, z in cells:
            lines += [f"ns=2;s=T_spindle_degC,{m},{w},{q}", f"ns=2;s=Z_growth_um,{m},{z},{good}"]
    drift(imported(tmp_path, written(tmp_path, lines)), np.where(bad, np.nan, WARM))


def test_numbers_of_rows_are_no_targets(tmp_path: Path) -> None:
    """`i` beside `Xi [mm]` became the position in mm."""
    rows = long_rows()
    targets = list(dict.fromkeys(x for _, x, _, _ in rows))
    found = {(r, x, s): d for r, x, s, d in rows}
    lines = ["Achse X", "i;Xi [mm];1↑ [µm];1↓ [µm];2↑ [µm];2↓ [µm];3↑ [µm];3↓ [µm]"]
    for i, x in enumerate(targets, 1):
        lines.append(f"{i};{x:g};" + ";".join(f"{found[r, x, s]:g}" for r in "123" for s in (1.0, -1.0)))
    holds_the_truth(imported(tmp_path, written(tmp_path, lines)))
    with pytest.raises(DataError):  # without the targets nobody knows them
        prepared(
            [written(tmp_path, [line.replace(f";{x:g};", ";") for line, x in zip(lines[2:], targets, strict=True)])]
        )


def test_lines_above_a_repeated_header_are_no_readings(tmp_path: Path) -> None:
    """A LabVIEW file with a header for each block: its `X0` and `Delta_X` were readings."""
    lines = ["LabVIEW Measurement\t", "Separator\tTab", "***End_of_Header***\t"]
    for block in range(4):
        lines += [
            "Channels\t2\t",
            "Samples\t10\t10",
            "X_Dimension\tTime\tTime",
            "X0\t0.0\t0.0",
            "Delta_X\t60\t60",
            "***End_of_Header***\t\t",
        ]
        lines += ["X_Value\tT bearing [°C]\tZ growth [µm]"]
        lines += [f"{TIMES[k]}\t{WARM[k]}\t{GROWTH[k]}" for k in range(10 * block, 10 * block + 10)]
    drift(imported(tmp_path, written(tmp_path, lines, "a.lvm")))


def test_a_remark_with_commas_ends_no_table(tmp_path: Path) -> None:
    rows = [f"{t:g},{w},{z}" for t, w, z in zip(TIMES, WARM, GROWTH, strict=True)]
    rows.insert(20, "# coffee break, spindle kept running")
    drift(imported(tmp_path, written(tmp_path, ["time [s],T spindle [°C],Z growth [um]", *rows])))


def test_a_title_with_commas_is_no_row_of_groups(tmp_path: Path) -> None:
    rows = [f"{r},{x},{x + d / 1e3:.4f},{s:+g}" for r, x, s, d in long_rows()]
    lines = ["Laser check, X axis, gauge of 5 mm gap, dry", "run,target [mm],reading [mm],dir"]
    holds_the_truth(imported(tmp_path, written(tmp_path, [*lines, *rows])))


def test_an_angle_in_a_unit_that_is_not_known_is_refused(tmp_path: Path) -> None:
    rows = [f"{10 * k};{np.cos(k / 3):.2f}" for k in range(40)]
    file = written(tmp_path, ["Ballbar", "Plane: XY", "Radius: 100 mm", "Angle [gon];CCW [µm]", *rows])
    with pytest.raises(DataError, match="gon"):
        prepared([file])


def test_a_nominal_radius_in_a_cell_is_no_group(tmp_path: Path) -> None:
    rows = [f"{10 * k},0;{100 + np.cos(k / 3) / 1e3:.5f}".replace(".", ",") for k in range(36)]
    lines = ["Kreisformtest", "Ebene;XY", "Nennradius;100,000 mm", "Winkel [°];Radius [mm]", *rows]
    assert imported(tmp_path, written(tmp_path, lines)).array("E_R")[0] == pytest.approx(1.0, abs=0.05)


def test_channels_that_a_table_above_names(tmp_path: Path) -> None:
    rows = [f"{k},{t:g},+ {w},{z}" for k, (t, w, z) in enumerate(zip(TIMES, WARM, GROWTH, strict=True))]
    lines = ["CH,Signal name,Input", "CH1,Spindle,TEMP", "CH2,Z probe,DC", "Data", "NO.,Time,CH1,CH2", "NO.,s,degC,um"]
    drift(imported(tmp_path, written(tmp_path, [*lines, *rows])))


def test_units_behind_a_word_that_says_so(tmp_path: Path) -> None:
    rows = [f";{t:g};{w};{z}" for t, w, z in zip(TIMES, WARM, GROWTH, strict=True)]
    lines = ["Channel name;Time;Spindle;Z growth", "Unit;s;°C;µm", "Comment;;;", *rows]
    drift(imported(tmp_path, written(tmp_path, lines)))


def test_a_database_export_below_its_annotations(tmp_path: Path) -> None:
    lines = ["#group,false,false,true,false,true", "#datatype,string,long,dateTime,double,string"]
    lines += [",result,table,_time,_value,_field"]
    for k, (name, values) in enumerate([("T_spindle_C", WARM), ("Z_growth_um", GROWTH)]):
        lines += [f",,{k},2025-03-04T08:{t // 60:02.0f}:00Z,{v},{name}" for t, v in zip(TIMES, values, strict=True)]
    drift(imported(tmp_path, written(tmp_path, lines)))


def test_channels_with_their_own_times(tmp_path: Path) -> None:
    lines = ["Name;X SetPos;Name;X ActPos", "SampleTime[ms];2;SampleTime[ms];2", "Unit;mm;Unit;mm"]
    x = 100 + 50 * np.sin(np.arange(500) / 60)
    lines += [f"{2 * k};{a:.4f};{2 * k};{a + 0.01:.4f}" for k, a in enumerate(x)]
    recording = imported(tmp_path, written(tmp_path, lines))
    assert recording.array("EXX") == pytest.approx(np.full(500, 10.0), abs=0.11)
    assert recording.array(recording.names("time")[0])[-1] == pytest.approx(0.998)
    lines[-1] = lines[-1].replace("998;", "999;", 1)
    with pytest.raises(DataError, match="different times"):
        prepared([written(tmp_path, lines)])


def test_a_unit_before_a_bracket(tmp_path: Path) -> None:
    rows = [f"{t:g},{1.8 * w + 32:.3f},{z}" for t, w, z in zip(TIMES, WARM, GROWTH, strict=True)]
    header = 'time [s],"Temp, °F (LGR S/N: 1, LBL: Spindle)","Z growth, um"'
    drift(imported(tmp_path, written(tmp_path, [header, *rows])))


def test_a_log_whose_clock_has_no_unit_is_asked_about(tmp_path: Path) -> None:
    """Milliseconds were seconds: velocities and time constants wrong by a thousand."""
    x = 200 + 100 * np.sin(np.arange(500) / 60)
    rows = [f"{4 * k};{a:.4f};{a + 0.01:.4f}" for k, a in enumerate(x)]
    file = written(tmp_path, ["TIME;X SetPos [mm];X ActPos [mm]", *rows])
    with pytest.raises(DataError, match=r"--set TIME\.unit=ms"):
        prepared([file])
    recording = imported(tmp_path, file, sets=["TIME.unit=ms"])
    assert recording.array(recording.names("time")[0])[-1] == pytest.approx(1.996)


def test_a_verdict_with_a_deviation_empties_nothing(tmp_path: Path) -> None:
    rows = [f"{r},{x},{d},{s:+g},{'ok' if abs(d) < 6 else 'fail'}" for r, x, s, d in long_rows()]
    file = written(tmp_path, ["X axis", "run,target [mm],error [um],dir,status", *rows])
    holds_the_truth(imported(tmp_path, file))


def test_units_below_names_of_which_blanks_follow_the_commas(tmp_path: Path) -> None:
    rows = [f"{r},{x},{d},{s:+g}" for r, x, s, d in long_rows()]
    file = written(tmp_path, ["Axis: X", "run, target, error, dir", ",mm,um,", *rows])
    holds_the_truth(imported(tmp_path, file))
