"""Days of three machines for `trials.faults_in_use`: lumped heat networks that know nothing of errpipe's terms.

A machine is drawn by seed around the nominal values of its kind. Bodies without a sensor take part in the deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trials.folder import Array, Sheet

STEP = 20.0  # s, of the explicit integration: a fifteenth of the shortest time constant
NIGHT = 12 * 3600.0  # s at rest before a day's first reading
HOURS = 8.0  # of a day
ROW = 60.0  # s between the rows of a recording
SEASONS = ((16.0, 5), (25.0, 5))  # degC of a morning's room, days
UNSEEN = 21.0  # degC of the morning that judges
NOISE, DISPLAY = 0.03, 0.05  # K: standard deviation and resolution of a shop's Pt100 channel
READING_NOISE = 0.4  # um
SPREAD = 0.25  # half width of what is drawn around a nominal value, as share


@dataclass(frozen=True)
class Body:
    """tau: time constant to the room, s; heat: rise at full power, K, of spindle, feed and fluid; growth, um/K."""

    tau: float
    heat: tuple[float, float, float] = (0.0, 0.0, 0.0)
    growth: float = 0.0
    sensors: int = 1


KINDS: dict[str, dict[str, Body]] = {
    "turning centre": {
        "bearing": Body(900.0, (20.0, 0.0, 0.0), 0.6),
        "headstock": Body(4200.0, (9.0, 0.0, 0.0), 2.2),
        "motor": Body(1500.0, (14.0, 0.0, 0.0)),
        "screw": Body(2400.0, (0.0, 11.0, 0.0), 1.5),
        "bed": Body(15000.0, (1.0, 1.0, 2.0), -2.5),
        "turret": Body(6000.0, (0.0, 1.0, 4.0), 0.8, sensors=0),
    },
    "grinder": {
        "wheel head": Body(1800.0, (16.0, 0.0, 2.0), 1.4),
        "oil": Body(2600.0, (4.0, 0.0, 8.0), 0.5),
        "bed": Body(18000.0, (0.0, 0.0, 4.0), -2.0),
        "dresser": Body(5000.0, (2.0, 0.0, 3.0), 0.6, sensors=0),
    },
    "gantry": {
        "beam": Body(7000.0, (3.0, 3.0, 0.0), 3.0, sensors=3),
        "ram": Body(2400.0, (12.0, 0.0, 0.0), 1.6, sensors=2),
        "left leg": Body(12000.0, (0.0, 2.0, 1.0), -1.5, sensors=2),
        "right leg": Body(11000.0, (0.0, 2.0, 0.0), -1.2, sensors=2),
        "table": Body(20000.0, (0.0, 1.0, 4.0), 1.0, sensors=1),
        "scale": Body(3000.0, (0.0, 5.0, 0.0), 0.9, sensors=1),
    },
}


@dataclass(frozen=True)
class Machine:
    """tau, heat, growth as of `Body`; joints (bodies, bodies), 1/s; sensors: name -> shares of bodies and the room."""

    kind: str
    tau: Array
    heat: Array
    growth: Array
    joints: Array
    sensors: dict[str, Array]


def machine(kind: str, seed: int) -> Machine:
    rng = np.random.default_rng([list(KINDS).index(kind), seed, 164])
    bodies = KINDS[kind]
    count = len(bodies)

    def around(values: Array) -> Array:
        return values * rng.uniform(1 - SPREAD, 1 + SPREAD, np.shape(values))

    tau = around(np.array([b.tau for b in bodies.values()]))
    joints = np.zeros((count, count))
    for i in range(1, count):  # each with the one before it: exchanged heat is the same on both sides
        joints[i, i - 1] = joints[i - 1, i] = 0.5 / max(tau[i], tau[i - 1]) * rng.uniform(0.4, 1.0)
    sensors = {}
    for i, (name, body) in enumerate(bodies.items()):
        for k in range(body.sensors):  # in part they read a neighbour
            share = np.zeros(count + 1)
            other = (i + 1 + k) % (count + 1)
            share[other] = rng.uniform(0.0, 0.35)
            share[i] = 1.0 - share[other]
            sensors[f"T_{name.replace(' ', '_')}_{k + 1}"] = share
    sensors["T_room"] = np.eye(count + 1)[count]
    heat = around(np.array([b.heat for b in bodies.values()])) / tau[:, None]
    return Machine(kind, tau, heat, around(np.array([b.growth for b in bodies.values()])), joints, sensors)


@dataclass(frozen=True)
class Day:
    """Every `STEP`: time and deviation since the start, s and um; what sensors have, degC (steps, sensors)."""

    t: Array
    deviation: Array
    sensors: Array


def day(m: Machine, rng: np.random.Generator, morning: float) -> Day:
    night, count = int(NIGHT / STEP), int((NIGHT + HOURS * 3600.0) / STEP) + 1
    t = (np.arange(count) - night) * STEP
    wander = np.cumsum(rng.normal(size=count)) * 0.3 * np.sqrt(STEP / 3600.0)
    wander = wander - np.linspace(wander[0], wander[-1], count)
    room = morning + rng.uniform(1.0, 4.0) * np.sin(2 * np.pi * (t - 3600.0) / 86400.0) + wander
    work = np.stack([_duty(rng, count, 900.0, 5400.0) for _ in range(3)], axis=1) * (t >= 0)[:, None]
    theta = np.full((count, m.tau.size), room[0])
    for i in range(1, count):
        x = theta[i - 1]
        flow = m.heat @ work[i] ** 1.3 + (room[i] - x) / m.tau + m.joints @ x - m.joints.sum(axis=1) * x
        theta[i] = x + STEP * flow
    shown = np.column_stack([theta, room]) @ np.array(list(m.sensors.values())).T
    deviation = theta @ m.growth
    return Day(t[night:], deviation[night:] - deviation[night], shown[night:])


def _duty(rng: np.random.Generator, count: int, least: float, most: float) -> Array:
    """Power as share of the full one: pieces of work and pauses of `least` to `most` s."""
    out, at = np.zeros(count), 0
    while at < count:
        length = int(rng.uniform(least, most) / STEP)
        out[at : at + length] = rng.choice([0.0, 0.4, 0.7, 1.0])
        at += length
    return out


def shown(day: Day, t: Array, rng: np.random.Generator) -> Array:
    """What the sensors read at times t, (times, sensors): noise and resolution."""
    read = np.column_stack([np.interp(t, day.t, column) for column in day.sensors.T])
    return np.round((read + NOISE * rng.normal(size=read.shape)) / DISPLAY) * DISPLAY


def recording(m: Machine, seed: int) -> Sheet:
    """The days that are fitted."""
    rng, parts = np.random.default_rng([list(KINDS).index(m.kind), seed, 165]), []
    for season, (morning, days) in enumerate(SEASONS):
        for k in range(days):
            one = day(m, rng, morning + rng.uniform(-2.0, 2.0))
            t = np.arange(0.0, one.t[-1] + ROW / 2, ROW)
            frame = pd.DataFrame(np.round(shown(one, t, rng), 3), columns=list(m.sensors))
            frame.insert(0, "run", f"day {season + 1}.{k + 1}")
            frame.insert(1, "t", t + 86400.0 * (100 * season + k))
            y = np.interp(t, one.t, one.deviation) + rng.normal(0, 5) + READING_NOISE * rng.normal(size=t.size)
            frame["E_Z"] = np.round(y, 3)
            parts.append(frame)
    columns = {"run": {"role": "run"}, "t": {"role": "time", "unit": "s"}}
    columns |= {name: {"role": "temperature", "unit": "degC"} for name in m.sensors}
    columns |= {"E_Z": {"role": "error", "component": "E_Z", "unit": "um"}}
    return Sheet(f"{m.kind}, ten days", pd.concat(parts, ignore_index=True), columns, m.kind.replace(" ", "-"))


def unseen(m: Machine, seed: int) -> tuple[Day, np.random.Generator]:
    """A day that was not recorded, and the numbers its readings' noise is drawn from."""
    rng = np.random.default_rng([list(KINDS).index(m.kind), seed, 166])
    return day(m, rng, UNSEEN), rng
