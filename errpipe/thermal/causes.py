"""Causes of thermal deviation, as drivers with a known sign.

Three kinds of cause, each in K, so that a gain is an expansion in um/K with a plausible size:

    body      the rise of a measured part since the start of the run; sign (+)
    running   the same rise, counted only while the spindle runs, and lagged: unmeasured heat
              of bearings and nuts, comes and goes with the stop at midday (+). It is friction of oil, and oil
              is thinner in a warm shop: it counts less by the oil's own law where the machine starts warmer
    follower  a part without a sensor that begins the run as warm as the machine, or some of the way to the room's
              temperature, and then follows the room through a slow lag: it carries the other side of the
              temperature, and then follows the room through a slow lag: it is on the other side of the

If the room is warm before the machine is (the heating starts early, the machine stood all night), the
follower moves at once although nothing was switched on; this distinguishes the seasons.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.shared import drive_all
from errpipe.errors import DataError, did_you_mean

_ROOM = re.compile(r"ambient|room|\bair\b|shop|hall|environment", re.IGNORECASE)
_SPINDLE = re.compile(r"spindle|headstock|motor|bearing", re.IGNORECASE)
_BED = re.compile(r"\bbed\b|base|frame", re.IGNORECASE)

HEAT_WINDOW = 360.0  # s: shortest window over which a rate exceeds the resolution of 0.01 K readings
COOLING_TIME = 9000.0  # s: a headstock's own cooling time; its loss at standstill must not count as running
OIL_REFERENCE = 20.0  # degC at which the share of running is one
OIL_RANGE = (-5.0, 55.0)  # degC range of its table, held beyond
HEATED = (3.0, 2.7)  # K/h: default thresholds, on above, off below; a turning centre at rest showed -5..2.0
HYSTERESIS = 0.15  # hysteresis of the threshold, as share of half the distance between standing and running
STANDING = 0.5  # largest heat at standstill as share of that of running: above it, it is a slower speed
MIXES = (
    0.0,
    0.25,
    0.5,
)  # how far towards the room a follower may begin, from the temperature of the machine's own body
VALLEY = 0.35  # largest density between two modes over that of the lower peak; a uniform distribution gives 0.5
NEIGHBOURS = (0.03, 30)  # nearest neighbours for the density estimate: share of the rows, and smallest number


@dataclass(frozen=True)
class Cause:
    """One driver, in K, with the sign of its gain."""

    name: str
    kind: Literal["body", "running", "follower"]
    driver: d.Driver
    start: str = ""  # follower: sensor of its initial temperature; causes with one start form a group

    @property
    def sign(self) -> float:
        """+1 where a positive value lengthens the measured loop, -1 where it shortens it."""
        return -1.0 if self.kind == "follower" else 1.0


@dataclass(frozen=True)
class Sensors:
    """The temperature columns by place. room, spindles and bed may be absent."""

    room: str | None
    bodies: tuple[str, ...]
    spindles: tuple[str, ...]
    bed: str | None
    starts: tuple[str, ...]

    def all(self) -> tuple[str, ...]:
        """Every sensor, the room first."""
        return ((self.room,) if self.room else ()) + self.bodies


def sensors(
    recording: Recording,
    *,
    room: str | None = None,
    spindle: str | None = None,
    bed: str | None = None,
    use: Sequence[str] = (),
) -> Sensors:
    """The temperature columns by location; given names take precedence.

    Raises DataError if a named sensor is not a temperature of the recording, or if there is no sensor on the machine.
    """
    present = recording.names("temperature")
    for name in (*use, *(n for n in (room, spindle, bed) if n)):
        if name not in present:
            raise DataError(
                f"thermal model: {name!r} is not a temperature of the recording "
                f"(present: {', '.join(present) or 'none'}).{did_you_mean(name, present)}"
            )
    names = tuple(n for n in present if not use or n in use)
    room = room or _first(recording, names, _ROOM)
    bodies = tuple(n for n in names if n != room)
    if not bodies:
        raise DataError(
            "thermal model: every temperature of the recording is a room temperature (needed: one on the machine; "
            "correct its location in the manifest, or name the room's sensor with `room`)"
        )
    near = tuple(n for n in bodies if _SPINDLE.search(_place(recording, n)))
    bed = bed or _first(recording, bodies, _BED)
    quiet = tuple(n for n in bodies if n not in near)
    return Sensors(room, bodies, (spindle,) if spindle else near, bed, quiet or bodies)


def _place(recording: Recording, name: str) -> str:
    return f"{recording.manifest.columns[name].location or ''} {name.replace('_', ' ')}"


def _first(recording: Recording, names: Sequence[str], pattern: re.Pattern[str]) -> str | None:
    return next((n for n in names if pattern.search(_place(recording, n))), None)


def running(recording: Recording, sensors: Sensors, rows: np.ndarray | None = None) -> d.Driver | None:
    """1 while the spindle runs, 0 at standstill, or None if no column shows it.

    From the spindle speed if recorded; else from the heat flow that warms its bearings,
    through a switch between the two levels in the rows of a mask (default: all). The mean
    of all sensors near the spindle is used: one that drifts or fails has only its share.
    """
    speed = recording.name("spindle_speed")
    if speed is not None:
        squared = d.Product(of=(d.Input(name=speed), d.Input(name=speed)))  # either direction of rotation
        return d.Switch(of=squared, on=100.0, off=1.0)
    near_spindle = tuple(n for n in sensors.spindles if n != sensors.bed)
    if not near_spindle or sensors.bed is None:
        return None
    heat = _heat(near_spindle, sensors.bed)
    heat_values = drive(heat, recording)
    on, off = _levels(heat_values if rows is None else heat_values[rows])
    return d.Switch(of=heat, on=on, off=off)


def _heat(warm: tuple[str, ...], bed: str) -> d.Driver:
    """Rate over `HEAT_WINDOW` plus what is lost to the bed, mean over sensors, K/h."""
    per_hour, loss = 3600.0 / HEAT_WINDOW / len(warm), 3600.0 / COOLING_TIME
    weights: list[float] = [-loss]
    parts: list[d.Driver] = [d.Input(name=bed)]
    for name in warm:
        bearing = d.Input(name=name)
        weights += [per_hour + loss / len(warm), -per_hour]
        parts += [bearing, d.Lag(of=bearing, tau_up=HEAT_WINDOW, tau_down=HEAT_WINDOW)]
    return d.Affine(weights=tuple(weights), of=tuple(parts))


def _levels(heat: np.ndarray) -> tuple[float, float]:
    """Thresholds, K/h, from which a spindle counts as running and as standing: about half-way between the two levels.

    Otsu's threshold (1979) between two modes with a low density between them; `HEATED` if there is
    one mode, or two speeds.
    """
    ordered = np.sort(heat[np.isfinite(heat)])
    near = max(int(NEIGHBOURS[0] * ordered.size), NEIGHBOURS[1])
    if ordered.size < 8 * near:
        return HEATED
    count = np.arange(1, ordered.size)
    total = np.cumsum(ordered)
    low, high = total[:-1] / count, (total[-1] - total[:-1]) / (ordered.size - count)
    cut = int(np.argmax(count * (ordered.size - count) * (high - low) ** 2))
    one, other = float(low[cut]), float(high[cut])
    if one > STANDING * other or _density_ratio(ordered, cut + 1, near) > VALLEY:
        return HEATED
    middle, half = (other + one) / 2.0, (other - one) / 2.0
    return middle + HYSTERESIS * half, middle - HYSTERESIS * half


def _density_ratio(ordered: np.ndarray, cut: int, near: int) -> float:
    """Lowest density between two modes over the peak density of the rarer mode, 0..1.

    ordered: values (n,), rising; the first `cut` are of one mode. near: number of neighbours for the density estimate.
    """
    if min(cut, ordered.size - cut) < 2 * near:
        return 1.0
    wide = np.maximum(ordered[near:] - ordered[:-near], 1e-12)  # density is inverse to the spacing
    peaks = max(wide[: cut - near].min(), wide[cut:].min())
    return float(min(peaks / wide[cut // 2 : (cut + ordered.size) // 2 - near].max(), 1.0))


def causes(
    recording: Recording,
    placed: Sensors,
    late: Sequence[float],
    slow: Sequence[float],
    thinning: float,
    rows: np.ndarray | None = None,
) -> tuple[Cause, ...]:
    """The dictionary: bodies, bodies while running (lags `late`, s), followers of the room (lags `slow`, s).

    thinning: of the oil whose friction heats, 1/K; rows: mask of the usable rows.
    """
    out = [Cause(f"rise of {n}", "body", d.rise(n)) for n in placed.bodies]
    state = running(recording, placed, rows)
    if state is not None:
        friction = oil_friction(placed, thinning)
        out += [
            Cause(
                f"rise of {n} while running, {tau / 60:.0f} min late",
                "running",
                _lagged_product(state, n, tau, friction),
            )
            for n in placed.bodies
            for tau in late
        ]
    if placed.room is not None:
        out += [
            Cause(
                f"part that starts as {n}{_mix_text(mix, placed.room)} and follows {placed.room}, {tau / 3600:.3g} h",
                "follower",
                room_lag(placed.room, n, tau, mix),
                f"{n} {mix:g}",
            )
            for n in placed.starts
            for mix in MIXES
            for tau in slow
        ]
    return tuple(out)


def _mix_text(mix: float, room: str) -> str:
    return f" {100 * mix:.0f} % towards {room}" if mix else ""


def oil_friction(sensors: Sensors, thinning: float) -> d.Driver | None:
    """Friction of an oil at the machine's temperature at the start of the run, 1 at 20 degC; None if constant."""
    if thinning == 0.0:
        return None
    starts = tuple(d.at_start(n) for n in sensors.bodies)
    level = d.Affine(weights=(1.0 / len(starts),) * len(starts), of=starts)
    grid = np.linspace(*OIL_RANGE, 25)
    values = tuple(float(v) for v in np.exp(-thinning * (grid - OIL_REFERENCE)))
    return d.Lookup(of=level, start=float(grid[0]), step=float(grid[1] - grid[0]), values=values)


def room_lag(room: str, start: str, tau: float, mix: float = 0.0) -> d.Lag:
    """Rise since the start of the run of a part that follows the room, K.

    It starts at the temperature of `start`, or the share `mix` of the way from there to the room's.
    """
    parts: tuple[d.Driver, ...] = (d.Input(name=room), d.at_start(start))
    weights: tuple[float, ...] = (1.0, mix - 1.0)
    if mix:
        parts, weights = (*parts, d.at_start(room)), (*weights, -mix)
    return d.lag(d.Affine(weights=weights, of=parts), tau)


def lagged_difference(one: str, other: str, tau: float) -> d.Lag:
    """Difference of two sensors through a lag that starts at zero, K."""
    gap = d.Affine(weights=(1.0, -1.0), of=(d.Input(name=one), d.Input(name=other)))
    return d.lag(gap, tau)


def _lagged_product(state: d.Driver, name: str, tau: float, friction: d.Driver | None) -> d.Lag:
    factors = (state, d.rise(name)) if friction is None else (state, friction, d.rise(name))
    return d.lag(d.Product(of=factors), tau)


def columns(recording: Recording, drivers: Sequence[d.Driver]) -> np.ndarray:
    """Values of drivers, shape (rows, drivers); causal, NaN where an input is missing."""
    return drive_all(drivers, recording)
