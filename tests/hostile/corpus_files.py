"""Generated hostile inputs beside recordings: compiled tables, files to import, NC programs (see `corpus`)."""

from __future__ import annotations

import gzip
import io
import json
import random
import zipfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from tests.hostile.corpus import ENCODINGS, IMPORTED, Case, Words


def tables() -> Iterator[Case]:
    """Compiled tables and their JSON twins."""
    from errpipe.tables import ect
    from tests.unit.targets import machines

    table = machines.too_long_at_plus_x()
    sound = {"ect": ect.dumps(table), "json": json.dumps(table.model_dump(mode="json")).encode()}
    rng = random.Random(13)
    for kind, data in sound.items():
        made = {f"cut {n}": data[: rng.randrange(len(data))] for n in range(8)}
        made |= {
            "no bytes": b"",
            "twice": data * 2,
            "a mark in front": b"\xef\xbb\xbf" + data,
            "zeros": bytes(len(data)),
        }
        if kind == "json":
            made |= {c: data.decode().encode(c) for c in ("utf-16", "utf-32")}
            made |= {word: data.replace(b"0.001", word.encode()) for word in ("NaN", "1e999", "-0", "9" * 400, "null")}
        for name, changed in made.items():
            yield f"table.{kind}: {name}", partial(_table, kind, changed)


def _table(kind: str, data: bytes, folder: Path) -> Words:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"table.{kind}"
    path.write_bytes(data)
    export = ["export", str(path), "--target", "linuxcnc_screw", "--out", str(folder / "e")]
    return [["eval", str(path), "--at", "x=1"], ["whatis", str(path)], ["show", str(path)], export]


def _zipped(name: str, data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo(name), data)
    return out.getvalue()


def imports() -> Iterator[Case]:
    text = "position [mm];EXX [um];T nut [degC]\n" + "".join(
        f"{x};{0.02 * x};{20 + n}\n" for n, x in enumerate(range(0, 400, 20))
    )
    nested = text.encode()
    for depth in range(12):
        nested = _zipped(f"{depth}.xlsx", nested)
    files = {
        **{
            f"{kind} of no bytes": (f"m.{kind}", b"")
            for kind in ("csv", "xlsx", "tdms", "h5", "mat", "xml", "rtl", "log")
        },
        **{
            f"{kind} of other bytes": (f"m.{kind}", random.Random(6).randbytes(3000))
            for kind in ("xlsx", "tdms", "h5", "mat")
        },
        "archives in archives": ("m.xlsx", nested),
        "an archive named CSV": ("m.csv", nested),
        "a gzip named CSV": ("m.csv", gzip.compress(text.encode(), mtime=0)),
        "an archive of nothing": ("m.xlsx", b"PK\x05\x06" + bytes(18)),
        "an archive that leads out": ("m.xlsx", _zipped("../../x", b"x")),
        "one row": ("m.csv", "\n".join(text.splitlines()[:2]).encode()),
        "a header": ("m.csv", (text.splitlines()[0] + "\n").encode()),
        "columns twice": ("m.csv", text.replace("T nut [degC]", "EXX [um]").encode()),
        "a name in Chinese": ("\u6e29\u5ea6.csv", text.replace("T nut", "\u6e29\u5ea6").encode()),
        "names that are formulas": ("m.csv", text.replace("T nut", "=cmd|' /C calc'!A0").encode()),
        **{f"CSV in {coding}": ("m.csv", text.encode(coding)) for coding in ENCODINGS},
    }
    for name, (file, data) in files.items():
        yield f"import: {name}", partial(_import, file, data)


def _import(name: str, data: bytes, folder: Path) -> Words:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_bytes(data)
    return [["import", str(path), "--out", str(folder / "imported"), *IMPORTED], ["whatis", str(path)]]


def programs() -> Iterator[Case]:
    sound = "%\nG21 G90 G54\nG1 X100 Y20 F1000\nG2 X120 Y40 I20 J0\nG0 Z10\nM30\n%\n"
    longer = b"N" + b"9" * 5000
    changed = {
        "no bytes": b"",
        "CRLF": sound.replace("\n", "\r\n").encode(),
        "CR": sound.replace("\n", "\r").encode(),
        "a mark in front": b"\xef\xbb\xbf" + sound.encode(),
        "zero bytes": sound.replace("X", "\0X").encode(),
        "only a mark": b"%",
        "another alphabet": sound.replace("X", "\u0425").encode(),
        "utf-16": sound.encode("utf-16"),
        "a line number without end": longer + sound.encode(),
        "no end": sound[:40].encode(),
        "brackets": b"(" * 4000 + sound.encode(),
        "an arc of no radius": sound.replace("I20", "I0").encode(),
        "a circle of kilometres": sound.replace("I20", "I99999999").encode(),
    }
    for word in ("9" * 400, "NaN", "inf", "1e3"):
        changed[f"a coordinate {word[:6]}"] = sound.replace("100", word).encode()
    for name, data in changed.items():
        yield f"program: {name}", partial(_program, data)


def _program(data: bytes, folder: Path) -> Words:
    from errpipe.tables import ect
    from tests.unit.targets import machines

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "p.ngc").write_bytes(data)
    ect.write(machines.too_long_at_plus_x(), folder / "t.ect")
    program, table = str(folder / "p.ngc"), str(folder / "t.ect")
    return [["correct", program, "--table", table, "--start", "0,0,0", "--out", str(folder / "o.ngc")]]
