"""An error model as the table that a controller runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, ValidationError

from errpipe.domain.recording import ActsOn, Recording
from errpipe.errors import GateError, UsageError, did_you_mean, first_problem
from errpipe.stages import _artefacts
from errpipe.yamlfile import Options, quantity

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.table import CompensationTable, TableInput
    from errpipe.drivers.lowered import Lowered
    from errpipe.guard.description import SensorGuard


TURN = 360.0  # deg
USUAL = 1.5  # steps between targets: a larger gap in the turn counts as not measured


class CompileOptions(Options):
    """How a model becomes a table."""

    error_bound: float = quantity("um", "Largest interpolation error of any profile.", 0.01, gt=0)
    position_cycle: float = quantity("s", "Time between two corrections.", 0.001, ge=1e-6, le=10)
    thermal_cycle: float = quantity("s", "Time between two updates of slow drivers.", 1.0, gt=0, le=1e7)
    magnitude: float | None = quantity(
        "um", "Largest correction of an axis; default: what it can reach.", None, gt=0, le=1e6
    )
    slew: float | None = quantity(
        "um/s",
        "Largest rate of an axis' correction; default: from the axis motion, at most 1 um/ms.",
        None,
        gt=0,
        le=1e9,
    )
    acceleration: float | None = quantity(
        "um/s2", "Largest change of that rate; default: the whole rate within 10 ms.", None, gt=0, le=1e12
    )
    acts_on: dict[str, ActsOn] = Field(
        {},
        description="Component -> axis that corrects it: for E_D, E_R and others that name no axis themselves; "
        "default: what the recording states of the column.",
    )


def compile_model(
    model: ErrorModel, options: CompileOptions, guard: SensorGuard | None = None, recording: Recording | None = None
) -> CompensationTable:
    """The table of a model. Raises GateError for what a controller cannot be given.

    recording: how fast its sensors and axes moved limits readings and corrections.
    """
    # A table may have no room for a node more for each lag: these then start with the last sensor, as they do where
    # nothing estimates what a late one missed (grinding spindle of an own generator: 1.44 um instead of 2.20).
    estimates = guard is not None and (guard.compares or any(s.start is not None for s in guard.sensors))
    forms = (True, False) if estimates else (False,)
    for apart in forms:
        try:
            return _table_of(model, options, guard, recording, apart)
        except ValidationError as err:
            problem = err
    raise GateError(f"export: no table holds this model: {problem.title} {first_problem(problem)}") from None


def _table_of(
    model: ErrorModel, options: CompileOptions, guard: SensorGuard | None, recording: Recording | None, apart: bool
) -> CompensationTable:
    from errpipe import __version__, jsonfile, tables
    from errpipe.domain import driver as d
    from errpipe.fitting.lowering import lower, uncompensated_terms
    from errpipe.stages import _inputs

    held = guard.held if guard is not None else ()
    lowered = {
        name: [replace(p, driver=_inputs.bounded(p.driver, model, held)) for p in pairs]
        for name, pairs in lower(model).items()
    }
    empty = [name for name, pairs in lowered.items() if not pairs]
    if len(empty) == len(lowered):
        behind = ", ".join(sorted({t for terms in uncompensated_terms(model).values() for t in terms})) or "no term"
        raise GateError(f"export: a controller can compensate nothing of this model (it contains {behind})")
    followed = [p for pairs in lowered.values() for p in pairs]
    _inputs.refuse_unknown_inputs((p.driver for p in followed), model)
    axes = {p.axis for p in followed if p.axis is not None and p.profile is not None}
    placed = _inputs.with_positions(model, axes.union(*(d.axes(p.driver) for p in followed)), recording)
    inputs = _inputs.table_inputs(placed, guard, recording)
    if guard is not None:
        lowered = {name: [_guarded(p, guard, inputs, apart) for p in pairs] for name, pairs in lowered.items()}
    keep = None if model.validity.fades else False  # no box in the table, but it still fades where a sensor is lost
    sources = [
        tables.ComponentSource(c.component, c.unit, tuple(lowered[c.component]), keep)
        for c in model.components
        if lowered[c.component]
    ]
    stated = tables.Limits(options.magnitude, options.slew, options.acceleration)
    table = tables.compile_table(
        sources,
        outputs=tables.outputs_of(sources, _acts_on(options.acts_on, recording, [s.name for s in sources])),
        inputs=inputs,
        travel=_inputs.travel(placed),
        turning=_inputs.modulo_axes(placed),
        limited=_inputs.limited_rotary_axes(placed),
        error_bound=options.error_bound,
        position_cycle_s=options.position_cycle,
        thermal_cycle_s=options.thermal_cycle,
        machine=model.machine,
        title="; ".join(filter(None, [*_not_measured(placed, followed, recording), model.title])),
        version=__version__,
        fingerprint=jsonfile.fingerprint(_artefacts.model_json(model)),
    )
    speeds = travel_speeds(recording) if recording is not None else {}
    return tables.limited(table, speeds, of_axes=stated)


def _not_measured(model: ErrorModel, pairs: Sequence[Lowered], recording: Recording | None) -> list[str]:
    """The interpolated part of a turn: where the measured ends are further apart than the targets."""
    from errpipe.stages import _inputs, _plausible

    sentences = []
    curved = {p.axis for p in pairs if p.axis is not None and p.profile is not None and not p.period}
    for axis in sorted(_inputs.modulo_axes(model) & curved):
        low, high = _inputs.travel(model)[axis]
        places = np.empty(0)
        if recording is not None:
            column = recording.name("command", axis=axis) or recording.name("position", axis=axis)
            places = np.unique(recording.array(column)) if column is not None else places
        usual = float(np.diff(places[(places >= low) & (places <= high)]).max(initial=0.0))
        if low + TURN - high > USUAL * usual:
            sentences.append(_plausible.interpolated_turn(axis, high, low + TURN))
    return sentences


def travel_speeds(recording: Recording) -> dict[str, float]:
    """Axis -> its largest speed in the recording, mm/s or deg/s; axes whose speed it does not show are left out."""
    from errpipe.drivers.motion import axes

    speeds = {}
    for axis in (*axes(recording), *axes(recording, "rotary")):
        name = recording.name("velocity", axis=axis)
        speed = np.abs(recording.array(name)) if name is not None else np.empty(0)
        if speed.size and np.nanmax(speed, initial=0.0) > 0:
            speeds[axis] = float(np.nanmax(speed))
    return speeds


def _acts_on(
    stated: Mapping[str, ActsOn], recording: Recording | None, known: Sequence[str]
) -> dict[str, tuple[str, float]]:
    """Component -> (axis, factor). Raises UsageError for a component that is not exported, and for a factor of 0.

    Options of the export take precedence over the recording's column.
    """
    from errpipe.domain import components

    columns = recording.manifest.columns.values() if recording is not None else ()
    wanted = {
        c.component: c.acts_on
        for c in columns
        if c.component is not None and c.acts_on is not None and c.component in known
    }
    wanted |= stated
    out = {}
    for name, on in wanted.items():
        if name not in known:
            raise UsageError(f"export: {not_exported(name, known)}")
        factor = on.factor
        if factor is None:
            factor = 0.5 if components.parse(name).kind == "diameter" else 1.0
        if factor == 0.0:
            raise UsageError(f"export: acts_on: {name}: a factor of 0 corrects nothing")
        out[name] = (on.axis, factor)
    return out


def not_exported(name: str, known: Sequence[str]) -> str:
    """The message for an unknown component of `acts_on`."""
    return f"acts_on: {name!r} is not exported ({', '.join(known)}).{did_you_mean(name, known)}"


def _guarded(pair: Lowered, guard: SensorGuard, inputs: Sequence[TableInput], apart: bool) -> Lowered:
    """The pair with guarded readings, which stay where the table keeps those that are read. apart: see `guarded`."""
    from errpipe.guard.replace import trusted
    from errpipe.tables.bounds import input_span

    return replace(pair, driver=trusted(pair.driver, guard, {i.name: input_span(i) for i in inputs}, apart))
