"""Is what the examples export ever worse than nothing? Their machines, drawn by seed, judged on the exact deviation.

python -m trials.examples [--first 1] [--seeds 20]

Each example of a known truth is simulated with sizes drawn by the seed, run through its own pipeline, and its exported
table predicts another session of the same machine (or, after push tests, the part that is cut), whose deviation without
noise is known. Ends with 1 where a table is worse than no compensation.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from errpipe.cli.app import main as errpipe
from errpipe.domain.recording import Recording
from errpipe.simulation import ball_screw_axis, sample_recordings, spindle_drift
from errpipe.simulation import folder as recording_folder

EXAMPLES = Path(__file__).parents[1] / "examples"
TEMPLATES = Path(ball_screw_axis.__file__).parents[1] / "stages" / "templates"
AVERAGED = range(1_000_000, 1_000_064)  # seeds of sessions whose mean is the machine's exact deviation
OTHER_SESSION = 100_000  # added to the seed of a session
REFUSED = (3, 4)  # exit codes: parameters that cannot be told apart; a gate said no


@dataclass(frozen=True)
class Example:
    """Two sessions of one machine; truth: the exact deviation of the second, um (rows,), NaN where none is known.

    pipeline: a file of the templates or of the examples, or the name of a template of `errpipe init`. A truth of two
    columns is E_X and E_Y of holes at (x, y): each plate's shift and rotation is its set-up.
    """

    pipeline: str
    component: str
    fitted: Recording
    later: Recording
    truth: np.ndarray


def ball_screw(seed: int) -> Example:
    """A ball-screw axis whose errors are 0 to 2 times the usual ones; some have hardly any."""
    usual = ball_screw_axis.Truth()
    rng = np.random.default_rng(seed)
    names = ("lead_error", "bow", "pitch", "backlash", "seat")
    drawn = {n: getattr(usual, n) * rng.uniform(0.0, 2.0) * rng.choice([0.05, 1.0]) for n in names}
    truth = ball_screw_axis.Truth(**drawn, noise=usual.noise * rng.uniform(0.3, 4.0))
    first = ball_screw_axis.simulate(seed, truth)
    later = ball_screw_axis.simulate(seed + OTHER_SESSION, truth)
    return Example("ball-screw-axis.yaml", "EXX", first.recording, later.recording, later.truth)


def spindle(seed: int) -> Example:
    """A spindle over three seasons; noise of 0.2 to 5 um."""
    noise = float(np.random.default_rng(seed).uniform(0.2, 5.0))
    first, _ = spindle_drift.simulate(seed, noise=noise)
    later, truth = spindle_drift.simulate(seed + OTHER_SESSION, noise=noise)
    return Example("spindle-drift.txt", "E_Z", first, later, truth)


def _deviation(recording: Recording, component: str) -> np.ndarray:
    """Deviation of each row, um; read minus commanded position, mm, where the recording holds these."""
    if component in recording.frame:
        return recording.array(component)
    return 1e3 * (recording.array("reading") - recording.array("commanded"))


def _of_template(name: str, sample: Callable[[int], Recording], seed: int) -> Example:
    """A template's machine with 0 to 2 times its deviations and 0.3 to 3 times its noise."""
    rng = np.random.default_rng(seed)
    size, noise = rng.uniform(0.0, 2.0) * rng.choice([0.05, 1.0]), rng.uniform(0.3, 3.0)
    (component,) = (c.component for c in sample(seed).manifest.columns.values() if c.role == "error")
    assert component is not None
    exact = np.mean([_deviation(sample(k), component) for k in AVERAGED], axis=0)

    def session(k: int) -> Recording:
        made = sample(k)
        deviation = size * exact + noise * (_deviation(made, component) - exact)
        if "reading" in made.frame:  # the error is derived from a dial gauge of 0.01 mm
            values = {"reading": np.round(made.array("commanded") + 1e-3 * deviation, 2)}
        else:
            values = {component: deviation}
        return Recording(made.manifest, made.frame.assign(**values))

    return Example(name, component, session(seed), session(seed + OTHER_SESSION), size * exact)


def laser(seed: int) -> Example:
    """An axis by laser after ISO 230-2."""
    return _of_template("laser-iso230", sample_recordings.laser, seed)


def dial_gauge(seed: int) -> Example:
    """A hobby machine's axis by a dial gauge of 0.01 mm."""
    return _of_template("dial-gauge", sample_recordings.dial_gauge, seed)


def gantry(seed: int) -> Example:
    """A gantry's Z reference while frame and bed warm up."""
    return _of_template("gantry", sample_recordings.gantry, seed)


def drilled_plate(seed: int) -> Example:
    """A drilling machine's plane with 0 to 2 times its deviations; noise of 0.3 to 3 times the usual."""
    rng = np.random.default_rng(seed)
    size, noise = rng.uniform(0.0, 2.0) * rng.choice([0.05, 1.0]), rng.uniform(0.3, 3.0)
    names = ["E_X", "E_Y"]
    exact = np.mean([sample_recordings.drilled_plate(k).frame[names].to_numpy() for k in AVERAGED], axis=0)

    def session(k: int) -> Recording:
        made = sample_recordings.drilled_plate(k)
        values = size * exact + noise * (made.frame[names].to_numpy() - exact)
        return Recording(made.manifest, made.frame.assign(E_X=values[:, 0], E_Y=values[:, 1]))

    return Example("drilled-plate", "E_X", session(seed), session(seed + OTHER_SESSION), size * exact)


def cutting_force(seed: int) -> Example:
    """A lathe whose post, spindle and tilt give way 0.2 to 3 times as much as usual; judged on the part that is cut."""
    spec = importlib.util.spec_from_file_location("lathe", EXAMPLES / "cutting-force" / "lathe.py")
    assert spec is not None and spec.loader is not None
    lathe = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(lathe)
    rng = np.random.default_rng(seed)
    for name in ("POST", "SPINDLE", "TILT"):
        setattr(lathe, name, getattr(lathe, name) * rng.uniform(0.2, 3.0))
    fitted = lathe.push_tests(seed, noise=float(rng.uniform(0.1, 2.0)))
    places, force = np.repeat([30.0, 80.0, 120.0, 170.0], 9), np.tile(np.linspace(0.0, 400.0, 9), 4)
    truth = force * np.array([lathe.gives(z, lathe.WORK) for z in places])
    cut = pd.DataFrame({"run": [f"Z{z:g}" for z in places], "Z": places, "F": force, "E_X": truth})
    return Example("cutting-force/pipeline.yaml", "E_X", fitted, Recording(fitted.manifest, cut), truth)


DRAWN = (ball_screw, spindle, laser, dial_gauge, gantry, drilled_plate, cutting_force)


def _pipeline(example: Example, folder: Path) -> Path:
    """The example's pipeline for the recording in the folder."""
    known = [p for p in (TEMPLATES / example.pipeline, EXAMPLES / example.pipeline) if p.is_file()]
    if not known:
        words = ["init", str(folder / "work"), "--template", example.pipeline, "--recording", str(folder / "recording")]
        if _quietly(words) != 0:
            raise RuntimeError(f"{example.pipeline}: no pipeline for this recording")
        return folder / "work" / "pipeline.yaml"
    text = known[0].read_text("utf-8")
    if "- kind: ingest" in text:
        head, stages = text[: text.index("stages:")], text[text.index("  - kind: ingest") :]
        stages = stages.replace("- kind: ingest", "- kind: ingest\n    recording: recording", 1)
        text = head.replace("root: ..\n", "") + "stages:\n" + stages
    text = text.replace("recording: push-tests", "recording: recording").replace("  - kind: report\n", "")
    (folder / "pipeline.yaml").write_text(text, "utf-8")
    return folder / "pipeline.yaml"


def outcome(example: Example, folder: Path) -> tuple[float, float] | None:
    """Exact rms without and with the exported table, um, each run from its mean; None where nothing is exported."""
    for name, recording in (("recording", example.fitted), ("later", example.later)):
        recording_folder.write(folder / name, recording)
    code = _quietly(["run", str(_pipeline(example, folder)), "--out", str(folder / "out")])
    table = folder / "out" / "export" / "table.ect"
    if code in REFUSED and not table.exists():
        return None
    words = ["predict", str(table), str(folder / "later"), "--out", str(folder / "predicted.csv")]
    if code != 0 or _quietly(words) != 0:
        raise RuntimeError(f"{example.pipeline}: errpipe ended with {code}")
    frame = pd.read_csv(folder / "predicted.csv")
    names = ("E_X", "E_Y") if example.truth.ndim == 2 else (example.component,)
    none = np.zeros(len(frame))  # of a component that the gate left out
    predicted = np.stack([frame.get(f"{n}_predicted", none) for n in names], axis=-1).reshape(example.truth.shape)
    left = example.truth - predicted
    return _rms(example.truth, example.later), _rms(left, example.later)


def _quietly(words: list[str]) -> int:
    """Exit code of one command line; its standard output goes to the error stream, beside its talk."""
    with contextlib.redirect_stdout(sys.stderr):
        return errpipe(words)


def _rms(deviation: np.ndarray, recording: Recording) -> float:
    """Of deviations from each run's mean: the zero of a run is set by hand. Of plates also without their rotation."""
    run = recording.run_codes()
    if deviation.ndim == 2:
        return float(np.sqrt(np.mean([_unclamped(deviation[run == k], recording, run == k) for k in np.unique(run)])))
    rows = pd.Series(deviation).groupby(run)
    return float(np.sqrt(np.nanmean((deviation - rows.transform("mean").to_numpy()) ** 2)))


def _unclamped(deviation: np.ndarray, recording: Recording, plate: np.ndarray) -> float:
    """Mean square of a plate's deviations, um (rows, 2), without its least-squares shift and rotation."""
    x, y = (recording.array(n)[plate] for n in ("x", "y"))
    place = np.stack([-(y - y.mean()), x - x.mean()], axis=1)
    centred = deviation - deviation.mean(axis=0)
    return float(np.mean((centred - place * np.sum(centred * place) / np.sum(place**2)) ** 2))


def rows(first: int, seeds: int) -> Iterator[tuple[str, list[tuple[float, float] | None]]]:
    """Each example with its outcomes."""
    for draw in DRAWN:
        found = []
        for seed in range(first, first + seeds):
            with tempfile.TemporaryDirectory() as name:
                found.append(outcome(draw(seed), Path(name)))
        yield draw.__name__, found


def main() -> int:
    """Print the table; 1 where an exported table is worse than nothing."""
    parser = argparse.ArgumentParser(description="Examples of known truth: is what they export worse than nothing?")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=20)
    a = parser.parse_args()
    print("| example | exported | refused | worse | before -> after, um, median | least gain |")
    print("| --- | --- | --- | --- | --- | --- |")
    worse = 0
    for name, found in rows(a.first, a.seeds):
        known = [f for f in found if f is not None]
        harm = sum(after > before for before, after in known)
        worse += harm
        medians = " -> ".join(f"{np.median(column):.3g}" for column in zip(*known, strict=True)) if known else "-"
        smallest = f"{min(1 - after / before for before, after in known):.0%}" if known else "-"
        print(f"| {name} | {len(known)} | {len(found) - len(known)} | {harm} | {medians} | {smallest} |", flush=True)
    return int(worse > 0)


if __name__ == "__main__":
    sys.exit(main())
