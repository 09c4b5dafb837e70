"""Generated hostile inputs: each a name, and a function that writes it into a folder and gives the command lines.

Sound files of every kind with one thing wrong: cut, in another encoding, with values no number has, columns missing,
empty or twice, archives in archives. None of it lies in the repository; `test_corpus.py` runs all of it.
"""

from __future__ import annotations

import gzip
import io
import random
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tests.hostile.command_line import MANIFEST, PIPELINE, recording_folder
from tests.hostile.kills import measured

Words = list[list[str]]
Case = tuple[str, Callable[[Path], Words]]

EXPORT = """  - kind: fit
    components: [{component: EXX, terms: [{term: offset}, {term: scale_error, axis: X}]}]
  - {kind: validate}
  - {kind: export, ungated: true}
"""
CELLS = (
    *("NaN", "inf", "-inf", "1e400", "-1e308", "1e-400", "1_000", "0x10", "1d3", "--1", "=1+1", "true", "NULL", "1e"),
    *("\u0661\u0662", "\u00bd", "\ufeff1", "1\u00a0000", "\0", "5%", "9" * 400, "1" * 5000, " ", '"', "'1", "1\t2"),
    *("\u202e5", "1e15", "1e16", "2024-01-01"),
)
ENCODINGS = ("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "utf-7", "cp500", "latin-1")
NAMES = (
    "\u6e29\u5ea6",
    "T\u200bnut",
    "\u202eT",
    "e\u0301",
    "T nut",
    "T\nnut",
    "-T",
    "__class__",
    "a" * 300,
    "#T",
    "1",
    "",
)
IMPORTED = ["--yes", "--axis", "X", "--component", "EXX", "--unit", "um", "--sign", "actual-minus-commanded"]


def cases() -> Iterator[Case]:
    """All of them, in a fixed order."""
    from tests.hostile import corpus_files as files

    for group in (
        _cells,
        _csv_texts,
        _columns,
        _encodings,
        _manifests,
        _pipelines,
        _parquet,
        files.tables,
        files.imports,
        files.programs,
    ):
        yield from group()


def sound(folder: Path) -> Words:
    """What all others are made of, as it should be: every command line gives 0."""
    return _run(folder)


def sound_rows() -> str:
    """The sound CSV."""
    at = np.arange(40.0)
    rows = zip(at, 500 * (at % 10) / 9, 20 + np.sin(at), measured(at), strict=True)
    return "t,x,T_nut,dev\n" + "".join(",".join(f"{v:.6g}" for v in row) + "\n" for row in rows)


def _run(
    folder: Path, rows: bytes | None = None, manifest: bytes | None = None, pipeline: bytes | None = None
) -> Words:
    """A recording and a pipeline of which some bytes are given; checked, and run to the exported table."""
    rec = recording_folder(folder / "rec", dev=measured(np.arange(40)))
    if rows is not None:
        (rec / "rows.csv").write_bytes(rows)
    if manifest is not None:
        (rec / "recording.yaml").write_bytes(manifest)
    path = folder / "p.yaml"
    path.write_bytes((PIPELINE + EXPORT).encode() if pipeline is None else pipeline)
    return [["check", str(path)], ["run", str(path), "--out", str(folder / "out")]]


def _csv(text: str | bytes, folder: Path) -> Words:
    return _run(folder, rows=text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))


def _cells() -> Iterator[Case]:
    """One cell of each column that is no number, or one that nothing measures."""
    lines = sound_rows().splitlines()
    for column, name in enumerate(("t", "x", "T_nut", "dev")):
        for number, cell in enumerate(CELLS):
            row = lines[17].split(",")
            row[column] = cell
            text = "\n".join([*lines[:17], ",".join(row), *lines[18:], ""])
            yield f"cell {number} in {name}", partial(_csv, text)


def _csv_texts() -> Iterator[Case]:
    text = sound_rows()
    lines = text.splitlines()
    rng = random.Random(11)
    for n in range(12):
        yield f"CSV cut {n}", partial(_csv, text[: rng.randrange(len(text))])
    whole = {
        "no bytes": "",
        "header only": lines[0] + "\n",
        "header without a line feed": lines[0],
        "one row": "\n".join(lines[:2]) + "\n",
        "two rows": "\n".join(lines[:3]) + "\n",
        "only line feeds": "\n" * 500,
        "only commas": "," * 500 + "\n" + "," * 500,
        "CRLF": "\r\n".join(lines),
        "CR": "\r".join(lines),
        "mixed line ends": "".join(line + end for line, end in zip(lines, ["\n", "\r\n"] * 40, strict=False)),
        "line separators": "\u2028".join(lines),
        "vertical tabs": "\v".join(lines),
        "semicolons": text.replace(",", ";"),
        "tabs": text.replace(",", "\t"),
        "decimal commas": text.replace(",", ";").replace(".", ","),
        "empty lines": text.replace("\n", "\n\n"),
        "comments": "# a log\n" + text,
        "a column too many": "\n".join(line + ",1" for line in lines[1:]),
        "a header of megabytes": "t" * 3_000_000 + "\n" + text,
        "quotes without an end": text.replace(",", ',"', 1),
        "header in quotes over two lines": text.replace("T_nut", '"T\n_nut"', 1),
        "rows backwards": "\n".join([lines[0], *lines[:0:-1]]),
        "time stands still": "\n".join([lines[0], *("5" + line[line.index(",") :] for line in lines[1:])]),
        "all rows alike": "\n".join([lines[0], *[lines[3]] * 40]),
        "a gzip": gzip.compress(text.encode(), mtime=0),
        "random bytes": random.Random(5).randbytes(5000),
        "Parquet's mark": b"PAR1" + text.encode() + b"PAR1",
    }
    for name, content in whole.items():
        yield f"CSV: {name}", partial(_csv, content)


def _columns() -> Iterator[Case]:
    """Columns that are empty, missing, twice, constant or have another name than the manifest says."""
    rows = [line.split(",") for line in sound_rows().splitlines()]
    names = rows[0]
    for column, name in enumerate(names):
        made = {
            "empty": [[*r[:column], "" if n else r[column], *r[column + 1 :]] for n, r in enumerate(rows)],
            "missing": [r[:column] + r[column + 1 :] for r in rows],
            "twice": [[*r, r[column]] for r in rows],
            "constant": [[*r[:column], "7" if n else r[column], *r[column + 1 :]] for n, r in enumerate(rows)],
            "empty but once": [[*r[:column], "" if n > 1 else r[column], *r[column + 1 :]] for n, r in enumerate(rows)],
        }
        for what, table in made.items():
            yield f"column {name} {what}", partial(_csv, "\n".join(map(",".join, table)) + "\n")
    for n, name in enumerate(NAMES):
        header = ",".join('"' + name + '"' if column == "T_nut" else column for column in names)
        text = "\n".join([header, *map(",".join, rows[1:])]) + "\n"
        manifest = MANIFEST.replace("T_nut:", '"' + name.replace("\n", "\\n") + '":')
        yield f"sensor name {n}", partial(_run, rows=text.encode(), manifest=manifest.encode())


def _encodings() -> Iterator[Case]:
    for coding in ENCODINGS:
        named = sound_rows().replace("T_nut", "T_\u00e4" if coding == "latin-1" else "T_nut")
        yield f"CSV in {coding}", partial(_run, rows=named.encode(coding))
        yield f"manifest in {coding}", partial(_run, manifest=MANIFEST.replace("1\n", "1 # \u00e4\n", 1).encode(coding))
        yield f"pipeline in {coding}", partial(_run, pipeline=(PIPELINE + "# \u00e4\n").encode(coding))


def _manifests() -> Iterator[Case]:
    changed = {
        "CRLF": MANIFEST.replace("\n", "\r\n"),
        "CR": MANIFEST.replace("\n", "\r"),
        "tabs": MANIFEST.replace("  ", "\t"),
        "no bytes": "",
        "a list": "- 1\n",
        "a number": "7\n",
        "version of 400 digits": MANIFEST.replace("1", "9" * 400, 1),
        "version 1e999": MANIFEST.replace("1", "1e999", 1),
        "version true": MANIFEST.replace("1", "true", 1),
        "no tables": MANIFEST.replace("[rows.csv]", "[]"),
        "a table twice": MANIFEST.replace("[rows.csv]", "[rows.csv, rows.csv]"),
        "itself a table": MANIFEST.replace("rows.csv", "recording.yaml"),
        "its folder a table": MANIFEST.replace("rows.csv", "."),
        "a table of no name": MANIFEST.replace("rows.csv", "''"),
        "10,000 tables": MANIFEST.replace("rows.csv", ", ".join(["rows.csv"] * 10_000)),
        "two positions of X": MANIFEST.replace(
            "{role: temperature, unit: degC}", "{role: position, axis: X, unit: mm}"
        ),
        "two errors": MANIFEST.replace("{role: temperature, unit: degC}", "{role: error, component: EXX, unit: um}"),
        "no error": MANIFEST.replace("{role: error, component: EXX, unit: um}", "{role: ignore}"),
        "unit of another role": MANIFEST.replace("degC", "mm"),
        "unit of 10,000 letters": MANIFEST.replace("degC", "m" * 10_000),
        "axis not a letter": MANIFEST.replace("axis: X", "axis: \u1e8a"),
        "component unknown": MANIFEST.replace("EXX", "E" * 50),
        "columns empty": MANIFEST.split("  t:")[0],
        "column null": MANIFEST.replace("{role: time, unit: s}", "null"),
        "roles in a list": MANIFEST.replace("role: time", "role: [time]"),
        "keys as lists": MANIFEST.replace("  t:", "  ? [t]\n  :"),
        "keys as numbers": MANIFEST.replace("  t:", "  1:"),
        "keys merged": MANIFEST + "  <<: {t: 1}\n",
    }
    travel = "constants:\n  X: {role: axis, kind: linear, travel: %s, unit: mm}\n"
    for text in (
        "[500, 0]",
        "[0, .inf]",
        "[.nan, 1]",
        "[0, 1e308]",
        "[0, 0]",
        "[0]",
        "[a, b]",
        "{0: 1}",
        f"[0, {'9' * 400}]",
    ):
        changed[f"travel {text[:20]}"] = MANIFEST + travel % text
    for name, text in changed.items():
        yield f"manifest: {name}", partial(_run, manifest=text.encode())


def _pipelines() -> Iterator[Case]:
    sound = PIPELINE + EXPORT
    changed = {
        "CRLF": sound.replace("\n", "\r\n"),
        "no stages": "pipeline: 1\nstages: []\n",
        "stages null": "pipeline: 1\nstages:\n",
        "a stage null": sound + "  - null\n",
        "a stage twice": sound + "  - {kind: clean}\n",
        "the recording is the output": sound.replace("recording: rec", "recording: out"),
        "the recording is nothing": sound.replace("recording: rec", "recording: ''"),
        "the recording is a file": sound.replace("recording: rec", "recording: rec/rows.csv"),
        "a title of megabytes": "title: " + "a" * 2_000_000 + "\n" + sound,
        "a title in Chinese": "title: \u4e3b\u8f74\u6e29\u5ea6\n" + sound,
    }
    for option, values in {
        "magnitude": ("0", "-1", "1e308", ".nan", ".inf", "9" * 400, "[]"),
        "position_cycle": ("1e-300", "1e300", "0", "true"),
        "error_bound": ("1e-300", ".inf", "1e308"),
    }.items():
        for value in values:
            text = sound.replace("ungated: true", f"ungated: true, {option}: {value}")
            changed[f"{option} {value[:12]}"] = text
    for name, text in changed.items():
        yield f"pipeline: {name}", partial(_run, pipeline=text.encode())


def _with_parquet(make: Callable[[], bytes], folder: Path) -> Words:
    words = _run(folder, manifest=MANIFEST.replace("rows.csv", "rows.parquet").encode())
    (folder / "rec" / "rows.parquet").write_bytes(make())
    return words


def _arrow(change: Callable[..., object]) -> bytes:
    """The sound rows as Parquet, one column made otherwise."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet as pq

    table = pa.csv.read_csv(io.BytesIO(sound_rows().encode()))
    out = io.BytesIO()
    pq.write_table(change(pa, table), out)
    return out.getvalue()


def _column(make: Callable[..., object], pa: object, table: object) -> object:
    return table.set_column(2, "T_nut", make(pa, table))  # type: ignore[attr-defined]


def _parquet() -> Iterator[Case]:
    sound = _arrow(lambda pa, table: table)
    rng = random.Random(12)
    for n in range(12):
        yield f"Parquet cut {n}", partial(_with_parquet, partial(bytes, sound[: rng.randrange(len(sound))]))
    for name, data in {
        "no bytes": b"",
        "its mark": b"PAR1",
        "two marks": b"PAR1PAR1",
        "CSV": sound_rows().encode(),
    }.items():
        yield f"Parquet: {name}", partial(_with_parquet, partial(bytes, data))
    columns: dict[str, Callable[..., object]] = {
        "words": lambda pa, t: pa.array(["a"] * len(t)),
        "numbers in words": lambda pa, t: pa.array(["20"] * len(t)),
        "lists": lambda pa, t: pa.array([[1.0]] * len(t)),
        "structs": lambda pa, t: pa.array([{"a": 1}] * len(t)),
        "nothing": lambda pa, t: pa.nulls(len(t)),
        "booleans": lambda pa, t: pa.array([True] * len(t)),
        "dates": lambda pa, t: pa.array([0] * len(t), pa.date32()),
        "times": lambda pa, t: pa.array([0] * len(t), pa.timestamp("ns")),
        "largest integers": lambda pa, t: pa.array([2**63 - 1] * len(t)),
        "unsigned": lambda pa, t: pa.array([2**64 - 1] * len(t), pa.uint64()),
        "decimals": lambda pa, t: pa.array([1] * len(t)).cast(pa.decimal128(38, 0)),
        "bytes": lambda pa, t: pa.array([b"\xff"] * len(t)),
        "categories": lambda pa, t: pa.array(["a"] * len(t)).dictionary_encode(),
        "half floats": lambda pa, t: pa.array(np.full(len(t), np.float16(20))),
        "not a number": lambda pa, t: pa.array([float("nan")] * len(t)),
        "infinity": lambda pa, t: pa.array([float("inf")] * len(t)),
    }
    for name, make in columns.items():
        yield f"Parquet of {name}", partial(_with_parquet, partial(_arrow, partial(_column, make)))
    tables: dict[str, Callable[..., object]] = {
        "no rows": lambda pa, t: t.slice(0, 0),
        "one row": lambda pa, t: t.slice(0, 1),
        "no columns": lambda pa, t: t.select([]),
        "names twice": lambda pa, t: t.rename_columns(["t", "x", "x", "dev"]),
        "names empty": lambda pa, t: t.rename_columns(["", "", "", ""]),
    }
    for name, change in tables.items():
        yield f"Parquet: {name}", partial(_with_parquet, partial(_arrow, change))
