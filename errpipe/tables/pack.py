"""A table as the record arrays that the kernels run on: the sections of its `.ect` file as they lie there; states."""

from __future__ import annotations

import numpy as np

from errpipe.domain import table as t
from errpipe.kernels import table_cycle as k
from errpipe.kernels.table_codes import SLOW
from errpipe.tables import ect


def _record(size: int, *stretches: tuple[int, str, str]) -> np.dtype:
    """A record of `size` bytes. stretches: first byte, type, and names of fields of that type side by side."""
    fields = [
        (n, kind, at + k * np.dtype(kind).itemsize) for at, kind, ns in stretches for k, n in enumerate(ns.split())
    ]
    names, formats, offsets = zip(*fields, strict=True)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


_INPUT_LIMITS = "low high max_rate stale hold default substitute_offset valid_low valid_high margin noise"
INPUT_RECORD = _record(160, (56, "<u2", "kind flags"), (60, "<u4", "first count"), (72, "<f8", _INPUT_LIMITS))
WEIGHTED = _record(16, (0, "<u4", "number"), (8, "<f8", "weight"))
NODE_RECORD = _record(56, (0, "<u2", "op flags"), (4, "<u4", "first count other others"), (24, "<f8", "a b c d"))
_PROFILE_GRID = "start step inverse_step inverse_turn scale"
PROFILE_RECORD = _record(72, (0, "<i4", "input"), (4, "<u4", "flags first count"), (16, "<f8", _PROFILE_GRID))
PAIR_RECORD = _record(16, (0, "<u4", "component profile node flags"))
OUTPUT_RECORD = _record(88, (44, "<u4", "flags first count"), (56, "<f8", "factor magnitude slew acceleration"))
TERM_RECORD = _record(32, (0, "<u4", "component count n0 n1 n2 n3"), (24, "<f8", "weight"))

INPUT_STATE = np.dtype(
    [(n, "f8") for n in ("raw", "wait", "good", "age", "anchor", "now", "left", "value")]
    + [(n, "i8") for n in ("seen", "usable", "fault", "source", "rejected")]
)
NODE_STATE = np.dtype(
    [(n, "f8") for n in ("value", "memory", "last", "before", "kept_value", "kept_memory")]
    + [(n, "i8") for n in ("ready", "steady", "departed", "stated", "changed")]
)
OUTPUT_STATE = np.dtype([(n, "f8") for n in ("deviation", "correction", "limited", "rate", "target")])
COMMON_STATE = np.dtype(
    [("fade", "f8"), ("ramp", "f8")] + [(n, "i8") for n in ("until_slow", "heartbeat", "status", "unready")]
)

_SECTIONS = {
    "inputs": (1, INPUT_RECORD),
    "substitutes": (2, WEIGHTED),
    "nodes": (3, NODE_RECORD),
    "operands": (4, WEIGHTED),
    "lookups": (5, np.dtype("<f8")),
    "profiles": (6, PROFILE_RECORD),
    "values": (7, np.dtype("<i4")),
    "pairs": (9, PAIR_RECORD),
    "outputs": (10, OUTPUT_RECORD),
    "terms": (11, TERM_RECORD),
}


def program(table: t.CompensationTable) -> k.Program:
    """The arrays of a table, in the records of version 2; a table of version 1 keeps its rules."""
    data = ect.dumps(table.model_copy(update={"table": 2}))
    arrays = {name: np.frombuffer(ect.section(data, n), dtype).copy() for name, (n, dtype) in _SECTIONS.items()}
    slow = (arrays["nodes"]["flags"] & SLOW) != 0
    return k.Program(
        rules=table.table,
        slow_every=table.slow_every,
        cycle_s=table.position_cycle_s,
        thermal_s=table.thermal_cycle_s,
        ramp_s=table.ramp_s,
        fade_s=table.fade_s,
        **arrays,
        every=np.arange(slow.size),
        fast=np.flatnonzero(~slow),
        same_grid=same_grid(arrays["profiles"]),
    )


def same_grid(profiles: np.ndarray) -> np.ndarray:
    """1 where a profile has input, start, step and count of the one before it, shape (profiles,)."""
    out = np.zeros(profiles.size, dtype=np.uint8)
    for p in range(1, profiles.size):
        same = all(profiles[p][f] == profiles[p - 1][f] for f in ("input", "flags", "count", "start", "step"))
        out[p] = same and profiles[p]["input"] >= 0
    return out


def state(program: k.Program) -> k.State:
    """A state at the start of a run."""
    components = 1 + max(int(program.pairs["component"].max(initial=0)), int(program.terms["component"].max(initial=0)))
    made = k.State(
        inputs=np.zeros(program.inputs.size, dtype=INPUT_STATE),
        nodes=np.zeros(program.nodes.size, dtype=NODE_STATE),
        profiles=np.zeros(program.profiles.size),
        components=np.zeros(components),
        outputs=np.zeros(program.outputs.size, dtype=OUTPUT_STATE),
        common=np.zeros(1, dtype=COMMON_STATE),
    )
    k.reset(program, made)
    return made
