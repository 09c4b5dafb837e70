"""Random sequences of faults around a table, and what a correction may do while they last.

A sequence is a list of parts. Each part is some cycles of readings in one mode, and begins with nothing, a reset or
another table. Axes move and turn, sensors fail, jump, drift and freeze, the machine stops, is homed and goes on; the
last part is calm and long enough for the correction to be what the readings ask for. There X stands, and its position
or its velocity reads wrong once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.kernels.table_codes import HOLD, OFF, ON
from errpipe.tables.reference import Evaluator

CYCLE = 0.001  # s
VELOCITY = 3  # its column of the readings
PARTS, LONGEST, CALM = 6, 80, 2500  # parts with faults, most cycles of each; cycles of the calm end
BAD_AT = CALM - 200  # cycle of the calm end in which X reads wrong once
BAD_SAMPLE = 5.0  # um that a single bad sample may add
SETTLED = 0.02  # um off what is right at the end: what a lag of 0.1 s leaves of a sensor that was accepted late


@cache
def table(number: int) -> t.CompensationTable:
    """One of three tables of one machine: lead, lost motion and a warm screw of X, the column's growth in Z."""
    gain = (1.0, 0.8, 1.3)[number]
    inputs = [
        t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-50, high=1050, default=0),
        *(
            t.TableInput(
                name=name,
                kind="sensor",
                unit="degC",
                low=-20,
                high=90,
                default=22,
                max_rate=50.0,
                noise=0.3,
                stale_after_s=0.03,
                valid=(15, 40),
                margin=5,
                **more,
            )
            for name, more in (("T nut", {}), ("T column", {"hold_s": 0.05}))
        ),
        t.TableInput(name="v", kind="velocity", axis="X", unit="mm/s", low=-500, high=500, default=0, optional=True),
    ]
    screw = d.Lag(of=d.above("T nut", 20.0), tau_up=0.1, tau_down=0.1)
    x_pairs = (
        Lowered(d.ONE, "X", lambda x: gain * (12.0 * np.sin(x / 90.0) + 0.01 * x)),
        Lowered(d.Direction(axis="X", threshold=0.01), None, lambda x: np.full(np.shape(x), -4.0 * gain)),
        Lowered(screw, "X", lambda x: gain * 0.011 * x),
    )
    sources = [
        tables.ComponentSource("EXX", "um", x_pairs),
        tables.ComponentSource("EZX", "um", (Lowered(d.above("T column", 20.0)),)),
    ]
    made = tables.compile_table(
        sources,
        inputs=inputs,
        travel={"X": (0, 1000)},
        position_cycle_s=CYCLE,
        thermal_cycle_s=20 * CYCLE,
        ramp_s=0.1,
        fade_s=0.1,
        error_bound=0.2,
    )
    return tables.limited(made, {"X": 100.0}, {"EZX": tables.Limits(magnitude=15.0, slew=400.0)})


def with_magnitude(made: t.CompensationTable, magnitude: float | None) -> t.CompensationTable:
    """The table with the last output's magnitude (um) or without one."""
    *others, last = made.outputs
    return made.model_copy(update={"outputs": (*others, last.model_copy(update={"magnitude": magnitude}))})


def with_slew(made: t.CompensationTable, slew: float | None) -> t.CompensationTable:
    """The table with the last output's slew (um/s) or without one."""
    *others, last = made.outputs
    return made.model_copy(update={"outputs": (*others, last.model_copy(update={"slew": slew}))})


@dataclass(frozen=True)
class Part:
    """Cycles in one mode; begins: "" (goes on), "reset", or "table" with `number`. readings (cycles, inputs)."""

    begins: str
    number: int
    readings: np.ndarray
    fresh: np.ndarray
    mode: np.ndarray


def sequence(seed: int) -> list[Part]:
    """One sequence, the same for the same seed."""
    r = np.random.default_rng(seed)
    parts, number = [Part("table", 0, *_calm(r, 100, 0.0, 500.0))], 0
    x = 500.0
    for _ in range(PARTS):
        begins = str(r.choice(["", "", "", "reset", "table"]))
        number = (number + int(r.integers(1, 3))) % 3 if begins == "table" else number
        cycles = int(r.integers(1, LONGEST))
        readings, fresh, mode, x = _faults(r, cycles, x)
        parts.append(Part(begins, number, readings, fresh, mode))
    readings, fresh, mode = _calm(r, CALM, 0.05, float(r.uniform(0, 900)))
    if r.random() < 0.5:
        readings[BAD_AT, 0] += r.choice([-1e4, -400.0, -3.0, -0.02, 0.02, 0.5, 10.0, 80.0, 400.0])
    else:
        readings[BAD_AT, VELOCITY] = r.choice([-600.0, -200.0, -0.01, 0.01, 30.0, np.nan])
    return [*parts, Part("", number, readings, fresh, mode)]


def _calm(r: np.random.Generator, cycles: int, noise: float, x: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X goes up by 1 mm and stays, which only its position says; the sensors read what they should."""
    way = x + np.minimum(np.arange(cycles) * 0.02, 1.0)
    sensors = np.array([27.0, 24.0]) + noise * r.normal(size=(cycles, 2)) * (np.arange(cycles) < cycles // 2)[:, None]
    readings = np.column_stack([way, sensors, np.zeros(cycles)])
    return readings, np.ones(readings.shape, np.uint8), np.full(cycles, ON, np.uint8)


def _faults(r: np.random.Generator, cycles: int, x: float):
    """Motion with a turn, and for each channel one of what goes wrong; the mode, and where X ends."""
    speed = r.uniform(-0.2, 0.2, 2)
    turn = int(r.integers(cycles))
    way = x + np.cumsum(np.where(np.arange(cycles) < turn, *speed))
    output = np.diff(way, prepend=way[0]) / CYCLE * (r.random() < 0.5)
    readings = np.column_stack([way, np.full(cycles, 27.0), np.full(cycles, 24.0), output])
    fresh = np.ones(readings.shape, np.uint8)
    at, length = int(r.integers(cycles)), int(r.integers(1, cycles + 1))
    for channel in range(readings.shape[1]):
        where = slice(at, at + length) if r.random() < 0.5 else slice(at, at + 1)
        match r.choice(["none", "lost", "jump", "drift", "frozen", "wild", "impossible"]):
            case "lost":
                readings[where, channel] = np.nan
            case "jump":
                readings[where, channel] += r.choice([-40.0, -3.0, 0.4, 8.0, 50.0]) * (10.0 if channel == 0 else 1.0)
            case "drift":
                readings[where, channel] += np.linspace(0, r.uniform(-60, 60), len(readings[where]))
            case "frozen":
                fresh[where, channel] = 0
            case "wild":
                readings[where, channel] = r.uniform(-80, 160, len(readings[where]))
            case "impossible":
                readings[where, channel] = r.choice([np.inf, -np.inf, 1e300, -1e9, 1e31])
    mode = np.full(cycles, ON, np.uint8)
    match r.choice(["runs", "stop", "off", "homing", "flicker"]):
        case "stop":
            mode[at : at + length] = HOLD
        case "off":
            mode[at : at + length] = OFF
        case "homing":  # corrections go out, the axis is somewhere else all at once, and they come back
            mode[at : at + length] = OFF
            readings[at + length // 2 :, 0] = r.uniform(0, 1000)
        case "flicker":
            mode[:] = r.choice([OFF, ON, HOLD], cycles)
    x = float(way[-1])
    return readings, fresh, mode, min(max(x, 0.0), 1000.0)


def right(parts: list[Part]) -> np.ndarray:
    """Corrections, um, that the last readings ask for once everything has settled."""
    last = parts[-1]
    evaluator = Evaluator(table(last.number))
    names = [i.name for i in evaluator.table.inputs]
    at = dict(zip(names, last.readings[0].tolist(), strict=True))
    evaluator.cycle(at, dt=0.0)
    at = dict(zip(names, last.readings[-1].tolist(), strict=True))
    for _ in range(3):
        cycle = evaluator.cycle(at, dt=1e6)
    return np.array([-v for v in cycle.deviation.values()])


@dataclass(frozen=True)
class Found:
    """What happened in a sequence, over all outputs: largest step and size in parts of the limit, um off at the end.

    held: largest move while the mode was hold, um; once: um off what is right after one bad sample at a standstill.
    """

    step: float
    size: float
    off: float
    held: float
    once: float

    def is_safe(self, single: bool = False) -> bool:
        """Never faster than the slew, never beyond the magnitude, still while held, and back where it should be.

        After one bad sample at a standstill no more than BAD_SAMPLE off.
        single: limits and corrections are rounded to binary32, 6e-8 of a correction that is many steps long.
        """
        exact = 1 + (1e-4 if single else 1e-9)
        limited = self.step <= exact and self.size <= exact and self.held == 0.0
        return limited and self.off <= SETTLED and self.once <= BAD_SAMPLE


def judge(parts: list[Part], corrections: np.ndarray) -> Found:
    """Corrections in um per cycle of the whole sequence, shape (cycles, outputs), against the limits."""
    ends = np.cumsum([len(p.mode) for p in parts])
    slew = np.vstack([np.tile(_limits(p.number)[0] * CYCLE, (len(p.mode), 1)) for p in parts])
    most = np.vstack([np.tile(_limits(p.number)[1], (len(p.mode), 1)) for p in parts])
    steps = np.abs(np.diff(corrections, axis=0, prepend=np.zeros((1, corrections.shape[1]))))
    off = np.abs(corrections[BAD_AT - CALM :] - right(parts)).max(axis=1)
    modes = np.concatenate([p.mode for p in parts])
    # A table of a smaller magnitude is reached at the slew, not at once: its limit counts once it has been reached.
    beyond = np.abs(corrections) / most
    for p, end in zip(parts, ends, strict=True):
        begin = end - len(p.mode)
        if p.begins == "table" and begin:
            way = np.abs(corrections[begin - 1]) - most[begin]
            wait = int(np.ceil(max((way / slew[begin]).max(), 0.0))) + 40  # 40 cycles: brake and turn
            beyond[begin : begin + wait] = np.minimum(beyond[begin : begin + wait], 1.0)
    return Found(
        step=float((steps / slew).max()),
        size=float(beyond.max()),
        off=float(off[-1]),
        held=float(steps[modes == HOLD].max(initial=0.0)),
        once=float(off.max()),
    )


@cache
def _limits(number: int) -> tuple[np.ndarray, np.ndarray]:
    outputs = table(number).outputs
    return np.array([o.slew or np.inf for o in outputs]), np.array([o.magnitude or np.inf for o in outputs])
