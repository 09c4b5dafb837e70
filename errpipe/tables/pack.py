"""A table as the record arrays the kernels run on: the sections of its `.ect` file as they lie there."""

from __future__ import annotations

import numpy as np

from errpipe.domain import table as t
from errpipe.kernels import table_cycle as k
from errpipe.tables import ect

_SECTIONS = {
    "inputs": (1, k.INPUT_RECORD), "substitutes": (2, k.WEIGHTED), "nodes": (3, k.NODE_RECORD),
    "operands": (4, k.WEIGHTED), "lookups": (5, np.dtype("<f8")), "profiles": (6, k.PROFILE_RECORD),
    "values": (7, np.dtype("<i4")), "pairs": (9, k.PAIR_RECORD), "outputs": (10, k.OUTPUT_RECORD),
    "terms": (11, k.TERM_RECORD),
}  # fmt: skip


def program(table: t.CompensationTable) -> k.Program:
    """The arrays of a table."""
    data = ect.dumps(table)
    arrays = {name: np.frombuffer(ect.section(data, n), dtype).copy() for name, (n, dtype) in _SECTIONS.items()}
    slow = (arrays["nodes"]["flags"] & k.SLOW) != 0
    return k.Program(
        slow_every=table.slow_every,
        cycle_s=table.position_cycle_s,
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
        inputs=np.zeros(program.inputs.size, dtype=k.INPUT_STATE),
        nodes=np.zeros(program.nodes.size, dtype=k.NODE_STATE),
        profiles=np.zeros(program.profiles.size),
        components=np.zeros(components),
        outputs=np.zeros(program.outputs.size, dtype=k.OUTPUT_STATE),
        common=np.zeros(1, dtype=k.COMMON_STATE),
    )
    k.reset(program, made)
    return made
