"""Nothing in errpipe/ stands unreachable: a command, a stage, a registry or what these use names each definition.

By name, on the syntax trees: a definition whose name stands nowhere else in errpipe/ is reached by nothing.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import pytest

import errpipe

TOP = Path(errpipe.__file__).parent

# Definition -> why it may stay. An entry that is no longer needed fails, too.
KNOWN = {
    "ChangesPending": "the exit code of `plan`; raised by name of its code",
    "usual_plan": "the usual plan that examples/next-duty-cycle compares with",
    "linearity": "examples/placement",
    "extrapolation": "examples/placement",
}
# Modules that no other module of errpipe imports, entry points apart.
KNOWN_MODULES = {"errpipe.simulation.fmu_worker": "run as a process of its own"}


def unreached(trees: Mapping[str, ast.Module], templates: str = "") -> set[str]:
    """Names of top-level definitions that no other code of these files names."""
    words: Counter[str] = Counter(re.findall(r"\w+", templates))
    defined: set[str] = set()
    for tree in trees.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Name):
                words[node.id] += 1
            elif isinstance(node, ast.Attribute):
                words[node.attr] += 1
            elif isinstance(node, ast.alias):
                words[node.name.split(".")[-1]] += 1
            elif isinstance(node, ast.keyword) and node.arg:
                words[node.arg] += 1
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value) < 200:
                matches = re.findall(r"\w+", node.value)
                words.update(matches)
                # a registry names files: tool_wear is the class ToolWear
                words.update("".join(part.capitalize() for part in word.split("_")) for word in matches)
        defined |= {n.name for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef)}
    return {name for name in defined if not words[name] and not name.startswith("__")}


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """Every module of errpipe by its path."""
    return {str(p.relative_to(TOP)): ast.parse(p.read_text(encoding="utf-8")) for p in sorted(TOP.rglob("*.py"))}


def test_every_definition_is_reached(trees: dict[str, ast.Module]) -> None:
    templates = "\n".join(p.read_text(encoding="utf-8") for p in TOP.rglob("*.j2"))
    unreachable = unreached(trees, templates)
    assert unreachable == set(KNOWN), (
        f"reached by nothing: {sorted(unreachable - set(KNOWN))}; not needed: {sorted(set(KNOWN) - unreachable)}"
    )


def test_a_definition_that_nothing_names_is_seen() -> None:
    sources = {"a.py": "def used(): pass\ndef lost(): pass\n", "b.py": "from a import used\nused()\n"}
    assert unreached({name: ast.parse(source) for name, source in sources.items()}) == {"lost"}


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
        if parts[-1] not in ("__init__", "__main__", *imported) and parts[-2] not in ("cli", "stages"):
            alone.add(".".join(parts))
    assert alone == set(KNOWN_MODULES), sorted(alone ^ set(KNOWN_MODULES))
