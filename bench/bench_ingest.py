"""Ingest beside pyarrow reading the same CSV bare, and one table cycle beside scikit-learn's single predict."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

from bench.figure import Figure, main, seconds, spread
from errpipe.formats import manifest_folder

ROWS, COLUMNS, ROUNDS = 1_000_000, 8, 3
INGEST_AIM = 1.5
MANIFEST = """recording: 1
tables: [recording.csv]
columns:
  run: {role: run}
  t: {role: time, unit: s}
"""


def write(folder: Path) -> Path:
    """A recording of a run, time and sensors, as a logger writes it."""
    import pyarrow as pa
    import pyarrow.csv as pacsv

    rng = np.random.default_rng(1)
    names = [f"T{n}" for n in range(COLUMNS)]
    values = {name: np.round(20 + rng.normal(0, 2, ROWS), 2) for name in names}
    table = pa.table({"run": pa.array(["1"] * ROWS), "t": np.arange(ROWS, dtype=float), **values})
    pacsv.write_csv(table, folder / "recording.csv", pacsv.WriteOptions(quoting_style="none"))
    lines = [f"  {n}: {{role: temperature, unit: degC, location: sensor {n}}}\n" for n in names]
    (folder / "recording.yaml").write_text(MANIFEST + "".join(lines))
    return folder


def figures() -> list[Figure]:
    """Ingest beside pyarrow's reader (same file, same process), and one cycle beside scikit-learn's predict."""
    import pyarrow.csv as pacsv

    with tempfile.TemporaryDirectory() as name:
        folder = write(Path(name))
        bare = seconds(lambda: pacsv.read_csv(folder / "recording.csv"), ROUNDS, perf_counter)
        ours = seconds(lambda: manifest_folder.read(folder), ROUNDS, perf_counter)
        parquet = seconds(lambda: manifest_folder.to_parquet(folder, folder / "out"), ROUNDS, perf_counter)
    reader = {"peer": "pyarrow, bare", "lacks": "units, roles, order of time, impossible values"}
    return [
        Figure("ingest over bare reading", ours[0] / bare[0], "x", 0.0, INGEST_AIM, **reader),
        Figure(f"ingest of {ROWS} rows", ours[0], "s", spread(ours), times=bare[0] / ours[0], **reader),
        Figure(
            "the same to Parquet, in chunks", parquet[0], "s", spread(parquet), times=bare[0] / parquet[0], **reader
        ),
        single_call(),
    ]


def single_call() -> Figure:
    """One evaluation of a model of eight temperatures: the table's cycle against scikit-learn's predict."""
    from sklearn.linear_model import LinearRegression

    from bench.bench_tables import bench_cycle

    rng = np.random.default_rng(2)
    x = rng.normal(size=(500, 8))
    model = LinearRegression().fit(x, x @ np.arange(8))
    calls = 2000
    peer = seconds(lambda: [model.predict(x[:1]) for _ in range(calls)], 3)[0] / calls * 1e9
    ours = bench_cycle()
    reference = {"peer": "scikit-learn predict of one row", "lacks": "curves, lags, limits, sensors that fail"}
    return Figure(
        "one cycle of a table", ours["cycle_ns"], "ns", ours["spread"], times=peer / ours["cycle_ns"], **reference
    )


if __name__ == "__main__":
    sys.exit(main(figures))
