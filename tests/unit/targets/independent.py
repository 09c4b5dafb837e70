"""Files of any target read by others than errpipe: what of them is program, and what is comment.

One reader for each kind of file, chosen by the file's ending. A target with an ending that stands here needs no line
of its own; a new ending needs one, and the test that uses this says so.
"""

from __future__ import annotations

import configparser
import re
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path


def program_of(name: str, text: str, folder: Path) -> list[str]:
    """The statements of a file without comments, one a line. Raises AssertionError where it cannot be read."""
    ending = name.rpartition(".")[2].lower()
    assert ending in READERS, f"{name}: say in {__name__} how a .{ending} file is read by others"
    return [line for line in READERS[ending](name, text, folder) if line.strip()]


def _c(name: str, text: str, folder: Path) -> list[str]:
    """gcc: trigraphs, line splices and comments as in C99; warnings are errors; the code left by the preprocessor."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    kind = ["-x", "c"] if name.endswith(".h") else []
    flags = ["-std=c99", "-trigraphs", "-Wall", "-Wextra", "-Wno-unused-function", "-Wno-unused-variable"]
    made = subprocess.run(
        ["gcc", *flags, "-Werror", "-fsyntax-only", f"-I{folder}", *kind, str(path)], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    code = ["gcc", "-std=c99", "-trigraphs", "-fpreprocessed", "-dD", "-E", "-P", *kind, str(path)]
    return subprocess.run(code, capture_output=True, text=True, check=True).stdout.splitlines()


@cache
def _structured_text(name: str, text: str, folder: Path) -> list[str]:
    """tree-sitter's grammar of IEC 61131-3 finds no error; what remains without its comments."""
    import tree_sitter
    import tree_sitter_iec61131_3_st as grammar

    # TwinCAT's references are not in the grammar of edition 2 (blark parses them in test_iec_st).
    text = text.replace("REFERENCE TO ", "").replace(" REF= ", " := ")
    data = re.sub(r":= \[[^\]]*\]", ":= [0]", text).encode()  # long initialisers are slow
    root = tree_sitter.Parser(tree_sitter.Language(grammar.language())).parse(data).root_node
    assert not root.has_error, f"{name}: {_first_error(root)}"
    out, at = b"", 0
    for start, end in sorted(_comments(root)):
        out, at = out + data[at:start] + b"\n", end
    return [line.strip() for line in (out + data[at:]).decode().splitlines()]


def _comments(node) -> list[tuple[int, int]]:
    if "comment" in node.type:
        return [(node.start_byte, node.end_byte)]
    return [span for child in node.children for span in _comments(child)]


def _first_error(node) -> str:
    if node.type == "ERROR" or node.is_missing:
        return f"line {node.start_point[0] + 1}: {node.text[:80]!r}"
    return next((output for output in map(_first_error, node.children) if output), "")


@cache
def _xml(name: str, text: str, folder: Path) -> list[str]:
    """lxml: elements and attributes in order; a list of global variables is read as Structured Text."""
    from lxml import etree

    out = []
    for element in etree.fromstring(text.encode()).iter():
        attributes = " ".join(f"{k}={v}" for k, v in sorted(element.attrib.items()))
        out.append(f"<{etree.QName(element).localname} {attributes}>")
        content = (element.text or "").strip()
        if content.startswith("(*") and "VAR_GLOBAL" in content:
            out += _structured_text(name, content, folder)
    return out


def _g_code(name: str, text: str, folder: Path) -> list[str]:
    """Blocks without the comments in brackets, as a tape reader of ISO 6983 takes them: none nests or spans lines."""
    out = []
    for line in text.splitlines():
        code = re.sub(r"\([^()]*\)", "", line)
        assert "(" not in code and ")" not in code, f"{name}: {line}"
        assert re.fullmatch(r"(%|[NGMTXYZAPQRS]-?[\d.]+|;|\s)*", code), f"{name}: {line}"
        out.append(code)
    return out


def _ini(name: str, text: str, folder: Path) -> list[str]:
    parser = configparser.RawConfigParser(strict=True, delimiters=("=", ":"), comment_prefixes=("#", ";"))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(text)
    return [f"[{section}] {key}" for section in parser.sections() for key in parser[section]]


def _lines(mark: str) -> Callable[[str, str, Path], list[str]]:
    """Statements that end with the line, with comments from a mark on."""

    def read(name: str, text: str, folder: Path) -> list[str]:
        assert not set(text) & set("\0\r\v\f\x1b\x85\u2028\u2029"), name
        return [line.split(mark)[0].rstrip() for line in text.split("\n")]

    return read


def _component(name: str, text: str, folder: Path) -> list[str]:
    """LinuxCNC's .comp: declarations end with a semicolon outside quotes; C follows the line ;;"""
    head, code = text.split("\n;;\n", 1)
    head = re.sub(r'"""(?:[^"\\]|\n)*?"""', '"_"', head)
    head = re.sub(r'"[^"\\\n]*"', '"_"', head)
    assert re.fullmatch(r'(\s*[a-z]\w*( \w+| = -?[\w.+]+| "_")*;?)*\s*', head), head
    (folder / "body.c").write_text(code)
    body = ["gcc", "-std=c99", "-trigraphs", "-fpreprocessed", "-dD", "-E", "-P", "-x", "c", str(folder / "body.c")]
    return head.splitlines() + subprocess.run(body, capture_output=True, text=True, check=True).stdout.splitlines()


READERS: dict[str, Callable[[str, str, Path], list[str]]] = {
    "c": _c,
    "h": _c,
    "st": _structured_text,
    "tcpou": _xml,
    "tcdut": _xml,
    "tcgvl": _xml,
    "xml": _xml,
    "plcproj": _xml,
    "txt": lambda name, text, folder: (_g_code if text.startswith("%") else _lines("#"))(name, text, folder),
    "cfg": _ini,
    "comp": lambda name, text, folder: (_component if ";;" in text else _lines("#"))(name, text, folder),
    "hal": _lines("#"),
    "lis": _lines("#"),
    "csv": _lines("//"),
    "ini": _lines(";"),
    "spf": _lines(";"),
    "com": _lines(";"),
    "cma": _lines(";"),
    "pmc": _lines(";"),
    "cal": _lines(";"),
    "gcode": _lines(";"),
    "g": _lines(";"),
    "dat": _lines("#"),
    "md": _lines("<!--"),
}
