"""Both readers accept or refuse the same damaged files."""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np
import pytest

from errpipe.errors import VerifyError
from errpipe.tables import ect
from tests.contract import second_reader
from tests.contract.second_agreement import golden
from tests.unit.tables.made import everything

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
def test_each_field_with_each_unexpected_number(number):
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
