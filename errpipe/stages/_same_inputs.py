"""Whether the columns that a model or a table reads by name are, in a recording, what it was made for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Manifest
from errpipe.errors import DataError

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable

PLACES = {"position": ("position", "command", "actual"), "direction": ("direction",)}  # input of a table -> roles


def refuse_others(source: ErrorModel | CompensationTable, manifest: Manifest) -> None:
    """Raises DataError if a column has the name of an input, but another axis, role or unit: X in place of Y, say.

    What lacks a column is not looked at, nor what states neither.
    """
    means = dict(_of_model(source) if isinstance(source, ErrorModel) else _of_table(source))
    for name, (roles, axis, unit) in means.items():
        column = manifest.columns.get(name)
        if column is None:
            continue
        wrong = [
            f"{found} here, {' or '.join(allowed)} there"
            for found, allowed in ((column.role, roles), (f"axis {column.axis}", axis), (f"in {column.unit}", unit))
            if allowed and found not in allowed
        ]
        if wrong:
            raise DataError(f"column {name} is not what the compensation was made for ({'; '.join(wrong)})")


Means = Iterator[tuple[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]]]


def _of_model(model: ErrorModel) -> Means:
    for name, facts in model.columns.items():
        axis, unit, role = facts.get("axis"), facts.get("unit"), facts["role"]
        roles = PLACES["position"] if role in PLACES["position"] else (role,)
        yield name, (roles, (f"axis {axis}",) if axis else (), (f"in {unit}",) if unit else ())


def _of_table(table: CompensationTable) -> Means:
    for i in table.inputs:
        moves = i.kind in PLACES
        axis = (f"axis {i.axis}",) if moves and i.axis else ()
        yield i.name, (PLACES.get(i.kind, ()), axis, (f"in {i.unit}",) if i.unit else ())
