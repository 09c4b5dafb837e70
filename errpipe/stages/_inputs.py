"""The inputs of a compensation table, from what an error model states of its columns."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.components import is_rotary
from errpipe.domain.error_model import DatumReadings, ErrorModel
from errpipe.domain.recording import Recording
from errpipe.domain.table import Kind, TableInput
from errpipe.domain.table_text import AXIS, NAME, text_problem
from errpipe.errors import GateError, UsageError
from errpipe.fitting.validity import box
from errpipe.guard import rates
from errpipe.guard.description import GuardedSensor, KeptSensor, SensorGuard
from errpipe.guard.detect import FADE_S
from errpipe.guard.rates import ReadingRate
from errpipe.tables.turn import TURN

FORCE_STALE = 0.1  # s: an older force is of another cut
# Of the largest force or velocity that was fitted: what is proportional to it continues somewhat beyond it (by
# judgement). A larger force is that of a failed sensor, a larger velocity counts as this: either would move the axis
# by millimetres.
BEYOND = 2.0
DISPLAYED = 0.01  # deg: coarser than the last digit of any modulo display (by judgement)
# Role of a column -> kind of the controller's channel, lowest and highest plausible reading, stale after (s).
CHANNELS: dict[str, tuple[Kind, float, float, float | None]] = {
    "position": ("position", -1e5, 1e5, None),
    "command": ("position", -1e5, 1e5, None),
    "direction": ("direction", -1.0, 1.0, None),
    "velocity": ("velocity", -1e5, 1e5, None),
    "force": ("force", -1e6, 1e6, FORCE_STALE),
    "temperature": ("sensor", -40.0, 200.0, 60.0),
    "pressure": ("sensor", 0.0, 1e6, 600.0),
    "humidity": ("sensor", 0.0, 100.0, 600.0),
    "spindle_speed": ("speed", 0.0, 1e6, None),
    "coolant": ("coolant", 0.0, 1.0, None),
    "load": ("load", 0.0, 1e6, None),
    "feed": ("other", 0.0, 1e7, None),
    "current": ("other", -1e6, 1e6, FORCE_STALE),  # of a drive: a cutting force where none is read
    "torque": ("other", -1e6, 1e6, FORCE_STALE),
    "overhang": ("tool", 0.0, 1e5, None),
    "depth_of_cut": ("other", 0.0, 1e4, None),
    "cut_length": ("other", 0.0, 1e9, None),
}
POSITIONS = ("command", "position")  # roles that give the position of an axis, in order of preference
STEPPING = ("speed", "coolant", "load", "tool", "other")  # kinds that may step, read once in a thermal cycle
STEP_S = 0.5  # s until such a step is accepted: one bad sample that meets a thermal cycle is not
STEP_NOISE = 0.02  # of the range that was seen: a spindle's own ripple
FADE_SHARE = 0.5  # where the model states no margin: half the width of what was seen


def table_inputs(
    model: ErrorModel, guard: SensorGuard | None = None, recording: Recording | None = None
) -> list[TableInput]:
    """One channel per column of the model, in its order.

    guard: what a healthy sensor can read; recording: how fast its sensors moved, and how often they were read.
    """
    columns = dict(model.columns)
    _check_names(columns)
    healthy: dict[str, GuardedSensor | KeptSensor] = {s.name: s for s in guard.sensors} if guard is not None else {}
    compared_only = set(healthy) - set(columns)  # for comparison with the others: without them the table goes on
    for name in sorted(compared_only):
        columns[name] = {"role": "temperature", "unit": "degC"}
    inputs = [_channel(name, facts, model) for name, facts in columns.items() if facts["role"] in CHANNELS]
    inputs += [_datum(c.datum_input, c.unit, c.readings) for c in model.components if c.readings is not None]
    known, silence = _sensor_rates_and_silences(recording) if recording is not None else ({}, {})
    rates = {c.name: known.get(c.name) or _rate_of_step_input(c, model) for c in inputs}
    if guard is not None:
        healthy |= {s.name: s for s in guard.kept}
    inputs = [c.model_copy(update={"fade_on_default": False}) if c.name in compared_only else c for c in inputs]
    inputs = [_limited(c, rates[c.name], silence.get(c.name, 0.0), healthy.get(c.name)) for c in inputs]
    held = guard.held if guard is not None else ()
    unguarded = [c for c in inputs if healthy and c.kind == "sensor" and c.name not in (*healthy, *held)]
    holds = {c.name: {"hold_s": (c.stale_after_s or 0.0) + FADE_S} for c in unguarded}  # then lost: the table fades
    return [c.model_copy(update=holds.get(c.name, {})) for c in inputs]


def _sensor_rates_and_silences(recording: Recording) -> tuple[dict[str, ReadingRate], dict[str, float]]:
    """Column -> how fast its readings move where the last one is held until the next; and how long it may be silent.

    A controller sees a reading that comes every ten minutes as one step from one cycle to the next.
    """
    from errpipe.thermal.arithmetic import longest_silence, short_gaps_held

    names = [n for role in rates.ROLES for n in recording.names(role)]
    return rates.estimate_rates(short_gaps_held(recording, names)), longest_silence(recording, names)


def _limited(
    channel: TableInput, rate: ReadingRate | None, silence: float, sensor: GuardedSensor | KeptSensor | None
) -> TableInput:
    """A channel with what was learnt of its readings; silence: s between two of them; sensor: of a guard."""
    learnt: dict[str, Any] = {} if rate is None else {"max_rate": rate.max_rate, "noise": rate.noise}
    if channel.stale_after_s is not None:
        learnt["stale_after_s"] = max(channel.stale_after_s, silence)
    if sensor is not None:
        learnt |= {"low": sensor.low, "high": sensor.high}
        if isinstance(sensor, GuardedSensor):
            learnt["max_rate"] = max(sensor.max_rate, learnt.get("max_rate", 0.0))  # its recording may be a quiet one
        learnt["default"] = min(max(channel.default, sensor.low), sensor.high)
    return channel.model_copy(update=learnt)


def _datum(name: str, unit: str, readings: DatumReadings) -> TableInput:
    """The channel of the last reading minus its prediction: 0 if there is none, or it is stale or an outlier."""
    if problem := text_problem(name, 31, NAME):
        raise GateError(f"export: the input of readings {name!r} does not fit a table: {problem}")
    span: dict[str, Any] = {"low": -readings.bound, "high": readings.bound, "stale_after_s": readings.hold_s}
    return TableInput(name=name, kind="other", unit=unit, default=0.0, optional=True, **span)


def _check_names(columns: Mapping[str, Mapping[str, Any]]) -> None:
    """Raises GateError for a column whose name, axis or unit a table cannot hold."""
    for name, facts in columns.items():
        if facts["role"] not in CHANNELS:
            continue
        for what, value, longest, signs in (
            ("name", name, 31, NAME),
            ("axis", facts.get("axis") or "", 7, AXIS),
            ("unit", facts.get("unit") or "", 15, NAME),
        ):
            if problem := text_problem(value, longest, signs):
                raise GateError(
                    f"export: the {what} of column {name!r} does not fit a table: {problem}. "
                    "Rename it in the recording and its manifest."
                )


def _rate_of_step_input(channel: TableInput, model: ErrorModel) -> ReadingRate | None:
    """For what may rightly step, such as a speed: a change of all that was seen is accepted once it has stayed."""
    if channel.kind not in STEPPING:
        return None
    low, high = model.validity.ranges.get(channel.name, (0.0, 1.0 if channel.kind == "coolant" else 0.0))
    return ReadingRate((high - low) / STEP_S, STEP_NOISE * (high - low)) if high > low else None


def _channel(name: str, facts: Mapping[str, Any], model: ErrorModel) -> TableInput:
    kind, low, high, stale = CHANNELS[facts["role"]]
    seen = model.validity.ranges.get(name)
    axis, unit = facts.get("axis") or "", facts.get("unit") or ""
    if kind == "direction":
        return TableInput(name=name, kind=kind, axis=axis, low=low, high=high, default=0.0, optional=True)
    extra: dict[str, Any] = {"default": min(max(sum(seen) / 2 if seen else 0.0, low), high)}
    if kind == "force":  # missing: no force, so no force correction, and the rest continues
        extra = {"default": 0.0, "hold_s": 0.0, "fade_on_default": False}
        if largest := max(map(abs, seen or (0.0,))):
            low, high = -BEYOND * largest, BEYOND * largest
    elif seen is not None and model.validity.fades and kind not in ("position", "velocity", "coolant"):
        margin = model.validity.margins.get(name) or FADE_SHARE * max(seen[1] - seen[0], 1e-3)
        extra |= {"valid": seen, "margin": margin}
    if facts["role"] in ("current", "torque"):  # a lost one is not held: the next cut has another
        extra |= {"hold_s": 0.0}
    return TableInput(name=name, kind=kind, axis=axis, unit=unit, low=low, high=high, stale_after_s=stale, **extra)


def bounded(driver: d.Driver, model: ErrorModel, held: Collection[str] = ()) -> d.Driver:
    """A driver in which velocities and held temperatures count within `_limits`.

    The sign of a velocity, the direction, is read at any speed.
    """
    if isinstance(driver, d.Input):
        limits = _limits(driver.name, model, held)
        return driver if limits is None else d.Clip(of=driver, low=limits[0], high=limits[1])
    of = getattr(driver, "of", None)
    if of is None:
        return driver
    inside = tuple(bounded(x, model, held) for x in of) if isinstance(of, tuple) else bounded(of, model, held)
    return driver.model_copy(update={"of": inside})


def _limits(name: str, model: ErrorModel, held: Collection[str]) -> tuple[float, float] | None:
    """How far a velocity counts, `BEYOND`, and a held temperature: by the width of its recorded range beyond it.

    A failed input may drift to any value. A model with validity fades there instead.
    """
    low, high = model.validity.ranges.get(name, (0.0, 0.0))
    largest, width = max(abs(low), abs(high)), high - low
    if model.columns.get(name, {}).get("role") == "velocity":
        return (-BEYOND * largest, BEYOND * largest) if largest else None
    return (low - width, high + width) if name in held and width and not model.validity.fades else None


def travel(model: ErrorModel) -> dict[str, tuple[float, float]]:
    """Range of each axis' profiles, mm or deg: what was seen, else its travel."""
    axes = {letter: facts for letter, facts in model.constants.items() if facts.get("role") == "axis"}
    out = {letter: tuple(facts["travel"]) for letter, facts in axes.items() if facts.get("travel")}
    for name, facts in model.columns.items():
        seen = model.validity.ranges.get(name)
        if facts["role"] in POSITIONS and seen is not None and seen[1] > seen[0]:
            out[facts["axis"]] = seen
    return out


def with_positions(model: ErrorModel, axes: Iterable[str], recording: Recording | None) -> ErrorModel:
    """The model with the positions of all of `axes`, which its pairs follow though none of its terms reads them.

    Raises GateError for an axis whose position was not recorded, and for one without motion or a stated travel.
    """
    columns, ranges = dict(model.columns), dict(model.validity.ranges)
    for axis in sorted(axes):
        held = [n for n, c in columns.items() if c["role"] in POSITIONS and c.get("axis") == axis]
        if not held and recording is not None:
            held = [n for role in POSITIONS if (n := recording.name(role, axis=axis)) is not None][:1]
            columns |= {n: recording.manifest.columns[n].model_dump(exclude_none=True) for n in held}
            ranges |= dict(box(recording, held, np.full(len(recording), True)).ranges)
        if not held:
            raise GateError(f"export: the model follows {axis}, and no column of the recording holds its position")
    validity = model.validity.model_copy(update={"ranges": ranges})
    model = model.model_copy(update={"columns": columns, "validity": validity})
    for axis in sorted(set(axes) - set(travel(model))):
        kind = "rotary, travel: [0, 360]" if is_rotary(axis) else "linear, travel: [0, 500]"
        raise GateError(
            f"export: {axis} did not move in the recording, and its travel is not stated: it is unknown where the "
            f"correction is valid. State the travel in the recording's manifest, such as constants: "
            f"{{{axis}: {{role: axis, kind: {kind}}}}}"
        )
    return model


def modulo_axes(model: ErrorModel) -> set[str]:
    """Rotary axes with a stated travel of a turn or more (modulo axes)."""
    return {axis for axis, length in _stated_turns(model).items() if length >= TURN}


def limited_rotary_axes(model: ErrorModel) -> set[str]:
    """Rotary axes with a stated travel of less than a turn; 0 to 359.999 deg is how a modulo axis is displayed."""
    return {axis for axis, length in _stated_turns(model).items() if length < TURN - DISPLAYED}


def _stated_turns(model: ErrorModel) -> dict[str, float]:
    """Rotary axis -> length of its stated travel, deg."""
    ends = {x: facts["travel"] for x, facts in model.constants.items() if facts.get("travel")}
    return {x: high - low for x, (low, high) in ends.items() if model.constants[x].get("kind") == "rotary"}


def refuse_unknown_inputs(drivers: Iterable[d.Driver], model: ErrorModel) -> None:
    """Raises GateError naming an input below some drivers that no controller can feed (such as a recording's time).

    Raises UsageError if a term was given a response for a sensor.
    """
    readings = {c.datum_input for c in model.components if c.readings is not None}
    for name in sorted({name for driver in drivers for name in d.inputs(driver)} - readings):
        role = model.columns.get(name, {}).get("role")
        if role not in CHANNELS:
            refusal = UsageError if role in ("error", "simulated") else GateError
            raise refusal(f"a driver reads {name!r} (role {role}), which a controller cannot be given")
