"""What no file of the project may hold: paths of one machine, hosts of package registries, pickles, idle tests."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.contract.sources import tree_of
from tests.contract.test_layers import called

ROOT = Path(__file__).parents[2]
PYTHON = ("errpipe", "tests", "trials", "bench", "examples")

# Written with a class of one letter, so that this file does not hold what it looks for.
FORBIDDEN = (
    r"[/]work/",
    r"[/]tmp/studio",
    r"[/]root/",
    r"pypi[.]org",
    r"files[.]pythonhosted",
    r"deb[.]debian",
    r"registry[.]npmjs",
)


def tracked() -> list[Path]:
    """Files under version control; where this is no checkout, all but what tools leave behind."""
    asked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if asked.returncode == 0 and asked.stdout:
        return [ROOT / name for name in asked.stdout.split("\0") if name and (ROOT / name).is_file()]
    left = {".venv", ".git", "__pycache__", "out", "build", "dist"}
    return [p for p in ROOT.rglob("*") if p.is_file() and not left & set(p.relative_to(ROOT).parts)]


# One of these stands in whatever `idle` objects to; parsing the other files would take seconds.
SUSPECT = re.compile(r"""pickle|dill|skip|xfail|assert\s*\(?\s*(True|\.\.\.|[\d'"]|b['"])""")


def python() -> Iterator[tuple[str, ast.Module]]:
    """Every suspect Python file: its name and its syntax tree, one at a time (all at once is half a gigabyte)."""
    for path in tracked():
        if path.suffix == ".py" and path.relative_to(ROOT).parts[0] in PYTHON:
            text = path.read_text(encoding="utf-8")
            if SUSPECT.search(text):
                yield str(path.relative_to(ROOT)), ast.parse(text)


def idle(name: str, tree: ast.Module) -> list[str]:
    """Pickles, tests that cannot fail, and skips that do not say why."""
    out = []
    for node in ast.walk(tree):
        where = f"{name}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
            out += [f"{where}: {n}" for n in names if n.split(".")[0] in ("pickle", "cPickle", "dill", "cloudpickle")]
        if isinstance(node, ast.Assert) and isinstance(node.test, ast.Constant) and node.test.value:
            out.append(f"{where}: asserts a constant")
        if isinstance(node, ast.Call) and called(node) in ("skip", "skipif", "xfail"):
            bare = not node.args and not any(word.arg == "reason" for word in node.keywords)
            condition = ast.unparse(node.func).endswith(("skipif", "mark.xfail", "mark.skip"))
            if bare or (condition and not any(word.arg == "reason" for word in node.keywords)):
                out.append(f"{where}: skips without a reason")
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            marks = [ast.unparse(mark) for mark in node.decorator_list]
            out += [f"{where}: {mark} without a reason" for mark in marks if re.search(r"\.(skip|xfail)$", mark)]
    return out


def numeric(value: ast.expr | None) -> bool:
    """Whether a value is a number, or a table of numbers, as it is written."""
    if isinstance(value, ast.Constant):
        return type(value.value) in (int, float)
    parts = (
        list(ast.iter_child_nodes(value)) if isinstance(value, ast.Tuple | ast.List | ast.BinOp | ast.UnaryOp) else []
    )
    return any(map(numeric, parts)) and all(numeric(p) for p in parts if isinstance(p, ast.expr))


def bare_numbers(source: str) -> list[str]:
    """Constants of a module without a word on unit or source, there or above the lines in a row that they stand in.

    A ratio of units (`UM_PER_MM`) says it by its name.
    """
    lines, bare = source.splitlines(), []
    for node in tree_of(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or not numeric(node.value):
            continue
        first = node.lineno
        while first > 1 and re.match(r"#|\w+(, \w+)*(: [^=]+)? = ", lines[first - 2]):
            first -= 1
        name = ast.unparse(node).partition(" = ")[0]
        if "#" not in "".join(lines[first - 1 : node.end_lineno]) and "_PER_" not in name:
            bare.append(f"{node.lineno}: {name}")
    return bare


def test_every_number_says_its_unit_or_source() -> None:
    files = {p.relative_to(ROOT).as_posix(): bare_numbers(p.read_text("utf-8")) for p in ROOT.glob("errpipe/**/*.py")}
    assert {name: bare for name, bare in files.items() if bare} == {}


def test_a_number_without_a_word_is_seen() -> None:
    source = (
        "A = 1.0\n\nB = 2  # s\nC = (1, 2)\n# two in a row, um\nD = -3\nE = 4.0 * 2\n\nUM_PER_MM = 1e3\nF = x + 1\n"
    )
    assert bare_numbers(source) == ["1: A"]


def test_no_path_of_one_machine_and_no_registry() -> None:
    wrong = []
    for path in tracked():
        text = path.read_bytes().decode("utf-8", errors="replace")
        for word in re.findall("|".join(FORBIDDEN), text):
            wrong.append(f"{path.relative_to(ROOT)}: {word}")
    assert wrong == []


def test_no_pickle_no_idle_assertion_no_silent_skip() -> None:
    assert [line for name, tree in python() for line in idle(name, tree)] == []


@pytest.mark.parametrize(
    "text",
    [
        "import pickle",
        "from pickle import loads",
        "def test(): assert True",
        "assert 1",
        "pytest.skip()",
        "@pytest.mark.skip\ndef test(): ...",
        "pytest.mark.skipif(True)",
        "pytest.mark.xfail(strict=True)",
    ],
)
def test_what_is_looked_for_is_found(text: str) -> None:
    assert SUSPECT.search(text) and idle("t.py", ast.parse(text))


@pytest.mark.parametrize(
    "text", ["pytest.skip('no compiler')", "pytest.mark.skipif(True, reason='why')", "assert x, True", "picky = 1"]
)
def test_what_is_allowed_is_let_through(text: str) -> None:
    assert idle("t.py", ast.parse(text)) == []
