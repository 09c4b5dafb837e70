"""Files whose rows need another table, a count, or a reading from elsewhere to be understood."""

from __future__ import annotations

import json
import sqlite3
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing.units import unit_of
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows, prepared

BEGIN = datetime(2026, 11, 27, 9)
STEP = 7.0  # s between two readings


def moment(k: int, sooner: float = 0.0) -> str:
    return (BEGIN + timedelta(seconds=STEP * k - sooner)).isoformat(sep=" ")


def written(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def warmth(k: int) -> float:
    return round(20.0 + 0.01 * k, 2)


def holds_positions(recording, temperatures: bool = True) -> None:  # type: ignore[no-untyped-def]
    """Deviations and temperatures of a log of commands and actual positions."""
    rows = long_rows()
    (error,) = recording.names("error", component="EXX")
    np.testing.assert_allclose(recording.array(error), [d for *_, d in rows], atol=1e-6)
    np.testing.assert_allclose(recording.array(recording.name("command", axis="X")), [x for _, x, _, _ in rows])
    if temperatures:
        (sensor,) = recording.names("temperature")
        np.testing.assert_allclose(recording.array(sensor), [warmth(k) for k in range(len(rows))], atol=1e-9)


def test_a_table_of_tags_names_the_signals_of_a_history(tmp_path: Path) -> None:
    base = sqlite3.connect(tmp_path / "plant.db")
    base.execute("create table tags(id integer, name text, unit text)")
    base.execute("create table history(ts text, tag_id integer, value real)")
    names = [(1, "X.CmdPos", "mm"), (2, "X.ActPos", "mm"), (3, "Temp_Nut", "degC")]
    base.executemany("insert into tags values(?, ?, ?)", names)
    for k, (_, x, _, d) in enumerate(long_rows()):
        values = zip((1, 2, 3), (x, x + d / 1000, warmth(k)), strict=True)
        base.executemany("insert into history values(?, ?, ?)", [(moment(k), i, v) for i, v in values])
    base.commit()
    base.close()
    holds_positions(imported(tmp_path, tmp_path / "plant.db", axis="X"))


def test_channels_by_number_have_the_names_and_units_of_the_list_above(tmp_path: Path) -> None:
    """The channels `0` and `1` are no runs, and `Scan` is no position."""
    lines = ["Channel,Name,Unit", "0,X command,mm", "1,X actual,mm", "2,T nut,degC", "", "Scan,Time,0,1,2"]
    rows = enumerate(long_rows())
    lines += [f"{k},{STEP * k},{x},{x + d / 1000:.4f},{warmth(k)}" for k, (_, x, _, d) in rows]
    recording = imported(tmp_path, written(tmp_path / "scan.csv", lines), axis="X")
    holds_positions(recording)
    assert recording.name("command", axis="X") == "X_command"


def test_channels_of_command_and_actual_are_no_runs(tmp_path: Path) -> None:
    lines = ["scan,0 X command [mm],1 X actual [mm]"]
    lines += [f"{k},{x},{x + d / 1000:.4f}" for k, (_, x, _, d) in enumerate(long_rows())]
    holds_positions(imported(tmp_path, written(tmp_path / "scan.csv", lines), axis="X"), temperatures=False)


def test_a_list_of_channels_right_above_the_header_is_no_group_of_columns(tmp_path: Path) -> None:
    lines = ["CH1,POSF,X,mm", "CH2,ERR,X,um", "N,POSF X(mm),DEV X(um)"]
    lines += [f"{k},{x},{d}" for k, (_, x, _, d) in enumerate(long_rows())]
    proposal, _ = prepared([written(tmp_path / "servo.csv", lines)])
    assert {"POSF_X", "DEV_X"} <= proposal.entries.keys()


@pytest.mark.parametrize("sooner", [0.0, 2.0])
def test_a_sensor_with_rows_of_its_own_has_its_last_reading(tmp_path: Path, sooner: float) -> None:
    lines = ["Timestamp;Tag;Value"]
    for k, (_, x, _, d) in enumerate(long_rows()):
        lines.append(f"{moment(k, sooner)};Temp Nut degC;{warmth(k)}")
        lines += [f"{moment(k)};X cmd mm;{x}", f"{moment(k)};X act mm;{x + d / 1000:.4f}"]
    holds_positions(imported(tmp_path, written(tmp_path / "trend.csv", lines), axis="X"))


def test_a_sensor_that_stopped_is_not_held_for_ever(tmp_path: Path) -> None:
    lines = ["Timestamp;Tag;Value"]
    for k, (_, x, _, d) in enumerate(long_rows()):
        lines += [f"{moment(k, 2.0)};Temp Nut degC;{warmth(k)}"] if k < 10 else []
        lines += [f"{moment(k)};X cmd mm;{x}", f"{moment(k)};X act mm;{x + d / 1000:.4f}"]
    recording = imported(tmp_path, written(tmp_path / "trend.csv", lines), axis="X")
    read = np.isfinite(recording.array(recording.names("temperature")[0]))
    assert read[:19].all() and not read[19:].any()


def test_messages_of_several_topics_are_rows_of_their_time(tmp_path: Path) -> None:
    lines = []
    for k, (_, x, _, d) in enumerate(long_rows()):
        when = moment(k).replace(" ", "T") + "+0100"
        lines += [f'{when} mill/cmd {{"x_mm": {x}}}', f'{when} mill/act {{"x_mm": {x + d / 1000:.4f}}}']
        lines += [f'{when} mill/temp {{"nut_C": {warmth(k)}}}']
    holds_positions(imported(tmp_path, written(tmp_path / "mqtt.log", lines), axis="X"))


def test_metrics_of_a_monitor_are_columns(tmp_path: Path) -> None:
    lines = ["# HELP axis_x_command_mm position", "# TYPE axis_x_command_mm gauge"]
    for k, (_, x, _, d) in enumerate(long_rows()):
        ms = int(1000 * (1795770000 + STEP * k))
        lines += [f'axis_x_command_mm{{m="1"}} {x} {ms}', f'axis_x_actual_mm{{m="1"}} {x + d / 1000:.4f} {ms}']
        lines += [f'temp_nut_celsius{{m="1"}} {warmth(k)} {ms}']
    holds_positions(imported(tmp_path, written(tmp_path / "metrics.txt", lines), axis="X"))


def test_series_that_became_columns_are_not_called_excluded(tmp_path: Path) -> None:
    rows = long_rows()
    series = [
        {"metric": {"__name__": name}, "values": [[1795770000 + STEP * k, str(v)] for k, v in enumerate(values)]}
        for name, values in (
            ("axis_x_command_mm", [x for _, x, _, _ in rows]),
            ("axis_x_actual_mm", [round(x + d / 1000, 4) for _, x, _, d in rows]),
        )
    ]
    path = written(tmp_path / "range.json", [json.dumps({"data": {"result": series}})])
    proposal, _ = prepared([path], axis="X")
    assert not [note for note in proposal.notes if "excluded" in note]


def test_lines_of_a_program_log_and_dictionaries_of_python(tmp_path: Path) -> None:
    rows = [(k, x, f"{x + d / 1000:.4f}") for k, (_, x, _, d) in enumerate(long_rows())]
    log = written(tmp_path / "a.log", [f"{moment(k)} INFO probe: X_cmd={x} X_meas={y}" for k, x, y in rows])
    printed = written(tmp_path / "b.txt", [f"{{'t': {STEP * k}, 'x_cmd': {x}, 'x_act': {y}}}" for k, x, y in rows])
    for path in (log, printed):
        holds_positions(imported(tmp_path / path.stem, path, axis="X"), temperatures=False)


@pytest.mark.parametrize(
    ("bits", "start", "resolution"), [(16, 0, 0.001), (24, 2**24 - 900, 0.00005), (16, 9, -0.0005)]
)
def test_a_counter_that_overflowed_is_counted_on_by_the_command(
    tmp_path: Path, bits: int, start: int, resolution: float
) -> None:
    rows = [(x, d, round((x + d / 1000) / resolution)) for _, x, _, d in long_rows()]
    lines = ["x_cmd_mm,x_enc_counts", *(f"{x},{(n + start) % 2**bits}" for x, _, n in rows)]
    recording = imported(tmp_path, written(tmp_path / "enc.csv", lines), axis="X", resolution=resolution)
    error = recording.array(recording.names("error")[0])
    np.testing.assert_allclose(error - error[0], [d - rows[0][1] for _, d, _ in rows], atol=1000 * abs(resolution))


def test_a_wrong_resolution_is_no_overflow(tmp_path: Path) -> None:
    lines = ["x_cmd_mm,x_enc_counts", *(f"{x},{round((x + d / 1000) / 0.001)}" for _, x, _, d in long_rows())]
    proposal, _ = prepared([written(tmp_path / "enc.csv", lines)], axis="X", resolution=0.0011)
    assert not [note for note in proposal.notes if "overflow" in note]


def long_lines(*more: str) -> list[str]:
    return ["run,dir,X target mm,dev um" + "".join(more[:1])] + [f"{r},{s:g},{x},{d}" for r, x, s, d in long_rows()]


def test_a_remark_among_the_rows_starts_no_other_table(tmp_path: Path) -> None:
    lines = [line.replace(",", " ") for line in long_lines()]
    lines[0] = "run dir target_mm dev_um"
    lines.insert(8, "% paused, coffee")
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.dat", lines), axis="X"))


def test_cells_with_line_breaks_stay_in_their_row(tmp_path: Path) -> None:
    rows = [f'{r},{s:g},{x},{d},"ok, see\nnote; 3"' for r, x, s, d in long_rows()]
    lines = ['"Run","Dir","X target\n(mm)","Error\n(um)","Remark"', *rows]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", lines), axis="X"))


def test_a_sign_of_inches_opens_no_cell(tmp_path: Path) -> None:
    lines = ['run,dir,X target mm,dev um,"', *(f"{r},{s:g},{x},{d}," for r, x, s, d in long_rows())]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", lines), axis="X"))


def test_zeros_behind_a_text_are_no_text(tmp_path: Path) -> None:
    path = written(tmp_path / "plc.csv", long_lines())
    path.write_bytes(path.read_bytes() + b"\0" * 4096)
    holds_the_truth(imported(tmp_path, path, axis="X"))


@pytest.mark.parametrize(("good", "wrong", "header"), [("1", "0", "valid"), ("OK", "BEAM LOST", "Status")])
def test_readings_that_a_column_calls_wrong_are_excluded(tmp_path: Path, good: str, wrong: str, header: str) -> None:
    lines = long_lines(f",{header}")
    lines = [lines[0], *(f"{line},{good}" for line in lines[1:])]
    lines.insert(9, f"1,1,300,99.9,{wrong}")
    proposal, _ = prepared([written(tmp_path / "x.csv", lines)], axis="X")
    assert np.nanmax(proposal.data["dev"]) < 90.0


def test_an_unknown_status_is_reported(tmp_path: Path) -> None:
    lines = long_lines(",Status")
    lines = [lines[0], *(f"{line},{'REPEATED' if k == 5 else 'OK'}" for k, line in enumerate(lines[1:]))]
    proposal, _ = prepared([written(tmp_path / "x.csv", lines)], axis="X")
    assert [note for note in proposal.notes if "'repeated'" in note and "kept" in note]


def test_a_file_below_itself_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "x.csv", long_lines() + long_lines())
    with pytest.raises(DataError, match="repeat those before to the last digit"):
        prepared([path], axis="X")


def test_parts_and_multiples_of_a_unit() -> None:
    said = ("in/10000", "mm/1000", "10 µm", "100 nm", "0.1 mil", "my", "My", "um/m")
    units = ("0.0001 inch", "0.001 mm", "0.01 mm", "0.1 um", "0.0001 inch", "um", None, "um/m")
    assert tuple(map(unit_of, said)) == units


def test_what_is_no_measurement_has_a_way_forward(tmp_path: Path) -> None:
    grbl = written(tmp_path / "a.log", [f"<Run|MPos:{x:.3f},0.000,-5.000|FS:500,0>" for _, x, _, _ in long_rows()])
    ball = written(
        tmp_path / "b.csv", ["C angle;X centre;Y centre;Z centre", *(f"{30 * k};1.1;2.2;{k}" for k in range(9))]
    )
    pairs = zip((grbl, ball), ("instrument read there", "protocol r_test"), strict=True)
    for path, says in pairs:
        with pytest.raises(DataError, match=says):
            prepared([path])


@pytest.mark.parametrize("name", ["Cycle {} {}", "{1} {0}", "Ciclo {} {} / um", "Pass {} {} / 1/1000 mm"])
def test_the_letter_of_a_pass_is_no_statistic(tmp_path: Path, name: str) -> None:
    """`B 1` beside `F 1` is the way back of run 1, not a reversal value; half of the readings were left out."""
    read = {(r, x, s): d for r, x, s, d in long_rows()}
    passes = [(r, s) for r in ("1", "2", "3") for s in (1.0, -1.0)]
    lines = [";".join(["Target [mm]", *(name.format(r, "F" if s > 0 else "B") for r, s in passes)])]
    lines += [
        ";".join(map(str, [x, *(read[r, x, s] for r, s in passes)])) for x in dict.fromkeys(x for _, x, _ in read)
    ]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", lines), axis="X"))


def test_repeated_names_are_runs(tmp_path: Path) -> None:
    read = {(r, x, s): d for r, x, s, d in long_rows()}
    passes = [(r, s) for r in ("1", "2", "3") for s in (1.0, -1.0)]
    lines = ["Target [mm]" + ";Fwd [um];Rev [um]" * 3]
    lines += [
        ";".join(map(str, [x, *(read[r, x, s] for r, s in passes)])) for x in dict.fromkeys(x for _, x, _ in read)
    ]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", lines), axis="X"))
