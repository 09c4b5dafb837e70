"""How many hours an optimal duty cycle saves against the customary one-speed-a-day plan, on a simulated spindle.

    python examples/next-duty-cycle/hours_saved.py --out out/next-duty-cycle

The machine that answers has time constants and an exponent that the model does not know. Prints the error on random
duty cycles after each day, and the day that is proposed first.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

from errpipe import jsonfile
from errpipe.fitting import experiment_design as design
from errpipe.kernels import responses
from errpipe.reporting import svg

DAYS = 8


def machine(plan: design.Plan, options: design.DesignOptions) -> np.ndarray:
    """Growth of a spindle with heat ~ speed^1.4 and three time constants, um."""
    t = np.arange(0.0, options.hours * 3600.0 + 1e-9, options.every)
    which = np.minimum((t / options.segment).astype(int), len(plan.speeds) - 1)
    speed = np.asarray(plan.speeds)[which]
    run = np.zeros(t.size, dtype=np.int64)

    def late(power: float, tau: float) -> np.ndarray:
        return responses.lag(run, t, speed**power, tau, tau, False)

    return 18 * late(1.4, 700.0) + 40 * late(1.4, 5200.0) - 6 * late(2.0, 100.0)


def days(
    choose: Callable[[list[design.Plan], int], design.Plan], options: design.DesignOptions, seed: int
) -> list[float]:
    """rms on random duty cycles after each day, um."""
    rng = np.random.default_rng(seed)
    done: list[design.Plan] = []
    readings: list[np.ndarray] = []
    judged = design.usage(options, 12, seed=7)
    out = []
    for day in range(DAYS):
        plan = choose(done, day)
        done.append(plan)
        clean = machine(plan, options)
        readings.append(clean + rng.normal(0, options.noise, clean.size))
        gains = design.fit(done, readings, options)
        left = np.concatenate([machine(p, options) - design.basis(p, options) @ gains for p in judged])
        out.append(float(np.sqrt(np.mean(left**2))))
    return out


def one_speed(level: float, options: design.DesignOptions) -> design.Plan:
    """The usual day: one speed for half of it, then cooling."""
    half = options.segments // 2
    return design.Plan((level,) * half + (0.0,) * (options.segments - half))


def main() -> None:
    """Print and draw the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/next-duty-cycle"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    usual = design.DesignOptions()
    custom = [one_speed(level, usual) for level in usual.levels if level > 0]
    plans = {
        "customary": (usual, lambda done, day: custom[day % len(custom)]),
        "I-optimal": (usual, lambda done, day: design.propose(done, usual)),
    }
    told = {}
    for name, (options, choose) in plans.items():
        runs = np.array([days(choose, options, seed) for seed in range(5)])
        told[name] = np.median(runs, axis=0).tolist()
        print(f"{name:12s}", {f"{8 * (k + 1)} h": round(v, 2) for k, v in enumerate(told[name])})
    for goal in (2.0, 1.0, 0.6):
        spent = {n: next((8 * (k + 1) for k, v in enumerate(c) if v <= goal), None) for n, c in told.items()}
        print(f"hours until {goal} um:", spent)
    first = design.propose([], usual).table(usual)
    print("first day proposed:", [f"{row['minutes']:.0f} min at {row['rpm']:.0f} rpm" for row in first])
    with svg.figure() as (canvas, axes):
        for (name, curve), shade in zip(told.items(), (svg.BEFORE, svg.AFTER), strict=True):
            axes.plot(8 * (np.arange(DAYS) + 1), curve, marker="o", color=shade, label=name)
        axes.set_xlabel("hours of measuring")
        axes.set_ylabel("rms on random duty cycles, um")
        axes.set_yscale("log")
        axes.legend()
        picture = svg.to_svg(canvas, "Error against hours of measuring")
    jsonfile.write(out / "hours_saved.json", {"hours_saved": 1, "rms": told, "first_day": first})
    jsonfile.write_text(out / "hours_saved.svg", picture)


if __name__ == "__main__":
    main()
