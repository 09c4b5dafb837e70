"""What a failed sensor costs a thermal compensation, with and without the guard: each sensor in turn, in five ways.

    python examples/sensor-failure/failures.py RECORDING_FOLDER [season] [run]

    ... season --drift -1 --step 3 --start 0.2      # K/h, K and the share of a run: other failures than the usual ones
    ... --family auto --judge OTHER_FOLDER          # whichever family wins; learnt from one folder, judged on the other

Model and guard are learnt without the rows they are judged on: `season` leaves out a season whole, `run` one run at a
time; `python -m trials.thermal --keep DIR` leaves pairs of folders, `fit` and `judge`. Needs a thermal recording with a
group column `of: season`. Each sensor fails at 40 % of every run where not told else; rms over the rows from there on.
All of it takes minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import sensor_failures
import sensor_watch

from errpipe.domain.recording import Recording
from errpipe.fitting import holdout
from errpipe.formats import manifest_folder
from errpipe.guard import learn
from errpipe.models import FAMILIES
from errpipe.thermal import arithmetic

SCHEMES = ("season", "run")


def folds(recording: Recording, scheme: str) -> Iterator[tuple[Recording, Recording]]:
    """What is learnt from, and what is judged."""
    if scheme == "season":
        for fold in holdout.groups(recording, "leave-one-group-out:season"):
            yield recording.take(fold.train), recording.take(fold.test)
        return
    run = recording.run_codes()
    yield from ((recording.take(run != code), recording.take(run == code)) for code in np.unique(run))


def _with(rows: Recording, names: tuple[str, ...], readings: np.ndarray) -> Recording:
    return Recording(rows.manifest, rows.frame.assign(**dict(zip(names, readings.T, strict=True))))


def judge(
    pairs: Iterable[tuple[Recording, Recording]], family: str, component: str, how: dict[str, float]
) -> tuple[dict, dict]:
    """Sums over the runs of each season: healthy squares, and per sensor and way what failing it makes of them.

    pairs: what is learnt from, and what is judged; how: drift, step and start of `sensor_failures.fail`.

    Result: season -> [runs, runs with an alarm, squares, rows, squares guarded]; (season, sensor, way) -> [detected,
    rows to detection, runs in which another sensor was blamed, squares unguarded, squares guarded].
    """
    healthy: dict = {}
    failed: dict = {}
    for learnt_from, rows in pairs:
        model = FAMILIES[family](component=component).train(learnt_from)
        guard = learn.learn(learnt_from)
        truth = arithmetic.since_start_of(rows, component)
        run = rows.run_codes()
        season = rows.frame["season"].to_numpy()
        labels = {code: season[run == code][0] for code in np.unique(run)}
        late = sensor_failures.rows_after(rows, how["start"])
        healthily = sensor_watch.watch(guard, rows)
        alarms = healthily.fault
        left = truth - model.values(rows)
        names = guard.names()
        held = truth - model.values(_with(rows, names, healthily.reading))
        for code, label in labels.items():
            mine = late & (run == code) & np.isfinite(left)
            total = healthy.setdefault(label, [0, 0, 0.0, 0, 0.0])
            total[0] += 1
            total[1] += bool(alarms[run == code].any())
            total[2] += float(np.sum(left[mine] ** 2))
            total[3] += int(np.count_nonzero(mine))
            total[4] += float(np.nansum(held[late & (run == code)] ** 2))
        for i, name in enumerate(names):
            for way in sensor_failures.WAYS:
                guilty = [i, (i + 1) % len(names)] if way == "swap" else [i]
                spoilt = sensor_failures.fail(rows, name, way, beside=names[guilty[-1]], **how)
                seen = sensor_watch.watch(guard, spoilt)
                bare = truth - model.values(spoilt)
                guarded = truth - model.values(_with(rows, names, seen.reading))
                for code, label in labels.items():
                    mine = late & (run == code)
                    told = np.flatnonzero(seen.fault[mine][:, guilty].any(axis=1))
                    total = failed.setdefault((label, name, way), [0, [], 0, 0.0, 0.0])
                    total[0] += bool(told.size)
                    total[1] += [int(told[0])] if told.size else []
                    total[2] += bool(np.delete(seen.fault[mine], guilty, axis=1).any())
                    total[3] += float(np.nansum(bare[mine] ** 2))
                    total[4] += float(np.nansum(guarded[mine] ** 2))
    return healthy, failed


def show(healthy: dict, failed: dict, how: str) -> None:
    """The table: detected runs @ median rows to detection, ratio to healthy unguarded > guarded."""
    for label, (runs, alarmed, squares, rows, held) in healthy.items():
        base = float(np.sqrt(squares / rows))
        beside = float(np.sqrt(held / rows))
        print(
            f"-- {how}: {label}: healthy {base:.2f} um, guarded {beside:.2f}; false alarms in {alarmed} of {runs} runs"
        )
        worst = 0.0
        for name in dict.fromkeys(n for _, n, _ in failed):
            cells = []
            for way in sensor_failures.WAYS:
                value, wait, wrong, bare, guarded = failed[label, name, way]
                ratios = [float(np.sqrt(s / rows)) / base for s in (bare, guarded)]
                worst = max(worst, ratios[1])
                middle = f"@{np.median(wait):.0f}" if wait else ""
                blamed = f" ({wrong} wrong)" if wrong else ""
                cells.append(f"{way} {value}/{runs}{middle}{blamed} {ratios[0]:.2f} > {ratios[1]:.2f}")
            print(f"{name:18s} " + " | ".join(cells))
        print(f"worst guarded ratio: {worst:.2f}")


def main() -> None:
    """Print the tables of the schemes asked for, or of both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("schemes", nargs="*", choices=[*SCHEMES, []], default=[])
    parser.add_argument("--component", default="E_D")
    parser.add_argument("--family", default="season")
    parser.add_argument("--judge", type=Path, help="another recording, of the same sensors, that is judged")
    parser.add_argument("--drift", type=float, default=sensor_failures.DRIFT, help="K/h")
    parser.add_argument("--step", type=float, default=sensor_failures.STEP, help="K")
    parser.add_argument("--start", type=float, default=sensor_failures.START, help="share of a run, 0..1")
    told = parser.parse_args()
    recording = manifest_folder.read(told.folder)
    how = {"drift": told.drift, "step": told.step, "start": told.start}
    if told.judge is not None:
        pairs = [(recording, manifest_folder.read(told.judge))]
        show(*judge(pairs, told.family, told.component, how), "learnt elsewhere")
        return
    for scheme in told.schemes or SCHEMES:
        show(*judge(folds(recording, scheme), told.family, told.component, how), f"{scheme} left out")


if __name__ == "__main__":
    main()
