"""How long the competition of thermal families takes: `errpipe run` with ingest, fit, validate and export.

The recording of 16 sensors is simulated here (seed 1). The turning centre's is real and lies in ERRPIPE_REAL_DATA;
without it that figure is left out.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

from bench.figure import Figure, main

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("ERRPIPE_REAL_DATA", ROOT.parent / "shared" / "real-data"))
SENSORS, DAYS, HOURS = 16, 30, 24
BODIES_H = np.array([0.5, 2.0, 6.0, 20.0])  # time constants of what warms, hours
SEASONS_C = {"winter": 15.0, "spring": 20.0, "summer": 26.0}  # mean of the room
PIPELINE = """pipeline: 1
stages:
  - {kind: ingest, recording: .}
  - {kind: fit, family: auto, component: E_Z}
  - {kind: validate}
  - {kind: export}
"""


def write(folder: Path) -> None:
    """Three seasons of hourly readings, a run a day: bodies warmed by duty and room, sensors that mix them."""
    import pandas as pd

    rng = np.random.default_rng(1)
    mixing, gains = rng.dirichlet(np.ones(len(BODIES_H)), SENSORS), rng.normal(0, 1.5, len(BODIES_H))
    frames = []
    for season, mean in SEASONS_C.items():
        body = np.full(len(BODIES_H), mean)
        for day in range(DAYS):
            duty = rng.uniform(0.3, 1.0) * (rng.random(HOURS) < 0.7)
            room = mean + rng.normal(0, 1) + 2 * np.sin(2 * np.pi * (np.arange(HOURS) - 9) / HOURS)
            bodies = np.empty((HOURS, len(BODIES_H)))
            for hour in range(HOURS):
                body = body + (1 - np.exp(-1 / BODIES_H)) * (room[hour] + 12 * duty[hour] - body)
                bodies[hour] = body
            temperatures = (bodies @ mixing.T + rng.normal(0, 0.05, (HOURS, SENSORS))).round(2)
            deviation = (bodies - bodies[0]) @ gains + rng.normal(0, 0.5, HOURS)
            frame = pd.DataFrame(temperatures, columns=[f"T{n}" for n in range(SENSORS)])
            frame.insert(0, "t", 3600.0 * np.arange(HOURS))
            frame.insert(0, "run", f"{season} {day}")
            frames.append(frame.assign(season=season, E_Z=deviation.round(2)))
    pd.concat(frames).to_csv(folder / "recording.csv", index=False)
    columns = ["  run: {role: run}", "  t: {role: time, unit: s}", "  season: {role: group, of: season}"]
    columns += [f"  T{n}: {{role: temperature, unit: degC, location: place {n}}}" for n in range(SENSORS)]
    columns += ["  E_Z: {role: error, unit: um, component: E_Z}", ""]
    head = "recording: 1\ntables: [recording.csv]\ncolumns:\n"
    (folder / "recording.yaml").write_text(head + "\n".join(columns), "utf-8")
    (folder / "pipeline.yaml").write_text(PIPELINE, "utf-8")


def run(pipeline: Path, out: Path) -> tuple[float, float]:
    """(wall time in s, peak memory in MB) of `errpipe run`. A gate that refuses the table (exit 4) has run as well."""
    command = [sys.executable, "-m", "errpipe", "run", str(pipeline), "--out", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    begin = perf_counter()
    child = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 4):
        raise RuntimeError(f"errpipe run {pipeline.name} ended with {child.returncode}")
    return perf_counter() - begin, used.ru_maxrss / 1024


def figures() -> list[Figure]:
    """Wall time and peak memory of each."""
    out = []
    with tempfile.TemporaryDirectory() as name:
        folder, raw = Path(name), Path(name) / "raw"
        raw.mkdir()
        write(raw)
        took, peak = run(raw / "pipeline.yaml", folder / "out")
        what = f"families of {SENSORS} sensors, {DAYS * HOURS * len(SEASONS_C)} hourly rows of three seasons"
        out += [Figure(what, took, "s", aim=300.0), Figure(f"{what}: peak memory", peak, "MB")]
        if (REAL / "turning-centre-thermal").is_dir():
            took, peak = run(ROOT / "pipelines" / "turning-centre-families.yaml", folder / "centre")
            out += [Figure("families of the turning centre", took, "s", aim=60.0)]
            out += [Figure("families of the turning centre: peak memory", peak, "MB")]
        else:
            print("skipped: turning centre, no recording in ERRPIPE_REAL_DATA")
    return out


if __name__ == "__main__":
    sys.exit(main(figures))
