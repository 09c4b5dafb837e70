"""A fit batch by batch from disk, beside numpy in memory, Dask and bare reading of the same columns.

Times are processor time, over all threads.

    python -m bench.bench_history --million 200       # as many rows through the command, stage by stage (7 GB of disk)
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import process_time

import numpy as np

from bench.figure import Figure, asked_rows, main, seconds, spread

ROWS, ROUNDS = 2_000_000, 9  # rounds: each in turns, of which the shortest counts
PIECE = 1 << 20  # rows that are made at once: whole groups of rows of the file
AIM, MEMORY_AIM = 1.5, 1000.0  # of the time of bare reading; MB
COLUMNS = ("x", "T_nut", "T_bed", "EXX")
MANIFEST = """recording: 1
tables: [recording.parquet]
columns:
  run: {role: run}
  t: {role: time, unit: s}
  x: {role: position, unit: mm, axis: X}
  T_nut: {role: temperature, unit: degC, location: nut}
  T_bed: {role: temperature, unit: degC, location: bed}
  EXX: {role: error, unit: um, component: EXX}
"""
TERMS = (
    {"term": "offset"},
    {"term": "scale_error", "axis": "X"},
    {"term": "scale_expansion", "axis": "X", "sensor": "T_nut"},
    {"term": "thermal_drift", "sensor": "T_bed"},
)


def write(folder: Path, rows: int = ROWS) -> Path:
    """A log of 40 runs, as `ingest` leaves it (seed 1)."""
    import pandas as pd

    from errpipe.domain.recording import Recording
    from errpipe.formats import manifest_folder

    (folder / "recording.yaml").write_text(MANIFEST, "utf-8")
    manifest, rng = manifest_folder.canonical(manifest_folder.load_manifest(folder)), np.random.default_rng(1)

    def piece(first: int) -> Recording:
        k = np.arange(first, min(first + PIECE, rows))
        x, nut, bed = 250 + 250 * np.sin(k / 300), 22 + 4 * np.sin(22 * k / rows), 21 + 2 * np.sin(13 * k / rows)
        exx = 3 + 0.01 * x + 0.011 * x * (nut - 20) + 2 * bed + rng.normal(size=k.size)
        frame = pd.DataFrame({"run": (k // (rows // 40)).astype(str), "t": k * 1.0, "x": x, "T_nut": nut, "T_bed": bed})
        return Recording(manifest, frame.assign(EXX=exx))

    manifest_folder.write_pieces(map(piece, range(0, rows, PIECE)), manifest, lambda: manifest, folder)
    return folder


def read(folder: Path) -> dict[str, np.ndarray]:
    """The columns of the fit, whole, by pyarrow alone."""
    import pyarrow.parquet as pq

    table = pq.read_table(folder / "recording.parquet", columns=list(COLUMNS))
    return {name: table[name].to_numpy() for name in COLUMNS}


def in_memory(folder: Path) -> np.ndarray:
    """The same parameters by numpy, everything in memory."""
    c = read(folder)
    design = np.column_stack([np.ones(ROWS), c["x"] / 1e3, c["x"] / 1e3 * (c["T_nut"] - 20), c["T_bed"] - 20])
    return np.linalg.lstsq(design, c["EXX"], rcond=None)[0]


def by_dask(folder: Path) -> np.ndarray:
    """The same parameters by Dask on one thread: the triangular factor of each partition, and that of all factors."""
    import dask
    import dask.dataframe as dd
    import pandas as pd

    def factor(part: pd.DataFrame) -> np.ndarray:
        x, nut = part["x"] / 1e3, part["T_nut"] - 20
        return np.linalg.qr(np.column_stack([np.ones(len(part)), x, x * nut, part["T_bed"] - 20, part["EXX"]]), "r")

    partitions = dd.read_parquet(folder / "recording.parquet", columns=list(COLUMNS), split_row_groups=1).to_delayed()
    factors = dask.compute(*(dask.delayed(factor)(part) for part in partitions), scheduler="synchronous")
    whole = np.linalg.qr(np.vstack(factors), "r")
    return np.linalg.solve(whole[:4, :4], whole[:4, 4])


def linear_part(folder: Path) -> np.ndarray:
    """The pass that leaves the triangular factors, and the parameters from them."""
    from errpipe.fitting import batches, solve
    from errpipe.fitting.source import survey
    from errpipe.models.terms import Terms
    from errpipe.stages._artefacts import source_in

    source = source_in(folder)
    family = Terms(components=[{"component": "EXX", "terms": TERMS}])
    (history,) = batches.gather(source, family, survey(source, family), lambda recording: recording)
    rows = batches.equivalent_rows(history.factor())
    return solve.least_squares(rows[:, 1:-2], rows[:, -1]).coefficients


def partitions(folder: Path, millions: int) -> None:
    """A log at 1 Hz as a machine leaves it, a run a day: files of a million rows (the noise of one is that of all)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng, rows, names = np.random.default_rng(1), 1_000_000, [f"part-{n:03d}.parquet" for n in range(millions)]
    noise = rng.normal(size=(3, rows)) * [[0.02], [0.02], [1.0]]
    for number, name in enumerate(names):
        k = number * rows + np.arange(rows)
        x, nut, bed = 250 + 250 * np.sin(k / 300), 22 + 4 * np.sin(k / 9e4), 21 + 2 * np.sin(k / 15e4)
        nut, bed = (nut + noise[0]).round(2), (bed + noise[1]).round(2)
        exx = (3 + 0.01 * x + 0.011 * x * (nut - 20) + 2 * (bed - 20) + noise[2]).round(2)
        days = k // 86400
        run = pa.DictionaryArray.from_arrays((days - days[0]).astype("i4"), [f"day {d}" for d in np.unique(days)])
        numbers = {"x": x, "T_nut": nut, "T_bed": bed, "EXX": exx}
        single = {n: values.astype("f4") for n, values in numbers.items()}
        pq.write_table(pa.table({"run": run, "t": k.astype("f8"), **single}), folder / name)
    (folder / "recording.yaml").write_text(MANIFEST.replace("recording.parquet", ", ".join(names)), "utf-8")


def stage(folder: Path, to: str = "validate") -> tuple[float, float]:
    """(s of processor time, peak MB) of `errpipe run` up to a stage, in a process of its own."""
    terms = json.dumps(TERMS)
    lines = "pipeline: 1\nstages:\n  - {kind: ingest, recording: .}\n  - {kind: clean}\n  - kind: fit\n"
    lines += f"    components: [{{component: EXX, terms: {terms}}}]\n  - {{kind: validate}}\n"
    (folder / "pipeline.yaml").write_text(lines, "utf-8")
    command = [sys.executable, "-m", "errpipe", "run", "pipeline.yaml", "--out", "../out", "--to", to]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    child = subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"errpipe run ended with {child.returncode}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def stage_by_stage() -> list[Figure]:
    """Each stage of the command on the rows that `--million` asks for."""
    millions = asked_rows(ROWS) // 1_000_000
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "raw"
        folder.mkdir()
        partitions(folder, millions)
        taken = {to: stage(folder, to) for to in ("ingest", "clean", "fit", "validate")}
    matches = [Figure(f"{to}, {millions} million rows", took, "s") for to, (took, _) in taken.items()]
    return matches + [Figure(f"{to}: peak memory", peak, "MB", 0.0, MEMORY_AIM) for to, (_, peak) in taken.items()]


def figures() -> list[Figure]:
    """The linear part over bare reading and beside numpy, and the whole command with its peak memory."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "raw"
        folder.mkdir()
        write(folder)
        np.testing.assert_allclose(linear_part(folder), in_memory(folder), rtol=1e-8)
        np.testing.assert_allclose(by_dask(folder), in_memory(folder), rtol=1e-8)
        taken = [
            [seconds(lambda f=f: f(folder), 1, process_time)[0] for f in (read, linear_part, in_memory, by_dask)]
            for _ in range(ROUNDS)
        ]
        bare, ours, numpy, dask = (sorted(times) for times in zip(*taken, strict=True))
        whole, peak = stage(folder)
    lacks = {"lacks": "held-out runs, missing values, memory that does not grow"}
    return [
        Figure("linear fit from disk over bare reading of its columns", ours[0] / bare[0], "x", 0.0, AIM),
        Figure(f"linear fit of {ROWS} rows from disk", ours[0], "s", spread(ours), None, False, "numpy, all in memory",
               numpy[0] / ours[0], **lacks),
        Figure("the same fit", ours[0], "s", spread(ours), None, False, "Dask, one thread", dask[0] / ours[0],
               "held-out runs, missing values"),
        Figure("ingest, clean, fit and validate by command", whole, "s"),
        Figure("peak memory of that command", peak, "MB", 0.0, MEMORY_AIM),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main(stage_by_stage if "--million" in sys.argv else figures))
