"""The binary compensation table, `.ect` version 2: fixed little-endian records that a PLC STRUCT overlays.

`schemas/ect-2.md` describes every field; this file is its strict reader, `ect_writer` makes the bytes. Everything
the JSON twin holds is in the file, so both turn into each other without losing a bit. Reciprocals and lag factors are
stored beside their sources, and the reader refuses a file where the two disagree. A table of version 1 is read and
written as such.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from errpipe import files, jsonfile
from errpipe.domain import table as t
from errpipe.errors import VerifyError, did_you_mean
from errpipe.tables import layout as lay
from errpipe.tables.ect_writer import dumps

Row = tuple[Any, ...]  # the fields of one record
MAX_FILE_BYTES = 64 << 20  # the largest table allowed (4 million profile values of 4 bytes) has about 20 MB


def write(table: t.CompensationTable, path: Path) -> bool:
    """Write the binary file, whole. True if the bytes changed."""
    return jsonfile.write_bytes(path, dumps(table))


def sniff(path: Path) -> bool:
    """Whether a file begins as a table does, whatever it is called: one found on a stick may have any name."""
    with Path(path).open("rb") as file:
        return file.read(4) == lay.MAGIC[:4]


def read(path: Path) -> t.CompensationTable:
    """Read a binary file. Raises VerifyError saying what is wrong with it."""
    data = files.read(Path(path), MAX_FILE_BYTES, VerifyError)
    try:
        return loads(data)
    except VerifyError as err:
        raise VerifyError(f"{path}: {err}") from None


def write_json(table: t.CompensationTable, path: Path) -> bool:
    """Write the JSON twin. True if the bytes changed."""
    return jsonfile.write(path, table.model_dump(mode="json"))


def read_json(path: Path) -> t.CompensationTable:
    """Read the JSON twin. Raises VerifyError saying what is wrong with it."""
    return _of_json(jsonfile.read(path), path)


def read_either(path: Path) -> t.CompensationTable:
    """Read either twin, recognised by its content. Raises VerifyError."""
    try:
        with files.open_regular(Path(path)) as stream:
            start = stream.read(1)
    except FileNotFoundError:
        raise VerifyError(f"{path}: there is no such file") from None
    except OSError as err:
        raise VerifyError(f"{path}: {files.why(err)}") from None
    return read_json(path) if start == b"{" else read(path)


def loads_any(data: bytes) -> t.CompensationTable:
    """The table in the bytes of either twin. Raises VerifyError."""
    return _of_json(jsonfile.loads(data, "JSON twin"), "JSON twin") if data[:1] == b"{" else loads(data)


def _of_json(content: Any, path: Path | str) -> t.CompensationTable:
    if isinstance(content, dict) and "error_model" in content:
        raise VerifyError(f"{path}: is an error model (a compensation table is needed: what `export` makes of it)")
    try:
        return t.CompensationTable.model_validate(content)
    except ValidationError as err:
        raise VerifyError(f"{path}: {first_problem(err)}") from None


def fingerprint(table: t.CompensationTable) -> str:
    """CRC-32 in the file, as 8 hexadecimal digits: the identity that a controller shows."""
    return f"{struct.unpack_from('<I', dumps(table), 20)[0]:08x}"


def loads(data: bytes) -> t.CompensationTable:
    """The table in the bytes of a file. Raises VerifyError: damaged, truncated, foreign or contradicting itself."""
    fixed = _check_header(data)
    rows = _rows(data, _section_index(data))
    try:
        table = _build(data, fixed, rows)
    except ValidationError as err:
        raise VerifyError(first_problem(err)) from None
    if dumps(table) != data:
        raise VerifyError(_contradiction(dumps(table), data))
    return table


def _check_header(data: bytes) -> tuple[Any, ...]:
    if len(data) < 8 or data[:4] != lay.MAGIC[:4]:
        raise VerifyError("not a compensation table (it does not start with ECT)")
    if data[:8] != lay.MAGIC:
        raise VerifyError("damaged by a transfer in text mode (its line ends were changed)")
    if len(data) < lay.HEADER_SIZE:
        raise VerifyError(f"cut off: {len(data)} bytes, its header alone has {lay.HEADER_SIZE}")
    fixed = lay.HEADER.unpack_from(data)
    if fixed[1] not in lay.VERSIONS:
        raise VerifyError(
            f"format version {fixed[1]} (this program reads versions {lay.VERSIONS[0]} and {lay.VERSIONS[1]})"
        )
    if fixed[2] != lay.HEADER_SIZE:
        raise VerifyError(f"header size {fixed[2]} (version {fixed[1]} has {lay.HEADER_SIZE})")
    if fixed[3] != len(data):
        raise VerifyError(f"{'cut off' if len(data) < fixed[3] else 'too long'}: {len(data)} of {fixed[3]} bytes")
    checksum = zlib.crc32(data[lay.CRC_FROM :])
    if fixed[4] != checksum:
        raise VerifyError(f"damaged: checksum {checksum:08x} (the file says {fixed[4]:08x})")
    return fixed


def section(data: bytes, number: int) -> bytes:
    """The records of one section of sound data, as bytes."""
    count, offset = _section_index(data)[number]
    return data[offset : offset + count * _records(data)[number][1].size]


def _records(data: bytes) -> dict[int, tuple[str, struct.Struct]]:
    return lay.records(struct.unpack_from("<I", data, 8)[0])


def _section_index(data: bytes) -> dict[int, tuple[int, int]]:
    """Section id -> (count, offset), in the one order and place the version allows."""
    index = {}
    at = lay.HEADER_SIZE
    for position, (number, (what, record)) in enumerate(_records(data).items()):
        entry = lay.SECTION.unpack_from(data, lay.SECTIONS_AT + position * lay.SECTION.size)
        if entry[:2] != (number, record.size):
            raise VerifyError(f"section {number} ({what}): id {entry[0]} with records of {entry[1]} bytes")
        if entry[2] > lay.MAX_RECORDS[number]:
            raise VerifyError(f"{entry[2]} {what} (allowed: {lay.MAX_RECORDS[number]})")
        if entry[3] != at:
            raise VerifyError(f"section {number} ({what}) starts at {entry[3]}, not at {at}")
        size = record.size * entry[2]
        at += size + -size % 8
        if at > len(data):
            raise VerifyError(f"section {number} ({what}) extends past the end of the file")
        index[number] = entry[2], entry[3]
    if at != len(data):
        raise VerifyError(f"{len(data) - at} bytes after the last section")
    return index


def _rows(data: bytes, index: dict[int, tuple[int, int]]) -> dict[int, list[Row]]:
    rows = {}
    for number, (count, offset) in index.items():
        record = _records(data)[number][1]
        rows[number] = list(record.iter_unpack(data[offset : offset + count * record.size]))
    return rows


def _build(data: bytes, fixed: Row, rows: dict[int, list[Row]]) -> t.CompensationTable:
    machine, title, version, fingerprint = lay.IDENTITY.unpack_from(data, lay.IDENTITY_AT)
    inputs = [_text(r[0], "input name") for r in rows[1]]
    components = [_text(r[0], "component name") for r in rows[8]]
    return t.CompensationTable.model_validate(
        {
            "table": fixed[1],
            "machine": _text(machine, "machine"),
            "title": _text(title, "title"),
            "version": _text(version, "version"),
            "fingerprint": fingerprint.hex() if any(fingerprint) else "",
            "slow_every": fixed[5],
            "position_cycle_s": fixed[6],
            "ramp_s": fixed[8],
            "fade_s": fixed[9],
            "inputs": [_input(r, rows[2], inputs) for r in rows[1]],
            "nodes": [_node(n, r, rows[4], rows[5], inputs) for n, r in enumerate(rows[3])],
            "profiles": [_profile(n, r, rows[7], inputs) for n, r in enumerate(rows[6])],
            "components": [
                {"name": c, "unit": _allowed_at(lay.UNITS, r[1], "unit")}
                for c, r in zip(components, rows[8], strict=True)
            ],
            "pairs": [_pair(r, components) for r in rows[9]],
            "outputs": [_output(r, rows[11], components) for r in rows[10]],
        }
    )


def _input(row: Row, substitutes: list[Row], names: list[str]) -> dict[str, Any]:
    name, axis, unit, kind, flags, first, count = row[:7]
    low, high, max_rate, stale, hold, default, offset, valid_low, valid_high, margin, *noise = row[7:]
    return {
        "name": _text(name, "input name"),
        "kind": _allowed_at(lay.KINDS, kind, "input kind"),
        "axis": _text(axis, "axis"),
        "unit": _text(unit, "unit"),
        "low": low,
        "high": high,
        "max_rate": max_rate if flags & lay.HAS_MAX_RATE else None,
        "noise": noise[0] if noise else 0.0,
        "stale_after_s": stale if flags & lay.HAS_STALE else None,
        "substitute": [
            {"input": _allowed_at(names, s[0], "input"), "weight": s[1]}
            for s in _slice(substitutes, first, count, "substitutes")
        ],
        "substitute_offset": offset,
        "hold_s": hold if flags & lay.HAS_HOLD else None,
        "default": default,
        "optional": bool(flags & lay.OPTIONAL),
        "fade_on_default": bool(flags & lay.FADE_ON_DEFAULT),
        "valid": (valid_low, valid_high) if flags & lay.HAS_VALID else None,
        "margin": margin if flags & lay.HAS_VALID else None,
    }


def _node(number: int, row: Row, operands: list[Row], reals: list[Row], inputs: list[str]) -> dict[str, Any]:
    code, flags, first, count, other, others = row[:6]
    if code not in lay.BY_CODE:
        raise VerifyError(f"node {number}: operation {code} is unknown (allowed: 1..{len(lay.BY_CODE)})")
    op, cls, fields = lay.BY_CODE[code]
    own = _slice(operands, first, count, "operands")
    out: dict[str, Any] = {"op": op, "slow": bool(flags & lay.SLOW), "of": [o[0] for o in own]}
    out |= dict(zip(fields, row[6:], strict=False))
    if cls is t.AffineNode:
        out["weights"] = [o[1] for o in own]
    if cls is t.InputNode:
        out["input"] = _allowed_at(inputs, other, "input")
    if cls is t.LagNode:
        out["start"] = "zero" if flags & lay.START_ZERO else "input"
    if cls is t.DirectionNode:
        out["start"] = int(out["start"]) if out["start"] in (-1.0, 1.0) else out["start"]
    if cls is t.LookupNode:
        out["values"] = [r[0] for r in _slice(reals, other, others, "lookup values")]
    return out


def _profile(number: int, row: Row, values: list[Row], inputs: list[str]) -> dict[str, Any]:
    source, flags, first, count, start, step, _, _, scale, interpolation, rounding = row
    return {
        "input": None if source == -1 else _allowed_at(inputs, source, f"input of profile {number}"),
        "start": start,
        "step": step,
        "scale": scale,
        "periodic": bool(flags & lay.PERIODIC),
        "values": [v[0] for v in _slice(values, first, count, "profile values")],
        "interpolation_error": interpolation,
        "rounding_error": rounding,
    }


def _pair(row: Row, components: list[str]) -> dict[str, Any]:
    component, profile, driver, flags = row
    name = _allowed_at(components, component, "component")
    return {"component": name, "profile": profile, "driver": driver, "keep": bool(flags & lay.KEEP)}


def _output(row: Row, terms: list[Row], components: list[str]) -> dict[str, Any]:
    name, axis, units, flags, first, count, _, magnitude, slew, acceleration = row
    return {
        "name": _text(name, "output name"),
        "axis": _text(axis, "axis"),
        "unit": _allowed_at(lay.UNITS, units & 0xFF, "unit"),
        "correction_unit": _allowed_at(lay.CORRECTION_UNITS, units >> 8, "correction unit"),
        "magnitude": magnitude if flags & lay.HAS_MAGNITUDE else None,
        "slew": slew if flags & lay.HAS_SLEW else None,
        "acceleration": acceleration if flags & lay.HAS_ACCELERATION else None,
        "terms": [_term(r, components) for r in _slice(terms, first, count, "terms")],
    }


def _term(row: Row, components: list[str]) -> dict[str, Any]:
    component, count = row[:2]
    if count > t.MAX_FACTORS:
        raise VerifyError(f"a term has {count} factors (allowed: {t.MAX_FACTORS})")
    return {
        "weight": row[6],
        "component": _allowed_at(components, component, "component"),
        "factors": list(row[2 : 2 + count]),
    }


def _text(raw: bytes, what: str) -> str:
    try:
        return raw.rstrip(b"\0").decode()
    except UnicodeDecodeError:
        raise VerifyError(f"{what} is not UTF-8 text") from None


def _allowed_at(allowed: Any, number: int, what: str) -> Any:
    if not 0 <= number < len(allowed):
        raise VerifyError(f"{what} number {number} (allowed: 0..{len(allowed) - 1})")
    return allowed[number]


def _slice(rows: list[Row], first: int, count: int, what: str) -> list[Row]:
    if first + count > len(rows):
        raise VerifyError(f"{what} {first}..{first + count - 1} of only {len(rows)}")
    return rows[first : first + count]


def _contradiction(expected: bytes, actual: bytes) -> str:
    """Where a file that can be read is not what its own content writes: reserved bytes, reciprocals, lag factors."""
    pairs = enumerate(zip(expected, actual, strict=False))
    at = next((n for n, (a, b) in pairs if a != b and not 20 <= n < 24), min(len(expected), len(actual)))
    where = "header"
    for number, (_, offset) in _section_index(actual).items():
        if at >= offset:
            what, record = _records(actual)[number]
            where = f"{what}, record {(at - offset) // record.size}, byte {(at - offset) % record.size}"
    return f"contradicts itself at byte {at} ({where})"


def first_problem(err: ValidationError) -> str:
    """The first thing wrong, in words: where, what, what is allowed."""
    problem = err.errors()[0]
    place = ".".join(str(p) for p in problem["loc"])
    message = problem["msg"].removeprefix("Value error, ").replace("Input should", "it should")
    if problem["type"] == "extra_forbidden":
        message = f"there is no such key.{_nearest_field(problem['loc'])}"
    elif problem["type"] == "missing":
        message = "this key is missing"
    elif isinstance(problem["input"], int | float | str) and "Value error" not in problem["msg"]:
        message = f"found {problem['input']!r}, {message}"
    return f"{place}: {message}" if place else message


def _nearest_field(place: tuple[str | int, ...]) -> str:
    parts: dict[str, type[t.Part]] = {"inputs": t.TableInput, "profiles": t.Profile, "outputs": t.Output}
    part = parts.get(str(place[0]), t.CompensationTable) if len(place) > 1 else t.CompensationTable
    return did_you_mean(str(place[-1]), part.model_fields)
