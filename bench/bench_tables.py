"""How fast tables are: python -m bench.bench_tables. Every figure is a ratio of two runs side by side."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from bench.figure import Figure, main, seconds, spread
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.tables import ComponentSource, MonomialSource, OutputSource, batch, compile_table

HERE = Path(__file__).parent
AXES = ("X", "Y", "Z")
TRAVEL = 600.0


def _curve(seed: int):
    rng = np.random.default_rng(seed)
    gains, phases = rng.normal(0, 3, 4), rng.uniform(0, 6.28, 4)
    pairs = list(zip(gains, phases, strict=True))
    return lambda x: sum(g * np.sin((k + 1) * np.pi * x / TRAVEL + p) for k, (g, p) in enumerate(pairs))


def machine(thermal: bool = False) -> t.CompensationTable:
    """21 components of three axes, synthesised to the tool point; with `thermal`, eight lagged sensors besides."""
    inputs = [
        t.TableInput(name=a.lower(), kind="position", axis=a, unit="mm", low=-10, high=TRAVEL + 10, default=0)
        for a in AXES
    ]
    components, terms = [], {a: [] for a in AXES}
    for n, axis in enumerate(AXES):
        for m, letter in enumerate("XYZABC"):
            name = f"E{letter}{axis}"
            curve = Lowered(d.ONE, axis, _curve(10 * n + m))
            components.append(ComponentSource(name, "um" if m < 3 else "urad", (curve,)))
            if m < 3:
                terms[letter].append(MonomialSource(1.0, name))
            else:
                _lever(terms, name, letter)
    for name, letter in (("C0Y", "C"), ("A0Z", "A"), ("B0Z", "B")):
        components.append(ComponentSource(name, "urad", (Lowered(d.Constant(value=12.0)),)))
        _lever(terms, name, letter)
    if thermal:
        for n in range(8):
            name = f"T{n}"
            inputs.append(
                t.TableInput(
                    name=name,
                    kind="sensor",
                    unit="degC",
                    low=-20,
                    high=120,
                    default=20,
                    max_rate=5.0,
                    valid=(10, 50),
                    margin=5,
                )
            )
            lagged = d.Lag(of=d.above(name, 20.0), tau_up=900.0 + 100 * n, tau_down=1500.0)
            slope = Lowered(lagged, AXES[n % 3], lambda x: 0.011 * x)
            old = components[7 * (n % 3)]
            components[7 * (n % 3)] = ComponentSource(old.name, old.unit, (*old.pairs, slope))
    outputs = [OutputSource(f"E_{a}", tuple(terms[a]), a) for a in AXES]
    return compile_table(
        components, inputs=inputs, outputs=outputs, travel=dict.fromkeys(AXES, (0.0, TRAVEL)), error_bound=0.01
    )


def _lever(terms: dict, name: str, letter: str) -> None:
    """An angle times its two arms, urad * mm = nm."""
    for out, arm, sign in {
        "A": (("Y", "z", -1), ("Z", "y", 1)),
        "B": (("X", "z", 1), ("Z", "x", -1)),
        "C": (("X", "y", -1), ("Y", "x", 1)),
    }[letter]:
        terms[out].append(MonomialSource(sign * 1e-3, name, (d.Input(name=arm),)))


def side_by_side(ours, theirs, repeats: int = 9, clock=thread_time) -> tuple[list[float], float]:
    """Times of ours, shortest first, and the shortest of theirs, taken in turns: a busy machine disturbs both, s."""
    pairs = [(seconds(ours, 1, clock)[0], seconds(theirs, 1, clock)[0]) for _ in range(repeats)]
    return sorted(p[0] for p in pairs), min(p[1] for p in pairs)


def bench_lattice(points: int = 300_000) -> dict[str, float]:
    """Volumetric deviation at scattered points: 21 curves in a table against a lattice of 3-vectors in scipy."""
    from scipy.interpolate import RegularGridInterpolator

    table = machine()
    evaluator = batch.Positions(table, ("x", "y", "z"))
    nodes = np.linspace(0, TRAVEL, 31)
    mesh = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), -1).reshape(-1, 3)
    lattice = RegularGridInterpolator((nodes,) * 3, evaluator(mesh).reshape(31, 31, 31, 3))
    where = np.random.default_rng(0).uniform(0, TRAVEL, (points, 3))
    columns = np.ascontiguousarray(where.T)
    evaluator.rows(columns)
    out = np.empty((3, points))
    times, theirs = side_by_side(lambda: evaluator.rows(columns, out), lambda: lattice(where))
    ours = times[0]
    return {
        "spread": spread(times),
        "table_ns_per_point": 1e9 * ours / points,
        "regular_grid_interpolator_ns": 1e9 * theirs / points,
        "times_faster": theirs / ours,
    }


def bench_curve(points: int = 1_000_000) -> dict[str, float]:
    """One curve at scattered points against numpy.interp on the same nodes."""
    source = ComponentSource("EXX", "um", (Lowered(d.ONE, "X", _curve(1)),))
    x = t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-10, high=TRAVEL + 10, default=0)
    table = compile_table([source], inputs=[x], travel={"X": (0.0, TRAVEL)})
    evaluator = batch.Positions(table, ("x",))
    where = np.random.default_rng(0).uniform(0, TRAVEL, (1, points))
    p = table.profiles[0]
    nodes, values = p.start + p.step * np.arange(len(p.values)), np.array(p.values) * p.scale
    evaluator.rows(where)
    (ours, *_), theirs = side_by_side(lambda: evaluator.rows(where), lambda: np.interp(where[0], nodes, values))
    return {
        "table_ns_per_point": 1e9 * ours / points,
        "numpy_interp_ns": 1e9 * theirs / points,
        "times_faster": theirs / ours,
    }


def bench_cycle(cycles: int = 200_000) -> dict[str, float]:
    """One controller cycle of 21 components and 8 lagged sensors in a Numba loop."""
    from errpipe.kernels import table_cycle
    from errpipe.tables import pack

    table = machine(thermal=True)
    program = pack.program(table)
    state = pack.state(program)
    rng = np.random.default_rng(0)
    readings = np.tile(np.array([i.default for i in table.inputs]), (cycles, 1))
    readings[:, :3] = rng.uniform(0, TRAVEL, (cycles, 3))
    fresh = np.ones(readings.shape, dtype=np.uint8)
    enable = np.ones(cycles, dtype=np.uint8)
    deviation, correction = np.empty((cycles, 3)), np.empty((cycles, 3))
    status = np.empty(cycles, dtype=np.int64)

    def run():
        table_cycle.stream(program, state, readings, fresh, enable, deviation, correction, status)

    run()
    times = seconds(run)
    return {"cycle_ns": 1e9 * times[0] / cycles, "spread": spread(times)}


def _compiled(source: Path, *more: str | Path) -> ctypes.CDLL | None:
    """A shared library made by the C compiler at -O3, or None where there is no compiler."""
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    folder = Path(tempfile.mkdtemp())
    flags = ["-std=c99", "-O3", "-march=native", "-ffp-contract=off", "-w", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, source, *more, "-o", folder / "bench.so"], check=True)
    return ctypes.CDLL(str(folder / "bench.so"))


def _address(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


CURVE = np.dtype(
    [
        ("start", "f8"),
        ("inverse_step", "f8"),
        ("scale", "f8"),
        ("factor", "f8"),
        ("knots", "u8"),
        ("axis", "i4"),
        ("last", "i4"),
        ("component", "i4"),
        ("same_grid", "i4"),
    ]
)
TERM = np.dtype([("weight", "f8"), ("output", "i4"), ("component", "i4"), ("axis", "i4"), ("_", "i4")])


def _knots(table: t.CompensationTable) -> tuple[np.ndarray, np.ndarray]:
    """Value and rise to the next value, alternating, of all profiles one after another, and where each begins."""
    parts = []
    for p in table.profiles:
        values = np.array(p.values, dtype=float)
        parts.append(np.stack([values, np.append(np.diff(values), 0.0)], axis=1).ravel())
    return np.concatenate(parts), np.cumsum([0, *(part.size for part in parts)])


def bench_c(points: int = 300_000) -> dict[str, float]:
    """The same 21 curves at scattered points in C at -O3, the faster of point by point and by blocks."""
    library = _compiled(HERE / "lattice.c")
    if library is None:
        return {}
    table = machine()
    evaluator = batch.Positions(table, ("x", "y", "z"))
    program, (knots, firsts) = evaluator.program, _knots(table)
    moving = [k for k in range(program.pairs.size) if program.profiles[program.pairs[k]["profile"]]["input"] >= 0]
    moving.sort(key=lambda k: program.pairs[k]["profile"])
    curves, fixed = np.zeros(len(moving), dtype=CURVE), np.zeros(len(table.components))
    for row, k in zip(curves, moving, strict=True):
        pair = program.pairs[k]
        own = program.profiles[pair["profile"]]
        place = knots.ctypes.data + 8 * int(firsts[pair["profile"]])
        factor = evaluator._node_fixed[pair["node"]]
        same = program.same_grid[pair["profile"]]
        row_values = (
            own["start"],
            own["inverse_step"],
            own["scale"],
            factor,
            place,
            own["input"],
            own["count"] - 1,
            pair["component"],
            same,
        )
        for name, value in zip(CURVE.names, row_values, strict=True):
            row[name] = value
    for pair in program.pairs:
        if program.profiles[pair["profile"]]["input"] < 0:
            fixed[pair["component"]] += evaluator._profile_fixed[pair["profile"]] * evaluator._node_fixed[pair["node"]]
    arms = {n: table.input_index(node.input) for n, node in enumerate(table.nodes) if node.op == "input"}
    numbers = {c.name: n for n, c in enumerate(table.components)}
    rows = [
        (m.weight, o, numbers[m.component], arms[m.factors[0]] if m.factors else -1, 0)
        for o, output in enumerate(table.outputs)
        for m in output.terms
    ]
    terms = np.array(rows, dtype=TERM)
    columns = np.ascontiguousarray(np.random.default_rng(0).uniform(0, TRAVEL, (points, 3)).T)
    out = np.empty((3, points))

    def run(function):
        function(
            _address(curves),
            len(curves),
            _address(terms),
            len(terms),
            _address(fixed),
            len(fixed),
            _address(columns),
            ctypes.c_long(points),
            _address(out),
        )

    ours = evaluator.rows(columns)
    for function in (library.by_point, library.by_block):
        run(function)
        assert np.abs(out - ours).max() < 1e-9
    mine = np.empty((3, points))
    (numba, *_), point = side_by_side(lambda: evaluator.rows(columns, mine), lambda: run(library.by_point))
    (again, *_), block = side_by_side(lambda: evaluator.rows(columns, mine), lambda: run(library.by_block))
    c = min(point, block)
    return {
        "numba_ns_per_point": 1e9 * min(numba, again) / points,
        "c_by_point_ns": 1e9 * point / points,
        "c_by_block_ns": 1e9 * block / points,
        "numba_times_c": min(numba, again) / c,
    }


def bench_c_cycle(cycles: int = 200_000) -> dict[str, float]:
    """One controller cycle of 21 components and 8 lagged sensors in the C runtime."""
    from errpipe import tables
    from errpipe.tables import ect

    runtime = Path(tables.__file__).parent / "runtime"
    library = _compiled(
        runtime / "ect.c", HERE.parent / "tests" / "unit" / "targets" / "c" / "driver.c", f"-I{runtime}"
    )
    if library is None:
        return {}
    table = machine(thermal=True)
    data = ect.dumps(table)
    readings = np.tile(np.array([i.default for i in table.inputs]), (cycles, 1))
    readings[:, :3] = np.random.default_rng(0).uniform(0, TRAVEL, (cycles, 3))
    out, status = np.empty((2, cycles, 3)), np.empty(cycles, dtype=np.uint32)

    def run():
        library.stream(
            data,
            ctypes.c_size_t(len(data)),
            ctypes.c_size_t(cycles),
            _address(readings),
            None,
            None,
            _address(out[0]),
            _address(out[1]),
            _address(status),
        )

    run()
    times = seconds(run)
    return {"cycle_ns": 1e9 * times[0] / cycles, "spread": spread(times)}


def bench_st(cycles: int = 20_000) -> float | None:
    """One controller cycle of the same table in the exported Structured Text, translated to C, ns; None without gcc."""
    if shutil.which("gcc") is None:
        return None
    from tests.unit.targets.st import test_iec_st, translate

    table = machine(thermal=True)
    readings = np.tile(np.array([i.default for i in table.inputs]), (cycles, 1))
    readings[:, :3] = np.random.default_rng(0).uniform(0, TRAVEL, (cycles, 3))
    fresh, mode = np.ones(readings.shape, dtype=np.uint8), np.ones(cycles, dtype=np.uint8)
    with tempfile.TemporaryDirectory() as name:
        block = test_iec_st.Block(Path(name), translate.by_lines(test_iec_st.units()), optimise="-O0")
        return 1e9 * seconds(lambda: block.stream(table, readings, fresh, mode), 3)[0] / cycles


NOT_A_TABLE = "fades, limits, sensors, a stated error; its memory grows with the cube of the grid"


def threaded(points: int) -> tuple[Any, np.ndarray, list[np.ndarray], np.ndarray, list[np.ndarray]]:
    """An evaluator, points and their halves, and where the results go: fresh memory would be timed, not the work."""
    evaluator = batch.Positions(machine(), ("x", "y", "z"))
    where = np.random.default_rng(0).uniform(0, TRAVEL, (3, points))
    halves = [np.ascontiguousarray(where[:, : points // 2]), np.ascontiguousarray(where[:, points // 2 :])]
    out = np.empty((len(evaluator.table.outputs), points))
    evaluator.rows(where, out)
    return evaluator, where, halves, out, [np.empty((len(out), half.shape[1])) for half in halves]


def neighbour(points: int) -> None:
    """Another process at the same work, for ever."""
    evaluator, _, halves, _, parts = threaded(points)
    while True:
        evaluator.rows(halves[1], parts[1])


def bench_threads(points: int = 1_000_000, rounds: int = 25) -> dict[str, float]:
    """The same points in one part and in two parts on two threads, by the wall clock; medians of pairs in turns.

    Beside it what two cores give at all: the half of one thread alone, and while another process does the other half.
    """
    evaluator, where, halves, out, parts = threaded(points)
    one, half = (lambda: evaluator.rows(where, out)), (lambda: evaluator.rows(halves[0], parts[0]))
    other = multiprocessing.get_context("spawn").Process(target=neighbour, args=(points,), daemon=True)
    other.start()
    time.sleep(5.0)  # until it is at work
    pairs = []
    with ThreadPoolExecutor(2) as pool:
        two = lambda: list(pool.map(evaluator.rows, halves, parts))  # noqa: E731
        for _ in range(rounds):
            os.kill(other.pid, signal.SIGSTOP)
            apart = [seconds(work, 1, perf_counter)[0] for work in (one, two, half)]
            os.kill(other.pid, signal.SIGCONT)
            half()  # until the other one is at work again
            pairs.append([*apart, seconds(half, 1, perf_counter)[0]])
    other.kill()
    one_s, two_s, alone, beside = np.array(pairs).T
    return {"times_faster": float(np.median(one_s / two_s)), "ceiling": float(np.median(2.0 * alone / beside))}


def figures() -> list[Figure]:
    """Every figure of this bench."""
    lattice, curve, threads, cycle = bench_lattice(), bench_curve(), bench_threads(), bench_cycle()
    st: dict[str, Any] = {}
    if (text := bench_st()) is not None:
        st = {"peer": "the exported Structured Text as C at -O0, as a PLC runs it", "times": text / cycle["cycle_ns"]}
        st["lacks"] = "a runtime: it is the same arithmetic, not optimised"
    out = [
        Figure(
            "21 curves at scattered points, one core",
            lattice["table_ns_per_point"],
            "ns/point",
            lattice["spread"],
            20.0,
            peer="scipy RegularGridInterpolator, 31 x 31 x 31",
            times=lattice["times_faster"],
            lacks=NOT_A_TABLE,
        ),
        Figure(
            "one curve at scattered points",
            curve["table_ns_per_point"],
            "ns/point",
            peer="numpy.interp",
            times=curve["times_faster"],
            lacks="fades, limits; searches its grid",
        ),
        Figure("two threads over one", threads["times_faster"], "x", aim=1.8, at_least=True),
        Figure("two processes at once, over one after the other", threads["ceiling"], "x"),
        Figure("cycle of 21 components and 8 drivers, Numba", cycle["cycle_ns"], "ns", cycle["spread"], 400.0, **st),
    ]
    if c := bench_c():
        beside = {"peer": "C at -O3, the faster of two layouts", "lacks": "everything but these curves"}
        out.append(
            Figure("the same points", c["numba_ns_per_point"], "ns/point", times=1 / c["numba_times_c"], **beside)
        )
    if c := bench_c_cycle():
        out.append(Figure("the same cycle, C runtime", c["cycle_ns"], "ns", c["spread"], 120.0))
    return out


if __name__ == "__main__":
    sys.exit(main(figures))
