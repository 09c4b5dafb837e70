"""The id of a plug-in is quoted in its own folder and nowhere else: what the house knows of it, the plug-in says.

An id stands in quotes elsewhere only where it means something else (`homonyms`, with the meaning) or where the clean-up
is under way (`pending`, with the reason).
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import errpipe

TOP = Path(errpipe.__file__).parent


@dataclass(frozen=True)
class Kind:
    """A kind of plug-in: its folder, the name of its registry, and where its ids may stand besides."""

    folder: str
    registry: str
    homonyms: dict[str, dict[str, str]]  # id -> file or folder -> what it means there
    pending: dict[str, str]  # file -> why its ids are still there

    def ids(self) -> set[str]:
        """Ids under which the registry's entries are asked for."""
        entries = getattr(import_module(f"errpipe.{self.folder}"), self.registry)
        return {name for entry in entries for name in ids_of(entry)}


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
            "straightness": {
                "domain/components.py": "kind of an ISO 230-1 component",
                "kinematics": "kind of a measured line",
                "simulation": "kind of a measured line",
                "validation/implausible_columns.py": "kind of an ISO 230-1 component",
            },
            "squareness": {
                "domain/components.py": "kind of an ISO 230-1 component",
                "kinematics": "kind of a machine parameter",
                "validation/iso230_4.py": "an error that a circular test shows (ISO 230-4)",
            },
            "scale_error": {"validation/iso230_4.py": "an error that a circular test shows (ISO 230-4)"},
            "backlash": {"validation/iso230_4.py": "an error that a circular test shows (ISO 230-4)"},
            "servo_mismatch": {"validation/iso230_4.py": "an error that a circular test shows (ISO 230-4)"},
            "offset": {
                "kinematics": "kind of a machine parameter",
                "ncprogram": "shift of a program's coordinates",
                "tables": "field of the compiled table's affine node",
                "drivers": "field of the affine driver",
                "simulation/patch.py": "field of the affine driver",
                "simulation/patch_fmu.py": "field of the affine driver",
                "domain": "field of the affine driver",
                "kernels": "field of the affine driver",
                "fitting/recalibration.py": "name of a line's height",
            },
        },
        pending={},
    ),
    Kind("formats", "FORMATS", {}, {}),
    Kind("targets", "TARGETS", {}, {}),
    Kind("cleaning", "RULES", {}, {}),
    # stages are not listed: their kinds (fit, clean, report) are everyday words; they are linked by artefact types
)


@cache
def quoted(path: Path) -> tuple[tuple[int, str], ...]:
    """(line, text) of every string of a file."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return tuple((n.lineno, n.value) for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str))


def offences(kind: Kind, top: Path = TOP) -> dict[str, list[str]]:
    """File -> `line: id` of every id that is quoted outside of the kind's folder and means the plug-in."""
    ids, out = kind.ids(), {}
    for path in sorted(top.rglob("*.py")):
        file = path.relative_to(top).as_posix()
        if file.startswith(f"{kind.folder}/"):
            continue
        found = [
            f"{line}: {text}"
            for line, text in quoted(path)
            if text in ids and not any(file == p or file.startswith(f"{p}/") for p in kind.homonyms.get(text, {}))
        ]
        if found:
            out[file] = found
    return out


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.folder)
def test_no_id_is_quoted_outside_its_folder(kind: Kind) -> None:
    found = offences(kind)
    assert {file: lines for file, lines in found.items() if file not in kind.pending} == {}


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.folder)
def test_a_quoted_id_is_noticed(kind: Kind, tmp_path: Path) -> None:
    name = sorted(kind.ids() - set(kind.homonyms))[0]
    (tmp_path / "stray.py").write_text(f'RULES = {{"{name}": 1}}\n')
    assert offences(kind, tmp_path) == {"stray.py": [f"1: {name}"]}
