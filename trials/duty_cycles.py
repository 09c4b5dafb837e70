"""Are duty cycles that `errpipe plan-day` chooses worth more than as many in random order, and does it stop in time?

python -m trials.duty_cycles --seed 8 [--machines 12]
python -m trials.duty_cycles --seed 8 --from RECORDING --component E_D [--splits 12]

Every run's temperatures are known, as from a log; deviations are shown run by run, in the order of the plan or in a
random one. After each run the model predicts runs of which no deviation is ever shown: of a recording a random third,
of a simulated machine the third season.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from errpipe.domain.recording import Recording
from errpipe.fitting.noise_floor import noise_floor
from errpipe.formats import manifest_folder
from errpipe.thermal.duty_cycles import DutyCycles

from . import folder
from .thermal.seasons import recordings

ORDERS = 6  # random orders that are averaged
RUNS = 6  # chosen one after the other, whose rms is printed


@dataclass(frozen=True)
class Outcome:
    """rms of the judged runs after each run, um, by the plan and in random order; at the plan's stop; after all."""

    name: str
    nothing: float
    plan: np.ndarray
    chance: np.ndarray
    stopped_after: int
    at_stop: float
    after_all: float


def after_each(cycles: DutyCycles, judged: Sequence[int], choose: Callable[[list[int]], int], runs: int) -> np.ndarray:
    """rms over the judged runs after each chosen one, (runs,), um; each judged run counts once."""
    done: list[int] = []
    out = []
    for _ in range(runs):
        done.append(choose(done))
        mean = cycles.fit(done).mean
        out.append(np.sqrt(np.mean([cycles.left(r, mean) ** 2 for r in judged])))
    return np.array(out)


def trial(recording: Recording, component: str, pool: Sequence[str], seed: int, name: str) -> Outcome:
    """pool: labels of the runs that may be measured; the others judge."""
    cycles = DutyCycles.of(recording, component)
    rows = np.flatnonzero(np.isfinite(cycles.deviation))
    threshold = noise_floor(recording, rows, cycles.deviation[rows]) or 1.0
    labels = recording.run_labels()
    free = [r for r in cycles.measured if labels[r] in pool]
    judged = [r for r in cycles.measured if labels[r] not in pool]
    stops: list[int] = []

    def best(done: list[int]) -> int:
        known = cycles.fit(done)
        after = {r: cycles.expected(known, [r]) for r in free if r not in done}
        run = min(after, key=lambda r: after[r])
        if cycles.expected(known) ** 2 - after[run] ** 2 <= threshold**2:
            stops.append(len(done))
        return run

    plan = after_each(cycles, judged, best, len(free))
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(free).tolist() for _ in range(ORDERS)]
    chance = [after_each(cycles, judged, lambda done, o=order: o[len(done)], min(RUNS, len(free))) for order in orders]
    stop = max(stops[0], 1) if stops else len(free)
    none = np.zeros(cycles.states.shape[1])
    nothing = float(np.sqrt(np.mean([cycles.left(r, none) ** 2 for r in judged])))
    mean = np.sqrt(np.mean(np.square(chance), axis=0))
    return Outcome(name, nothing, plan[:RUNS], mean, stop, float(plan[stop - 1]), float(plan[-1]))


def of_recording(path: Path, component: str, splits: int, seed: int) -> Iterator[Outcome]:
    """Random thirds of the runs of a recording sit out."""
    recording = manifest_folder.read(path)
    labels = recording.run_labels()
    for number in range(splits):
        order = np.random.default_rng([seed, number]).permutation(labels).tolist()
        yield trial(recording, component, order[len(order) // 3 :], seed + number, f"split {number}")


def of_machines(machines: int, seed: int) -> Iterator[Outcome]:
    """The third season of simulated machines sits out."""
    for number in range(machines):
        fit, judged = recordings(seed, number)
        fit.table = pd.concat([fit.table, judged.table], ignore_index=True)
        with tempfile.TemporaryDirectory() as temporary:
            folder.write(Path(temporary), fit)
            recording = manifest_folder.read(Path(temporary))
        pool = [label for label in recording.run_labels() if label not in set(judged.runs())]
        yield trial(recording, "E_Z", pool, seed + number, fit.machine)


def geometric(values: np.ndarray) -> np.ndarray:
    return np.exp(np.mean(np.log(values), axis=0))


def printed(values: np.ndarray) -> str:
    return ", ".join(f"{v:.2f}" for v in np.atleast_1d(values))


def main() -> None:
    """Play all, print each and the geometric means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=8)
    parser.add_argument("--machines", type=int, default=12)
    parser.add_argument("--splits", type=int, default=12)
    parser.add_argument("--from", dest="source", type=Path)
    parser.add_argument("--component", default="E_D")
    a = parser.parse_args()
    outcomes = []
    for o in of_recording(a.source, a.component, a.splits, a.seed) if a.source else of_machines(a.machines, a.seed):
        outcomes.append(o)
        print(f"{o.name}: nothing {o.nothing:.2f}, plan {printed(o.plan)}, random {printed(o.chance)}, ", end="")
        print(f"stops after {o.stopped_after} at {o.at_stop:.2f}, all {o.after_all:.2f} um", flush=True)
    count = min(len(o.plan) for o in outcomes)
    plan, chance = (np.array([getattr(o, which)[:count] for o in outcomes]) for which in ("plan", "chance"))
    print(f"um left of runs not measured, geometric mean after 1 to {count} runs; nothing", end=" ")
    print(printed(geometric(np.array([o.nothing for o in outcomes]))))
    print(f"by the plan   {printed(geometric(plan))}")
    print(f"random order  {printed(geometric(chance))}")
    print(f"plan better on {printed(np.mean(plan < chance, axis=0))} of {len(outcomes)}")
    stop = np.array([[o.stopped_after, o.at_stop / o.after_all] for o in outcomes])
    print(f"stops after {np.mean(stop[:, 0]):.1f} runs, with {geometric(stop[:, 1]):.2f} of what all of them leave")


if __name__ == "__main__":
    main()
