"""A plug-in is one file and one line: every file of a plug-in folder stands in its registry, and nothing else does."""

from __future__ import annotations

import inspect
import re
import types
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, get_origin, get_type_hints

import pytest

import errpipe
from errpipe.cli import app
from errpipe.targets._base import Target
from errpipe.yamlfile import Choice
from errpipe.yamlfile.annotations import tags_of

TOP = Path(errpipe.__file__).parent

# package -> its registry tuple. Files whose name starts with `_` are shared by plug-ins, not plug-ins.
REGISTRIES = {
    "terms": "TERMS",
    "formats": "FORMATS",
    "targets": "TARGETS",
    "cleaning": "RULES",
    "guard.rules": "RULES",
    "models": "FAMILIES",
    "stages": "STAGES",
}
FOR_PEOPLE = {"diagnosis", "report"}  # artefacts that no stage takes


def home(entry: Any) -> str:
    """The file that a registered thing comes from."""
    if isinstance(entry, types.ModuleType):
        return entry.__name__.split(".")[-1]
    return (entry if isinstance(entry, type) else type(entry)).__module__.split(".")[-1]


@pytest.mark.parametrize("package", [name for name in REGISTRIES if name != "stages"])
def test_every_file_is_registered_and_nothing_else(package: str) -> None:
    files = {path.stem for path in (TOP / package.replace(".", "/")).glob("*.py") if not path.stem.startswith("_")}
    registered = {home(entry) for entry in getattr(import_module(f"errpipe.{package}"), REGISTRIES[package])}
    registry = f"the registry in errpipe/{package}/__init__.py"
    assert files <= registered, f"not in {registry}: {sorted(files - registered)}"
    assert registered <= files, f"in {registry}, and no file: {sorted(registered - files)}"


def test_every_stage_file_is_a_stage_and_every_verb_is_asked() -> None:
    files = {
        f"{room}.{path.stem}"
        for room in ("stages", "verbs")
        for path in (TOP / room).glob("*.py")
        if not path.stem.startswith("_")
    }
    stages = {f"stages.{home(stage)}" for stage in import_module("errpipe.stages").STAGES}
    asked = {
        name for verb in (TOP / "cli").glob("*.py") for name in re.findall(r'module_of\("([\w.]+)"', verb.read_text())
    }
    assert stages <= files
    assert files <= stages | asked, f"no stage of the registry and no work of a verb: {sorted(files - stages - asked)}"
    missing = {name for name in asked if not (TOP / f"{name.replace('.', '/')}.py").is_file()}
    assert not missing, "a verb asks for work that no file does"


@pytest.mark.parametrize("package", REGISTRIES)
def test_every_plug_in_is_documented(package: str) -> None:
    silent = []
    for entry in getattr(import_module(f"errpipe.{package}"), REGISTRIES[package]):
        kind = entry if isinstance(entry, type | types.ModuleType) else type(entry)
        module = entry if isinstance(entry, types.ModuleType) else import_module(kind.__module__)
        output = [(module.__doc__ or "").strip(), (vars(kind).get("__doc__") or "").strip()]
        silent += [] if all(output) else [home(entry)]
    assert silent == []


@pytest.mark.parametrize("package", REGISTRIES)
def test_a_registry_has_no_doubles(package: str) -> None:
    registered = getattr(import_module(f"errpipe.{package}"), REGISTRIES[package])
    assert isinstance(registered, tuple | Choice) and len(set(map(id, registered))) == len(registered) > 0


@pytest.mark.parametrize("package", ["terms", "cleaning", "guard.rules", "models", "stages"])
def test_a_tag_of_the_registry_is_what_the_file_says(package: str) -> None:
    registry = getattr(import_module(f"errpipe.{package}"), REGISTRIES[package])
    for tag in registry.tags:
        members = registry[tag] if isinstance(registry[tag], Choice) else (registry[tag],)
        assert {tags_of(member, registry.key)[0] for member in members} == {tag}


@pytest.mark.parametrize("package", ["terms", "cleaning", "guard.rules", "models", "stages"])
def test_nothing_of_the_registry_is_left_to_write(package: str) -> None:
    registered = getattr(import_module(f"errpipe.{package}"), REGISTRIES[package])
    abstract = {f"{home(e)}: {', '.join(sorted(e.__abstractmethods__))}" for e in registered if inspect.isabstract(e)}
    assert not abstract, f"methods that their base asks for: {sorted(abstract)}"


@pytest.mark.parametrize("package", ["formats", "targets"])
def test_a_name_is_given_once(package: str) -> None:
    entries = getattr(import_module(f"errpipe.{package}"), REGISTRIES[package])
    names = [entry.name for entry in entries]
    twice = sorted({f"{home(e)}: {e.name}" for e in entries if names.count(e.name) > 1})
    assert not twice, f"two {package} of one name: {twice}"


def test_a_format_and_a_target_say_what_is_asked_of_them() -> None:
    formats, targets = import_module("errpipe.formats").FORMATS, import_module("errpipe.targets").TARGETS
    missing = [f"{f.__name__}.{x}" for f in formats for x in ("name", "Options", "sniff", "read") if not hasattr(f, x)]
    stated = [n for n, kind in get_type_hints(Target).items() if get_origin(kind) is ClassVar]
    missing += [f"{home(t)}: {t.__name__}.{x}" for t in targets for x in stated if not hasattr(t, x)]
    assert not missing, f"not stated: {missing}"


def test_every_stage_stands_in_a_pipeline_and_gives_what_some_stage_takes() -> None:
    from errpipe.stages import STAGES

    places = [path for folder in ("pipelines", "examples", "errpipe") for path in (TOP.parent / folder).rglob("*.yaml")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in places)
    unused = [kind for kind in STAGES.tags if not re.search(rf"kind: {kind}\b", text)]
    assert not unused, f"no pipeline of pipelines/ or examples/ uses {unused}"
    taken = {need.type for stage in STAGES for need in stage.takes.values()}
    idle = {f"{stage.__name__} gives {a!r}" for stage in STAGES for a in set(stage.gives) - taken - FOR_PEOPLE}
    assert not idle, f"a type that no stage takes: {sorted(idle)} (taken: {', '.join(sorted(taken))})"


def test_every_stage_has_its_own_kind_and_takes_what_some_stage_gives() -> None:
    from errpipe.stages import STAGES

    kinds = [stage.model_fields["kind"].annotation.__args__[0] for stage in STAGES]
    names = [(kind, getattr(stage, "of", stage).__name__) for kind, stage in zip(kinds, STAGES, strict=True)]
    assert len(set(names)) == len(names)
    assert all(stage.variant_key for kind, stage in zip(kinds, STAGES, strict=True) if kinds.count(kind) > 1)
    given = {artefact for stage in STAGES for artefact in stage.gives}
    for stage in STAGES:
        assert stage.gives, f"{stage.__name__} does not say what it gives"
        for slot, need in stage.takes.items():
            assert need.type in given, f"{stage.__name__} takes {slot} of a type that no stage gives"
            assert not set(kinds) & {need.type}, f"{stage.__name__}: {slot} names a kind of stage, not a type"


def test_every_verb_is_a_file_and_every_file_a_verb() -> None:
    shared = {"app", "output", "progress"}
    files = {path.stem for path in (TOP / "cli").glob("*.py") if not path.stem.startswith("_")} - shared
    assert {name.replace("-", "_") for name in app.VERBS} == files
