"""One log of some days in one run to fit, and four later logs of the same machine and season to judge.

A log of one day begins with the machine at rest over night and ends with its work; a longer one goes on through nights
and, from the fifth day on, through ends of weeks at rest, while the weather changes from day to day.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from trials.folder import Array, Sheet

from .machines import Machine, Rng
from .seasons import DAY, NIGHT, SEASONS, Shop, columns_of, machine_of, sensor_name, slow_sensors

LATER = 4  # logs that judge
LONG_STEP = 600.0  # s between the rows of a log of several days
WEATHER = 0.8  # K: standard deviation of the room's change from one day to the next


def recordings(seed: int, number: int, days: int) -> tuple[Sheet, Sheet]:
    """The log to fit, and the later ones."""
    machine, s, _ = machine_of(seed, number)
    rng = np.random.default_rng([seed, number, days, 77])
    season = str(rng.choice(list(SEASONS)))
    parts, at = [], 0.0
    for k in range(LATER + 1):
        t, deviation, seen = log(rng, machine, s, days, rng.uniform(*SEASONS[season]))
        shown = seen + s.sensor_noise * rng.normal(size=seen.shape)
        frame = pd.DataFrame({"run": f"log {k + 1}", "t": np.round(at + t, 1)})
        for i, column in enumerate(shown.T):
            frame[sensor_name(i, seen.shape[1])] = np.round(np.round(column / s.display) * s.display, 3)
        zero = rng.normal(0, 8)
        frame["E_Z"] = np.round(deviation - deviation[0] + zero + s.reading_noise * rng.normal(size=t.size), 3)
        parts.append(frame)
        at += t[-1] + DAY * float(rng.integers(2, 9))
    table = pd.concat(parts, ignore_index=True)
    columns = {name: spec for name, spec in columns_of(table).items() if name in table}
    first = (table["run"] == "log 1").to_numpy()

    def of(rows: Array) -> Sheet:
        title = f"{machine.kind} {number}, logs of {days} days"
        return Sheet(title, table[rows].reset_index(drop=True), columns, f"{machine.kind}-{number}")

    return of(first), of(~first)


def log(rng: Rng, machine: Machine, s: Shop, days: int, morning: float) -> tuple[Array, Array, Array]:
    """(time from the first reading, deviation, temperatures with the room last) of one log, without noise."""
    step = LONG_STEP if days > 1 else s.step
    night = int(NIGHT / step)
    count = night + int((days * DAY if days > 1 else s.hours * 3600) / step)
    t = (np.arange(count) - night) * step
    slow = np.cumsum(rng.normal(size=count)) * s.fluctuation * np.sqrt(step / 3600)
    weather = np.interp(t / DAY, np.arange(-2, days + 3), np.cumsum(rng.normal(0, WEATHER, days + 5)))
    rise = s.daily_rise * rng.uniform(0.6, 1.4)
    room = morning + rise * np.sin(2 * np.pi * t / DAY) + slow - slow[night] + weather
    work, speed = np.zeros((count, machine.heat.shape[1])), np.zeros(count)
    for day in (d for d in range(days) if days < 5 or d % 7 < 5):
        duty = s.duties[str(rng.choice(list(s.duties)))]
        edges = day * DAY + np.cumsum([0.0] + [share for share, _, _ in duty]) * s.hours * 3600
        for (_, works, pace), start, end in zip(duty, edges[:-1], edges[1:], strict=True):
            rows = (t >= start) & (t < end)
            work[rows], speed[rows] = works * rng.uniform(0.9, 1.1), pace
    theta = machine.march(step, work, speed, room)
    deviation = (theta - 20) @ machine.growth + machine.room_growth * (room - 20)
    seen = slow_sensors(np.column_stack([theta[:, machine.nodes], room]), step, s.sensor_delay)
    return t[night:], deviation[night:], seen[night:]
