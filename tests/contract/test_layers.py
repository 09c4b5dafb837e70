"""Imports run downward only; packages on one line are siblings; no files import each other in a circle; a few
libraries belong to a few packages.

Checked on the syntax tree of every file, so that imports inside functions and under TYPE_CHECKING count too.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import errpipe
from tests.contract.sources import tree_of

TOP = Path(errpipe.__file__).parent

PAGE = TOP.parent / "docs" / "architecture.md"


def drawn(page: str) -> tuple[tuple[str, ...], ...]:
    """Lines of packages of the drawing: upper may import lower; names on one line may not import each other."""
    lines = page.split("```layers\n")[1].split("\n```")[0].splitlines()
    return tuple(tuple(line.split(" | ")) for line in lines)


LAYERS = (("__main__",), *drawn(PAGE.read_text()))
LINE = {name: number for number, names in enumerate(LAYERS) for name in names}

# Packages that may import less than what lies below them.
ONLY = {"pipeline": {"yamlfile", "jsonfile", "files", "errors"}, "kernels": set()}

# Library -> packages that may import it.
LIBRARIES = {
    "numba": {"kernels"},
    "typer": {"cli"},
    "click": set(),
    "sklearn": {"fitting", "thermal", "models", "validation", "diagnosis"},
    "ruamel": {"yamlfile"},
    "yaml": set(),
    "pickle": set(),
    "cloudpickle": set(),
    "dill": set(),
    "joblib": set(),
    "skops": set(),
}

# Folders of plug-ins: one file per thing, and no file leans on another one (`_shared.py` files apart).
PLUG_INS = ("terms", "formats", "targets", "cleaning", "guard.rules", "models")


def called(call: ast.Call) -> str:
    """The last name of what is called: `import_module` of `importlib.import_module(...)`."""
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


@cache
def imports(source: str, module: str) -> tuple[tuple[int, str], ...]:
    """(line, absolute name) of everything that a module imports; `from a import b` counts as a.b."""
    return tuple(_imports(source, module))


def _imports(source: str, module: str) -> Iterator[tuple[int, str]]:
    package = module.split(".")
    for node in ast.walk(tree_of(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # relative: one level up drops the module's own name (for a package's __init__ that is "__init__")
            base = package[: len(package) - node.level] if node.level else []
            start = ".".join([*base, *(node.module or "").split(".")]).strip(".")
            yield from ((node.lineno, f"{start}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and called(node) in ("__import__", "import_module"):
            yield from ((node.lineno, arg.value) for arg in node.args[:1] if isinstance(arg, ast.Constant))


def breaches(source: str, module: str) -> list[str]:
    """What a module imports and must not, one line each. `module` is its full name, such as errpipe.terms.backlash."""
    own = [*module.split("."), ""][1]
    out: list[str] = []
    for line, name in imports(source, module):
        parts = name.split(".")
        where = f"{module}:{line}"
        if parts[0] != "errpipe":
            owners = LIBRARIES.get(parts[0], {own})
            if own not in owners:
                out.append(f"{where} imports {parts[0]}, which is for {', '.join(sorted(owners)) or 'no one'}")
            continue
        other = parts[1] if len(parts) > 1 else ""
        if other == own:
            if _plug_in_folder(module) == _plug_in_folder(name) != "":
                out.append(f"{where} imports {name}: files of {own} do not lean on each other")
            continue
        private = any(part.startswith("_") and not part.startswith("__") for part in parts[2:])
        if private and own not in ("stages", "verbs"):
            out.append(f"{where} imports {name}, which is private to {other}")
            continue
        if other not in LINE or own not in LINE:
            continue  # errpipe itself: the version
        if LINE[other] < LINE[own]:
            out.append(f"{where} imports {name}: {own} lies below {other}")
        elif LINE[other] == LINE[own]:
            out.append(f"{where} imports {name}: {own} and {other} are siblings")
        elif own in ONLY and other not in ONLY[own]:
            out.append(f"{where} imports {name}: {own} may import only {', '.join(sorted(ONLY[own])) or 'libraries'}")
    return out


def _plug_in_folder(name: str) -> str:
    """The folder of plug-ins that a module, or a name in it, is of (not the registry, not shared `_files`)."""
    for folder in PLUG_INS:
        file = f"{name}.".removeprefix(f"errpipe.{folder}.").split(".")[0]
        inside = name.startswith(f"errpipe.{folder}.") and not file.startswith("_")
        if inside and (TOP / folder.replace(".", "/") / f"{file}.py").is_file():
            return folder
    return ""


def modules() -> list[tuple[str, Path]]:
    """Every module of errpipe by its full name; a package's own file ends in `.__init__`."""
    return [
        (".".join(("errpipe", *path.relative_to(TOP).with_suffix("").parts)), path)
        for path in sorted(TOP.rglob("*.py"))
    ]


def test_imports_run_downward() -> None:
    assert [breach for name, path in modules() for breach in breaches(path.read_text(encoding="utf-8"), name)] == []


def test_every_package_has_a_line() -> None:
    here = {path.name for path in TOP.iterdir() if path.is_dir() and any(path.glob("*.py"))}
    here |= {path.stem for path in TOP.glob("*.py")} - {"__init__"}
    assert here <= set(LINE), f"no line for {sorted(here - set(LINE))}: say where it stands in docs/architecture.md"


def import_graph(sources: dict[str, str]) -> dict[str, set[str]]:
    """Module -> modules of `sources` that it imports, wherever in the file."""
    graph: dict[str, set[str]] = {}
    for module, source in sources.items():
        graph[module] = set()
        for _, name in imports(source, module):
            parts = name.split(".")
            while parts and ".".join(parts) not in sources:
                parts = parts[:-1] if f"{'.'.join(parts)}.__init__" not in sources else [*parts, "__init__"]
            graph[module] |= {".".join(parts)} - {"", module}
    return graph


def circles(graph: dict[str, set[str]]) -> set[tuple[str, ...]]:
    """Groups of modules that reach each other (strongly connected components of two or more), each sorted."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            module = waiting.pop()
            if module not in seen:
                seen.add(module)
                waiting += graph[module]
        return seen

    reach = {module: reached(module) for module in graph}
    values = {tuple(sorted(o for o in reach[m] if m in reach[o])) for m in graph if m in reach[m]}
    return {group for group in values if len(group) > 1}


def test_no_files_import_each_other() -> None:
    cycles = circles(import_graph({name: path.read_text(encoding="utf-8") for name, path in modules()}))
    assert not cycles, f"files import each other: {sorted(cycles)}"


def test_a_planted_circle_is_found() -> None:
    sources = {
        "errpipe.a.__init__": "",
        "errpipe.a.one": "from errpipe.a.two import x",
        "errpipe.a.two": "def f():\n    from errpipe.a import three",
        "errpipe.a.three": "from .one import y",
        "errpipe.a.four": "import errpipe.a.one",
    }
    assert circles(import_graph(sources)) == {("errpipe.a.one", "errpipe.a.three", "errpipe.a.two")}


@pytest.mark.parametrize(
    "module, source, word",
    [
        ("errpipe.terms.backlash", "from errpipe.fitting import solve", "below fitting"),
        ("errpipe.terms.backlash", "def f():\n    import errpipe.cli.app", "below cli"),
        ("errpipe.terms.backlash", "from errpipe import fitting", "below fitting"),
        ("errpipe.terms.backlash", "from .. import fitting", "below fitting"),
        ("errpipe.terms.__init__", "from ..fitting import solve", "below fitting"),
        ("errpipe.terms.backlash", "from ..fitting.solve import x", "below fitting"),
        ("errpipe.formats.csv", "import errpipe.targets.iso", "siblings"),
        ("errpipe.domain.table", "from errpipe.kernels import kernel", "siblings"),
        ("errpipe.jsonfile", "from errpipe.yamlfile import load", "siblings"),
        ("errpipe.pipeline.spec", "from errpipe.domain.recording import Manifest", "may import only"),
        ("errpipe.kernels.lag", "from errpipe.errors import DataError", "may import only"),
        ("errpipe.fitting.solve", "if TYPE_CHECKING:\n    import numba", "imports numba"),
        ("errpipe.stages.fit", "import typer", "imports typer"),
        ("errpipe.tables.gridding", "from sklearn.linear_model import Ridge", "imports sklearn"),
        ("errpipe.stages.fit", "import pickle", "imports pickle"),
        ("errpipe.domain.table", "importlib.import_module('errpipe.cli.app')", "below cli"),
        ("errpipe.terms.backlash", "from errpipe.terms.squareness import Squareness", "do not lean"),
        ("errpipe.terms.backlash", "from .squareness import Squareness", "do not lean"),
        ("errpipe.fitting.solve", "from errpipe.terms._base import Term", "private to terms"),
    ],
)
def test_a_planted_breach_is_found(module: str, source: str, word: str) -> None:
    (violations,) = breaches(source, module)
    assert word in violations


@pytest.mark.parametrize(
    "module, source",
    [
        ("errpipe.terms.backlash", "from errpipe.terms._base import Term\nfrom errpipe.domain.driver import Driver"),
        ("errpipe.pipeline.spec", "from errpipe import __version__, jsonfile\nimport errpipe"),
        ("errpipe.kernels.lag", "import numba\nimport numpy as np\nfrom errpipe.kernels import kernel"),
        ("errpipe.cli.run", "import typer\nfrom errpipe.stages import STAGES\nfrom . import say"),
        ("errpipe.terms.__init__", "from errpipe.terms.backlash import Backlash"),
    ],
)
def test_what_is_allowed_passes(module: str, source: str) -> None:
    assert breaches(source, module) == []


def test_the_page_describes_every_package() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(), re.MULTILINE)
    assert sorted(rows) == sorted(name for names in LAYERS[1:] for name in names)
