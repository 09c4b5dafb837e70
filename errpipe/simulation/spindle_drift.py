"""A spindle that heats, grows and cools by conduction along a bar, over days in different rooms.

The bar is heated at its front bearing by a power of the speed, loses heat to the room along its side, and its growth
is the integral of temperature: it has no single time constant. Sensors are on the spindle and in the room.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Manifest, Recording

PIECES = 30  # cells along the spindle
STEP = 2.0  # s
LOG_STEP = 60.0  # s between readings
LENGTH = 0.3  # m
DIFFUSIVITY = 1.25e-5  # m2/s, steel
LOSS = 2.2e-4  # 1/s: h P / (rho c A) of an 80 mm bar
EXPANSION = 11.5  # um/m/K
SENSOR_AT = (0.35, 0.85)  # of the length, from the heated end


@dataclass(frozen=True)
class Day:
    """One run: room at its start in degC, its rise in K over the run, and (minutes, rpm) steps."""

    label: str
    season: str
    room: float
    rise: float
    duty: tuple[tuple[float, float], ...]


COLUMN_LAG = 9000.0  # s, lag of the column relative to the room
WARM_UP = ((90, 6000), (40, 0), (60, 9000), (60, 0))  # (minutes, rpm)
STAIRS = ((35, 2000), (35, 4000), (35, 6000), (35, 8000), (35, 3000), (50, 0))
MIXED = ((20, 8000), (15, 0), (25, 4000), (10, 10000), (20, 0), (40, 7000), (30, 1000), (40, 0))
DAYS = (
    Day("w1", "winter", 17.5, 2.5, WARM_UP),
    Day("w2", "winter", 18.5, 1.5, STAIRS),
    Day("w3", "winter", 17.0, 3.0, MIXED),
    Day("p1", "spring", 21.0, 2.0, STAIRS),
    Day("p2", "spring", 20.5, 2.5, MIXED),
    Day("s1", "summer", 25.5, 3.0, WARM_UP),
    Day("s2", "summer", 27.0, 2.0, MIXED),
    Day("s3", "summer", 26.0, 3.5, STAIRS),
)


def simulate(seed: int = 1, *, noise: float = 0.7, days: tuple[Day, ...] = DAYS) -> tuple[Recording, np.ndarray]:
    """(recording, exact deviation in um). noise: standard deviation of the reading, um."""
    rng = np.random.default_rng(seed)
    frames, exact = [], []
    for number, day in enumerate(days):
        frame, true = _run(day, rng)
        frame["t"] += number * 86400.0
        frame["E_Z"] = np.round(true + rng.normal(0.0, noise, true.size), 3)
        frames.append(frame)
        exact.append(true)
    rows = pd.concat(frames, ignore_index=True)
    return Recording(MANIFEST, rows[list(MANIFEST.columns)]), np.concatenate(exact)


def _run(day: Day, rng: np.random.Generator) -> tuple[pd.DataFrame, np.ndarray]:
    speed = np.concatenate([np.full(int(60 * minutes / STEP), float(n)) for minutes, n in day.duty])
    room = day.room + day.rise * (1 - np.exp(-np.arange(speed.size) * STEP / 7000.0))
    theta = _bar(speed, room)
    keep = np.arange(0, speed.size, int(LOG_STEP / STEP))
    growth = EXPANSION * LENGTH * (theta.mean(axis=1) - 20.0)
    column = 3.0 * _slow(room - 20.0)  # the column follows the room, late
    at = [int(s * PIECES) for s in SENSOR_AT]
    frame = pd.DataFrame({"run": day.label, "season": day.season, "t": keep * STEP, "n": speed[keep]})
    for name, values in (("T_front", theta[:, at[0]]), ("T_rear", theta[:, at[1]]), ("T_room", room)):
        frame[name] = np.round(values[keep] + rng.normal(0, 0.03, keep.size), 2)
    return frame, (growth - column)[keep]


def _bar(speed: np.ndarray, room: np.ndarray) -> np.ndarray:
    dx = LENGTH / PIECES
    theta, out = np.full(PIECES, room[0]), np.empty((speed.size, PIECES))
    for k in range(speed.size):
        out[k] = theta
        flow = DIFFUSIVITY / dx**2 * np.diff(theta)
        change = -LOSS * (1 + 0.6 * speed[k] / 10000.0) * (theta - room[k])
        change[:-1] += flow
        change[1:] -= flow
        change[0] += 0.055 * (speed[k] / 6000.0) ** 1.4
        theta = theta + STEP * change
    return out


def _slow(u: np.ndarray) -> np.ndarray:
    out = np.empty_like(u)
    out[0] = u[0]
    for k in range(1, u.size):
        out[k] = out[k - 1] + (u[k - 1] - out[k - 1]) * STEP / COLUMN_LAG
    return out


MANIFEST = Manifest(
    recording=1,
    title="Spindle drift, simulated: eight days over three seasons",
    machine="simulated-spindle-1",
    tables=("recording.csv",),
    columns={
        "run": Column(role="run"),
        "season": Column(role="group", of="season"),
        "t": Column(role="time", unit="s"),
        "n": Column(role="spindle_speed", unit="rpm"),
        "T_front": Column(role="temperature", unit="degC", location="spindle front"),
        "T_rear": Column(role="temperature", unit="degC", location="spindle rear"),
        "T_room": Column(role="temperature", unit="degC", location="room air"),
        "E_Z": Column(role="error", component="E_Z", unit="um"),
    },
)
