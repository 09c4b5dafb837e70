"""How cost grows with points, nodes, sensors, components and rows: python -m bench.bench_growth.

Each quantity is varied alone; the exponent is the slope of a straight line through log(cost) over log(size). The
exponent for points is 1 at best; where it is below, a part of the cost does not grow.

    python -m bench.bench_growth --million 100       # rows of a run up to so many, and nothing else (5 GB of disk)
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from bench.figure import Figure, asked_rows, main, seconds
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.tables import ComponentSource, MonomialSource, OutputSource, batch, compile_table, pack

POINTS = (10_000, 100_000, 1_000_000, 10_000_000, 100_000_000)
ROWS = (10_000, 100_000, 1_000_000, 10_000_000)
NODES = (31, 301, 3_001, 30_001)
SIZES = (2, 4, 8, 16, 32)
CYCLES = 20_000
TRAVEL = 600.0


def table(sensors: int, curves: int) -> t.CompensationTable:
    """One axis with so many lagged sensors and so many curves."""
    inputs = [t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-10, high=TRAVEL + 10, default=0)]
    inputs += [
        t.TableInput(name=f"T{n}", kind="sensor", unit="degC", low=-20, high=120, default=20) for n in range(sensors)
    ]
    lags = [Lowered(d.Lag(of=d.above(f"T{n}", 20.0), tau_up=900.0 + n, tau_down=1500.0)) for n in range(sensors)]
    waves = [Lowered(d.ONE, "X", lambda x, k=k: np.sin((k + 1) * x / 200.0)) for k in range(curves)]
    parts = [ComponentSource(f"C{n}", "um", (wave,)) for n, wave in enumerate(waves)]
    parts.append(ComponentSource("EXX", "um", (Lowered(d.ONE, "X", lambda x: 0.01 * x), *lags)))
    whole = OutputSource("E_X", tuple(MonomialSource(1.0, part.name) for part in parts), "X")
    return compile_table(parts, inputs=inputs, outputs=[whole], travel={"X": (0.0, TRAVEL)}, error_bound=0.01)


def cycle_ns(made: t.CompensationTable) -> float:
    """One cycle in a Numba loop, ns."""
    from errpipe.kernels import table_cycle

    program = pack.program(made)
    state = pack.state(program)
    readings = np.tile(np.array([i.default for i in made.inputs]), (CYCLES, 1))
    readings[:, 0] = np.random.default_rng(0).uniform(0, TRAVEL, CYCLES)
    fresh, mode = np.ones(readings.shape, dtype=np.uint8), np.ones(CYCLES, dtype=np.uint8)
    out, status = np.empty((2, CYCLES, len(made.outputs))), np.empty(CYCLES, dtype=np.int64)

    def run() -> None:
        table_cycle.stream(program, state, readings, fresh, mode, out[0], out[1], status)

    run()
    return 1e9 * seconds(run)[0] / CYCLES


def positions_ns(made: t.CompensationTable, points: int) -> float:
    """All points in one call, ns."""
    evaluator = batch.Positions(made, ("x",))
    where, out = np.random.default_rng(0).uniform(0, TRAVEL, (1, points)), np.empty((len(made.outputs), points))
    evaluator.rows(where[:, :1000])
    return 1e9 * seconds(lambda: evaluator.rows(where, out), 3)[0]


def sampled(nodes: int) -> t.CompensationTable:
    """One axis whose curve has so many nodes."""
    whole = table(0, 1)
    values = tuple(int(v) for v in np.arange(nodes) % 1000)
    curve = whole.profiles[0].model_copy(update={"step": TRAVEL / (nodes - 1), "values": values})
    return whole.model_copy(update={"profiles": (curve, *whole.profiles[1:])})


def command_s(rows: int) -> float:
    """Processor time of `errpipe run` with ingest, clean, fit and validate of so many rows, s."""
    from bench import bench_history

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "raw"
        folder.mkdir()
        bench_history.write(folder, rows)
        return bench_history.stage(folder)[0]


def exponent(sizes: tuple[int, ...], costs: list[float]) -> float:
    """Slope of log(cost) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def figures() -> list[Figure]:
    """Exponents, and the cost at the largest size."""
    measured = {
        "points in one call": (POINTS, "ns", lambda n: positions_ns(table(0, 8), n)),
        "nodes of a curve, a million points": (NODES, "ns", lambda n: positions_ns(sampled(n), 1_000_000)),
        "lagged sensors of a cycle": (SIZES, "ns", lambda n: cycle_ns(table(n, 4))),
        "components of a cycle": (SIZES, "ns", lambda n: cycle_ns(table(2, n))),
        "rows of a run, ingest to validate": (ROWS, "s", command_s),
    }
    if (requested := asked_rows(0)) > ROWS[-1]:
        measured = {"rows of a run, ingest to validate": ((*ROWS, requested), "s", command_s)}
    out = []
    for what, (sizes, unit, cost) in measured.items():
        costs, span = [cost(size) for size in sizes], f"{sizes[0]} to {sizes[-1]}"
        out.append(Figure(f"exponent over {what}, {span}", exponent(sizes, costs), "1", aim=1.05))
        out += [Figure(f"{what}: {size}", value, unit) for size, value in zip(sizes, costs, strict=True)]
    return out


if __name__ == "__main__":
    sys.exit(main(figures))
