"""Ingest beside pyarrow reading the same CSV bare, and one table cycle beside scikit-learn's single predict."""

from __future__ import annotations

import resource
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

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


def best(work) -> float:
    """Shortest wall time of a few rounds, s."""
    times = []
    for _ in range(ROUNDS):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return min(times)


def bench_ingest() -> float:
    """Seconds of ours over seconds of pyarrow's own reader, same file, same process."""
    import pyarrow.csv as pacsv

    with tempfile.TemporaryDirectory() as name:
        folder = write(Path(name))
        size = (folder / "recording.csv").stat().st_size
        bare = best(lambda: pacsv.read_csv(folder / "recording.csv"))
        ours = best(lambda: manifest_folder.read(folder))
        parquet = best(lambda: manifest_folder.to_parquet(folder, folder / "out"))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"  {'pyarrow, bare':28} {bare:7.3f} s  {size / bare / 1e6:6.0f} MB/s")
    print(f"  {'ingest, read and checked':28} {ours:7.3f} s  {ours / bare:6.2f} x bare, wanted: at most {INGEST_AIM}")
    print(f"  {'ingest to Parquet, chunked':28} {parquet:7.3f} s  {parquet / bare:6.2f} x bare")
    print(f"  {'peak memory of all three':28} {peak:7.0f} MB")
    return ours / bare


def bench_single_call() -> None:
    """One evaluation of a model of eight temperatures: the table's cycle against scikit-learn's predict."""
    from sklearn.linear_model import LinearRegression

    from bench.bench_tables import bench_cycle

    rng = np.random.default_rng(2)
    x = rng.normal(size=(500, 8))
    model = LinearRegression().fit(x, x @ np.arange(8))
    one, calls = x[:1], 2000
    start = perf_counter()
    for _ in range(calls):
        model.predict(one)
    peer = (perf_counter() - start) / calls * 1e9
    ours = bench_cycle()["cycle_ns"]
    print(f"  {'scikit-learn predict, one row':28} {peer:9.0f} ns")
    print(f"  {'a table cycle, 21 curves':28} {ours:9.0f} ns  {peer / ours:6.0f} x faster, wanted: below 1000 ns")


def main() -> int:
    ratio = bench_ingest()
    bench_single_call()
    return int(ratio > INGEST_AIM)


if __name__ == "__main__":
    sys.exit(main())
