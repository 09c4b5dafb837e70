"""Tables that are damaged, endless, impossibly large or impossibly full: each is refused with a message."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from errpipe.errors import ConfigError, DataError
from errpipe.formats import manifest_folder
from tests.hostile.command_line import MANIFEST, command, recording_folder

ROOT = Path(__file__).parents[2]
FIT = """pipeline: 1
stages:
  - {kind: ingest, recording: rec}
  - {kind: clean}
  - kind: fit
    components:
      - {component: EXX, terms: [{term: scale_expansion, axis: X, sensor: T_nut}]}
"""


@pytest.mark.parametrize(
    "column, value, word",
    [
        ("dev", 1e10, "1e.?10 um is impossible"),
        ("dev", -2e6, "impossible"),
        ("dev", 1e30, "impossible"),
        ("x", 1e30, "impossible"),
        ("T_nut", -1e300, "impossible"),
        ("t", 1e16, "impossible"),
    ],
)
def test_an_impossible_value_is_refused_with_its_line(tmp_path: Path, column: str, value: float, word: str) -> None:
    values = {"dev": np.zeros(40), "x": np.linspace(0, 500, 40), "T_nut": np.full(40, 20.0), "t": np.arange(40.0)}
    values[column][17 if column != "t" else 39] = value
    line = 19 if column != "t" else 41
    with pytest.raises(DataError, match=rf"rows\.csv:{line}  {column}: .*{word.split()[-1]}"):
        manifest_folder.read(recording_folder(tmp_path / "rec", **values))


@pytest.mark.parametrize("columns", ["constant", "empty"])
def test_a_sensor_that_says_nothing_is_named(tmp_path: Path, columns: str, capsys: Any) -> None:
    dead = np.full(200, 21.0 if columns == "constant" else np.nan)
    folder = recording_folder(tmp_path / "rec", rows=200, T_nut=dead, T_bed=20 + np.cos(np.arange(200.0)))
    (folder / "recording.yaml").write_text(MANIFEST + "  T_bed: {role: temperature, unit: degC}\n")
    (tmp_path / "p.yaml").write_text(FIT)
    code, text = command("run", tmp_path / "p.yaml", "--out", tmp_path / "out", capsys=capsys)
    assert code == 3 and "T_nut: cleaning set it aside" in text and "fit without it" in text
    recording_folder(tmp_path / "rec", rows=200, T_nut=dead)
    code, text = command("run", tmp_path / "p.yaml", "--out", tmp_path / "out", capsys=capsys)
    said = {"constant": "T_nut: cleaning set it aside: shows 21 in every row", "empty": "role: ignore"}[columns]
    assert code == 3 and "T_nut" in text and said in text


def test_a_title_with_a_zero_byte_is_refused_where_it_stands(tmp_path: Path) -> None:
    folder = recording_folder(tmp_path / "rec")
    (folder / "recording.yaml").write_text('recording: 1\ntitle: "a\\0b"\n' + MANIFEST.partition("\n")[2])
    with pytest.raises(ConfigError, match=r"recording\.yaml:2:8 .*control character U\+0000"):
        manifest_folder.read(folder)


def test_two_thousand_columns_are_refused(tmp_path: Path) -> None:
    folder = recording_folder(tmp_path / "rec")
    more = "".join(f"  T{n}: {{role: temperature, unit: degC}}\n" for n in range(2_000))
    (folder / "recording.yaml").write_text(MANIFEST + more)
    with pytest.raises(ConfigError, match="2004 columns"):
        manifest_folder.read(folder)


def test_a_carriage_return_inside_a_line_is_refused_with_its_line(tmp_path: Path) -> None:
    folder = recording_folder(tmp_path / "rec")
    lines = (folder / "rows.csv").read_text().split("\n")
    lines[4] = lines[4].replace(",", "\r,", 1)
    (folder / "rows.csv").write_text("\n".join(lines), newline="")
    with pytest.raises(DataError, match=r"rows\.csv:5  a carriage return"):
        manifest_folder.read(folder)


@pytest.mark.slow
def test_a_line_of_300_mb_is_refused_in_little_memory(tmp_path: Path) -> None:
    folder = recording_folder(tmp_path / "rec")
    with open(folder / "rows.csv", "ab") as stream:
        for _ in range(300):
            stream.write(b"1" * (1 << 20))
    (tmp_path / "p.yaml").write_text(FIT)
    peak = tmp_path / "peak"
    words = ["-m", "tests.peak_memory", peak, "run", tmp_path / "p.yaml", "--out", tmp_path / "out"]
    done = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 3 and "rows.csv:42  is longer than 4 MB" in done.stderr, done.stderr
    assert int(peak.read_text()) < 400_000  # kB: 2.5 GB before the limit of a line


def parquet_folder(folder: Path, rows: int = 2000) -> Path:
    rng = np.random.default_rng(3)
    recording_folder(folder)
    (folder / "rows.csv").unlink()
    text = MANIFEST.replace("rows.csv", "rows.parquet").replace("columns:\n", "columns:\n  run: {role: run}\n")
    (folder / "recording.yaml").write_text(text)
    labels = np.repeat(["a", "b"], rows // 2)
    table = {"run": labels, "t": np.arange(rows) * 1.0, "x": rng.uniform(0, 500, rows)}
    table |= {"T_nut": rng.normal(20, 1, rows), "dev": rng.normal(0, 1, rows)}
    pq.write_table(pa.table(table), folder / "rows.parquet", compression="snappy")
    return folder


def test_corrupt_parquet_is_a_message_wherever_it_is_damaged(tmp_path: Path) -> None:
    folder = parquet_folder(tmp_path / "rec")
    sound = (folder / "rows.parquet").read_bytes()
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(300):
        data = bytearray(sound)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(256)
        if rng.random() < 0.1:
            del data[rng.integers(len(data)) :]
        (folder / "rows.parquet").write_bytes(data)
        try:
            manifest_folder.read(folder)
        except DataError as err:
            refused += 1
            assert "rows.parquet" in str(err)
    assert refused > 30


def test_a_small_table_of_ten_million_equal_rows_is_refused(tmp_path: Path) -> None:
    folder = parquet_folder(tmp_path / "rec")
    rows = 10_000_000
    ones = pa.array(np.ones(rows))
    run = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int8)), ["a"])
    table = pa.table({"run": run, "t": ones, "x": ones, "T_nut": ones, "dev": ones})
    pq.write_table(table, folder / "rows.parquet", compression="zstd")
    with pytest.raises(DataError, match="unpack to 50000000 cells"):
        manifest_folder.read(folder)


def test_readings_that_unpack_to_very_many_rows_are_refused(tmp_path: Path) -> None:
    from errpipe.stages import _readings

    rows = pa.array(np.zeros(_readings.MAX_CELLS // 2 + 1, dtype=np.float32))
    pq.write_table(pa.table({"time": rows, "EXX": rows}), tmp_path / "r.parquet", compression="zstd")
    with pytest.raises(DataError, match=r"r.parquet: holds 5000001 rows"):
        _readings.read(tmp_path / "r.parquet", manifest_folder.read(recording_folder(tmp_path / "rec")), ["EXX"])


def test_more_cells_than_the_machine_can_hold_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manifest_folder, "max_cells", lambda: 100)
    with pytest.raises(DataError, match="do not fit into this machine's memory"):
        manifest_folder.read(recording_folder(tmp_path / "rec"))


def test_many_sensors_and_many_runs_are_cleaned_in_bounded_time() -> None:
    """All rules: twice the sensors take at most three times as long; 24,000 runs at most ten times 24 of them."""
    import time

    import pandas as pd

    from errpipe.cleaning import clean
    from errpipe.domain.recording import Column, Manifest, Recording

    def seconds(sensors: int, rows: int, runs: int) -> float:
        rng = np.random.default_rng(0)
        kinds = {"run": Column(role="run")}
        frame: dict[str, Any] = {"run": (np.arange(rows) * runs // rows).astype(str)}
        for n in range(sensors):
            kinds[f"T{n}"] = Column(role="temperature", unit="degC")
            frame[f"T{n}"] = 20 + rng.normal(size=rows)
        recording = Recording(Manifest(recording=1, tables=("a",), columns=kinds), pd.DataFrame(frame))
        recording.run_codes()
        began = time.process_time()
        clean(recording)
        return time.process_time() - began

    assert seconds(60, 2000, 20) < 0.5 + 3 * seconds(30, 2000, 20)
    assert seconds(4, 24_000, 24_000) < 0.5 + 10 * seconds(4, 24_000, 24)


def test_a_model_whose_term_has_no_name_is_a_message() -> None:
    from pydantic import ValidationError

    from errpipe.domain.error_model import FittedTerm

    with pytest.raises(ValidationError, match="has its name under `term`"):
        FittedTerm.model_validate({"term": {"axis": "X"}, "parameters": []})


def test_a_model_whose_column_has_an_unknown_key_is_a_message(tmp_path: Path) -> None:
    from errpipe.errors import VerifyError
    from errpipe.stages._artefacts import read_model

    path = tmp_path / "error_model.json"
    path.write_text('{"error_model": 1, "columns": {"x": {"role": "position", "!xis": "X"}}, "components": []}')
    with pytest.raises(VerifyError, match=r"not an error model: columns\.x\.!xis: Extra inputs"):
        read_model(path)
