"""`errpipe predict` from Parquet to Parquet beside reading and writing as many columns bare.

Each in a process of its own, for its peak memory; processor time, start of the interpreter and imports included.

    python -m bench.bench_predict --million 100       # as many rows (12 GB of disk)
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from bench.figure import Figure, asked_rows, main

ROWS = 20_000_000  # the start of Numba counts for a tenth
PIECE = 1 << 20  # rows that are made at once: whole groups of rows of the file
RUNS, SENSORS, REPEATS = 50, 4, 2
AIM, MEMORY_AIM = 2.0, 1.0  # times bare reading and writing; GB
BARE = """
import sys, pyarrow.parquet as pq
read = pq.ParquetFile(sys.argv[1])
names = read.schema_arrow.names[:6]
with pq.ParquetWriter(sys.argv[2], read.schema_arrow.empty_table().select(names).schema, use_dictionary=["run"]) as out:
    for batch in read.iter_batches(131_072):
        out.write_batch(batch.select(names))
"""


def write(folder: Path, count: int) -> None:
    """A recording of runs, time, a position and temperatures; a table of one curve and a lag per temperature."""
    import pandas as pd

    from bench.bench_growth import TRAVEL, table
    from errpipe.domain.recording import Column, Manifest, Recording
    from errpipe.formats import manifest_folder
    from errpipe.tables import ect

    rng = np.random.default_rng(0)
    names = [f"T{n}" for n in range(SENSORS)]
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        **{n: Column(role="temperature", unit="degC", location=n) for n in names},
    }
    manifest = Manifest(recording=1, title="bench", tables=("rows.parquet",), columns=columns)

    def piece(first: int) -> Recording:
        k = np.arange(first, min(first + PIECE, count))
        x = TRAVEL * (0.5 + 0.5 * np.sin(k / 50))
        frame = pd.DataFrame({"run": (k * RUNS // count).astype(str), "t": k * 1.0, "x": x})
        return Recording(manifest, frame.assign(**{n: 22 + rng.normal(0, 1, k.size).round(2) for n in names}))

    manifest_folder.write_pieces(map(piece, range(0, count, PIECE)), manifest, lambda: manifest, folder)
    ect.write(table(SENSORS, 0), folder / "table.ect")


def cost(*arguments: str) -> tuple[float, float]:
    """Processor time, s, and peak memory, GB, of an interpreter."""
    child = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{arguments} ended with {child.returncode}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6


def figures() -> list[Figure]:
    """Time against bare reading and writing, time and peak memory."""
    count = asked_rows(ROWS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_it = f"from bench.bench_predict import *; write(Path({name!r}), {count})"
        subprocess.run([sys.executable, "-c", write_it], check=True)
        table, read = str(folder / "table.ect"), str(folder / "recording.parquet")
        ours = ("-m", "errpipe", "predict", table, name, "--out", str(folder / "p.parquet"))
        cost(*ours)  # compiles
        bare, done = (sorted(cost(*c) for _ in range(REPEATS)) for c in (("-c", BARE, read, str(folder / "b")), ours))
    peer = {"peer": "pyarrow, bare", "times": bare[0][0] / done[0][0], "lacks": "a prediction, checks of the rows"}
    spread = done[-1][0] / done[0][0] - 1.0
    return [
        Figure("predict, Parquet to Parquet, over bare", done[0][0] / bare[0][0], "x", spread, AIM, **peer),
        Figure(f"predict of {count} rows", done[0][0], "s", spread, **peer),
        Figure("its peak memory", done[0][1], "GB", 0.0, MEMORY_AIM),
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
