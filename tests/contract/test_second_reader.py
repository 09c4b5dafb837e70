"""The specification of the compensation table alone is enough: a second reader, written from it, against the first.

Both must give every bit of the golden vectors, of random tables under random readings and of the edges where two
rules meet, and must accept or refuse the same damaged files.
"""

from __future__ import annotations

import ast
import math
import struct
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from errpipe.domain import table as t
from errpipe.errors import VerifyError
from errpipe.tables import ect, reference
from tests.contract import second_reader
from tests.contract.second_cycle import Evaluator
from tests.contract.second_functions import Single, exp, ln, power
from tests.golden import vectors
from tests.unit.tables.made import everything, modes, stimulus
from tests.unit.targets.c import test_c_runtime as c

NAMES = vectors.names()
every = pytest.mark.parametrize("number", range(len(NAMES)), ids=NAMES)
# Random tables that between them use every branch of sections 5 to 8 that random readings reach.
SEEDS = (0, 1, 2, 18, 28, 47, 48, 81, 174, 181, 196)

NUMBERS = (
    0.0,
    -0.0,
    5e-324,
    1e-15,
    math.nextafter(1e-15, 1),
    1e-6,
    0.5,
    1.0,
    -1.0,
    2.0,
    10.0,
    16.0,
    3600.0,
    1e9,
    1e15,
    -1e15,
    math.nextafter(1e15, math.inf),
    1e308,
    math.nan,
    math.inf,
    -math.inf,
)
WORDS = (
    0,
    1,
    2,
    3,
    4,
    5,
    7,
    8,
    63,
    64,
    255,
    256,
    257,
    0x201,
    0x301,
    0x401,
    1 << 30,
    (1 << 30) - 1,
    0x7FFFFFFF,
    0x80000000,
    0xC0000000,
    0xC0000001,
    0xFFFFFFFF,
)


@cache
def golden():
    return vectors.golden()


def bits(numbers) -> list[str]:
    """Every bit of some numbers, the sign of a zero too."""
    return [float(x).hex() for x in numbers]


def given(row, fresh) -> list[float | None]:
    """Readings of one cycle: None where there is no new one."""
    return [float(v) if new else None for v, new in zip(row, fresh, strict=True)]


def agree(table: t.CompensationTable, readings, fresh, enable) -> int:
    """Run both evaluators side by side; the status bits that were visited."""
    first, second = reference.Evaluator(table), Evaluator(second_reader.load(ect.dumps(table)))
    names = [i.name for i in table.inputs]
    visited = 0
    for k, row in enumerate(readings):
        values = given(row, fresh[k])
        theirs = first.cycle({n: v for n, v in zip(names, values, strict=True) if v is not None}, **modes(enable[k]))
        ours = second.cycle(int(enable[k]), values)
        assert bits(ours.deviations) == bits(theirs.deviation.values()), k
        assert bits(ours.corrections) == bits(theirs.correction.values()), k
        assert bits(s.y for s in second.nodes) == bits(first.nodes()), k
        assert (ours.status, ours.heartbeat) == (theirs.status, theirs.heartbeat), k
        assert [t.FAULTS[f] for f in ours.faults] == list(theirs.faults.values()), k
        assert ours.rejected == list(theirs.rejected.values()), k
        assert [t.SOURCES[s] for s in ours.sources] == list(theirs.sources.values()), k
        visited |= ours.status
    return visited


def test_it_needs_nothing_of_the_package():
    for name in ("reader", "cycle", "functions"):
        tree = ast.parse((Path(__file__).parent / f"second_{name}.py").read_text(encoding="utf-8"))
        modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        modules |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        plain = {"math", "struct", "zlib", "typing", "collections.abc"}
        assert {m for m in modules if not m.startswith("tests.contract.second_")} <= plain


@every
def test_golden_vectors_to_the_bit(number):
    name, data, readings, fresh, enable, results, status = golden()[number]
    assert name == NAMES[number]
    evaluator = Evaluator(second_reader.load(data))
    for k, row in enumerate(readings):
        cycle = evaluator.cycle(int(enable[k]), given(row, fresh[k]))
        assert bits(cycle.deviations + cycle.corrections) == bits(results[k])
        assert (cycle.status, cycle.heartbeat) == (status[k], k + 1)


@every
def test_after_a_reset_corrections_go_on_from_where_they_stand(number):
    _, data, readings, fresh, enable, *_ = golden()[number]
    table = ect.loads(data)
    first, second = reference.Evaluator(table), Evaluator(second_reader.load(data))
    for k in (*range(40), -1, *range(40)):
        if k < 0:
            before = dict(zip(names_of(table), (s.c for s in second.outputs), strict=True))
            first.reset()
            second.reset()
            assert table.table == 1 or before == dict(zip(names_of(table), (s.c for s in second.outputs), strict=True))
            continue
        k = min(k, len(readings) - 1)
        values = given(readings[k], fresh[k])
        known = {i.name: v for i, v in zip(table.inputs, values, strict=True) if v is not None}
        theirs, ours = first.cycle(known, **modes(enable[k])), second.cycle(int(enable[k]), values)
        assert bits(ours.corrections) == bits(theirs.correction.values()), k
        assert (ours.status, ours.heartbeat) == (theirs.status, theirs.heartbeat)


def names_of(table: t.CompensationTable) -> list[str]:
    return [o.name for o in table.outputs]


@every
def test_golden_tables_under_other_readings(number):
    table = ect.loads(golden()[number][1])
    agree(table, *stimulus(table, 150, number))


@pytest.mark.parametrize("seed", SEEDS)
def test_random_tables(seed):
    table = everything(seed)
    agree(table, *stimulus(table, 250, seed))


@pytest.mark.slow
def test_many_random_tables_visit_every_status_bit():
    visited = 0
    for seed in range(1000, 1150):
        table = everything(seed)
        visited |= agree(table, *stimulus(table, 300, seed))
    assert visited == (1 << len(t.STATUS)) - 1


# edges ----------------------------------------------------------------------------------------------

TICK = 2.0**-10  # so that times add up without rounding


def channel(name: str, **more) -> t.TableInput:
    return t.TableInput(name=name, kind="sensor", **({"low": -1000.0, "high": 1000.0, "default": 3.0} | more))


def shown(inputs, nodes, **more) -> t.CompensationTable:
    """A table of which each node is an output of its own, 1 um for 1."""
    components = tuple(t.Component(name=f"C{n}") for n in range(len(nodes)))
    pairs = tuple(t.Pair(component=f"C{n}", profile=0, driver=n, keep=True) for n in range(len(nodes)))
    outputs = tuple(
        t.Output(name=f"O{n}", correction_unit="um", terms=(t.Monomial(weight=1.0, component=f"C{n}"),), **more)
        for n in range(len(nodes))
    )
    return t.CompensationTable(
        position_cycle_s=TICK,
        slow_every=2,
        ramp_s=0.0,
        fade_s=4 * TICK,
        inputs=inputs,
        nodes=nodes,
        profiles=(t.Profile(values=(1,), scale=1.0),),
        components=components,
        pairs=pairs,
        outputs=outputs,
    )


def rows(*values):
    """Readings, fresh and enable of one input; None: nothing new."""
    fresh = np.array([[v is not None] for v in values], dtype=np.uint8)
    return np.array([[0.0 if v is None else v] for v in values]), fresh, np.ones(len(values), dtype=np.uint8)


@pytest.mark.parametrize(
    "more",
    [
        {"stale_after_s": 3 * TICK, "hold_s": 3 * TICK},
        {"stale_after_s": 3 * TICK, "hold_s": 0.0},
        {"max_rate": 8 / TICK},
        {"max_rate": 8 / TICK, "hold_s": 2 * TICK},
        {"valid": (-1.0, 1.0), "margin": 8.0},
        {"optional": True},
        {"fade_on_default": False, "hold_s": 0.0},
        {"low": 0.0, "high": 8.0, "hold_s": TICK},
    ],
    ids=str,
)
def test_readings_exactly_at_a_bound(more):
    table = shown((channel("a", **more),), (t.InputNode(input="a"), t.InputNode(input="a", slow=True)))
    pair = t.Pair(component="C0", profile=0, driver=0)  # this one fades
    table = table.model_copy(update={"pairs": (*table.pairs, pair)})
    agree(
        table,
        *rows(
            None,
            math.nan,
            0.0,
            8.0,
            16.0,
            32.0,
            None,
            8.0,
            None,
            None,
            None,
            None,
            None,
            None,
            -8.0,
            math.inf,
            0.0,
            1e30,
            2e30,
            -1e30,
            1.0,
            -1.0,
            9.0,
            -9.0,
            math.nextafter(1.0, 2.0),
            1000.0,
            math.nextafter(1000.0, 2000.0),
            None,
            None,
            None,
            -1000.0,
            -0.0,
            5e-324,
            0.0,
            -8.0,
            -24.0,
            math.nan,
            -40.0,
        ),
    )


def test_a_substitute_is_kept_within_the_range_of_its_input():
    inputs = (
        channel("a", low=-4.0, high=4.0, substitute=({"input": "b", "weight": 2.0},), substitute_offset=-1.0),
        channel("b", substitute=({"input": "a", "weight": 1.0},)),
    )
    table = shown(inputs, (t.InputNode(input="a"), t.InputNode(input="b"), t.FirstNode(of=(0,))))
    values = [(math.nan, None), (math.nan, 1.0), (9.0, 2.5), (9.0, 3.0), (9.0, -9.0), (2.0, math.nan), (9.0, math.nan)]
    fresh = np.array([[v is not None for v in row] for row in values], dtype=np.uint8)
    readings = np.array([[0.0 if v is None else v for v in row] for row in values])
    agree(table, readings, fresh, np.ones(len(values), dtype=np.uint8))


def test_operations_exactly_at_a_bound():
    of = (0,)
    nodes = (
        t.InputNode(input="a"),
        t.SwitchNode(of=of, on=8.0, off=0.0),
        t.SwitchNode(of=of, on=8.0, off=8.0),
        t.ClipNode(of=of, low=0.0, high=8.0),
        t.DirectionNode(of=of, threshold=0.0),
        t.DirectionNode(of=of, threshold=8.0, start=-1),
        t.DirectionNode(of=(0, 1), threshold=8.0),
        t.DirectionNode(of=of, threshold=8.0, slow=True),
        t.ApproachNode(of=(0, 4), length=1e-3),
        t.ApproachNode(of=(0, 5), length=1e14),
        t.LagNode(of=of, tau_up=TICK, tau_down=TICK / 4),
        t.LagNode(of=of, tau_up=1e-14, tau_down=1e14, start="zero"),
        t.LagNode(of=of, tau_up=0.125, tau_down=0.5, slow=True),
        t.LookupNode(of=of, start=-0.0, step=8.0, values=(-0.0, 5.0)),
        t.PowerNode(of=of, exponent=1.0),
        t.PowerNode(of=of, exponent=2.0),
        t.PowerNode(of=of, exponent=3.0),
        t.PowerNode(of=of, exponent=0.3),
        t.PowerNode(of=of, exponent=16.0),
        t.AffineNode(of=of, offset=0.0, weights=(1e15,)),
        t.PowerNode(of=(19,), exponent=2.5),
        t.ProductNode(of=(19, 19)),
        t.AffineNode(of=of, offset=0.0, weights=(1e-15,)),
        t.PowerNode(of=(22,), exponent=1.5),
        t.ProductNode(of=(22, 22, 22)),
        t.PowerNode(of=(24,), exponent=0.5),
    )
    way = [
        math.nan,
        0.0,
        8.0,
        0.0,
        4.0,
        -4.0,
        4.0,
        4.0,
        12.0,
        4.0,
        3.0,
        -0.0,
        0.0,
        7.0,
        -1.0,
        1e3,
        -1e3,
        5e-324,
        1e-7,
        -1e-7,
        1e-15,
        8.0,
        16.0,
        8.0,
        8.0,
        1.0,
        -7.0,
        1.0,
        1.5,
        2.0,
        3.0,
        5.0,
        8.0,
        13.0,
        5.0,
        3.0,
        2.0,
        1.0,
    ]
    assert agree(shown((channel("a"),), nodes), *rows(*way)) & 1 << 12


@pytest.mark.parametrize("slew", [None, 4.0 / TICK])
@pytest.mark.parametrize("acceleration", [None, 1.0 / TICK**2])
@pytest.mark.parametrize("magnitude", [None, 20.0])
def test_limits_that_are_met_exactly(slew, acceleration, magnitude):
    table = shown(
        (channel("a"),), (t.InputNode(input="a"),), slew=slew, acceleration=acceleration, magnitude=magnitude
    ).model_copy(update={"ramp_s": 8 * TICK})
    way = [0.0, 1.0, 3.0, 6.0, 10.0, 14.0, 18.0, 21.0, 23.0, 24.0, 24.0, 20.0, 16.0, *[-30.0] * 30, *range(-30, 0, 3)]
    readings, fresh, enable = rows(*map(float, [*way, *way, *[v / 3 for v in way]]))
    enable[60:75] = 0
    agree(table, readings, fresh, enable)


def test_functions_are_those_of_the_runtime():
    from errpipe.kernels import arithmetic

    r = np.random.default_rng(5)
    for y in [0.0, -0.0, 700.0, 701.0, -700.0, -701.0, 5e-324, *r.uniform(-710, 710, 300), *r.normal(0, 1, 300)]:
        assert exp(float(y)).hex() == arithmetic.exp(float(y)).hex()
    for x in [1.0, 1e-30, 2.0, 0.5, 1e300, *10 ** r.uniform(-30, 30, 300), *r.uniform(0.5, 2, 300)]:
        assert ln(float(x)).hex() == arithmetic.ln(float(x)).hex()
        for e in (1.0, 2.0, 3.0, 0.37, 2.5, 16.0):
            assert power(-float(x), e).hex() == float(arithmetic.power(-float(x), e)).hex()
    assert bits([power(-1e-31, 1.0), power(-0.0, 2.0)]) == bits([0.0, 0.0])


# damaged files ----------------------------------------------------------------------------------------


def refusals(data: bytes) -> tuple[str, str]:
    """What each reader says of a file; empty where it takes it."""
    words = []
    for load, error in ((ect.loads, VerifyError), (second_reader.load, second_reader.Refused)):
        try:
            load(data)
            words.append("")
        except error as err:
            words.append(str(err))
            assert words[-1]
    return words[0], words[1]


def changed(data: bytes, at: int, content: bytes) -> bytes:
    """A file with other bytes somewhere, its checksum mended unless it is the checksum that was changed."""
    out = bytearray(data)
    out[at : at + len(content)] = content
    if not 20 <= at < 24:
        struct.pack_into("<I", out, 20, zlib.crc32(out[24:]))
    return bytes(out)


def alike(data: bytes, where) -> bool:
    """Both readers take a file, or both refuse it."""
    first, second = refusals(data)
    assert bool(first) == bool(second), (where, first, second)
    return not first


@pytest.mark.parametrize("number", [0, 6])
def test_each_byte_of_the_header(number):
    data = golden()[number][1]
    taken = 0
    for at in range(512):
        for mask in (0x01, 0x80, 0xFF, data[at]):
            taken += alike(changed(data, at, bytes([data[at] ^ mask])), (at, mask))
    assert 100 < taken < 512 * 4  # texts and the fingerprint may be anything


def test_each_byte_without_mending_the_checksum():
    data = golden()[0][1]
    for at in range(len(data)):
        broken = bytearray(data)
        broken[at] ^= 1 << at % 8
        assert all(refusals(bytes(broken)))


@pytest.mark.parametrize(
    "number", [0, pytest.param(2, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)]
)
def test_each_field_with_each_odd_number(number):
    data = golden()[number][1]
    taken = 0
    step = 1 if number != 5 else 5
    for at in range(24, len(data), 8 * step):
        for value in NUMBERS:
            taken += alike(changed(data, at, struct.pack("<d", value)), (at, value))
    for at in range(8, len(data), 4 * step):
        for word in WORDS:
            taken += alike(changed(data, at, struct.pack("<I", word)), (at, word))
    assert taken > 100


def test_random_damage_in_every_section():
    r = np.random.default_rng(11)
    pool = [ect.dumps(everything(seed)) for seed in range(300, 320)]
    taken = 0
    for _ in range(900):
        data = pool[r.integers(len(pool))]
        at = int(r.integers(64, len(data) // 8)) * 8 if r.random() < 0.5 else int(r.integers(128, len(data) // 4)) * 4
        odd = struct.pack("<d", r.choice(NUMBERS)) if at % 8 == 0 else struct.pack("<I", int(r.choice(WORDS)))
        taken += alike(changed(data, at, odd), at)
    assert 60 < taken < 700


TEXTS = (
    b"",
    b" ",
    b"x" * 31,
    b"x" * 32,
    b"\xc3\xbc",
    b"\xc3",
    b"\xc0\x80",
    b"\xe0\x80\x80",
    b"\xed\xa0\x80",
    b"\xf0\x9f\x98\x80",
    b"\xf4\x90\x80\x80",
    b"\xff",
    b"a\0b",
    b"\x01\x7f",
)


@pytest.mark.parametrize("text", TEXTS, ids=repr)
def test_texts(text):
    data = golden()[0][1]
    for at, size in ((64, 64), (256, 32), (512, 32), (544, 8)):
        alike(changed(data, at, text.ljust(size, b"\0")[:size]), (at, text))


def test_cut_off_and_too_long():
    data = golden()[4][1]
    for size in (*range(0, 64), *range(64, len(data), 41), len(data) - 1):
        assert all(refusals(data[:size]))
        assert all(refusals(changed(data[:size], 16, struct.pack("<I", size)) if size > 24 else data[:size]))
    longer = data + bytes(8)
    assert all(refusals(longer)) and all(refusals(changed(longer, 16, struct.pack("<I", len(longer)))))


def test_the_gap_behind_an_odd_number_of_profile_values_is_zero():
    data = next(d for _, d, *_ in golden() if struct.unpack_from("<I", d, 320 + 16 * 6 + 8)[0] % 2)
    count, offset = struct.unpack_from("<2I", data, 320 + 16 * 6 + 8)
    assert all(refusals(changed(data, offset + 4 * count, b"\1")))


# single precision ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    return c.Library(c.build(tmp_path_factory.mktemp("c"), "-DECT_SINGLE"), np.float32)


@pytest.mark.toolchain
@pytest.mark.skipif(not c.COMPILERS, reason="no C compiler on this machine")
@every
def test_single_precision_is_the_c_runtime_to_the_bit(number, single):
    _, data, readings, fresh, enable, results, _ = golden()[number]
    evaluator = Evaluator(second_reader.load(data), Single)
    with np.errstate(over="ignore"):
        theirs = single.stream(ect.loads(data), readings, fresh, enable)
    for k, row in enumerate(readings):
        cycle = evaluator.cycle(int(enable[k]), given(row, fresh[k]))
        assert bits(cycle.deviations) == bits(theirs[0][k])
        assert bits(cycle.corrections) == bits(theirs[1][k])
        assert cycle.status == theirs[2][k]
        wanted = results[k][: len(cycle.deviations)]
        bound = vectors.single_bound(NAMES[number], results[:, : len(cycle.deviations)])
        assert np.abs(np.subtract(cycle.deviations, wanted)).max() <= bound
