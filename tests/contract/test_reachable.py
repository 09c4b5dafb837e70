"""Nothing in errpipe/ stands unreachable: a command, a stage, a registry or what these use names each definition.

A definition at the top of a module is reached where its own module uses it, or another one imports it or takes it as
an attribute of the module. Files that are loaded by name (plug-ins, verbs, stages) are asked for their definitions by
name, so there any use of the name counts. Methods and fields (of dataclasses, and options) are reached where their name
is read.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

import errpipe
from tests.contract.sources import parsed

TOP = Path(errpipe.__file__).parent

# Definition -> why it may stay. An entry that is no longer needed fails, too.
KNOWN = {
    "fitting.experiment_design.fit": "examples/next-duty-cycle",
    "kernels.table_cycle.stream": "a controller's cycles in a loop: every other evaluator is compared with it",
    "tables.reference.status_names": "the reference's status in words, for tests of the other evaluators",
    "targets._base.rounding_um": "stated for the tests that every format goes through",
    "cli._verbs.list_commands": "click calls it",
    "cli._verbs.format_commands": "click calls it",
    **{f"importing.readers.markup.handle_{event}": "HTMLParser calls it" for event in ("starttag", "endtag", "data")},
}
LOADED_BY_NAME = (
    *("api", "cleaning", "cli", "formats", "guard.rules", "importing.readers"),
    *("models", "simulation", "stages", "targets", "terms", "verbs"),
)
# Modules that no other module of errpipe imports, entry points apart.
KNOWN_MODULES = {"errpipe.simulation.fmu_worker": "run as a process of its own"}


def words_of(tree: ast.Module) -> set[str]:
    """Names that a module reads, attributes, keywords, imported names, and words of its short strings."""
    out: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Load()) | ast.Attribute(attr=name, ctx=ast.Load()):
                out.add(name)
            case ast.alias(name=name):
                out.add(name.split(".")[-1])
            case ast.MatchClass(kwd_attrs=names):
                out.update(names)
            case ast.Constant(value=str() as text) if len(text) < 200:
                words = re.findall(r"\w+", text)
                # a registry names files: tool_wear is the class ToolWear
                out |= {*words, *("".join(part.capitalize() for part in word.split("_")) for word in words)}
    return out


def reads_of(name: str, tree: ast.Module, modules: frozenset[str]) -> Iterator[tuple[str, str]]:
    """(module, name) of what a module uses of its own and imports of others, itself or as attributes of them."""
    modules_by_alias = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("errpipe"):
            of = str(node.module).removeprefix("errpipe").lstrip(".")
            for alias in node.names:
                module = f"{of}.{alias.name}".lstrip(".")
                if module in modules:
                    modules_by_alias[alias.asname or alias.name] = module
                else:
                    yield of, alias.name
    for top in tree.body:
        own = getattr(top, "name", "")  # a class that names itself alone, as in `def of() -> Own`, is not reached by it
        for node in ast.walk(top):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id != own:
                yield name, node.id
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                yield modules_by_alias.get(node.value.id, ""), node.attr


def defined(tree: ast.Module) -> Iterator[tuple[str, bool]]:
    """(name, at the top) of functions, classes and constants; of methods; and of fields, options among them."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, True
        elif isinstance(node, ast.Assign):
            yield from ((x.id, True) for x in node.targets if isinstance(x, ast.Name))
        if not isinstance(node, ast.ClassDef):
            continue
        for child in node.body:
            if isinstance(child, ast.FunctionDef) and not any("_" in ast.unparse(d) for d in child.decorator_list):
                yield child.name, False
            elif isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name):
                yield child.target.id, False


def unreached(trees: Mapping[str, ast.Module], templates: str = "") -> set[str]:
    """`module.name` of definitions that no other code of these files reaches. trees: by module, without `errpipe.`"""
    anywhere = set(re.findall(r"\w+", templates)).union(*map(words_of, trees.values()))
    read: dict[str, set[str]] = defaultdict(set)
    for module, tree in trees.items():
        for of, name in reads_of(module, tree, frozenset(trees)):
            read[of].add(name)
    out = set()
    for module, tree in trees.items():
        by_name = module.startswith(LOADED_BY_NAME)
        for name, top in defined(tree):
            reached = name in (anywhere if by_name or not top else read[module])
            if not reached and not name.startswith("__"):
                out.add(f"{module}.{name}".lstrip("."))
    return out


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """Every module of errpipe by its path."""
    paths = {p: p.relative_to(TOP).with_suffix("").parts for p in sorted(TOP.rglob("*.py"))}
    return {".".join(paths[path]).removesuffix("__init__").rstrip("."): tree for path, tree in parsed(paths).items()}


def test_every_definition_is_reached(trees: dict[str, ast.Module]) -> None:
    templates = "\n".join(p.read_text(encoding="utf-8") for p in TOP.rglob("*.j2"))
    unreachable = unreached(trees, templates)
    assert unreachable == set(KNOWN), (
        f"reached by nothing: {sorted(unreachable - set(KNOWN))}; not needed: {sorted(set(KNOWN) - unreachable)}"
    )


def test_a_definition_that_nothing_names_is_seen() -> None:
    sources = {
        "a": "def used(): pass\ndef lost(): lost()\n"
        "class Kept:\n    unread: int = 1\n    read: int = 2\n    def asked(self): pass\n    def never(self): pass\n",
        "b": "from errpipe.a import Kept\nfrom errpipe import a\na.used()\nKept().asked(Kept.read)\n",
        "c": "def lost(): return 1\nlost()\n",  # a namesake elsewhere does not reach it
    }
    assert unreached({name: ast.parse(source) for name, source in sources.items()}) == {"a.lost", "a.never", "a.unread"}


def test_every_module_is_imported(trees: dict[str, ast.Module]) -> None:
    imported: set[str] = set()
    for tree in trees.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                imported |= {(node.module or "").split(".")[-1], *(alias.name for alias in node.names)}
            elif isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[-1] for alias in node.names}
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                imported.add(node.value.split(".")[-1].replace("-", "_"))  # modules of a registry, loaded by name
    alone = set()
    for path in TOP.rglob("*.py"):
        parts = ("errpipe", *path.relative_to(TOP).with_suffix("").parts)
        if parts[-1] not in ("__init__", "__main__", *imported) and parts[-2] not in ("cli", "stages", "verbs"):
            alone.add(".".join(parts))
    assert alone == set(KNOWN_MODULES), sorted(alone ^ set(KNOWN_MODULES))
