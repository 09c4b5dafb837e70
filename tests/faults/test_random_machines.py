"""Sequences of faults on machines drawn at random: other travels, signs, axes, sensors, waves, a table of one node."""

from __future__ import annotations

import shutil
from dataclasses import dataclass

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.kernels import table_cycle
from errpipe.kernels.table_codes import HOLD, OFF, ON
from errpipe.tables import ect, pack
from errpipe.tables.limits import MAX_DEFAULT_SLEW
from errpipe.tables.reference import Evaluator
from tests.faults import campaign
from tests.faults.sequences import CYCLE, SETTLED, Part
from tests.unit.tables.made import modes

CALM = 3000  # cycles at the end, with which every lag and ramp is through
PARTS = 8


@dataclass(frozen=True)
class Machine:
    """A table with default limits, the range of each position, and calm readings."""

    table: t.CompensationTable
    travel: dict[str, tuple[float, float]]
    calm: np.ndarray


def machine(seed: int) -> Machine:
    """One to three axes (linear or rotary, any travel), up to three sensors, one to four components."""
    r = np.random.default_rng(1000 + seed)
    axes = [str(a) for a in r.choice(list("XYZC"), size=r.integers(1, 4), replace=False)]
    travel = {a: _travel(r, a) for a in axes}
    sensors = [f"T{n}" for n in range(r.integers(0, 4))]
    names = [f"E{b}{a}" for a in axes for b in axes if (a == "C") == (b == "C")]
    sources = [
        tables.ComponentSource(name, "urad" if name == "ECC" else "um", tuple(_pairs(r, name[2], travel, sensors)))
        for name in sorted(r.choice(names, size=min(len(names), int(r.integers(1, 5))), replace=False).tolist())
    ]
    places = [
        t.TableInput(name=a.lower(), kind="position", axis=a, low=-1e5, high=1e5, default=float(np.mean(travel[a])))
        for a in axes
    ]
    made = tables.compile_table(
        sources,
        inputs=[*places, *(_sensor(r, s) for s in sensors)],
        travel=travel,
        position_cycle_s=CYCLE,
        thermal_cycle_s=float(r.choice([1, 7, 40])) * CYCLE,
        ramp_s=float(r.choice([0.0, 0.05, 0.3])),
        fade_s=float(r.choice([0.0, 0.1])),
        error_bound=0.2,
    )
    made = tables.limited(made, {a: float(r.uniform(5, 200)) for a in axes if r.random() < 0.6})
    return Machine(made, travel, np.array([i.default for i in made.inputs]))


def _travel(r: np.random.Generator, axis: str) -> tuple[float, float]:
    if axis == "C":
        return (0.0, 360.0) if r.random() < 0.6 else (-110.0, 110.0)
    low = float(r.choice([0.0, -300.0, 5000.0, -1200.0, -50.0]))
    return low, low + float(r.choice([40.0, 300.0, 1500.0]))


def _sensor(r: np.random.Generator, name: str) -> t.TableInput:
    more = {"hold_s": 0.05} if r.random() < 0.3 else {}
    return t.TableInput(
        name=name,
        kind="sensor",
        low=-40,
        high=200,
        default=float(r.uniform(20, 26)),
        max_rate=20.0,
        noise=0.3,
        stale_after_s=float(r.choice([0.02, 60.0])),
        valid=(18, 32),
        margin=5,
        **more,
    )


def _pairs(r: np.random.Generator, axis: str, travel, sensors) -> list[Lowered]:
    """A random sum of what errors are made of, along one axis."""
    low, high = travel[axis]
    size, wave = float(r.uniform(-40, 40)), float(r.uniform(3, 8))
    kinds = {
        "constant": Lowered(d.ONE),
        "line": Lowered(d.ONE, axis, lambda x: size * (x - low) / (high - low)),
        "bend": Lowered(d.ONE, axis, lambda x: size * np.sin(wave * (x - low) / (high - low))),
        "pitch": Lowered(d.ONE, axis, lambda x: 3.0 * np.sin(2 * np.pi * x / 12.0), 12.0),
        "lost": Lowered(d.Direction(axis=axis, threshold=0.01), axis, lambda x: np.full(np.shape(x), 0.2 * size)),
    }
    if sensors:
        warm = d.above(str(r.choice(sensors)), 20.0)
        kinds["at once"] = Lowered(warm, axis, lambda x: 0.3 * size * (x - low) / (high - low))
        kinds["late"] = Lowered(d.Lag(of=warm, tau_up=0.08, tau_down=0.05), axis, lambda x: 0.01 * (x - low))
    return [kinds[str(k)] for k in r.choice(list(kinds), size=min(len(kinds), int(r.integers(1, 5))), replace=False)]


def sequence(seed: int, made: Machine) -> list[Part]:
    """Parts of up to 150 cycles with faults in any channel, stops, homing and resets; then calm, as at the start."""
    r = np.random.default_rng(seed)
    parts = [Part("table", 0, *_still(made, 200))]
    for _ in range(PARTS):
        begins = str(r.choice(["", "", "reset"]))
        cycles = int(r.integers(40 if begins else 1, 150))
        readings = np.tile(made.calm, (cycles, 1))
        for k, channel in enumerate(made.table.inputs):
            if channel.kind == "position":
                low, high = made.travel[channel.axis]
                start = r.uniform(low, high) if r.random() < 0.3 else readings[0, k]
                readings[:, k] = start + np.cumsum(r.choice([-0.3, 0.0, 0.2], cycles // 20 + 1).repeat(20)[:cycles])
            if channel.kind == "position" or not begins:  # sensors are right at a reset: what they say then is accepted
                _spoil(r, readings[:, k])
        mode = np.full(cycles, ON, np.uint8)
        at = int(r.integers(cycles))
        mode[at:] = r.choice([ON, ON, HOLD, OFF])
        fresh = (r.random(readings.shape) < r.choice([1.0, 1.0, 0.5, 0.02])).astype(np.uint8)
        parts.append(Part(begins, 0, readings, fresh, mode))
    return [*parts, Part("", 0, *_still(made, CALM))]


def _still(made: Machine, cycles: int):
    """Everything stands, but each position comes from below at the beginning."""
    readings = np.tile(made.calm, (cycles, 1))
    for k, channel in enumerate(made.table.inputs):
        if channel.kind == "position":
            readings[:, k] -= np.maximum(1.0 - 0.02 * np.arange(cycles), 0.0)
        else:  # a reading that never changes is an old one
            readings[:, k] += 1e-6 * (np.arange(cycles) % 2)
    return readings, np.ones(readings.shape, np.uint8), np.full(cycles, ON, np.uint8)


def _spoil(r: np.random.Generator, readings: np.ndarray) -> None:
    at, length = int(r.integers(readings.size)), int(r.choice([1, 1, 3, 80]))
    where = slice(at, at + length)
    match r.choice(["none", "none", "lost", "jump", "drift", "wild", "impossible"]):
        case "lost":
            readings[where] = np.nan
        case "jump":
            readings[where] += r.choice([-50.0, -5.0, 0.5, 7.0, 50.0])
        case "drift":
            readings[where] += np.linspace(0, r.uniform(-80, 80), readings[where].size)
        case "wild":
            readings[where] = r.uniform(-500, 500, readings[where].size)
        case "impossible":
            readings[where] = r.choice([np.inf, -np.inf, 1e300, 1e31, -1e5])


def by_numba(made: Machine, parts: list[Part]) -> np.ndarray:
    program = pack.program(made.table)
    state, out = pack.state(program), []
    for part in parts:
        if part.begins == "reset":
            table_cycle.reset(program, state)
        deviation, correction = np.empty((2, len(part.mode), len(made.table.outputs)))
        status = np.empty(len(part.mode), dtype=np.int64)
        table_cycle.stream(program, state, part.readings, part.fresh, part.mode, deviation, correction, status)
        out.append(correction)
    return np.vstack(out)


def unsafe(made: Machine, parts: list[Part], corrections: np.ndarray) -> str:
    """What is wrong with corrections (mm or deg), empty where nothing is."""
    outputs, mode = made.table.outputs, np.concatenate([p.mode for p in parts])
    value = corrections / np.array([o.factor for o in outputs])
    steps = np.abs(np.diff(value, axis=0, prepend=np.zeros((1, len(outputs)))))
    slew, most = (np.array([getattr(o, name) or 0.0 for o in outputs]) for name in ("slew", "magnitude"))
    said = []
    if (steps > CYCLE * slew * (1 + 1e-4) + 1e-9).any():
        said.append("a step beyond the slew")
    if (np.abs(value) > most * (1 + 1e-6) + 1e-9).any():
        said.append("beyond the magnitude")
    if steps[mode == HOLD].max(initial=0.0) > 0.0:
        said.append("moved while held")
    for axis in {o.axis for o in outputs}:
        own = [k for k, o in enumerate(outputs) if o.axis == axis]
        moved = np.abs(np.diff(value[:, own].sum(axis=1), prepend=0.0)).max()
        if moved > CYCLE * MAX_DEFAULT_SLEW * (1 + 1e-4):
            said.append(f"{axis} moves {moved:.3f} in a cycle")
    if (off := np.abs(value[-1] - right(made, parts)).max()) > SETTLED:
        said.append(f"{off:.4f} off at the end")
    return "; ".join(said)


def right(made: Machine, parts: list[Part]) -> np.ndarray:
    """Corrections, um or urad, in the calm state: that of an evaluator which never saw anything else."""
    by_numba_values = by_numba(made, [Part("table", 0, *_still(made, CALM))])[-1]
    return by_numba_values / np.array([o.factor for o in made.table.outputs])


@pytest.mark.parametrize("seed", range(40))
def test_a_machine_drawn_at_random_is_safe(seed):
    made = machine(seed)
    parts = sequence(seed, made)
    assert unsafe(made, parts, by_numba(made, parts)) == ""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.toolchain
@pytest.mark.parametrize("name", ["C, double", "C, single", "Structured Text"])
def test_compiled_evaluators_keep_them_safe(name, tmp_path):
    machines = [machine(seed) for seed in range(40, 70)]
    largest = max(machines, key=lambda m: len(ect.dumps(m.table)))
    run = campaign.compiled(name, tmp_path, largest.table)
    ran = 0
    for seed, made in enumerate(machines, 40):
        parts = sequence(seed, made)
        try:
            session = run.open(ect.dumps(made.table))
        except AssertionError:
            assert name == "Structured Text"  # more nodes or values than the arrays of the largest file have room for
            continue
        ran += 1
        out = []
        for part in parts:
            if part.begins == "reset":
                run.dll.session_reset(session)
            out.append(run.part(session, part, len(made.table.outputs)) / 1e3)
        run.dll.session_close(session)
        assert unsafe(made, parts, np.vstack(out)) == "", seed
        if name != "C, single":
            assert np.array_equal(1e3 * np.vstack(out), 1e3 * by_numba(made, parts)), seed
    assert ran > 20


def test_without_a_slew_they_are_not():
    said = 0
    for seed in range(12):
        made = machine(seed)
        free = tuple(o.model_copy(update={"slew": None, "acceleration": None}) for o in made.table.outputs)
        parts = sequence(seed, made)
        bare = Machine(made.table.model_copy(update={"outputs": free}), made.travel, made.calm)
        said += unsafe(made, parts, by_numba(bare, parts)) != ""
    assert said > 8


def test_the_reference_gives_the_same():
    for seed in (70, 71, 72):
        made = machine(seed)
        parts = sequence(seed, made)[:-1]
        evaluator, names, out = Evaluator(made.table), [i.name for i in made.table.inputs], []
        for part in parts:
            if part.begins == "reset":
                evaluator.reset()
            for row, news, mode in zip(part.readings.tolist(), part.fresh, part.mode, strict=True):
                given = {n: v for n, v, new in zip(names, row, news, strict=True) if new}
                out.append(list(evaluator.cycle(given, **modes(mode)).correction.values()))
        assert np.array_equal(np.array(out), by_numba(made, parts))
