"""A volumetric table of 21 components, evaluated as `errpipe predict` does: against vectorised numpy.

    python bench/bench_kinematics.py

Prints ratios; the same points and answer on both sides (checked to the bound of the table's curves). Best
of several rounds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit" / "kinematics"))
from machines import ready

from bench.figure import Figure, main
from errpipe.kinematics.errors import MachineErrors
from errpipe.simulation.metrology import smooth_machine
from errpipe.stages.export_volumetric import compile_machine
from errpipe.tables import batch

POINTS = 400_000
BOUND = 0.001  # um, of each curve in the table


def with_numpy(errors: MachineErrors, q: np.ndarray, tip: np.ndarray, gather: bool, chunk: int = 8192) -> np.ndarray:
    """The same evaluation as a numpy user writes it, in chunks that stay in the cache.

    gather False: np.interp for each of the 18 curves. True: one index per axis and its six curves at once.
    """
    chain, out = errors.chain, np.empty((len(q), 3))
    square = {n: errors.constants[chain.index(n)] * 1e-3 for n in ("C0Y", "A0Z", "B0Z")}
    links = chain.machine.order()[::-1]
    for first in range(0, len(q), chunk):
        x, p = q[first : first + chunk], tip[first : first + chunk].copy()
        total = np.zeros_like(p)
        total[:, 0] = square["B0Z"] * x[:, 2] - square["C0Y"] * x[:, 1]
        total[:, 1] = -square["A0Z"] * x[:, 2]
        for name in links:
            a = chain.axes.index(name)
            table, start, step = errors.tables[a], errors.start[a], errors.step[a]
            if gather:
                s = np.clip((x[:, a] - start) / step, 0.0, len(table) - 1.0)
                j = np.minimum(s.astype(np.int64), len(table) - 2)
                curve = table[j] + (s - j)[:, None] * (table[j + 1] - table[j])
                curve = curve.T
            else:
                grid = start + step * np.arange(len(table))
                curve = [np.interp(x[:, a], grid, table[:, c]) for c in range(6)]
            arm = p - np.array(chain.machine.axes[name].reference)
            ea, eb, ec = (c * 1e-3 for c in curve[3:])
            total[:, 0] += curve[0] + eb * arm[:, 2] - ec * arm[:, 1]
            total[:, 1] += curve[1] + ec * arm[:, 0] - ea * arm[:, 2]
            total[:, 2] += curve[2] + ea * arm[:, 1] - eb * arm[:, 0]
            p[:, "XYZ".index(name)] += x[:, a]
        out[first : first + chunk] = total
    return out


def best(rounds: int, *works) -> list[float]:
    """Shortest of several rounds of each, taken in turn so that a busy machine hurts all alike, s."""
    times = [[] for _ in works]
    for _ in range(rounds):
        for work, seconds in zip(works, times, strict=True):
            start = perf_counter()
            work()
            seconds.append(perf_counter() - start)
    return [min(seconds) for seconds in times]


def measure() -> dict[str, float]:
    """ns per point of each way."""
    chain = ready("cmm")
    errors = MachineErrors.of(chain, smooth_machine(chain, 1), nodes=257)
    rng = np.random.default_rng(0)
    q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1], (POINTS, 3))
    tip = np.ascontiguousarray(np.broadcast_to(chain.tip(120.0), (POINTS, 3)))

    table = compile_machine(chain, errors, "", "", BOUND)
    ways = {
        "errpipe": lambda: batch.position(table, q, tuple(chain.axes), {"tool_length": 120.0}),
        "numpy, np.interp per curve": lambda: with_numpy(errors, q, tip, False),
        "numpy, six curves gathered at once": lambda: with_numpy(errors, q, tip, True),
    }
    ours = ways["errpipe"]()
    for name, way in ways.items():
        gap = np.abs(ours - way()).max()
        if gap > 6 * BOUND:  # shifts and angles times their arms add up
            raise SystemExit(f"{name} differs by {gap} um")
    return dict(zip(ways, (t / POINTS * 1e9 for t in best(9, *ways.values())), strict=True))


def figures() -> list[Figure]:
    """The table, with its validity and limits, beside numpy's plain sum."""
    times, lacks = measure(), "validity, drivers, other chains"
    ours = times.pop("errpipe")
    return [
        Figure("volumetric deviation", ours, "ns/point", peer=name, times=ns / ours, lacks=lacks)
        for name, ns in times.items()
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
