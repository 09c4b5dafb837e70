"""Does a new machine with two runs gain from the pooled parameters of its type? Own and pooled fit on later runs.

python -m trials.pooled --seed 39 [--fleets 20]
python -m trials.pooled --from RECORDING

A simulated fleet has ten machines of a type with fifteen runs each and a new one with two. Of a real recording with
days each month is a machine, and one after the other is the new one, by every two runs in a row of it that leave
others to judge; the models are every spindle temperature beside one or two others. Both go through `errpipe fleet` with
`pool: true`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from errpipe.cli.app import main as errpipe
from errpipe.domain.error_model import ErrorModel
from errpipe.formats import manifest_folder
from errpipe.validation.predict import predict

MACHINES, RUNS = 10, 15  # machines of the type, and runs of each
NEW_RUNS, JUDGED = 2, 20  # runs of the new one, and runs that judge it
PLACES = np.r_[np.arange(0.0, 601.0, 60.0), np.arange(600.0, -1.0, -60.0)]  # mm
MANIFEST = """recording: 1
tables: [recording.csv]
columns:
  run: {role: run}
  t: {role: time, unit: s}
  x: {role: position, axis: X, unit: mm}
  T_nut: {role: temperature, unit: degC}
  EXX: {role: error, component: EXX, unit: um}
"""
PIPELINE = """pipeline: 1
stages:
  - {{kind: ingest, recording: .}}
  - kind: fit
    components:
      - {{component: {component}, terms: [{{term: offset}}, {terms}]}}
    holdout: {{scheme: leave-one-run-out}}
  - {{kind: validate}}
"""
FLEET = "fleet: 1\npipeline: pipeline.yaml\nrecordings: recordings\npool: true\n"


def runs_of(rng: np.random.Generator, traits: np.ndarray, count: int) -> pd.DataFrame:
    """Runs of a machine, one every nine days from a random one on; traits: level um, slope um/m, screw um/m/K.

    Each run is set up anew (2 um) and bends by itself (1 um): errors that a run's rows have in common.
    """
    parts, first = [], rng.integers(365)
    for k in range(count):
        air = 20.0 + 4.0 * np.sin(2 * np.pi * (first + 9 * k) / 365) + rng.normal(0, 1)
        nut = air + rng.uniform(1, 7)
        level, slope, screw = traits
        error = level + (slope + screw * (nut - 20)) * PLACES / 1e3
        error += rng.normal(0, 2) + rng.normal(0, 1) * np.sin(np.pi * PLACES / 600) + rng.normal(0, 0.8, PLACES.size)
        time, numbers = (9 * 86400.0 * k + 5.0 * np.arange(PLACES.size), {"x": PLACES, "T_nut": nut, "EXX": error})
        parts.append(pd.DataFrame({"run": f"run {k + 1}", "t": time, **numbers}))
    return pd.concat(parts, ignore_index=True).round(3)


def simulated(seed: int) -> tuple[dict[str, pd.DataFrame], pd.DataFrame]:
    """Recordings of a fleet, of which the machine `new` has two runs; and later runs of it."""
    rng = np.random.default_rng(seed)
    middle, spread = rng.uniform([-5, -15, 8], [5, 15, 13]), rng.uniform([1, 3, 0.3], [6, 12, 2])
    traits = {name: rng.normal(middle, spread) for name in [f"m{k}" for k in range(MACHINES)] + ["new"]}
    rows = {name: runs_of(rng, traits[name], NEW_RUNS if name == "new" else RUNS) for name in traits}
    return rows, runs_of(rng, traits["new"], JUDGED)


def left(
    machines: dict[str, pd.DataFrame], new: str, judged: pd.DataFrame, manifest: str, pipeline: str
) -> list[float]:
    """rms of the judged rows, um: uncompensated, by the new machine's own fit (nan: none), by the pooled one; or []."""
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(io.StringIO()):
        here = Path(name)
        for folder, frame in [*((here / "recordings" / m, f) for m, f in machines.items()), (here / "judged", judged)]:
            folder.mkdir(parents=True)
            frame.to_csv(folder / "recording.csv", index=False)
            (folder / "recording.yaml").write_text(manifest, encoding="utf-8")
        (here / "pipeline.yaml").write_text(pipeline, encoding="utf-8")
        (here / "fleet.yaml").write_text(FLEET, encoding="utf-8")
        with contextlib.redirect_stderr(io.StringIO()):
            errpipe(["fleet", str(here / "fleet.yaml"), "--out", str(here / "out"), "--jobs", "1"])
        paths = [here / f"out/machines/{new}/fit/error_model.json", here / f"out/pooled/{new}/error_model.json"]
        if not all(path.is_file() for path in paths):
            return []
        machines_of = json.loads((here / "out/fleet.json").read_text(encoding="utf-8"))["machines"]
        borrows = next(m["borrows"] for m in machines_of if m["name"] == new)
        recording = manifest_folder.read(here / "judged")
        (response,) = recording.names("error")
        measured = recording.array(response)
        models = [ErrorModel.model_validate_json(path.read_text(encoding="utf-8")) for path in paths]
        rests = [measured, *(measured - predict(m, recording)[f"{response}_predicted"].to_numpy() for m in models)]
        nothing, own, pooled = (float(np.sqrt(np.mean(rest**2))) for rest in rests)
        return [nothing, np.nan if borrows else own, pooled]


def of_months(folder: Path) -> Iterator[tuple[str, list[float]]]:
    """Every two runs in a row of a month that leave others of it, and every model: its name and what is left."""
    recording = manifest_folder.read(folder)
    manifest, columns = (folder / "recording.yaml").read_text(encoding="utf-8"), recording.manifest.columns
    frame = pd.read_csv(folder / recording.manifest.tables[0])
    (run,), (response,) = recording.names("run"), recording.names("error")
    day = next(n for n in recording.names("group") if columns[n].of == "day")
    months, warm = frame[day].astype(str).str[:7], recording.names("temperature")
    beside = [t for t in warm if "spindle" not in t]
    choices = [(s, *more) for s in warm if "spindle" in s for n in (1, 2) for more in combinations(beside, n)]
    runs_of_months = {m: list(dict.fromkeys(frame[run][months == m])) for m in sorted(set(months))}
    for new, first in (
        (m, runs[k : k + NEW_RUNS]) for m, runs in runs_of_months.items() for k in range(len(runs) - NEW_RUNS + 1)
    ):
        judged = frame[(months == new) & ~frame[run].isin(first)]
        machines = {m: frame[(months == m) & ((months != new) | frame[run].isin(first))] for m in sorted(set(months))}
        for sensors in choices if len(judged) else ():
            terms = ", ".join(f"{{term: thermal_drift, sensor: {sensor}}}" for sensor in sensors)
            pipeline = PIPELINE.format(component=columns[response].component, terms=terms)
            yield (
                f"{new} from {', '.join(map(str, first))} by {', '.join(sensors)}",
                left(machines, new, judged, manifest, pipeline),
            )


def of_fleets(seed: int, fleets: int, first: int = 0) -> Iterator[tuple[str, list[float]]]:
    terms = "{term: scale_error, axis: X}, {term: scale_expansion, axis: X, sensor: T_nut}"
    pipeline = PIPELINE.format(component="EXX", terms=terms)
    for number in range(first, first + fleets):
        machines, judged = simulated(1000 * seed + number)
        yield f"fleet {number}", left(machines, "new", judged, MANIFEST, pipeline)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fleets", type=int, default=20)
    parser.add_argument("--from", dest="folder", type=Path, help="a recording with days, whose months are the machines")
    a = parser.parse_args()
    rows = []
    for name, figures in of_months(a.folder) if a.folder else of_fleets(a.seed, a.fleets):
        shown = "{:.2f} uncompensated, {:.2f} own fit, {:.2f} pooled, um".format(*figures) if figures else "not judged"
        print(f"{name}: {shown}", flush=True)
        rows += [figures] if figures else []
    figures = np.array(rows).reshape(-1, 3)
    for what, some in (("with a fit of its own", True), ("without one", False)):
        part = figures[np.isfinite(figures[:, 1]) == some]
        if len(part):
            means = ", ".join(f"{m:.2f}" for m in np.exp(np.mean(np.log(part), axis=0)) if np.isfinite(m))
            harmed = int(np.sum(part[:, 2] > part[:, 0]))
            print(f"{len(part)} {what}: {means} um (geometric means); {harmed} worse than uncompensated")
            ratio = part[:, 2] / part[:, 1]
            print(f"pooled better in {np.sum(ratio < 1)}, at worst {ratio.max():.2f} times the own fit" if some else "")


if __name__ == "__main__":
    main()
