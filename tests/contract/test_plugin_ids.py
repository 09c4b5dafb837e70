"""The id of a plug-in is quoted in its own folder and nowhere else: what the house knows of it, the plug-in says.

An id stands in quotes elsewhere only where it means something else (`homonyms`, with the meaning). An id of several
words (`run_offset`) does not stand inside a longer text either, such as a message.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import errpipe
from tests.contract.sources import tree_of

TOP = Path(errpipe.__file__).parent


@dataclass(frozen=True)
class Kind:
    """A kind of plug-in: its folder, the name of its registry, and where its ids may stand besides."""

    folder: str
    registry: str
    homonyms: dict[str, dict[str, str]]  # id -> file or folder -> what it means there; unused ones fail
    everyday: tuple[str, ...] = ()  # ids that are everyday words: a search for them proves nothing

    def ids(self) -> set[str]:
        """Ids under which the registry's entries are asked for."""
        entries = getattr(import_module(f"errpipe.{self.folder.replace('/', '.')}"), self.registry)
        return {name for entry in entries for name in ids_of(entry)} - set(self.everyday)


def ids_of(entry: Any) -> set[str]:
    """Ids of one registered thing: the name of its file, the effect it reports, and a stage's `kind`."""
    module = entry if isinstance(entry, ModuleType) else import_module(getattr(entry, "__module__", ""))
    kind = getattr(entry, "model_fields", {}).get("kind")
    named = getattr(kind.annotation, "__args__", ()) if kind is not None else ()
    return {module.__name__.split(".")[-1], str(getattr(entry, "reports_as", "") or ""), *map(str, named)} - {""}


KINDS = (
    Kind(
        folder="terms",
        registry="TERMS",
        homonyms={
            "straightness": {"domain/components.py": "kind of an ISO 230-1 component"},
            "squareness": {"domain/components.py": "kind of an ISO 230-1 component"},
            "offset": {
                "kinematics/identify.py": "kind of machine parameter, published in identification.json",
                "tables/layout.py": "published field of the table's affine node",
                "simulation": "the same field of the affine driver, in generated source",
            },
        },
    ),
    Kind("formats", "FORMATS", {}),
    Kind("targets", "TARGETS", {}),
    Kind("cleaning", "RULES", {}),
    Kind("guard/rules", "RULES", {}),
    Kind(
        folder="models",
        registry="FAMILIES",
        homonyms={},
        everyday=("auto", "direct", "force", "network", "nothing", "plate", "season", "terms"),
    ),
    Kind(
        folder="stages",
        registry="STAGES",
        homonyms={},
        # linked by artefact types; `diagnose` and `diagnosis`, `clean`, `fit` ... are verbs and words of messages
        everyday=(
            *("clean", "diagnose", "diagnosis", "export", "fit", "identify", "ingest", "report", "simulate", "twin"),
            "validate",
        ),
    ),
)


# Files whose texts give examples to people: help and pages of the documentation.
EXAMPLES = ("cli/formats.py", "cli/targets.py", "verbs/reference.py")


@cache
def quoted(path: Path) -> tuple[tuple[int, str], ...]:
    """(line, text) of every string of a file, docstrings apart, and every `several_words` inside a longer one."""
    tree, out = tree_of(path.read_text(encoding="utf-8")), []
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            inside = re.findall(r"[a-z0-9]+(?:_[a-z0-9]+)+", node.value)
            out += [(node.lineno, text) for text in {node.value, *inside}]
    return tuple(out)


def offences(kind: Kind, top: Path = TOP) -> dict[str, list[str]]:
    """File -> `line: id` of every id that is quoted outside of the kind's folder and means the plug-in."""
    ids, out = kind.ids(), {}
    for path in sorted(top.rglob("*.py")):
        file = path.relative_to(top).as_posix()
        if file.startswith(f"{kind.folder}/") or file in EXAMPLES:
            continue
        if strays := [f"{line}: {text}" for line, text in quoted(path) if text in ids]:
            out[file] = strays
    return out


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.folder)
def test_no_id_is_quoted_outside_its_folder(kind: Kind) -> None:
    homonyms = {(place, text) for text, places in kind.homonyms.items() for place in places}
    used, wrong = set(), {}
    for file, lines in offences(kind).items():
        for line in lines:
            text = line.split(": ", 1)[1]
            excused = {(place, text) for place in (file, *map(str, Path(file).parents))} & homonyms
            used |= excused
            if not excused:
                wrong.setdefault(file, []).append(line)
    assert wrong == {}, f"take it from the registry, or the class that it names: {wrong}"
    assert used == homonyms, f"no longer needed: {sorted(homonyms - used)}"


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.folder)
def test_a_quoted_id_is_noticed(kind: Kind, tmp_path: Path) -> None:
    name = sorted(kind.ids() - set(kind.homonyms))[0]
    (tmp_path / "stray.py").write_text(f'"""Of {name}."""\n\nRULES = {{"{name}": 1}}\n')
    assert offences(kind, tmp_path) == {"stray.py": [f"3: {name}"]}


def test_an_id_inside_a_message_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "stray.py").write_text('raise ValueError(f"{name} (allowed: run_offset, and others)")\n')
    assert offences(KINDS[0], tmp_path) == {"stray.py": ["1: run_offset"]}
