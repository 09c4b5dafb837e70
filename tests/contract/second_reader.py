"""A second reader of the compensation table (`.ect`), written from the text of `schemas/ect-2.md` alone.

It shares no line with the package: where the two disagree, one of them or the text is wrong. Nothing but the standard
library. Sections are those of `ect-2.md`; the cycle itself (sections 4 to 9) is in `second_cycle.py`.
"""

import math
import struct
import zlib
from collections.abc import Iterable, Iterator
from typing import Any

from tests.contract.second_functions import exp
from tests.contract.second_records import Component, Input, Link, Node, Number, Output, Pair, Profile, Table, Term

MAGIC = bytes.fromhex("454354000D0A1A0A")
HEADER = 512
NO_NODE = 0xFFFFFFFF


class Refused(ValueError):
    """The file breaks a rule of section 2 or 3; the text says which."""


# id - 1: record, its layout, the most records, may it be empty (section 2)
SECTIONS: tuple[tuple[Any, str, int, bool], ...] = (
    (Input, "<32s8s16sHHIII11d", 64, True),
    (Link, "<IId", 4096, True),
    (Node, "<HHIIIII4d", 1024, False),
    (Link, "<IId", 4096, True),
    (Number, "<d", 65536, True),
    (Profile, "<iIII7d", 512, False),
    (Number, "<i", 4194304, False),
    (Component, "<16sII", 64, False),
    (Pair, "<IIII", 2048, False),
    (Output, "<32s8sIIII4d", 64, False),
    (Term, "<IIIIIId", 4096, False),
)

# section 11: what version 1 has instead
SECTIONS_1 = ((Input, "<32s8s16sHHIII10d", 64, True), *SECTIONS[1:])

# unit, correction unit: factor (section 3.4)
FACTORS = {(0, 0): 0.001, (0, 1): 1.0, (1, 2): 1.0, (1, 3): 5.729577951308232e-05, (1, 4): 1e-06}

# operation: least and most operands (section 3.2)
OPERANDS = {
    1: (0, 0),
    2: (0, 0),
    3: (1, 64),
    4: (1, 1),
    5: (1, 1),
    6: (1, 16),
    7: (1, 1),
    8: (1, 1),
    9: (1, 1),
    10: (1, 2),
    11: (2, 2),
    12: (1, 1),
}
LAG, AFFINE, LOOKUP = 5, 3, 12


def check(sound: bool, rule: str) -> None:
    """Refuse the file if it breaks the rule (section 2, last paragraph)."""
    if not sound:
        raise Refused(rule)


def is_n(x: float) -> bool:
    """Section 1: parameters marked N."""
    return abs(x) <= 1e15


def is_p(x: float) -> bool:
    """Section 1: parameters marked P."""
    return 1e-15 < x <= 1e15


def same(x: float, y: float) -> bool:
    """Sections 2 and 3, a number that follows from others: equal to the bit, so that 0 is eight zero bytes."""
    return x == y and math.copysign(1, x) == math.copysign(1, y)


ALNUM = {*range(48, 58), *range(65, 91), *range(97, 123)}
BEYOND = set(range(128, 256))
TITLE = set(range(32, 127)) | BEYOND
NAME = ALNUM | set(b" _-.:+%/^()[]") | BEYOND
# Section 1: which signs the texts of a section may hold, in the order of its record.
SIGNS = {0: (NAME, ALNUM, NAME), 7: (NAME,), 9: (NAME, ALNUM)}


def text(raw: bytes, what: str, signs: set[int] = TITLE) -> str:
    """Section 1, char[n]: UTF-8 of certain signs, then zero bytes, at least one."""
    content, _, rest = raw.partition(b"\0")
    check(len(content) < len(raw) and not any(rest), f"{what} is not filled up with zero bytes")
    check(set(content) <= signs, f"{what} holds a sign that is not allowed")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        raise Refused(f"{what} is not UTF-8") from None


def load(data: bytes) -> Table:
    """Section 2: a table out of a file's bytes, or `Refused`."""
    check(len(data) >= HEADER, "shorter than its header")
    check(data[:8] == MAGIC, "no magic")
    version, header, size, crc, slow_every, zero = struct.unpack_from("<6I", data, 8)
    check(version in (1, 2), "format version is not 1 or 2")
    check(header == HEADER, "header size is not 512")
    check(size == len(data), "file size is wrong")
    check(crc == zlib.crc32(data[24:]), "CRC-32 is wrong")
    check(1 <= slow_every <= 1000000, "slow_every is out of range")
    check(zero == 0 and not any(data[496:HEADER]), "an unused field of the header is not zero")
    cycle, thermal, ramp, fade = times = struct.unpack_from("<4d", data, 32)
    check(all(map(math.isfinite, times)), "a number of the header is not finite")
    check(1e-6 <= cycle <= 10, "position_cycle is out of range")
    check(same(thermal, cycle * slow_every), "thermal_cycle is not position_cycle * slow_every")
    check(0 <= ramp <= 3600 and 0 <= fade <= 3600, "ramp or fade is out of range")
    machine, title = text(data[64:128], "machine"), text(data[128:256], "title")
    compiler = text(data[256:288], "version")
    layouts = SECTIONS_1 if version == 1 else SECTIONS
    sections = [_records(data, layouts, *place) for place in _places(data, layouts)]
    sections[4], sections[6] = [r.value for r in sections[4]], [r.value for r in sections[6]]
    table = Table(version, f"{crc:08x}", machine, title, compiler, slow_every, cycle, thermal, ramp, fade, *sections)
    _check_inputs(table)
    _check_nodes(table)
    _check_profiles(table)
    _check_components(table)
    _check_outputs(table)
    return table


def _places(data: bytes, layouts: tuple[Any, ...]) -> list[tuple[int, int, int]]:
    """Section 2, the list of sections: number, count and offset of each, all of them inside the file."""
    end, places = HEADER, []
    for i, (_, layout, most, empty) in enumerate(layouts):
        ident, record, count, offset = struct.unpack_from("<4I", data, 320 + 16 * i)
        check(ident == i + 1 and record == struct.calcsize(layout), f"section {i + 1}: id or record size is wrong")
        check((count > 0 or empty) and count <= most, f"section {i + 1}: too few or too many records")
        start = end + -end % 8
        check(offset == start, f"section {i + 1}: is not where the one before ends")
        check(not any(data[end:start]), f"section {i + 1}: the gap before it is not zero")
        end = start + record * count
        check(end <= len(data), f"section {i + 1}: ends behind the file")
        places.append((i, count, start))
    check(end + -end % 8 == len(data) and not any(data[end:]), "the file does not end behind its last section")
    return places


def _records(data: bytes, layouts: tuple[Any, ...], section: int, count: int, offset: int) -> list[Any]:
    """Section 3: the records of a section; words are words, numbers are finite (section 1)."""
    kind, layout, _, _ = layouts[section]
    end = offset + count * struct.calcsize(layout)
    records = []
    for i, fields in enumerate(struct.iter_unpack(layout, data[offset:end])):
        where = f"section {section + 1}, record {i}"
        for x in fields:
            check(not isinstance(x, float) or math.isfinite(x), f"{where}: a number is not finite")
        signs = iter(SIGNS.get(section, ()))
        records.append(kind(*(text(x, where, next(signs)) if isinstance(x, bytes) else x for x in fields)))
    return records


def _check_lists(lists: Iterable[tuple[int, int]], length: int, what: str) -> None:
    """Section 3: lists follow each other without gap or overlap and end with their section."""
    end = 0
    for first, count in lists:
        check(first == end, f"{what}: a list does not start where the one before ends")
        end += count
    check(end == length, f"{what}: the last list does not end with its section")


def _check_names(names: Iterable[str], what: str) -> None:
    """Section 3: names are not empty and unique."""
    names = list(names)
    check(all(names) and len(set(names)) == len(names), f"{what}: a name is empty or stands twice")


def _check_inputs(table: Table) -> None:
    """Section 3.1."""
    _check_names((r.name for r in table.inputs), "inputs")
    _check_lists(((r.first, r.count) for r in table.inputs), len(table.substitutes), "substitutes")
    for i, r in enumerate(table.inputs):
        check(all(_input_rules(r)), f"input {r.name}: a field is out of range")
        for link in table.substitutes[r.first : r.first + r.count]:
            check(link.target < len(table.inputs) and link.target != i, f"input {r.name}: substitute by no other input")
            check(not table.inputs[link.target].optional, f"input {r.name}: a substitute is optional")
            check(link.zero == 0 and is_n(link.weight), f"input {r.name}: a substitute's field is out of range")


def _input_rules(r: Input) -> Iterator[bool]:
    """Section 3.1, field by field."""
    yield r.kind <= 9 and r.flags < 64 and r.zero == 0
    yield is_n(r.low) and is_n(r.high) and r.high > r.low
    yield is_p(r.max_rate) if r.flags & 8 else same(r.max_rate, 0)
    yield 0 <= r.noise <= 1e15 if r.flags & 8 else same(r.noise, 0)
    yield is_p(r.stale_after) if r.flags & 16 else same(r.stale_after, 0)
    yield 0 <= r.hold <= 1e15 if r.flags & 32 else same(r.hold, 0)
    yield r.low <= r.default <= r.high and is_n(r.offset)
    if r.flags & 4:
        yield is_n(r.valid_low) and is_n(r.valid_high) and r.valid_high >= r.valid_low and is_p(r.margin)
    else:
        yield same(r.valid_low, 0) and same(r.valid_high, 0) and same(r.margin, 0)


def _check_nodes(table: Table) -> None:
    """Section 3.2."""
    _check_lists(((r.first, r.count) for r in table.nodes), len(table.operands), "operands")
    lookups = [(r.other, r.others) for r in table.nodes if r.operation == LOOKUP]
    _check_lists(lookups, len(table.lookups), "lookup values")
    check(all(map(is_n, table.lookups)), "a lookup value is too large")
    for i, r in enumerate(table.nodes):
        check(r.operation in OPERANDS, f"node {i}: no such operation")
        least, most = OPERANDS[r.operation]
        check(least <= r.count <= most, f"node {i}: too few or too many operands")
        check(r.flags < 4 and (r.flags < 2 or r.operation == LAG) and r.zero == 0, f"node {i}: flags")
        for link in table.operands[r.first : r.first + r.count]:
            check(link.target < i and link.zero == 0, f"node {i}: an operand does not stand before it")
            check(is_n(link.weight) and (link.weight == 1 or r.operation == AFFINE), f"node {i}: weight of an operand")
        check(_node_rule(r, table), f"node {i}: a parameter is out of range")
        used = {1: 1, 2: 0, 3: 1, 4: 0, 5: 4, 6: 0, 7: 1, 8: 2, 9: 2, 10: 2, 11: table.version, 12: 3}[r.operation]
        check(all(same(x, 0) for x in r[7 + used :]), f"node {i}: a parameter without a meaning is not 0")
        if r.operation != LOOKUP:
            check(r.others == 0 and (r.other == 0 or r.operation == 2), f"node {i}: other or others is not 0")


def _node_rule(r: Node, table: Table) -> bool:
    """Section 3.2, the columns a to d."""
    dt = table.thermal_cycle if r.slow else table.position_cycle
    match r.operation:
        case 1 | 3:
            return is_n(r.a)
        case 2:
            return r.other < len(table.inputs)
        case 5:
            return is_p(r.a) and is_p(r.b) and same(r.c, exp(-(dt / r.a))) and same(r.d, exp(-(dt / r.b)))
        case 7:
            return 0 < r.a <= 16
        case 8:
            return is_n(r.a) and is_n(r.b) and r.b >= r.a
        case 9:
            return is_n(r.a) and is_n(r.b) and r.b <= r.a
        case 10:
            return 0 <= r.a <= 1e15 and r.b in (-1, 1)
        case 11:
            return is_p(r.a) and 0 <= r.b <= 1e15
        case 12:
            return is_n(r.a) and is_p(r.b) and same(r.c, 1 / r.b) and r.others >= 2
        case _:
            return True


def _check_profiles(table: Table) -> None:
    """Section 3.3."""
    _check_lists(((r.first, r.count) for r in table.profiles), len(table.values), "profile values")
    for i, r in enumerate(table.profiles):
        check(-1 <= r.input < len(table.inputs) and r.flags < 2, f"profile {i}: input or flags")
        check(r.count >= 1 and (r.count == 1) == (r.input == -1), f"profile {i}: one value exactly if constant")
        check(is_n(r.start) and is_p(r.step) and is_p(r.scale), f"profile {i}: start, step or scale")
        check(same(r.per_step, 1 / r.step), f"profile {i}: 1 / step")
        check(r.interpolation >= 0 and r.rounding >= 0, f"profile {i}: largest errors")
        values = table.values[r.first : r.first + r.count]
        check(all(abs(v) < 2**30 for v in values), f"profile {i}: a value is too large")
        if not r.periodic:
            check(same(r.per_period, 0), f"profile {i}: 1 / (count - 1) without being periodic")
            continue
        check(r.count >= 3 and same(r.per_period, 1 / (r.count - 1)), f"profile {i}: 1 / (count - 1)")
        check(values[0] == values[-1], f"profile {i}: periodic, but does not end as it starts")
        period, span = (r.count - 1) * r.step, table.inputs[r.input]
        ends = (span.low, span.high, *((span.valid_low, span.valid_high) if span.flags & 4 else ()))
        far = max(abs(end - r.start) for end in ends)
        check(far / period <= 1e9, f"profile {i}: too many periods")


def _check_components(table: Table) -> None:
    """Section 3.4, components and pairs."""
    _check_names((r.name for r in table.components), "components")
    check(all(r.unit <= 1 and r.zero == 0 for r in table.components), "components: unit")
    for i, r in enumerate(table.pairs):
        inside = r.component < len(table.components) and r.profile < len(table.profiles) and r.node < len(table.nodes)
        check(inside and r.flags < 2, f"pair {i}: component, profile, node or flags")


def _check_outputs(table: Table) -> None:
    """Section 3.4, outputs and terms."""
    _check_names((r.name for r in table.outputs), "outputs")
    _check_lists(((r.first, r.count) for r in table.outputs), len(table.terms), "terms")
    for r in table.outputs:
        check(FACTORS.get((r.units % 256, r.units // 256)) == r.factor, f"output {r.name}: units or factor")
        check(r.flags < 8 and r.count >= 1, f"output {r.name}: flags or terms")
        for bit, x in ((1, r.magnitude), (2, r.slew), (4, r.acceleration)):
            check(is_p(x) if r.flags & bit else same(x, 0), f"output {r.name}: a limit is out of range")
    for i, t in enumerate(table.terms):
        check(t.component < len(table.components) and t.count <= 4 and is_n(t.weight), f"term {i}: a field")
        nodes = t[2:6]
        check(all(n < len(table.nodes) for n in nodes[: t.count]), f"term {i}: a factor is no node")
        check(all(n == NO_NODE for n in nodes[t.count :]), f"term {i}: an unused factor is not FFFFFFFF")
