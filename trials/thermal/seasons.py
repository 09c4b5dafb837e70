"""Three seasons of a machine's working days, as two recordings: two seasons to fit, the third to judge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trials.folder import Array, Sheet

from .machines import KINDS, Machine, Rng

SEASONS = {"winter": (13.0, 17.0), "spring": (18.0, 22.0), "summer": (25.0, 31.0)}  # degC, a morning's room
NIGHT = 12 * 3600.0  # s that the machine has stood still before a day's first reading
DAY = 86400.0


@dataclass
class Shop:
    """What is the same on every day of one machine: its duty cycles, how it is read, how the room follows the day."""

    step: float
    hours: float
    duties: dict[str, list[tuple[float, Array, float]]]  # name -> (share of the day, work of each source, speed)
    daily_rise: float
    fluctuation: float
    sensor_delay: float
    sensor_noise: float
    display: float
    reading_noise: float


def shop(rng: Rng, machine: Machine) -> Shop:
    """Duty cycles are this machine's own: three to six pieces of work a day, one of them a pause."""
    duties = {}
    for name in ("TM", "CM", "BM")[: int(rng.integers(2, 4))]:
        shares = rng.dirichlet(np.full(int(rng.integers(3, 7)), 4.0))
        pause = int(rng.integers(1, shares.size - 1)) if shares.size > 2 else -1
        duties[name] = []
        for k, share in enumerate(shares):
            works = rng.uniform(0.2, 1.0, machine.heat.shape[1]) * (rng.random(machine.heat.shape[1]) < 0.8)
            idle = k == pause
            duties[name].append((float(share), np.zeros_like(works) if idle else works, 0.0 if idle else works.max()))
    return Shop(
        step=float(rng.choice([60, 120, 180, 300])),
        hours=rng.uniform(6, 9),
        duties=duties,
        daily_rise=rng.uniform(1, 5),
        fluctuation=rng.uniform(0.1, 0.6),
        sensor_delay=rng.uniform(20, 200),
        sensor_noise=rng.uniform(0.01, 0.06),
        display=float(rng.choice([0.01, 0.01, 0.1])),
        reading_noise=rng.uniform(0.3, 0.9),
    )


def day(rng: Rng, machine: Machine, s: Shop, duty: str, morning: float) -> tuple[Array, Array, Array]:
    """(time from the first reading, deviation, temperatures with the room last) of one day, without noise."""
    count = int(s.hours * 3600 / s.step)
    night = int(NIGHT / s.step)
    t = (np.arange(count + night) - night) * s.step
    slow = np.cumsum(rng.normal(size=t.size)) * s.fluctuation * np.sqrt(s.step / 3600)
    rise = s.daily_rise * rng.uniform(0.6, 1.4)
    room = morning + rise * np.sin(2 * np.pi * np.clip(t, -1e9, None) / DAY) + slow - slow[night]
    work, speed = np.zeros((t.size, machine.heat.shape[1])), np.zeros(t.size)
    edges = np.cumsum([0.0] + [share for share, _, _ in s.duties[duty]]) * s.hours * 3600
    for (_, works, pace), start, end in zip(s.duties[duty], edges[:-1], edges[1:], strict=True):
        rows = (t >= start) & (t < end)
        work[rows], speed[rows] = works * rng.uniform(0.9, 1.1), pace
    theta = machine.march(s.step, work, speed, room)
    deviation = (theta - 20) @ machine.growth + machine.room_growth * (room - 20)
    seen = slow_sensors(np.column_stack([theta[:, machine.nodes], room]), s.step, s.sensor_delay)
    return t[night:], deviation[night:], seen[night:]


def slow_sensors(seen: Array, step: float, delay: float) -> Array:
    """Readings (rows, sensors) of sensors with a first-order delay, s."""
    keep = np.exp(-step / delay)
    for i in range(1, len(seen)):
        seen[i] = seen[i] + (seen[i - 1] - seen[i]) * keep
    return seen


def machine_of(seed: int, number: int) -> tuple[Machine, Shop, Rng]:
    """The machine of a number; kinds take turns. Its drift spans 15 to 120 um over a day of work."""
    rng = np.random.default_rng([seed, number, 31])
    kind = list(KINDS)[number % len(KINDS)]
    machine = KINDS[kind](rng)
    s = shop(rng, machine)
    spans = [np.ptp(day(rng, machine, s, duty, 20.0)[1]) for duty in s.duties]
    machine.growth *= np.exp(rng.uniform(np.log(15), np.log(120))) / max(spans)
    machine.room_growth *= np.exp(rng.uniform(np.log(15), np.log(120))) / max(*spans, 50.0)
    return machine, s, rng


def recordings(seed: int, number: int, judged: str = "summer") -> tuple[Sheet, Sheet]:
    """The two seasons to fit, and the one that judges."""
    machine, s, rng = machine_of(seed, number)
    parts, at = [], 0.0
    for season, (cold, warm) in SEASONS.items():
        for k in range(int(rng.integers(4, 8))):
            duty = str(rng.choice(list(s.duties)))
            t, deviation, seen = day(rng, machine, s, duty, rng.uniform(cold, warm))
            shown = seen + s.sensor_noise * rng.normal(size=seen.shape)
            frame = pd.DataFrame(
                {"run": f"{duty}{k + 1} {season}", "season": season, "cycle": duty}, index=range(t.size)
            )
            frame["t"] = np.round(at + t, 1)
            for i, column in enumerate(shown.T):
                frame[sensor_name(i, seen.shape[1])] = np.round(np.round(column / s.display) * s.display, 3)
            zero = rng.normal(0, 8)  # each day is measured from another zero
            frame["E_Z"] = np.round(deviation - deviation[0] + zero + s.reading_noise * rng.normal(size=t.size), 3)
            parts.append(frame)
            at += DAY * float(rng.integers(1, 6))
        at += 60 * DAY
    table = pd.concat(parts, ignore_index=True)
    title = f"{machine.kind} {number}, days over three seasons"
    columns = columns_of(table)

    def of(rows: Array) -> Sheet:
        return Sheet(title, table[rows].reset_index(drop=True), columns, f"{machine.kind}-{number}")

    chosen = (table["season"] == judged).to_numpy()
    return of(~chosen), of(chosen)


def sensor_name(i: int, count: int) -> str:
    """Column of a sensor; the last one is the room's."""
    return "T_room" if i == count - 1 else f"T_{i + 1}"


def columns_of(table: pd.DataFrame) -> dict[str, dict]:
    """The manifest's columns of a table of readings."""
    columns: dict[str, dict] = {
        "run": {"role": "run"},
        "season": {"role": "group", "of": "season"},
        "cycle": {"role": "group", "of": "duty_cycle"},
        "t": {"role": "time", "unit": "s"},
    }
    for name in table.columns:
        if name.startswith("T_"):
            where = "ambient air" if name == "T_room" else f"machine, place {name[2:]}"
            columns[name] = {"role": "temperature", "unit": "degC", "location": where}
    columns["E_Z"] = {"role": "error", "component": "E_Z", "unit": "um"}
    return columns
