"""The two files of a table: every bit comes back, and what is not whole is refused in words."""

from __future__ import annotations

import json
import random
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from errpipe.domain import table as t
from errpipe.errors import VerifyError
from errpipe.tables import ect, layout, pack
from tests.unit.tables.made import everything, ten_um_too_long
from tests.unit.tables.refused import mended


@pytest.mark.parametrize("seed", range(20))
def test_every_bit_comes_back(seed, tmp_path):
    table = everything(seed)
    data = ect.dumps(table)
    assert ect.loads(data) == table and ect.dumps(ect.loads(data)) == data
    assert ect.write(table, tmp_path / "t.ect") and not ect.write(table, tmp_path / "t.ect")
    assert ect.read(tmp_path / "t.ect") == ect.read_either(tmp_path / "t.ect") == table
    ect.write_json(table, tmp_path / "t.json")
    assert ect.read_json(tmp_path / "t.json") == ect.read_either(tmp_path / "t.json") == table
    assert ect.dumps(ect.read_json(tmp_path / "t.json")) == data


@settings(max_examples=200, deadline=None)
@given(st.floats(-1e15, 1e15), st.floats(1e-12, 1e12), st.integers(-t.LARGEST_VALUE, t.LARGEST_VALUE))
def test_every_number_comes_back(number, positive, integer):
    table = ten_um_too_long()
    profile = table.profiles[0].model_copy(update={"start": number, "step": positive, "values": (integer, 0, -integer)})
    node = t.AffineNode(of=(0,), weights=(number,), offset=-number)
    table = table.model_copy(update={"profiles": (profile,), "nodes": (*table.nodes, node)})
    assert ect.dumps(ect.loads(ect.dumps(table))) == ect.dumps(table)
    assert ect.loads(ect.dumps(table)) == table


def test_fields_lie_where_the_format_page_says():
    table = ten_um_too_long(machine="vmc-1", title="X", version="0.1", position_cycle_s=0.002, thermal_cycle_s=0.5)
    data = ect.dumps(table)
    assert data[:8] == bytes.fromhex("45435400 0D0A1A0A")
    assert struct.unpack_from("<IIII", data, 8) == (2, 512, len(data), zlib.crc32(data[24:]))
    assert struct.unpack_from("<I4xdddd", data, 24) == (250, 0.002, 0.5, 0.0, 1.0)
    assert data[64:70] == b"vmc-1\0" and data[128:130] == b"X\0" and data[256:260] == b"0.1\0"
    sections = [struct.unpack_from("<IIII", data, 320 + 16 * n) for n in range(11)]
    assert [s[:2] for s in sections] == [
        (1, 160),
        (2, 16),
        (3, 56),
        (4, 16),
        (5, 8),
        (6, 72),
        (7, 4),
        (8, 24),
        (9, 16),
        (10, 88),
        (11, 32),
    ]
    assert [s[2] for s in sections] == [1, 0, 1, 0, 0, 1, 2, 1, 1, 1, 1]
    assert sections[0][3] == 512 and all(s[3] % 8 == 0 for s in sections) and len(data) % 8 == 0
    values = struct.unpack_from("<2i", data, sections[6][3])
    assert values == (0, 10000)


def test_the_kernels_records_are_the_files_records():
    pairs = (
        (pack.INPUT_RECORD, layout.INPUT),
        (pack.WEIGHTED, layout.SUBSTITUTE),
        (pack.WEIGHTED, layout.OPERAND),
        (pack.NODE_RECORD, layout.NODE),
        (pack.PROFILE_RECORD, layout.PROFILE),
        (pack.PAIR_RECORD, layout.PAIR),
        (pack.OUTPUT_RECORD, layout.OUTPUT),
        (pack.TERM_RECORD, layout.TERM),
    )
    for dtype, record in pairs:
        assert dtype.itemsize == record.size
    table = everything(5)
    program = pack.program(table)
    for n, i in enumerate(table.inputs):
        own = program.inputs[n]
        assert (own["low"], own["high"], own["default"]) == (i.low, i.high, i.default)
        assert own["substitute_offset"] == i.substitute_offset
        assert own["margin"] == (i.margin or 0.0) and own["count"] == len(i.substitute)
    for n, p in enumerate(table.profiles):
        own = program.profiles[n]
        assert (own["start"], own["scale"], own["count"]) == (p.start, p.scale, len(p.values))
        assert own["inverse_step"] == 1.0 / p.step
    for n, o in enumerate(table.outputs):
        own = program.outputs[n]
        assert (own["factor"], own["magnitude"], own["slew"]) == (o.factor, o.magnitude or 0.0, o.slew or 0.0)


def test_every_damaged_bit_is_noticed():
    data = ect.dumps(everything(4))
    for at in range(0, len(data), 7):
        broken = bytearray(data)
        broken[at] ^= 1 << at % 8
        with pytest.raises(VerifyError):
            ect.loads(bytes(broken))


@pytest.mark.parametrize("count", [0, 1, 4, 8, 100, 511, 512, 700])
def test_every_cut_is_noticed(count):
    with pytest.raises(VerifyError):
        ect.loads(ect.dumps(everything(4))[:count])


def test_damage_behind_a_mended_checksum_is_refused_or_sound():
    """What the reader lets through is a table that writes the very same bytes; nothing else escapes."""
    r = random.Random(3)
    sound = [ect.dumps(everything(s)) for s in range(70, 76)]
    taken = 0
    for _ in range(1500):
        data = bytearray(r.choice(sound))
        for _ in range(r.randint(1, 3)):
            data[r.randrange(24, len(data))] = r.randrange(256)
        broken = mended(data)
        try:
            assert ect.dumps(ect.loads(broken)) == broken
            taken += 1
        except VerifyError as err:
            assert "\n" not in str(err) and "pydantic" not in str(err)
    assert taken < 700


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"position_cycle_s": 0.0}, "position_cycle_s"),
        ({"slow_every": 0}, "slow_every"),
        ({"machine": "m" * 64}, "longer than 63 bytes"),
        ({"title": "a\0b"}, "control characters are not allowed"),
        ({"nodes": []}, "nodes"),
        ({"pairs": [{"component": "EYX", "profile": 0, "driver": 0}]}, "component 'EYX' is not in the table"),
        ({"pairs": [{"component": "EXX", "profile": 7, "driver": 0}]}, "no profile 7"),
        ({"nodes": [{"op": "first", "of": []}]}, "0 operands (allowed: 1..1)"),
        ({"nodes": [{"op": "input", "input": "T"}]}, "input 'T' is not in the table"),
        ({"nodes": [{"op": "constant", "value": 1e16}]}, "1000000000000000"),
        ({"profiles": [{"input": "x", "values": [1, 2], "scale": 0.0}]}, "scale"),
        ({"profiles": [{"input": "x", "values": [1, 2, 3], "periodic": True}]}, "ends on its first"),
        ({"profiles": [{"input": "x", "values": [1, 2, 1], "periodic": True, "step": 1e-9}]}, "1e9 periods"),
        ({"profiles": [{"values": [1 << 30]}]}, "1073741823"),
        ({"outputs": [{"name": "a", "unit": "urad", "terms": [{"weight": 1, "component": "EXX"}]}]}, "cannot be in mm"),
    ],
)
def test_a_twin_that_makes_no_sense_is_refused(change, words, tmp_path):
    twin = json.loads(ten_um_too_long().model_dump_json()) | change
    (tmp_path / "t.json").write_text(json.dumps(twin))
    with pytest.raises(VerifyError, match=r"t\.json: ") as output:
        ect.read_json(tmp_path / "t.json")
    assert words in str(output.value)


def test_fingerprint_is_the_checksum_a_controller_shows(tmp_path):
    table = everything(1)
    assert int(ect.fingerprint(table), 16) == struct.unpack_from("<I", ect.dumps(table), 20)[0]


def test_profiles_on_one_grid_stand_side_by_side():
    from bench.bench_tables import machine

    program = pack.program(machine())
    assert program.same_grid.sum() >= 15
    grids = np.flatnonzero(program.same_grid)
    for p in grids:
        assert program.profiles[p]["step"] == program.profiles[p - 1]["step"]
