"""Volumetric evaluation with 21 components: against vectorised numpy and against the memory floor.

    python bench/bench_kinematics.py

Prints ratios; the same points, curves and answer on both sides (checked to 1e-9 um). Best of several rounds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from numba import njit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit" / "kinematics"))
from machines import ready

from bench.figure import Figure, main
from errpipe.kinematics.errors import MachineErrors, ThreeAxisVolume
from errpipe.simulation.metrology import smooth_machine

POINTS = 400_000


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
        for work, entry in zip(works, times, strict=True):
            start = perf_counter()
            work()
            entry.append(perf_counter() - start)
    return [min(entry) for entry in times]


@njit
def touch(q, tip, out):
    """The memory floor of `linear_axes`: the same bytes read and written, hardly any arithmetic."""
    for i in range(q.shape[0]):
        out[i, 0] = q[i, 0] + tip[i, 0]
        out[i, 1] = q[i, 1] + tip[i, 1]
        out[i, 2] = q[i, 2] + tip[i, 2]


def measure() -> dict[str, float]:
    """ns per point of each way."""
    chain = ready("cmm")
    errors = MachineErrors.of(chain, smooth_machine(chain, 1), nodes=257)
    volume = ThreeAxisVolume.of(errors)
    rng = np.random.default_rng(0)
    q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1], (POINTS, 3))
    tip = np.ascontiguousarray(np.broadcast_to(chain.tip(120.0), (POINTS, 3)))
    for gather in (False, True):
        gap = np.abs(volume(q, tip) - with_numpy(errors, q, tip, gather)).max()
        if gap > 1e-9:
            raise SystemExit(f"the two differ by {gap} um")
    out = np.empty((POINTS, 3))
    touch(q, tip, out)
    times = best(
        9,
        lambda: volume(q, tip, out),
        lambda: touch(q, tip, out),
        lambda: with_numpy(errors, q, tip, False),
        lambda: with_numpy(errors, q, tip, True),
    )
    names = ("errpipe", "memory floor", "numpy, np.interp per curve", "numpy, six curves gathered at once")
    return dict(zip(names, (t / POINTS * 1e9 for t in times), strict=True))


def figures() -> list[Figure]:
    """The chain's deviation beside numpy; the memory floor reads and writes the same arrays."""
    measured = measure()
    ours = measured.pop("errpipe")
    lacks = {"memory floor": "any arithmetic"}
    return [
        Figure(
            "volumetric deviation", ours, "ns/point", peer=name, times=ns / ours, lacks=lacks.get(name, "other chains")
        )
        for name, ns in measured.items()
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
