"""A table as the arrays the kernels run on."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from errpipe.domain import table as t
from errpipe.kernels.table_cycle import Program, State, reset
from errpipe.tables import layout as lay
from errpipe.tables.ect import lag_factors


def program(table: t.CompensationTable) -> Program:
    """The arrays of a table."""
    inputs = {i.name: n for n, i in enumerate(table.inputs)}
    components = {c.name: n for n, c in enumerate(table.components)}
    return Program(
        slow_every=table.slow_every,
        cycle_s=table.position_cycle_s,
        ramp_s=table.ramp_s,
        fade_s=table.fade_s,
        **_inputs(table, inputs),
        **_nodes(table, inputs),
        **_profiles(table, inputs),
        pair=_table([(components[p.component], p.profile, p.driver, int(p.keep)) for p in table.pairs], 4, np.int64),
        **_outputs(table, components),
    )


def state(program: Program) -> State:
    """A state at the start of a run."""
    inputs, nodes, outputs = program.in_flags.size, program.op.size, program.o_flags.size
    components = int(program.pair[:, 0].max(initial=0)) + 1
    components = max(components, int(program.term[:, 0].max(initial=0)) + 1)
    reals = dict.fromkeys(("raw", "wait", "good", "age", "value"), inputs)
    reals |= {"node": nodes, "a": nodes, "profile": program.p_input.size, "component": components, "real": 2}
    reals |= dict.fromkeys(("deviation", "correction", "limited", "rate", "target"), outputs)
    integers = dict.fromkeys(("seen", "usable", "fault", "source"), inputs) | {"ready": nodes, "count": 4}
    made = State(
        **{name: np.zeros(size) for name, size in reals.items()},
        **{name: np.zeros(size, dtype=np.int64) for name, size in integers.items()},
    )
    reset(program, made)
    return made


def _firsts(counts: list[int]) -> np.ndarray:
    return np.array([0, *accumulate(counts)], dtype=np.int64)


def _table(rows: list[tuple], columns: int, dtype: type) -> np.ndarray:
    return np.array(rows, dtype=dtype).reshape(len(rows), columns)


def _inputs(table: t.CompensationTable, number: dict[str, int]) -> dict[str, np.ndarray]:
    flags, rows = [], []
    for i in table.inputs:
        flags.append(lay.input_flags(i))
        valid = i.valid or (0.0, 0.0)
        rows.append(
            (i.low, i.high, i.max_rate or 0.0, i.stale_after_s or 0.0, i.hold_s or 0.0, i.default, i.substitute_offset,
             *valid, i.margin or 0.0)
        )  # fmt: skip
    parts = [s for i in table.inputs for s in i.substitute]
    return {
        "in_flags": np.array(flags, dtype=np.int64),
        "in_real": _table(rows, 10, np.float64),
        "sub_first": _firsts([len(i.substitute) for i in table.inputs]),
        "sub_input": np.array([number[s.input] for s in parts], dtype=np.int64),
        "sub_weight": np.array([s.weight for s in parts], dtype=np.float64),
    }


def _nodes(table: t.CompensationTable, inputs: dict[str, int]) -> dict[str, np.ndarray]:
    par = np.zeros((len(table.nodes), 4))
    other = np.zeros(len(table.nodes), dtype=np.int64)
    others = np.zeros(len(table.nodes), dtype=np.int64)
    weights: list[float] = []
    reals: list[float] = []
    for n, node in enumerate(table.nodes):
        fields = [float(getattr(node, f)) for f in lay.OPERATIONS[node.op][2]]
        par[n, : len(fields)] = fields
        weights += node.weights if isinstance(node, t.AffineNode) else [1.0] * len(node.of)
        if isinstance(node, t.InputNode):
            other[n] = inputs[node.input]
        if isinstance(node, t.LagNode):
            par[n, 2:] = lag_factors(node, table)
            other[n] = node.start == "zero"
        if isinstance(node, t.LookupNode):
            par[n, 2] = 1.0 / node.step
            other[n], others[n] = len(reals), len(node.values)
            reals += node.values
    return {
        "op": np.array([lay.OPERATIONS[n.op][0] for n in table.nodes], dtype=np.int64),
        "slow": np.array([n.slow for n in table.nodes], dtype=np.int64),
        "other": other,
        "others": others,
        "par": par,
        "of_first": _firsts([len(n.of) for n in table.nodes]),
        "of": np.array([o for n in table.nodes for o in n.of], dtype=np.int64),
        "weight": np.array(weights, dtype=np.float64),
        "reals": np.array(reals, dtype=np.float64),
        "fast": np.array([k for k, n in enumerate(table.nodes) if not n.slow], dtype=np.int64),
    }


def _profiles(table: t.CompensationTable, inputs: dict[str, int]) -> dict[str, np.ndarray]:
    rows = []
    for p in table.profiles:
        last = len(p.values) - 1
        rows.append((p.start, 1.0 / p.step, p.scale, 1.0 / last if p.periodic else 0.0))
    firsts = _firsts([len(p.values) for p in table.profiles])
    return {
        "p_input": np.array([-1 if p.input is None else inputs[p.input] for p in table.profiles], dtype=np.int64),
        "p_periodic": np.array([p.periodic for p in table.profiles], dtype=np.int64),
        "p_first": firsts[:-1].copy(),
        "p_last": np.diff(firsts) - 1,
        "p_real": _table(rows, 4, np.float64),
        "values": np.array([v for p in table.profiles for v in p.values], dtype=np.int32),
    }


def _outputs(table: t.CompensationTable, components: dict[str, int]) -> dict[str, np.ndarray]:
    terms = [m for o in table.outputs for m in o.terms]
    rows = [(components[m.component], len(m.factors), *m.factors, *(0,) * (4 - len(m.factors))) for m in terms]
    limits = [(o.factor, o.magnitude or 0.0, o.slew or 0.0, o.acceleration or 0.0) for o in table.outputs]
    return {
        "o_flags": np.array([lay.output_flags(o) for o in table.outputs], dtype=np.int64),
        "o_real": _table(limits, 4, np.float64),
        "term_first": _firsts([len(o.terms) for o in table.outputs]),
        "term": _table(rows, 6, np.int64),
        "term_weight": np.array([m.weight for m in terms], dtype=np.float64),
    }
