"""Tables of single axes as one: a control's files number points, tables and drivers for all axes of a machine."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from errpipe.domain.table import CompensationTable, InputNode
from errpipe.domain.table import Output as TableOutput
from errpipe.errors import UsageError

MAX_NAME_BYTES = 31  # bytes of an input's name (schemas/ect-2.md)
# What tables that run together have in common
MAX_TITLE = 127  # characters, as the table holds them
SHARED = ("table", "position_cycle_s", "slow_every", "ramp_s", "fade_s")


def joined(tables: Sequence[CompensationTable]) -> CompensationTable:
    """One table that moves the axes of all of them; inputs of one name get their axis behind it, each stays its own.

    Raises UsageError if two move or read the same axis, are of different machines, run in different cycles, or have
    inputs of one long name.
    """
    first = tables[0]
    if len(tables) == 1:
        return first
    _refuse_same_axis(tables)
    if len(machines := {table.machine for table in tables if table.machine}) > 1:
        raise UsageError(
            f"tables of different machines ({', '.join(sorted(machines))}): of one machine, write one name as "
            "`machine` of their recordings and run again"
        )
    for fact in SHARED:
        if len(values := {getattr(table, fact) for table in tables}) > 1:
            raise UsageError(f"tables of different {fact} ({', '.join(map(str, sorted(values)))}) do not run as one")
    count = Counter(i.name for table in tables for i in table.inputs)
    parts: dict[str, list[Any]] = {key: [] for key in ("inputs", "nodes", "profiles", "components", "pairs", "outputs")}
    for table in tables:
        own = "".join(sorted(_moved(table)))
        names = {i.name: _renamed(i.name, own) if count[i.name] > 1 else i.name for i in table.inputs}
        for key, behind in _shifted(table, names, len(parts["nodes"]), len(parts["profiles"])).items():
            parts[key] += behind
    if twice := [name for name, n in Counter(i.name for i in parts["inputs"]).items() if n > 1]:
        raise UsageError(f"inputs of several tables would be called {', '.join(twice)}: give them shorter names")
    return CompensationTable.model_validate(
        {
            **{fact: getattr(first, fact) for fact in (*SHARED, "version")},
            "machine": max(table.machine for table in tables),
            "title": _title([*dict.fromkeys(table.title for table in tables)]),
            "fingerprint": hashlib.sha256("".join(t.fingerprint for t in tables).encode()).hexdigest(),
            **parts,
        }
    )


def _title(titles: list[str]) -> str:
    """All titles, each cut to its share where they are too long together: they begin with what to beware of."""
    text = ", ".join(titles)
    return text if len(text) <= MAX_TITLE else ", ".join(t[: MAX_TITLE // len(titles) - 2] for t in titles)


def _moved(table: CompensationTable) -> set[str]:
    return {output.axis or output.name for output in table.outputs}


def _refuse_same_axis(tables: Sequence[CompensationTable]) -> None:
    """Raise UsageError if an axis is moved or read by two: which of its ranges counts is not known."""
    checks: tuple[tuple[str, Callable[[CompensationTable], set[str]]], ...] = (
        ("move", _moved),
        ("read the position of", lambda table: {i.axis for i in table.inputs if i.kind == "position"}),
    )
    for what, of in checks:
        twice = [axis for axis, n in Counter(a for table in tables for a in of(table)).items() if n > 1]
        if twice:
            raise UsageError(
                f"two of the tables {what} {', '.join(twice)} (allowed: tables of different axes; fits of one pipeline "
                "are summed by its `export`, also those of several recordings)"
            )


def _renamed(name: str, axis: str) -> str:
    """A name with its axis behind it, as long as a controller can print it."""
    end = f"_{axis}"
    kept = name.encode()[: MAX_NAME_BYTES - len(end.encode())].decode(errors="ignore")
    return kept + end


def _shifted(
    table: CompensationTable, names: Mapping[str, str], nodes: int, profiles: int
) -> dict[str, Sequence[object]]:
    """The parts of a table behind so many nodes and profiles, its inputs called by other names."""
    return {
        "inputs": [
            i.model_copy(
                update={
                    "name": names[i.name],
                    "substitute": tuple(s.model_copy(update={"input": names[s.input]}) for s in i.substitute),
                }
            )
            for i in table.inputs
        ],
        "nodes": [
            n.model_copy(
                update={
                    "of": tuple(k + nodes for k in n.of),
                    **({"input": names[n.input]} if isinstance(n, InputNode) else {}),
                }
            )
            for n in table.nodes
        ],
        "profiles": [p.model_copy(update={"input": names.get(p.input or "", p.input)}) for p in table.profiles],
        "components": table.components,
        "pairs": [
            p.model_copy(update={"profile": p.profile + profiles, "driver": p.driver + nodes}) for p in table.pairs
        ],
        "outputs": [_output(o, nodes) for o in table.outputs],
    }


def _output(output: TableOutput, nodes: int) -> TableOutput:
    terms = (t.model_copy(update={"factors": tuple(k + nodes for k in t.factors)}) for t in output.terms)
    return output.model_copy(update={"terms": tuple(terms)})
