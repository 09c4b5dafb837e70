"""Reading a manifest: roles, units, rows, and what is refused with which words."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from errpipe.domain.batch import joined
from errpipe.domain.manifest_text import manifest_text
from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.errors import ConfigError, DataError
from errpipe.formats import _tables, manifest_folder

MANIFEST = """\
recording: 1
title: a test
tables: [recording.csv]
constants:
  X: {role: axis, kind: linear, travel: [0, 0.8], screw_lead: 0.01, unit: m}
  tool_length: {value: 6, unit: inch}
columns:
  run: {role: run}
  t: {role: time, unit: min}
  x: {role: position, axis: X, unit: inch}
  dir: {role: direction, axis: X}
  T: {role: temperature, unit: degF, location: nut}
  note: {role: ignore}
  EXX: {role: error, component: EXX, unit: mm}
"""
HEADER = "run,t,x,dir,T,note,EXX"
ROWS = ["1,0,0,1,68,cold,0.001", "1,0.5,1,1,,,", '2,0,2,-1,212,"a, b",-0.002']


def folder(path: Path, rows=ROWS, header=HEADER, manifest=MANIFEST, encoding="utf-8") -> Path:
    path.mkdir(exist_ok=True, parents=True)
    (path / "recording.yaml").write_text(manifest, encoding="utf-8")
    (path / "recording.csv").write_bytes(("\n".join([header, *rows]) + "\n").encode(encoding))
    return path


def test_units_are_converted_once_and_missing_cells_stay_missing(tmp_path):
    recording = manifest_folder.read(folder(tmp_path))
    frame = recording.frame
    assert list(frame) == ["run", "t", "x", "dir", "T", "EXX"]
    assert list(frame["run"]) == ["1", "1", "2"]
    np.testing.assert_array_equal(frame["t"], [0, 30, 0])
    np.testing.assert_allclose(frame["x"], [0, 25.4, 50.8])
    np.testing.assert_allclose(frame["T"], [20, np.nan, 100])
    np.testing.assert_allclose(frame["EXX"], [1, np.nan, -2])
    assert all(frame[n].dtype == float for n in frame if n != "run")
    assert recording.manifest.columns["x"].unit == "mm" and recording.manifest.columns["EXX"].unit == "um"
    axis = recording.manifest.axis("X")
    assert (axis.travel, axis.screw_lead, axis.unit) == ((0, 800), 10, "mm")
    assert recording.manifest.constants["tool_length"].value == pytest.approx(152.4)
    assert type(recording.manifest) is Manifest


def test_several_tables_are_appended_in_order_whatever_their_kind(tmp_path):
    manifest = MANIFEST.replace("[recording.csv]", "[recording.csv, more.parquet]")
    folder(tmp_path, manifest=manifest)
    more = {"run": [3, 3], "t": [0.0, 1.0], "x": [3, 4], "dir": [1, -1], "T": [None, 50.0], "EXX": [0.0, np.nan]}
    pq.write_table(pa.table({**more, "note": ["a", "b"]}), tmp_path / "more.parquet")
    recording = manifest_folder.read(tmp_path)
    assert list(recording.frame["run"]) == ["1", "1", "2", "3", "3"]
    np.testing.assert_allclose(recording.frame["x"], np.array([0, 1, 2, 3, 4]) * 25.4)
    np.testing.assert_allclose(recording.frame["T"], [20, np.nan, 100, np.nan, 10])


def test_a_parquet_column_of_the_wrong_kind_is_named_with_its_file(tmp_path):
    folder(tmp_path, manifest=MANIFEST.replace("[recording.csv]", "[recording.parquet]"))
    sound = {"run": [3, 3], "t": [0.0, 1.0], "x": [3, 4], "dir": [1, -1], "T": [None, 50.0], "EXX": [0.0, 1.0]}
    for column, values, held in (("EXX", ["a", "b"], "string"), ("run", [0.5, 1.5], "double")):
        table = pa.table({**sound, "note": ["a", "b"], column: values})
        pq.write_table(table, tmp_path / "recording.parquet")
        with pytest.raises(DataError, match=rf"recording\.parquet  {column}: holds {held} \(allowed"):
            manifest_folder.read(tmp_path)


@pytest.mark.parametrize("rows", [1, 2, 3, 7, 1000])
def test_chunks_hold_the_same_rows(tmp_path, rows, monkeypatch):
    monkeypatch.setattr(_tables, "BLOCK_BYTES", 37)
    lines = [f"{i // 10},{i % 10},{i},1,70,,0.00{i % 7}" for i in range(50)]
    whole = manifest_folder.read(folder(tmp_path, lines))
    chunks = list(manifest_folder.iter_chunks(tmp_path, rows))
    assert all(len(c) == rows for c in chunks[:-1])
    pd.testing.assert_frame_equal(joined(chunks), whole.frame)
    assert all(c.manifest == whole.manifest for c in chunks)


REFUSED = {
    "a cell that is no number": (
        {"rows": [*ROWS, "2,1,x1,1,70,,0"]},
        "recording.csv:5  x: 'x1' is not a number (allowed: a number, or an empty cell where it is missing).",
    ),
    "not a number": ({"rows": [*ROWS, "2,1,1,1,nan,,0"]}, "recording.csv:5  T: found 'nan' (allowed: a finite number"),
    "infinity": ({"rows": [*ROWS, "2,1,1,1,-inf,,0"]}, "recording.csv:5  T: found '-inf' (allowed: a finite number"),
    "too large": ({"rows": [*ROWS, "2,1,1,1,1e999,,0"]}, "recording.csv:5  T: '1e999' is too large for a number"),
    "a decimal comma": (
        {"rows": [*ROWS, '2,1,"1,5",1,70,,0']},
        "recording.csv:5  x: '1,5' is not a number (allowed: a number, or an empty cell where it is missing)."
        " A decimal comma? Write 1.5, not 1,5.",
    ),
    "a time of day": (
        {"rows": [*ROWS, "2,12:30:00,1,1,70,,0"]},
        "recording.csv:5  t: '12:30:00' is not a number (allowed: a number, or an empty cell where it is missing)."
        " A date or time of day? `errpipe import` converts it to seconds.",
    ),
    "a ragged row": (
        {"rows": [*ROWS, "2,1,1,5,1,70,,0"]},
        "recording.csv:5  8 cells where the header has 7 (a decimal comma? write 1.5, not 1,5)",
    ),
    "a short row": ({"rows": ["1,0", *ROWS]}, "recording.csv:2  2 cells where the header has 7"),
    "a quote over two lines": (
        {"rows": [ROWS[0], '1,1,1,1,70,"a', 'b",0']},
        "recording.csv:3  a quote is not closed in its line",
    ),
    "a direction of 0": (
        {"rows": [*ROWS, "2,1,1,0,70,,0"]},
        "recording.csv:5  dir: 0 is not a direction (allowed: -1 or +1, or empty)",
    ),
    "time that decreases": (
        {"rows": [*ROWS, "1,0.4,1,1,70,,0"]},
        "recording.csv:5  t: 24 s comes after 30 s of run '1' (allowed: time that increases or repeats in a run)",
    ),
    "a row without a run": ({"rows": [*ROWS, ",1,1,1,70,,0"]}, "recording.csv:5  run: is empty"),
    "no rows": ({"rows": []}, "recording.csv: the table has a header but no rows"),
    "an undeclared column": (
        {"header": HEADER + ",Tair", "rows": [r + ",20" for r in ROWS]},
        "recording.csv:1  column 'Tair' is not in the manifest. Declare it with its role, or with `role: ignore`.",
    ),
    "a misspelt column": (
        {"header": HEADER.replace("EXX", "EX")},
        "recording.csv:1  column 'EX' is not in the manifest. Did you mean EXX?",
    ),
    "a missing column": (
        {"header": "run,t,x,dir,T,note", "rows": ["1,0,0,1,68,"]},
        "recording.csv:1  column 'EXX' of the manifest is not in the table (found: run, t, x, dir, T, note)",
    ),
    "a column twice": (
        {"header": HEADER + ",T", "rows": [r + ",20" for r in ROWS]},
        "recording.csv:1  column 'T' occurs 2 times in the header (allowed: once)",
    ),
    "semicolons": (
        {"header": HEADER.replace(",", ";")},
        "recording.csv:1  the header is separated by semicolons (allowed: commas)",
    ),
    "a byte order mark": ({"encoding": "utf-8-sig"}, "recording.csv:1  begins with a UTF-8 byte order mark"),
    "UTF-16": ({"encoding": "utf-16"}, "recording.csv:1  begins with UTF-16"),
    "Latin-1": (
        {"rows": ["\xe9,0,0,1,68,,0"], "encoding": "latin-1"},
        "recording.csv:2  not UTF-8 text: byte 0xe9 at 1",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused_says_where_and_what(tmp_path, case):
    changes, message = REFUSED[case]
    with pytest.raises(DataError) as refusal:
        manifest_folder.read(folder(tmp_path, **changes))
    assert str(refusal.value).startswith(f"{tmp_path}/{message}")


def test_a_wrong_file_shows_a_few_lines_not_all(tmp_path):
    with pytest.raises(DataError) as refusal:
        manifest_folder.read(folder(tmp_path, ["1,0,0;5,1,68,,0"] * 100))
    assert len(str(refusal.value).splitlines()) == _tables.MAX_PROBLEMS


def test_the_line_is_right_in_every_block(tmp_path, monkeypatch):
    monkeypatch.setattr(_tables, "BLOCK_BYTES", 64)
    lines = [f"1,{i},{i},1,70,,0" for i in range(200)]
    lines.insert(57, "")  # an empty line is passed over, and counts as a line
    lines[150] = "1,150,here,1,70,,0"
    with pytest.raises(DataError, match=r"recording\.csv:152  x: 'here' is not a number"):
        manifest_folder.read(folder(tmp_path, lines))
    lines[150] = "1,10,1,1,70,,0"
    with pytest.raises(DataError, match=r"recording\.csv:152  t: 600 s comes after 8880 s of run '1'"):
        manifest_folder.read(folder(tmp_path, lines))


def test_time_may_stand_still_and_runs_may_take_turns(tmp_path):
    rows = ["1,0,0,1,,,", "2,0,0,1,,,", "1,0,0,1,,,", "1,,0,1,,,", "2,5,0,1,,,", "1,1,0,1,,,"]
    assert len(manifest_folder.read(folder(tmp_path, rows))) == 6


def test_windows_line_ends_blanks_and_a_missing_last_line_end(tmp_path):
    folder(tmp_path)
    (tmp_path / "recording.csv").write_bytes(
        (HEADER + "\r\n" + "1, 0 ,+1.0,+1,70,,-0\r\n\r\n1,1,.5,1,7e1,,1.").encode()
    )
    frame = manifest_folder.read(tmp_path).frame
    np.testing.assert_allclose(frame["x"], [25.4, 12.7])


@pytest.mark.parametrize("table", ["../recording.csv", "/etc/hosts", "a/../../b.csv", "C:\\data.csv", ""])
def test_a_path_outside_the_folder_is_refused(tmp_path, table):
    manifest = MANIFEST.replace("[recording.csv]", f"['{table}']")
    with pytest.raises(ConfigError, match=r"recording\.yaml:3:10  tables\[0\]: .* is outside the folder"):
        manifest_folder.read(folder(tmp_path / "inner", manifest=manifest))


def test_a_link_outside_the_folder_is_refused(tmp_path):
    folder(tmp_path / "inner")
    (tmp_path / "inner" / "recording.csv").rename(tmp_path / "secret.csv")
    (tmp_path / "inner" / "recording.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(DataError, match="leads outside the folder through a link"):
        manifest_folder.read(tmp_path / "inner")


def test_no_other_file_is_opened(tmp_path):
    """The answer may lie beside the question: a reader that peeks would fail on this one."""
    folder(tmp_path)
    before = manifest_folder.read(tmp_path).frame
    (tmp_path / "answer.json").write_bytes(b"\xff not json")
    (tmp_path / "other.csv").write_bytes(b"\xff")
    for name in ("answer.json", "other.csv"):
        (tmp_path / name).chmod(0)
    pd.testing.assert_frame_equal(manifest_folder.read(tmp_path).frame, before)


def test_a_missing_table_is_named_with_the_nearest(tmp_path):
    folder(tmp_path, manifest=MANIFEST.replace("recording.csv", "recordings.csv"))
    with pytest.raises(DataError, match=r"recordings\.csv: no such table\. Did you mean recording\.csv\?"):
        manifest_folder.read(tmp_path)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("part-*.parquet", r"part-\*\.parquet: no such table\. Tables are listed by name; a pattern is not expanded"),
        ("times.parquet", r"t: holds timestamp\[..\] \(allowed: numbers; `errpipe import` converts times to seconds\)"),
    ],
)
def test_what_a_partition_cannot_be_says_what_to_do(tmp_path, table, message):
    place = folder(tmp_path, manifest=MANIFEST.replace("recording.csv", f'"{table}"'))
    frame = pd.read_csv(place / "recording.csv")
    frame["t"] = pd.Timestamp("2026-03-01") + pd.to_timedelta(frame["t"], unit="min")
    frame.to_parquet(place / "times.parquet", index=False)
    with pytest.raises(DataError, match=message):
        manifest_folder.read(place)


WRONG_MANIFESTS = {
    "role: runn": ("run: {role: run}", "run: {role: runn}", "columns.run.role: found 'runn'"),
    "unit": (
        "unit: degF",
        "unit: F",
        "'F' is not a unit of role temperature (allowed: degC, degF, K). Did you mean degF?",
    ),
    "no unit": (", unit: inch}\n  dir", "}\n  dir", "columns.x.unit: a column of role position needs a unit"),
    "axis": ("axis: X, unit", "axis: x, unit", "columns.x.axis: 'x' is not an ISO 841 axis"),
    "component": ("component: EXX", "component: EXZZ", "columns.EXX.component: 'EXZZ' is not an ISO 230-1 component"),
    "unit of the component": ("component: EXX", "component: EBX", "columns.EXX.unit: EBX is measured in urad"),
    "torque of a linear axis": ("component: EXX, unit: mm", "component: F_X, unit: N m", "F_X is measured in N (found"),
    "two times": ("note: {role: ignore}", "t2: {role: time}", "columns 't' and 't2' are both role time (allowed: one"),
    "unknown key": ("location: nut", "locaton: nut", "columns.T.locaton: unknown key"),
    "epoch": ("unit: min", "unit: min, epoch: yesterday", "columns.t.epoch: 'yesterday' is not ISO 8601"),
    "version": ("recording: 1", "recording: 2", "recording.yaml:1:12  recording:"),
    "table twice": ("[recording.csv]", "[recording.csv, recording.csv]", "a table is listed twice"),
}


@pytest.mark.parametrize("case", WRONG_MANIFESTS)
def test_a_wrong_manifest_is_refused(tmp_path, case):
    old, new, message = WRONG_MANIFESTS[case]
    assert old in MANIFEST
    with pytest.raises(ConfigError) as refusal:
        manifest_folder.read(folder(tmp_path, manifest=MANIFEST.replace(old, new)))
    assert message in str(refusal.value)


def test_a_flow_of_coolant_counts_as_on_or_off(tmp_path):
    """Before: "a column of role coolant has no unit (found 'l/min')"."""
    manifest = MANIFEST.replace("note: {role: ignore}", "note: {role: coolant, unit: l/min}")
    rows = ["1,0,0,1,68,0.02,1", "1,1,0,1,68,11.5,1", "1,2,0,1,68,,1", "1,3,0,1,68,-0.1,1", "1,4,0,1,68,0.5,1"]
    recording = manifest_folder.read(folder(tmp_path, rows, manifest=manifest))
    np.testing.assert_array_equal(recording.array("note"), [0.0, 1.0, np.nan, 0.0, 1.0])
    assert recording.array("note").dtype == float and recording.manifest.columns["note"].unit is None
    manifest_folder.write(recording, tmp_path / "again")
    np.testing.assert_array_equal(manifest_folder.read(tmp_path / "again").array("note"), recording.array("note"))

    said = r"recording.csv:3  note: -1 is not a flow in l/min \(allowed: 0 and more, or empty\)"
    with pytest.raises(DataError, match=said):
        manifest_folder.read(folder(tmp_path, [rows[0], "1,1,0,1,68,-1,1"], manifest=manifest))
    with pytest.raises(ConfigError, match=r"'lpm' is not a unit of role coolant .* Did you mean l/min"):
        manifest_folder.read(folder(tmp_path, rows, manifest=manifest.replace("l/min", "lpm")))


def test_the_page_of_the_contract_is_accepted(tmp_path):
    text = """\
recording: 1                     # format version
title: X axis, bidirectional positioning at nine thermal states
machine: vmc-1                   # free text, or the name of a machine file
tables: [recording.csv]          # read in this order, rows appended
constants:                       # facts about the set-up, all optional
  X: {role: axis, kind: linear, travel: [0, 800], screw_lead: 10, encoder_period: 0.02, drive_end: 0, unit: mm}
  tool_length: {value: 150, unit: mm}
columns:
  run:    {role: run}                                   # an uninterrupted measuring run
  season: {role: group, of: season}
  t:      {role: time, unit: s, epoch: 2026-01-31T08:00:00Z}
  x:      {role: position, axis: X, unit: mm}
  xc:     {role: command, axis: X, unit: mm}
  c:      {role: position, axis: C, unit: deg}
  dir:    {role: direction, axis: X}                    # +1 or -1: the side the target was approached from
  v:      {role: velocity, axis: X, unit: mm/s}
  a:      {role: acceleration, axis: X, unit: mm/s2}
  feed:   {role: feed, axis: X, unit: mm/min}
  path:   {role: feed, unit: mm/min}
  n:      {role: spindle_speed, unit: rpm}
  T_nut:  {role: temperature, unit: degC, location: ball-screw nut}
  p:      {role: pressure, unit: hPa}
  p_oil:  {role: pressure, unit: hPa, location: hydraulic circuit}
  rh:     {role: humidity, unit: '%'}
  wet:    {role: coolant}
  Fc:     {role: force, axis: X, unit: N}
  Fd:     {role: force, axis: X, component: F_X, unit: N}
  m:      {role: load, unit: kg}
  ap:     {role: depth_of_cut, unit: mm}
  L:      {role: overhang, unit: mm}
  cut:    {role: cut_length, unit: m}
  skip:   {role: ignore}
  EXX:     {role: error, component: EXX, unit: um}      # what was recorded
  EXX_sim: {role: simulated, component: EXX, unit: um}  # what the simulation says for that row
  C0Y:     {role: error, component: C0Y, unit: urad}
  EBX:     {role: error, component: EBX, unit: urad}
  E_Z:     {role: error, component: E_Z, unit: um}
  E_R:     {role: error, component: E_R, unit: um}
  E_D:     {role: error, component: E_D, unit: um}
  F_X:     {role: error, component: F_X, unit: N}
"""
    (tmp_path / "recording.yaml").write_text(text, encoding="utf-8")
    manifest = manifest_folder.load_manifest(tmp_path)
    assert manifest_folder.canonical(manifest) == manifest
    (tmp_path / "recording.yaml").write_text(manifest_text(manifest), encoding="utf-8")
    assert manifest_folder.load_manifest(tmp_path) == manifest


# ---------------------------------------------------------------- writing


def test_what_is_written_reads_back_and_has_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(manifest_folder, "CHUNK_ROWS", 20)
    source = folder(tmp_path / "in", [f"{i // 9},{i % 9},{i},1,{70 + i % 3},n,0.00{i % 7}" for i in range(50)])
    whole = manifest_folder.read(source)
    assert manifest_folder.write(whole, tmp_path / "a") == 50
    assert manifest_folder.to_parquet(source, tmp_path / "b") == 50
    for name in ("recording.parquet", "recording.yaml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    again = manifest_folder.read(tmp_path / "a")
    pd.testing.assert_frame_equal(again.frame, whole.frame)
    schema = pq.read_schema(tmp_path / "a" / "recording.parquet")
    assert schema.field("x").metadata == {b"role": b"position", b"unit": b"mm"}
    # Nothing is written where nothing changes.
    before = (tmp_path / "b" / "recording.parquet").stat().st_mtime_ns
    manifest_folder.to_parquet(source, tmp_path / "b")
    assert (tmp_path / "b" / "recording.parquet").stat().st_mtime_ns == before


def test_a_refused_recording_leaves_nothing_behind(tmp_path):
    source = folder(tmp_path / "in", [*ROWS, "2,1,x,1,70,,0"])
    with pytest.raises(DataError):
        manifest_folder.to_parquet(source, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


@settings(max_examples=30, deadline=None)
@given(
    title=st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=30),
    name=st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1, max_size=12),
    values=st.lists(st.floats(-1e15, 1e15), min_size=1, max_size=5),
)
def test_any_title_name_and_number_survives(tmp_path_factory, title, name, values):
    columns = {name: Column(role="temperature", unit="degC", location=title or None)}
    constants = {name: Constant(value=values[0], unit="mm")}
    manifest = Manifest(recording=1, title=title, tables=("recording.parquet",), columns=columns, constants=constants)
    out = tmp_path_factory.mktemp("any")
    manifest_folder.write(Recording(manifest, pd.DataFrame({name: np.array(values)})), out)
    again = manifest_folder.read(out)
    assert again.manifest == manifest
    np.testing.assert_array_equal(again.array(name), values)


# ---------------------------------------------------------------- size


GENERATE = """
import sys, pathlib
rows, out = int(sys.argv[1]), pathlib.Path(sys.argv[2])
line = "".join(f"1,{{t}},{i}.2345,1,{60 + i % 9}.25,,0.00{i % 7}\\n" for i in range(1000))
with open(out / "recording.csv", "w") as f:
    f.write("run,t,x,dir,T,note,EXX\\n")
    for k in range(rows // 1000):
        f.write(line.replace("{t}", str(k)))
"""
CONVERT = """
import sys
from pathlib import Path
from errpipe.formats import manifest_folder
from tests.peak_memory import peak_kb
manifest_folder.to_parquet(Path(sys.argv[1]), Path(sys.argv[2]))
print(peak_kb() // 1024)
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_file(tmp_path):
    """Peak memory of converting 10 and 40 times the rows (50 and 200 MB of text) differs by less than 100 MB."""
    peaks = []
    for rows in (1_500_000, 6_000_000):
        source = folder(tmp_path / str(rows))
        subprocess.run([sys.executable, "-c", GENERATE, str(rows), str(source)], check=True)
        done = subprocess.run(
            [sys.executable, "-c", CONVERT, str(source), str(tmp_path / "out")],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        peaks.append(int(done.stdout))
    assert peaks[1] < 1000 and peaks[1] - peaks[0] < 100, peaks
