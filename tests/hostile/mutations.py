"""Bytes of a sound file changed, cut and repeated, so that what reads them has something to refuse."""

from __future__ import annotations

import io
import json
import random
import zipfile
from typing import Any

TOKENS = [
    b"../../precious.txt", b"/etc/passwd", b"\0", b"nan", b"-inf", b"1e400", b"1e30", b"9" * 400, b"-", b"&a", b"*a",
    b"${HOME}", b"!!python/object:os.system", b"{", b"[" * 60, b"}", b"'", b'"', b"\xff\xfe", b"\n", b"\r", b",", b";",
    b"G2 I-400", b"G4 P1 X500", b"(", b"%", b"X9999999999", b"P99999999", b"#1", b"0", b"null", b"true",
]  # fmt: skip


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, cut, repeated or replaced by what parsers dislike."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(7):
            case 0 if out:
                out[at % len(out)] = rng.randrange(256)
            case 1 if out:
                out[at % len(out)] ^= 1 << rng.randrange(8)
            case 2:
                del out[at : at + rng.choice((1, 2, 8, 64, len(out)))]
            case 3:
                out[at:at] = rng.choice(TOKENS)
            case 4:
                out[at : at + rng.randrange(1, 12)] = rng.choice(TOKENS)
            case 5:
                out[at:at] = out[at : at + rng.choice((1, 16, 200))] * rng.choice((1, 2, 50))
            case _:
                lines = bytes(out).split(b"\n")
                rng.shuffle(lines) if len(lines) < 200 and rng.random() < 0.2 else lines.insert(
                    rng.randrange(len(lines)), rng.choice(lines)
                )
                out = bytearray(b"\n".join(lines))
    return bytes(out[: 1 << 20])


def sealed(data: bytes) -> bytes:
    """A binary table with the length and check sum that it should have, so that the rest of it is looked at."""
    import struct
    import zlib

    from errpipe.tables import layout

    if len(data) < layout.HEADER_SIZE:
        return data
    out = bytearray(data)
    struct.pack_into("<I", out, 16, len(out))
    struct.pack_into("<I", out, 20, zlib.crc32(bytes(out[layout.CRC_FROM :])))
    return bytes(out)


def repacked(data: bytes, rng: random.Random) -> bytes:
    """An archive with one of its files changed, whole otherwise."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        chosen = rng.choice(source.namelist())
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, mutated(content, rng) if name == chosen else content)
    return out.getvalue()


OTHER = [
    None,
    True,
    0,
    -1,
    1e300,
    -1e-300,
    2**70,
    "",
    "x",
    "../../precious.txt",
    "\0",
    [],
    {},
    [[]],
    {"a": {}},
    ["x"] * 3,
]


def reshaped(data: bytes, rng: random.Random) -> bytes:
    """A JSON document with one or two of its values of another kind, gone, or doubled; sound JSON still."""
    value = {"document": json.loads(data)}
    for _ in range(rng.choice((1, 1, 2))):
        places: list[tuple[Any, Any]] = []
        waiting: list[Any] = [value]
        while waiting:
            inner = waiting.pop()
            keys = list(inner) if isinstance(inner, dict) else range(len(inner)) if isinstance(inner, list) else ()
            places += [(inner, key) for key in keys]
            waiting += [inner[key] for key in keys]
        inner, key = rng.choice(places)
        if rng.random() < 0.25 and inner is not value:
            del inner[key]
        elif rng.random() < 0.2 and isinstance(inner, list):
            inner.append(inner[key])
        else:
            inner[key] = rng.choice(OTHER)
    return json.dumps(value["document"]).encode()
