"""A ball-screw axis measured in both directions over nine thermal states: position, thermal and mixed errors together.

The truth is known and does not have the fitted form: heat is conducted (see `heat`), the lead error is a set of
short waves, the bearing's seat moves with its own temperature. Equal seeds give equal bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.simulation import heat

TRAVEL = (0.0, 800.0)  # mm
LEAD = 10.0  # mm a revolution
# Minutes and mean speed (mm/s) of the axis before each of the nine measuring runs: cold, warming, resting, warm.
STATES = ((0, 0), (15, 100), (20, 200), (25, 300), (30, 300), (25, 0), (20, 150), (30, 250), (45, 0))
STROKE = (80.0, 720.0)  # mm: the axis runs between these ends to warm up
TARGETS = 25  # positions in one direction
CYCLES = 3  # visits to each target and direction
APPROACH_SPEED = 60.0  # mm/s
DWELL = 4.0  # s at each target
LOG_EVERY = 30.0  # s between rows that log only temperatures


@dataclass(frozen=True)
class Truth:
    """Errors of the axis, and how it is measured. um, K; noise_memory: share of noise correlated by 0.8."""

    lead_error: float = 14.0  # um/m
    bow: float = 5.0
    pitch: float = 1.6
    backlash: float = 6.0
    seat: float = 0.8  # um/K of the fixed bearing
    noise: float = 0.8
    noise_memory: float = 0.2
    outliers: float = 0.0  # share of readings
    sensor_noise: float = 0.01  # K
    display: float = 0.01  # K


@dataclass(frozen=True)
class Simulated:
    """A recording, and its error column without noise (same rows; NaN where not measured)."""

    recording: Recording
    truth: np.ndarray
    noise: np.ndarray


def simulate(seed: int = 1, truth: Truth = Truth()) -> Simulated:
    """One session: the axis warms up and rests, and is measured after each of `STATES`."""
    rng = np.random.default_rng(seed)
    screw = heat.Screw()
    program = _program()
    air = _room(program.end, rng)
    warm = heat.simulate_temperatures(screw, program.speed, program.low, program.high, air, float(air[0]))
    at = np.minimum((program.row_time / heat.STEP).astype(int), warm.time.size - 1)
    growth = heat.growth(screw, warm.screw[at], program.x)
    exact = _geometry(truth, program.x) + growth + truth.seat * (warm.bearing[at] - 20.0)
    exact = exact - 0.5 * truth.backlash * program.direction
    exact[~program.measured] = np.nan
    noise = _noise(rng, program.run_number, truth)
    sensed = {"T_nut": warm.nut, "T_bearing": warm.bearing, "T_bed": warm.bed, "T_air": warm.air}
    columns = {name: _sensor(rng, values[at], truth) for name, values in sensed.items()}
    frame = pd.DataFrame(
        {
            "run": program.run,
            "t": program.row_time,
            "x": np.round(program.x, 4),
            "dir": program.direction,
            "EXX": np.round(exact + noise, 3),
            **columns,
        }
    )
    return Simulated(
        Recording(MANIFEST, frame[list(MANIFEST.columns)]), exact, np.where(program.measured, noise, np.nan)
    )


@dataclass(frozen=True)
class _Program:
    """Motion: per step of the heat model, and per row of the recording."""

    end: float
    speed: np.ndarray
    low: np.ndarray
    high: np.ndarray
    run: np.ndarray
    run_number: np.ndarray
    row_time: np.ndarray
    x: np.ndarray
    direction: np.ndarray
    measured: np.ndarray


def _targets() -> np.ndarray:
    """Targets scattered by up to half a lead about equal spacing (ISO 230-2, 5.3), otherwise the pitch would be hidden.

    The squares of a golden step have no rhythm; its multiples would beat with the lead.
    """
    even = np.linspace(TRAVEL[0], TRAVEL[1], TARGETS)
    inner = (even > TRAVEL[0]) & (even < TRAVEL[1])
    scatter = (np.arange(TARGETS) ** 2 * 0.618034) % 1.0 - 0.5
    return np.round(even + LEAD * scatter * inner, 3)


def _program() -> _Program:
    rows, moves, t = [], [], 0.0
    targets = _targets()
    for k, (minutes, speed) in enumerate(STATES):
        for start in np.arange(t, t + 60.0 * minutes, LOG_EVERY):
            side = 1.0 if int(start / LOG_EVERY) % 2 == 0 else -1.0
            middle = 400.0 + (200.0 * side if speed else 0.0)
            rows.append((f"log-{k + 1}", 2 * k, start, middle, side, False))
        if minutes:
            moves.append((t, t + 60.0 * minutes, float(speed), *STROKE))
            t += 60.0 * minutes
        here = float(targets[0])
        for x, side in [*((float(x), 1.0) for x in targets), *((float(x), -1.0) for x in targets[::-1])] * CYCLES:
            lasts = max(abs(x - here), 2.0) / APPROACH_SPEED + DWELL
            moves.append((t, t + lasts, abs(x - here) / lasts, min(x, here), max(x, here)))
            t, here = t + lasts, x
            rows.append((f"state-{k + 1}", 2 * k + 1, round(t - 0.5, 3), x, side, True))
    grid = np.arange(0.0, t + heat.STEP, heat.STEP)
    begin = np.array([m[0] for m in moves])
    which = np.clip(np.searchsorted(begin, grid, side="right") - 1, 0, len(moves) - 1)
    motion = np.array([m[2:] for m in moves])[which]
    run, number, when, at, sides, measured = (np.array(c) for c in zip(*rows, strict=True))
    speed_at, low, high = motion.T
    return _Program(t, speed_at, low, high, run.astype(object), number, when, at, sides, measured)


def _room(end: float, rng: np.random.Generator) -> np.ndarray:
    t = np.arange(0.0, end + heat.STEP, heat.STEP)
    phase = rng.uniform(0, 2 * np.pi)
    return 21.0 + 1.2 * t / 10800.0 + 0.3 * np.sin(2 * np.pi * t / 2700.0 + phase)


def _geometry(truth: Truth, x: np.ndarray) -> np.ndarray:
    """Lead error: a slope, a bow, two short waves of the grinding machine that made the screw, the pitch."""
    u = x / TRAVEL[1]
    smooth = truth.lead_error * x * 1e-3 + truth.bow * (4 * u * (1 - u)) + 0.25 * truth.bow * np.sin(7.0 * u + 0.4)
    angle = 2 * np.pi * x / LEAD
    return smooth + truth.pitch * np.sin(angle + 0.7) + 0.2 * truth.pitch * np.sin(2 * angle)


def _noise(rng: np.random.Generator, run: np.ndarray, truth: Truth) -> np.ndarray:
    white, drive = rng.normal(size=run.size), rng.normal(size=run.size)
    slow = np.empty(run.size)
    for i in range(run.size):
        fresh = i == 0 or run[i] != run[i - 1]
        slow[i] = drive[i] if fresh else 0.8 * slow[i - 1] + 0.6 * drive[i]
    out = truth.noise * (np.sqrt(1 - truth.noise_memory) * white + np.sqrt(truth.noise_memory) * slow)
    hit = rng.random(run.size) < truth.outliers
    return out + hit * truth.noise * rng.choice([-1.0, 1.0], run.size) * rng.uniform(8, 40, run.size)


def _sensor(rng: np.random.Generator, exact: np.ndarray, truth: Truth) -> np.ndarray:
    return np.round(
        np.round((exact + rng.normal(0, truth.sensor_noise, exact.size)) / truth.display) * truth.display, 6
    )


def _temperature(location: str) -> Column:
    return Column(role="temperature", unit="degC", location=location)


MANIFEST = Manifest(
    recording=1,
    title="Ball-screw axis, simulated: bidirectional positioning over nine thermal states",
    machine="simulated-axis-1",
    tables=("recording.csv",),
    constants={"X": Constant(role="axis", kind="linear", travel=TRAVEL, screw_lead=LEAD, drive_end=0.0, unit="mm")},
    columns={
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "dir": Column(role="direction", axis="X"),
        "T_nut": _temperature("ball-screw nut"),
        "T_bearing": _temperature("fixed screw bearing"),
        "T_bed": _temperature("bed"),
        "T_air": _temperature("room air"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    },
)
