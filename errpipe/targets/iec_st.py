"""IEC 61131-3 Structured Text: one pair of function blocks that interprets any compensation table.

Value     corrections in each output's unit (mm), to be added to the commanded positions: minus the deviation.
Blocks    FB_EctLoad unpacks the bytes of an `.ect` file (checksum, every index) into a structure, FB_EctCycle runs it
          once per position cycle, FB_EctStore keeps the last good file in RETAIN memory and exchanges two tables while
          the machine runs (FB_EctSwitch), FB_EctFind numbers the inputs by name, FB_EctWatch reports missed calls. A
          new table is new bytes: nothing is compiled again.
          FB_EctLoad refuses what the other readers refuse, every rule of the format page.
Files     plain Structured Text; TwinCAT .TcPOU/.TcDUT/.TcGVL with errpipe.plcproj, a library project with its version;
          PLCopen XML (TC6 2.01). The table itself stands in them as an array of bytes (in the library it does not), so
          that a program runs before the first download.
Accepts   only what every compiler tried takes: no // comments, no __ in names, literal bounds, reals with a point,
          no TRUNC, explicit conversions, no rounding of ties (floor is LREAL_TO_DINT and a comparison), FOR only
          between literal bounds (MATIEC runs a FOR from a to a not at all), WHILE elsewhere, NOT only before a
          variable (STruC++ refuses it before a comparison).
Precision LREAL, the operations of the format page in its order: the bits of the other evaluators, where the compiler
          does not fuse or reorder them.
"""

from __future__ import annotations

import re
import uuid
import zlib
from collections.abc import Mapping
from html import escape  # as xml.sax.saxutils has it, which imports an HTTP client
from typing import Any

from errpipe.domain.table import CompensationTable
from errpipe.tables import ect
from errpipe.tables import layout as lay
from errpipe.targets._base import ReadBack, Target, expect, matched
from errpipe.targets._text import byte_rows, plain, source
from errpipe.targets._whole import WholeTable

TYPES = ("ECT_FILE", "ECT_INPUTS", "ECT_FRESH", "ECT_OUTPUTS", "ECT_TABLE")
FUNCTIONS = ("EctInt", "EctReal", "EctNull", "EctMisfit", "EctExp", "EctPower", "EctMove", "EctClosing")
BLOCKS = ("FB_EctLoad", "FB_EctCycle", "FB_EctSwitch", "FB_EctStore", "FB_EctFind", "FB_EctWatch")
DATA = "GVL_EctData"
LIBRARY_VERSION = "2.0.0"  # first number: of the table format; the others count changes of the blocks
# Room for other tables than the one exported: what the arrays hold at least.
MIN_CAPACITY = {
    "inputs": 32,
    "substitutes": 64,
    "nodes": 128,
    "operands": 256,
    "lookup values": 1024,
    "profiles": 64,
    "profile values": 8192,
    "components": 32,
    "pairs": 128,
    "outputs": 16,
    "terms": 128,
}
_NAMES = {"lookup values": "LOOKUPS", "profile values": "VALUES"}
_NAMESPACE = uuid.UUID("6f7a3f6e-5a1c-5b8e-9d6a-2f4f7c1f0a11")
_BYTES_PER_LINE = 24  # so that a line stays below 120 characters


class IecSt(Target):
    """Function blocks that interpret the whole table, for any IEC 61131-3 controller."""

    name = "iec_st"
    controller = "IEC 61131-3 (TwinCAT, CODESYS, PLCopen XML)"
    confidence = "verified"
    sign = "a positive value of afCorrection is added to the command: it moves the axis in plus"
    limits = "whole table; memory of the PLC (LREAL); arrays have room for tables twice as large"
    unit = "as the declarations name each input and output: mm (deg) unless the table says otherwise"
    holds = ("screw", "both directions", "cross", "temperature")
    remark = {"ect.st": "(* {} *)"}
    source = "IEC 61131-3 ed. 2 and 3; PLCopen TC6 XML 2.01; executed and compared in the tests"
    activation = (
        "example_twincat.st shows two tables that are exchanged, the last good file in RETAIN memory, AXIS_REF",
        "call FB_EctLoad once with the bytes of table.ect (or FB_EctData, GVL_EctData.aFile); bOk must be TRUE",
        "stTable.nName shows the table's checksum: compare it with `errpipe whatis table.ect`",
        "call FB_EctCycle once per position cycle of stTable.fCycle seconds; bit 0 of nStatus must be set",
        "read afCorrection at three points, with bEnable FALSE (all 0) and TRUE, before it is added to a command",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        capacities = capacity_for(table)
        units = {name: unit(name, capacities) for name in (*TYPES, *FUNCTIONS, *BLOCKS)}
        data = ect.dumps(table)
        files = {"ect.st": "\n".join([*units.values(), _data_unit(data, table)]), "example_twincat.st": _example(table)}
        for name, text in units.items():
            files[f"{name}.{'TcDUT' if name in TYPES else 'TcPOU'}"] = _twincat(name, text)
        size = f"VAR_GLOBAL\n    nFileSize : DINT := {len(data)};\n    aFile : ARRAY [0..{capacities['BYTES']}] OF BYTE"
        files[f"{DATA}.TcGVL"] = _twincat(DATA, f"{_shown(table)}{size} := [\n        {_rows(data)}];\nEND_VAR\n")
        files["ect.plcopen.xml"] = _plcopen(units)
        files["errpipe.plcproj"] = _library()
        return files

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        tables = [_bytes_of(name, files[name]) for name in ("ect.st", f"{DATA}.TcGVL") if name in files]
        expect(len(tables) == 2 and tables[0] == tables[1], cls.name, "the files do not hold one and the same table")
        return WholeTable.as_written(cls, files, tables[0])


def capacity_for(table: CompensationTable) -> dict[str, int]:
    """Highest index of each array: at least MIN_CAPACITY, and twice what the table needs."""
    data = ect.dumps(table)
    capacity = {}
    for number, (what, record) in lay.RECORDS.items():
        needed = len(ect.section(data, number)) // record.size
        capacity[_NAMES.get(what, what.upper())] = max(MIN_CAPACITY[what], 2 * needed, 1) - 1
    capacity["FACTORS"] = 4 * (capacity["TERMS"] + 1) - 1
    sizes = {_NAMES.get(what, what.upper()): record.size for what, record in lay.RECORDS.values()}
    capacity["BYTES"] = lay.HEADER_SIZE + sum(-(-(capacity[name] + 1) * size // 8) * 8 for name, size in sizes.items())
    return capacity


def unit(name: str, capacity: Mapping[str, int]) -> str:
    """One type, function or function block as Structured Text, its arrays sized."""
    text = source("targets/st", f"{name}.st")
    text = re.sub(r"^( *)@REALS p\+(\d+) (.*?)\{(.*?)\}(\[\w\])@$", _reals, text, flags=re.M)
    text = re.sub(r"@([48]) (?:(\w)\+)?(\d+)@", _bytes_at, text)
    return re.sub(r"@([A-Z]+)@", lambda m: str(capacity[m[1]]), text)


def _reals(match: re.Match[str]) -> str:
    """Lines that unpack consecutive numbers of a record into arrays."""
    indent, at, prefix, names, index = match[1], int(match[2]), match[3], match[4].split(","), match[5]
    lines = []
    for n, name in enumerate(names):
        places = ", ".join(f"aFile[p + {at + 8 * n + k}]" for k in range(8))
        lines.append(f"{indent}{prefix}{name}{index} := EctReal({places});")
    return "\n".join(lines)


def _bytes_at(match: re.Match[str]) -> str:
    """Four or eight bytes of the file from a place on, as arguments."""
    count, base, at = int(match[1]), match[2], int(match[3])
    numbers = [f"{base} + {at + k}" if base and at + k else base or str(at + k) for k in range(count)]
    return ", ".join(f"aFile[{n}]" for n in numbers)


def _shown(table: CompensationTable) -> str:
    """Header above the bytes: the table's name, and the indices of readings and corrections with their names."""
    arrays: Any = (("afReading", table.inputs), ("afCorrection", table.outputs))
    lines = [
        f"   {kind}[{n}]: {plain(part.name)}, {plain(unit) or '-'}, name DWORD#16#{name_number(part.name):08X}"
        for kind, parts in arrays
        for n, part in enumerate(parts)
        for unit in [getattr(part, "correction_unit", None) or part.unit]
    ]
    shown = "\n".join(lines)
    return f"(* Table {ect.fingerprint(table)}: {plain(table.machine)} {plain(table.title)}\n{shown} *)\n"


def _rows(data: bytes) -> str:
    """Only the bytes of this table: a PLC fills the rest with zeros, and FB_EctLoad takes nSize of them."""
    return byte_rows(data, _BYTES_PER_LINE, ",\n        ")


def _data_unit(data: bytes, table: CompensationTable) -> str:
    """The table's bytes as a function block that hands them over: global variables outside a resource are refused."""
    rows = _rows(data)
    return (
        f"{_shown(table)}FUNCTION_BLOCK FB_EctData\nVAR_IN_OUT\n    aFile : ECT_FILE;\nEND_VAR\n"
        f"VAR_OUTPUT\n    nFileSize : DINT := {len(data)};\nEND_VAR\n"
        f"VAR\n    aBytes : ARRAY [0..{len(data) - 1}] OF BYTE := [\n        {rows}];\n    i : DINT;\nEND_VAR\n"
        f"    i := 0;\n    WHILE i <= nFileSize - 1 DO\n        aFile[i] := aBytes[i];\n        i := i + 1;\n"
        "    END_WHILE;\nEND_FUNCTION_BLOCK\n"
    )


def name_number(name: str) -> int:
    """What FB_EctFind looks a name up by: the CRC-32 of its field of 32 bytes."""
    return zlib.crc32(name.encode().ljust(32, b"\0"))


def _example(table: CompensationTable) -> str:
    """A program for TwinCAT: two tables, the last good file kept, readings by name, the correction handed to the axis.

    As read from Beckhoff's manuals (TF50x0 NC PTP, position correction; Tc2_MC2, AXIS_REF); not run here.
    """
    arrays: Any = (table.inputs, table.outputs)
    output = next((o for o in table.outputs if o.axis), table.outputs[0])
    names = "\n".join(
        f"    {number}: DWORD#16#{name_number(part.name):08X} {plain(part.name)}"
        for parts in arrays
        for number, part in enumerate(parts)
    )
    text = source("targets/st", "P_EctExample.st")
    first = next((i for i in table.inputs if i.kind == "position"), table.inputs[0] if table.inputs else output)
    for mark, value in {
        "@names@": names,
        "@output@": f"DWORD#16#{name_number(output.name):08X}",
        "@input@": f"DWORD#16#{name_number(first.name):08X}",
    }.items():
        text = text.replace(mark, value)
    return text


def _bytes_of(name: str, text: str) -> bytes:
    size = matched(r"nFileSize : DINT := (\d+);", text, name, "holds no table")
    pattern = r"(?:aFile|aBytes) : ARRAY \[0\.\.\d+\] OF BYTE := \[([\d,\s]*)\];"
    match = matched(pattern, text, name, "holds no table")
    values = [int(v) for v in match[1].split(",")]
    expect(len(values) == int(size[1]) and all(v < 256 for v in values), name, f"{len(values)} bytes of {size[1]}")
    return bytes(values)


# TwinCAT ----------------------------------------------------------------------------------------------


def split(text: str) -> tuple[str, str]:
    """(declaration, body) of a function or function block."""
    lines = text.splitlines()
    last = max(n for n, line in enumerate(lines) if line == "END_VAR")
    return "\n".join(lines[: last + 1]) + "\n", "\n".join(lines[last + 1 : -1]) + "\n"


def _twincat(name: str, text: str) -> str:
    identity = f"{{{uuid.uuid5(_NAMESPACE, name)}}}"
    head = '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1">\n'
    if name == DATA:
        inner = f'  <GVL Name="{name}" Id="{identity}">\n    <Declaration><![CDATA[{text}]]></Declaration>\n  </GVL>\n'
    elif name in TYPES:
        inner = f'  <DUT Name="{name}" Id="{identity}">\n    <Declaration><![CDATA[{text}]]></Declaration>\n  </DUT>\n'
    else:
        declaration, body = split(text)
        inner = (
            f'  <POU Name="{name}" Id="{identity}" SpecialFunc="None">\n'
            f"    <Declaration><![CDATA[{declaration}]]></Declaration>\n"
            f"    <Implementation>\n      <ST><![CDATA[{body}]]></ST>\n    </Implementation>\n  </POU>\n"
        )
    return f"{head}{inner}</TcPlcObject>\n"


def _library() -> str:
    """A TwinCAT 3 library project of all types and blocks; the table's bytes belong to the program that uses it."""
    files = [f"{name}.{'TcDUT' if name in TYPES else 'TcPOU'}" for name in (*TYPES, *FUNCTIONS, *BLOCKS)]
    items = "".join(f'    <Compile Include="{f}">\n      <SubType>Code</SubType>\n    </Compile>\n' for f in files)
    facts = {
        "FileVersion": "1.0.0.0",
        "SchemaVersion": "2.0",
        "ProjectGuid": f"{{{uuid.uuid5(_NAMESPACE, 'library')}}}",
        "Name": "errpipe",
        "Released": "true",
        "Title": "errpipe",
        "DefaultNamespace": "errpipe",
        "Company": "errpipe",
        "ProjectVersion": LIBRARY_VERSION,
    }
    rows = "".join(f"    <{key}>{value}</{key}>\n" for key, value in facts.items())
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<Project DefaultTargets="Build" xmlns="http://schemas.microsoft.com/developer/msbuild/2003">\n'
        f"  <PropertyGroup>\n{rows}  </PropertyGroup>\n  <ItemGroup>\n{items}  </ItemGroup>\n</Project>\n"
    )


# PLCopen XML ------------------------------------------------------------------------------------------

_SECTION = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR_IN_OUT": "inOutVars", "VAR": "localVars"}
_VARIABLE = re.compile(r"^ +(\w+) : (?:ARRAY \[(\d+)\.\.(\d+)\] OF )?(\w+)(?: := \[([^\]]*)\])?;$")
_ELEMENTARY = ("LREAL", "DINT", "BOOL", "BYTE", "DWORD")
_DATE = "2000-01-01T00:00:00"  # the schema requires one; files that depend on the clock cannot be compared


def _type(name: str, low: str | None, high: str | None) -> str:
    base = f"<{name}/>" if name in _ELEMENTARY else f'<derived name="{name}"/>'
    if low is None:
        return base
    return f'<array><dimension lower="{low}" upper="{high}"/><baseType>{base}</baseType></array>'


def _variable(line: str) -> str:
    match = _VARIABLE.match(line)
    if match is None:
        raise ValueError(f"not a declaration this file can turn into XML: {line!r}")
    name, low, high, base, initial = match.groups()
    first = ""
    if initial is not None:
        values = "".join(f'<value><simpleValue value="{v.strip()}"/></value>' for v in initial.split(","))
        first = f"<initialValue><arrayValue>{values}</arrayValue></initialValue>"
    return f'<variable name="{name}"><type>{_type(base, low, high)}</type>{first}</variable>'


def _interface(declaration: str) -> str:
    out, opened, result = [], "", ""
    for line in declaration.splitlines():
        returns = re.match(r"FUNCTION \w+ : (\w+)$", line)
        if returns:
            result = f"<returnType><{returns[1]}/></returnType>"
        elif line in _SECTION:
            opened = _SECTION[line]
            out.append(f"<{opened}>")
        elif line == "END_VAR":
            out.append(f"</{opened}>")
            opened = ""
        elif opened:
            out.append(_variable(line))
    return result + "".join(out)


def _data_type(name: str, text: str) -> str:
    if "STRUCT" in text:
        rows = [line for line in text.splitlines() if _VARIABLE.match(line)]
        base = f"<struct>{''.join(map(_variable, rows))}</struct>"
    else:
        low, high, element = re.findall(r"ARRAY \[(\d+)\.\.(\d+)\] OF (\w+)", text)[0]
        base = _type(element, low, high)
    return f'<dataType name="{name}"><baseType>{base}</baseType></dataType>'


def _pou(name: str, text: str) -> str:
    declaration, body = split(text)
    kind = "function" if name in FUNCTIONS else "functionBlock"
    return (
        f'<pou name="{name}" pouType="{kind}"><interface>{_interface(declaration)}</interface>'
        f"<body><ST><xhtml:p>{escape(body, quote=False)}</xhtml:p></ST></body></pou>"
    )


def _plcopen(units: Mapping[str, str]) -> str:
    types = "\n".join(_data_type(name, units[name]) for name in TYPES)
    pous = "\n".join(_pou(name, units[name]) for name in (*FUNCTIONS, *BLOCKS))
    scaling = "".join(f'<{v}><scaling x="1" y="1"/></{v}>' for v in ("fbd", "ld", "sfc"))
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml">\n'
        f'<fileHeader companyName="errpipe" productName="errpipe" productVersion="{LIBRARY_VERSION}" '
        f'creationDateTime="{_DATE}"/>\n<contentHeader name="errpipe" version="{LIBRARY_VERSION}">'
        f"<coordinateInfo>{scaling}</coordinateInfo></contentHeader>\n"
        f"<types>\n<dataTypes>\n{types}\n</dataTypes>\n<pous>\n{pous}\n</pous>\n</types>\n"
        "<instances><configurations/></instances>\n</project>\n"
    )
