"""Writer of the binary compensation table, `.ect` version 2 (`schemas/ect-2.md`): a table as bytes.

Layout: a header of 512 bytes (identity, cycles, table of 11 sections), then the sections, each starting at a multiple
of 8. What the controller would have to divide or exponentiate (reciprocal steps, lag factors) is stored beside its
source. `ect` reads this format.
"""

from __future__ import annotations

import struct
import zlib

from errpipe.domain import table as t
from errpipe.kernels.arithmetic import exp
from errpipe.tables import layout as lay


def dumps(table: t.CompensationTable) -> bytes:
    sections = _sections(table)
    at = lay.HEADER_SIZE
    index, body = b"", b""
    for number, (_, record) in lay.records(table.table).items():
        data = sections[number]
        index += lay.SECTION.pack(number, record.size, len(data) // record.size, at)
        data += bytes(-len(data) % 8)
        body += data
        at += len(data)
    identity = lay.IDENTITY.pack(
        table.machine.encode(), table.title.encode(), table.version.encode(), bytes.fromhex(table.fingerprint)
    )
    fixed = (table.slow_every, table.position_cycle_s, table.thermal_cycle_s, table.ramp_s, table.fade_s)
    head = lay.HEADER.pack(lay.MAGIC, table.table, lay.HEADER_SIZE, at, 0, *fixed) + identity + index
    whole = bytearray(head + bytes(lay.HEADER_SIZE - len(head)) + body)
    struct.pack_into("<I", whole, 20, zlib.crc32(whole[lay.CRC_FROM :]))
    return bytes(whole)


def _sections(table: t.CompensationTable) -> dict[int, bytes]:
    inputs = {i.name: n for n, i in enumerate(table.inputs)}
    components = {c.name: n for n, c in enumerate(table.components)}
    out: dict[int, bytes] = dict.fromkeys(lay.RECORDS, b"")
    substitutes = 0
    for i in table.inputs:
        out[1] += _input_record(i, substitutes)[: lay.records(table.table)[1][1].size]
        substitutes += len(i.substitute)
        out[2] += b"".join(lay.SUBSTITUTE.pack(inputs[s.input], s.weight) for s in i.substitute)
    operands = constants = 0
    for node in table.nodes:
        out[3] += _node_record(node, operands, constants, inputs, table)
        weights = node.weights if isinstance(node, t.AffineNode) else (1.0,) * len(node.of)
        out[4] += b"".join(lay.OPERAND.pack(o, w) for o, w in zip(node.of, weights, strict=True))
        operands += len(node.of)
        if isinstance(node, t.LookupNode):
            out[5] += struct.pack(f"<{len(node.values)}d", *node.values)
            constants += len(node.values)
    values = 0
    for p in table.profiles:
        out[6] += _profile_record(p, values, inputs)
        out[7] += struct.pack(f"<{len(p.values)}i", *p.values)
        values += len(p.values)
    out[8] = b"".join(lay.COMPONENT.pack(c.name.encode(), lay.UNITS.index(c.unit)) for c in table.components)
    out[9] = b"".join(
        lay.PAIR.pack(components[p.component], p.profile, p.driver, lay.KEEP if p.keep else 0) for p in table.pairs
    )
    terms = 0
    for o in table.outputs:
        out[10] += _output_record(o, terms)
        out[11] += b"".join(_term_record(m, components) for m in o.terms)
        terms += len(o.terms)
    return out


def _input_record(i: t.TableInput, first: int) -> bytes:
    names = (i.name.encode(), i.axis.encode(), i.unit.encode())
    numbers = (lay.KINDS.index(i.kind), lay.input_flags(i), first, len(i.substitute))
    hold = 0.0 if i.hold_s is None else i.hold_s  # `or` would turn -0.0 round
    reading = (i.low, i.high, i.max_rate or 0.0, i.stale_after_s or 0.0, hold, i.default)
    valid = (*(i.valid or (0.0, 0.0)), i.margin or 0.0)
    noise = i.noise if i.max_rate is not None else 0.0
    return lay.INPUT.pack(*names, *numbers, *reading, i.substitute_offset, *valid, noise)


def _node_record(
    node: t.AnyNode, first: int, constants: int, inputs: dict[str, int], table: t.CompensationTable
) -> bytes:
    code, _, fields = lay.OPERATIONS[node.op]
    flags = lay.SLOW if node.slow else 0
    parameters = [float(getattr(node, f)) for f in fields]
    number, count = 0, 0
    if isinstance(node, t.InputNode):
        number = inputs[node.input]
    if isinstance(node, t.LagNode):
        flags |= lay.START_ZERO if node.start == "zero" else 0
        parameters += lag_factors(node, table)
    if isinstance(node, t.LookupNode):
        parameters.append(1.0 / node.step)
        number, count = constants, len(node.values)
    parameters += [0.0] * (4 - len(parameters))
    return lay.NODE.pack(code, flags, first, len(node.of), number, count, *parameters)


def lag_factors(node: t.LagNode, table: t.CompensationTable) -> list[float]:
    """What remains of a difference after one cycle of the node's rate, rising and falling."""
    dt = table.thermal_cycle_s if node.slow else table.position_cycle_s
    return [exp(-(dt / node.tau_up)), exp(-(dt / node.tau_down))]


def _profile_record(p: t.Profile, first: int, inputs: dict[str, int]) -> bytes:
    number = -1 if p.input is None else inputs[p.input]
    inverse_turn = 1.0 / (len(p.values) - 1) if p.periodic else 0.0
    grid = (p.start, p.step, 1.0 / p.step, inverse_turn, p.scale)
    flags = lay.PERIODIC if p.periodic else 0
    return lay.PROFILE.pack(number, flags, first, len(p.values), *grid, p.interpolation_error, p.rounding_error)


def _output_record(o: t.Output, first: int) -> bytes:
    has = {lay.HAS_MAGNITUDE: o.magnitude, lay.HAS_SLEW: o.slew, lay.HAS_ACCELERATION: o.acceleration}
    flags = sum(flag for flag, value in has.items() if value is not None)
    units = lay.UNITS.index(o.unit) | lay.CORRECTION_UNITS.index(o.correction_unit) << 8
    limits = (o.magnitude or 0.0, o.slew or 0.0, o.acceleration or 0.0)
    return lay.OUTPUT.pack(o.name.encode(), o.axis.encode(), units, flags, first, len(o.terms), o.factor, *limits)


def _term_record(m: t.Monomial, components: dict[str, int]) -> bytes:
    factors = (*m.factors, *(lay.NONE,) * (t.MAX_FACTORS - len(m.factors)))
    return lay.TERM.pack(components[m.component], len(m.factors), *factors, m.weight)
