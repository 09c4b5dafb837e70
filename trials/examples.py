"""Is what the examples export ever worse than nothing? Their machines, drawn by seed, judged on the exact deviation.

python -m trials.examples [--first 1] [--seeds 20]

Each example of a known truth is simulated with sizes drawn by the seed, run through its own pipeline, and its exported
table predicts another session of the same machine, whose deviation without noise is known. Ends with 1 where a table is
worse than no compensation.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from errpipe.cli.app import main as errpipe
from errpipe.domain.recording import Recording
from errpipe.formats import manifest_folder
from errpipe.simulation import ball_screw_axis, spindle_drift

TEMPLATES = Path(ball_screw_axis.__file__).parents[1] / "stages" / "templates"
OTHER_SESSION = 100_000  # added to the seed of a session
REFUSED = (3, 4)  # exit codes: parameters that cannot be told apart; a gate said no


@dataclass(frozen=True)
class Example:
    """Two sessions of one machine; truth: the exact deviation of the second, um (rows,), NaN where none is known."""

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


def outcome(example: Example, folder: Path) -> tuple[float, float] | None:
    """Exact rms without and with the exported table, um, each run from its mean; None where nothing is exported."""
    for name, recording in (("recording", example.fitted), ("later", example.later)):
        manifest_folder.write(recording, folder / name)
    text = (TEMPLATES / example.pipeline).read_text("utf-8")
    head, stages = text[: text.index("stages:")], text[text.index("  - kind: ingest") :]
    stages = stages.replace("- kind: ingest", "- kind: ingest\n    recording: recording", 1)
    pipeline = head.replace("root: ..\n", "") + "stages:\n" + stages.replace("  - kind: report\n", "")
    (folder / "pipeline.yaml").write_text(pipeline, "utf-8")
    code = _quietly(["run", str(folder / "pipeline.yaml"), "--out", str(folder / "out")])
    table = folder / "out" / "export" / "table.ect"
    if code in REFUSED and not table.exists():
        return None
    words = ["predict", str(table), str(folder / "later"), "--out", str(folder / "predicted.csv")]
    if code != 0 or _quietly(words) != 0:
        raise RuntimeError(f"{example.pipeline}: errpipe ended with {code}")
    frame = pd.read_csv(folder / "predicted.csv")
    (column,) = [c for c in frame.columns if c.endswith("_predicted")]
    run = example.later.run_codes()
    before = _rms(example.truth, run)
    return before, _rms(example.truth - frame[column].to_numpy(), run)


def _quietly(words: list[str]) -> int:
    """Exit code of one command line; its standard output goes to the error stream, beside its talk."""
    with contextlib.redirect_stdout(sys.stderr):
        return errpipe(words)


def _rms(deviation: np.ndarray, run: np.ndarray) -> float:
    """Of deviations from each run's mean: the zero of a run is set by hand."""
    rows = pd.Series(deviation).groupby(run)
    return float(np.sqrt(np.nanmean((deviation - rows.transform("mean").to_numpy()) ** 2)))


def rows(first: int, seeds: int) -> Iterator[tuple[str, list[tuple[float, float] | None]]]:
    """Each example with its outcomes."""
    for draw in (ball_screw, spindle):
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
        least = f"{min(1 - after / before for before, after in known):.0%}" if known else "-"
        print(f"| {name} | {len(known)} | {len(found) - len(known)} | {harm} | {medians} | {least} |", flush=True)
    return int(worse > 0)


if __name__ == "__main__":
    sys.exit(main())
