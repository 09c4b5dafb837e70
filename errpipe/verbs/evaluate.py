"""A compensation table evaluated at one point."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from errpipe.errors import UsageError, did_you_mean
from errpipe.stages import _artefacts

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable, Output

SETTLED = 1e9  # s: every lag has reached its operand


def evaluate(table: Path, at: Mapping[str, float]) -> dict[str, Any]:
    """Deviation and correction at given readings; inputs that are not named are at their default.

    at: by the names of the table's inputs, or of a position by its axis, such as X.
    The readings are those of a settled machine with healthy sensors, on which a guard does not act: references are
    taken at the inputs' default values, then every lag settles.
    """
    from errpipe.guard.in_table import without_guard
    from errpipe.tables.reference import Evaluator

    compensation_table = without_guard(_artefacts.read_table(table))
    names = [i.name for i in compensation_table.inputs]
    of_axis = {i.axis: i.name for i in compensation_table.inputs if i.kind == "position"}
    at = {name if name in names else of_axis.get(name, name): value for name, value in at.items()}
    unknown = [name for name in at if name not in names]
    if unknown:
        near = did_you_mean(unknown[0], names)
        raise UsageError(f"{unknown[0]}: not an input of {table} (inputs: {', '.join(names)}).{near}")
    evaluator = Evaluator(compensation_table)
    start = {i.name: i.default for i in compensation_table.inputs if not (i.optional and i.name not in at)}
    fast = {i.name for i in compensation_table.inputs if i.fast}
    evaluator.cycle(start | {name: value for name, value in at.items() if name in fast}, dt=0.0)
    evaluator.cycle({**start, **at}, dt=SETTLED)
    cycle = evaluator.cycle({**start, **at}, dt=SETTLED)
    outputs = {o.name: o for o in compensation_table.outputs}
    deviation = {name: value / _share(outputs[name]) for name, value in cycle.deviation.items()}
    lines = [
        f"{name}: deviation {value:+.4f} {outputs[name].unit}, "
        f"correction {f'of {outputs[name].axis} ' if _share(outputs[name]) != 1.0 else ''}"
        f"{cycle.correction[name]:+.7f} {outputs[name].correction_unit}"
        for name, value in deviation.items()
    ]
    notes = _outside(compensation_table, at)
    absent = [f"{i.name} = {i.default:g}" for i in compensation_table.inputs if i.name not in at and not i.optional]
    return {
        "deviation": deviation,
        "correction": dict(cycle.correction),
        "outside": notes,
        "not_given": absent,
        "says": [*lines, *notes, *([f"not given, so at its default: {', '.join(absent)}"] if absent else [])],
    }


def _share(output: Output) -> float:
    """Motion of the axis per deviation of the component of its name: 0.5 of a diameter; 1 for a sum of components."""
    alone = output.terms[0] if len(output.terms) == 1 else None
    return alone.weight if alone is not None and alone.component == output.name and alone.weight else 1.0


def _outside(table: CompensationTable, at: Mapping[str, float]) -> list[str]:
    """Readings that the table rejects, or that lie beyond what was measured, in words."""
    from errpipe.validation.changes import of_table

    measured, out = of_table(table).ranges, []
    for i in (i for i in table.inputs if i.name in at):
        value, (low, high) = at[i.name], measured[i.name]
        if not i.low <= value <= i.high:
            out.append(f"{i.name} = {value:g} counts as no reading (allowed: {i.low:g} .. {i.high:g})")
        elif low < high and not low <= value <= high:
            out.append(f"{i.name} = {value:g} lies outside what was measured ({low:g} .. {high:g})")
    return out
