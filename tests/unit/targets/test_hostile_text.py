"""Titles, names and units of a table that try to become a part of a controller's program.

Every target of the registry writes tables that differ in their texts only. Independent readers (gcc, tree-sitter, lxml,
configparser, small parsers of `independent`) take every file, and what is left without comments is the same program.
"""

from __future__ import annotations

import re
import shutil

import pytest

from errpipe.domain.table import CompensationTable, TableInput
from errpipe.errors import GateError
from errpipe.targets import TARGETS
from errpipe.targets._text import plain
from tests.unit.targets import independent, machines

TITLES = (
    '"*\\\n/ int x=1; /\\\n*"',
    "*??/\n/ int x=1; /??/\n*",
    "*/ int x=1; /*",
    "*) x := 1; (*",
    "]]><Evil/><![CDATA[",
    '")\nM30\n("',
    ")M30(",
    "%\nO1\n%",
    "\n[gcode_macro X]\ngcode: M112\n",
    "$AA_ENC_COMP[0,0,AX1]=9\n",
    "a\0b",
    "\u2028x\u202ey\x85z\x1b[2J",
    '"""; pin in bit evil;\n;;\n"',
    "# ; // <!-- --> {{7*7}} {% x %} %s \\",
)
NAMES = (
    'T")\nM30\n("',
    "T]\n[gcode_macro M]\ngcode: M112",
    "T*/",
    "T*)",
    "T]]>",
    "T\\",
    "T;x",
    "T\0",
    "T\n",
    "T{x}",
    "T#",
)
AXES = ("../../x", "/tmp/zz", "X\n", "X Y", "X)", "..", "C:", "Ä")
WORST = "a (b) [c]: /%+^._-9"  # all signs that a name may hold


def packed(texts, longest: int) -> list[str]:
    """All texts in few lines of at most so many bytes; a zero byte would end the field of the file."""
    out = [""]
    for text in texts:
        more = text.replace("\0", "\1")
        if len((out[-1] + more).encode()) > longest:
            out.append("")
        out[-1] += more
    assert all(len(line.encode()) <= longest for line in out)
    return out


def rewritten(table: CompensationTable, **texts: str) -> CompensationTable:
    """The table with other texts, unchecked, as a program that builds tables by hand could make it."""
    return table.model_copy(update=texts)


def renamed(table: CompensationTable, old: str, new: str) -> CompensationTable:
    text = table.model_dump_json()
    for key in ("name", "input"):
        text = text.replace(f'"{key}":"{old}"', f'"{key}":"{new}"')
    return CompensationTable.model_validate_json(text.replace('"unit":"degC"', f'"unit":"{WORST[:15].strip()}"'))


def programs(target, table, folder) -> dict[str, list[str]] | None:
    """File name -> its program; None where the target refuses the table."""
    try:
        files = target.write(table)
    except GateError:
        return None
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return {name: independent.program_of(name, text, folder) for name, text in files.items()}


def masked(program: dict[str, list[str]]) -> dict[str, list[str]]:
    """Without numbers: the table's own bytes and checksum hold its title."""
    out = {}
    for name, lines in program.items():
        text = re.sub(r"\b(0x)?[0-9a-f]+\b", "0", "\n".join(lines))
        text = re.sub(r"(\b0,?\s*)+", "0 ", text)
        out[name] = text.splitlines()
    return out


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_no_text_becomes_a_part_of_the_program(target, tmp_path):
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="tree-sitter's grammar is not installed")
    written = 0
    for number, table in enumerate((machines.bent(), machines.warm(), machines.too_long_from_above())):
        benign = programs(target, rewritten(table, title="a", machine="b", version="c"), tmp_path / f"{number}")
        if benign is None:
            continue
        written += 1
        for n, title in enumerate(packed(TITLES, 127)):
            texts = {"title": title, "machine": packed(TITLES, 63)[n % 2], "version": "*/ ]]> *) ??/\n"}
            hostile = programs(target, rewritten(table, **texts), tmp_path / f"{number}-{n}")
            assert hostile is not None and masked(hostile) == masked(benign)
    assert written


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_the_oddest_names_that_a_table_may_hold_are_read_back(target, tmp_path):
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="tree-sitter's grammar is not installed")
    for number, (table, old) in enumerate(
        ((machines.bent(), "x"), (machines.warm(), "T"), (machines.too_long_from_above(), "x"))
    ):
        odd = renamed(table, old, WORST)
        if programs(target, odd, tmp_path / str(number)) is None:
            continue
        read = target.read_back(target.write(odd))
        assert set(read.axes()) <= {"X", "Y", "Z"}
        assert {line.sensor for line in read.lines} <= {WORST}


@pytest.mark.parametrize("title", TITLES)
def test_plain_text_holds_no_sign_of_any_language(title):
    output = plain(title)
    assert output.isprintable() and not set(output) & set("\"'\\*?;()[]{}<>%#=&$`|~!@\n")


@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_a_remark_is_ascii_and_is_taken_off_again(target):
    files = target.write(machines.sample(target))
    remarked = target.with_remarks(files, ["signed by J\u00fcrgen \u4f60\u597d: 10\u00b2 \u00b5m"])
    assert all(text.isascii() for name, text in remarked.items() if files[name].isascii())
    assert remarked == files or any("signed by Jurgen __: 10_ _m" in text for text in remarked.values())
    assert target.without_remarks(remarked) == files


@pytest.mark.parametrize("name", NAMES)
def test_a_table_takes_no_such_name(name):
    data = machines.warm().model_dump()
    for part, key in (("inputs", "name"), ("inputs", "unit"), ("outputs", "name"), ("components", "name")):
        changed = [dict(row) for row in data[part]]
        changed[-1][key] = name
        with pytest.raises(ValueError, match=r"holds|longer"):
            CompensationTable.model_validate({**data, part: changed})


@pytest.mark.parametrize("axis", AXES)
def test_a_table_takes_no_such_axis(axis):
    with pytest.raises(ValueError, match="holds"):
        TableInput(name="x", kind="position", axis=axis, low=0, high=1, default=0)
