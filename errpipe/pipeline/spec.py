"""The pipeline file: its model (derived from the given stages), and its reader.

pipeline: 1
title: Spindle drift of a turning centre
root: ..                       # relative paths start here; relative to this file; default: its own folder
stages:
  - kind: ingest
    recording: ${ERRPIPE_REAL_DATA:-../shared/real-data}/turning-centre-thermal
  - kind: fit
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field, create_model

from errpipe import files, yamlfile
from errpipe.errors import ConfigError, Problem, UsageError, did_you_mean
from errpipe.pipeline.graph import Links, link
from errpipe.pipeline.stage import Stage
from errpipe.yamlfile import Choice, Document, Options
from errpipe.yamlfile.annotations import tags_of


@dataclass(frozen=True)
class Pipeline:
    """A pipeline that was read and checked.

    links: for every stage name, slot -> names of the earlier stages behind it. document: the file as it was
    read, for messages that point into it.
    """

    file: Path
    root: Path
    title: str
    stages: tuple[Stage, ...]
    links: Links
    document: Document = field(repr=False, compare=False)

    def stage(self, name: str) -> Stage:
        """The stage of a name. Raises UsageError with the nearest name."""
        for stage in self.stages:
            if stage.label == name:
                return stage
        names = [stage.label for stage in self.stages]
        raise UsageError(f"no stage {name!r} in {self.file} (stages: {', '.join(names)}).{did_you_mean(name, names)}")


class _Header(Options):
    kinds: ClassVar[Any] = None
    pipeline: Literal[1] = Field(description="Version of the pipeline format.")
    title: str = Field("", description="One line for people; the report shows it.")
    root: Path = Field(
        Path("."), description="Folder where relative paths start, itself relative to this file; default: its folder."
    )


Stages = Choice[type[Stage]] | Sequence[type[Stage]]


@lru_cache
def pipeline_model(stages: Choice[type[Stage]] | tuple[type[Stage], ...]) -> type[Options]:
    """The model of a whole pipeline file for these kinds of stages: a choice by `kind`."""
    kinds: Any = stages if isinstance(stages, Choice) else _by_kind(stages)
    model = create_model(
        "Pipeline",
        __base__=_Header,
        __doc__="A pipeline: stages in order; each reads the outputs of earlier ones.",
        stages=(tuple[kinds, ...], Field(min_length=1, description="The stages, in order.")),
    )
    model.kinds = kinds
    return model


def _by_kind(stages: Sequence[type[Stage]]) -> Choice[type[Stage]]:
    """The choice of these stages; several of one kind are a choice by their second key."""
    groups: dict[str, list[type[Stage]]] = {}
    for stage in stages:
        groups.setdefault(tags_of(stage, "kind")[0], []).append(stage)
    members: dict[str, Any] = {kind: group[0] for kind, group in groups.items()}
    for kind, group in groups.items():
        if len(group) > 1:
            key = group[0].variant_key
            variants = {tags_of(stage, key)[0]: partial(_same, stage) for stage in group}
            members[kind] = Choice(key, variants, group[0].default_variant)
    return Choice("kind", {kind: partial(_same, member) for kind, member in members.items()})


def _same(member: Any) -> Any:
    return member


def _complete_variants(document: Document, kinds: Choice[type[Stage]]) -> None:
    """Name the variant of every stage that leaves it out; refuse a kind that joins kind and variant, as files of before
    do (`fit_plate`), with the spelling of now."""
    entries = document.value.get("stages") if isinstance(document.value, dict) else None
    for number, entry in enumerate(entries if isinstance(entries, list) else ()):
        kind = entry.get("kind") if isinstance(entry, dict) else None
        if not isinstance(kind, str):
            continue
        if kind in kinds.tags:
            choice: Any = kinds[kind]
            if isinstance(choice, Choice):
                if choice.several and isinstance(entry.get(choice.key), list):
                    tag, field_of_list = choice.several
                    entry |= {choice.key: tag, field_of_list: entry[choice.key]}
                entry.setdefault(choice.key, choice.default)
            continue
        base, _, variant = kind.partition("_")
        choice = kinds[base] if base in kinds.tags else None
        if isinstance(choice, Choice) and variant in choice.tags:
            text = f"found {kind!r}: write {{kind: {base}, {choice.key}: {variant}, ...}} instead"
            document.problems.append(document.problem(("stages", number, "kind"), text))


def load_pipeline(
    path: Path, stages: Stages, *, sets: Sequence[str] = (), environment: Mapping[str, str] | None = None
) -> Pipeline:
    """Read and check a pipeline file. Raises ConfigError with every problem, UsageError for a bad `--set`.

    stages: the registry of stage classes. sets: `STAGE.key=value` or `title=value`, the value being YAML.
    environment: for `${NAME}` in texts; default: the process's own.
    """
    path = Path(path)
    document = yamlfile.read(path, environment=os.environ if environment is None else environment)
    for text in sets:
        assign(document, text)
    model: Any = pipeline_model(stages if isinstance(stages, Choice) else tuple(stages))
    _complete_variants(document, model.kinds)
    root = _root(path, document)
    pipeline: Any = document.check(model, {"root": root})
    if pipeline is None:
        document.raise_problems()
    links, problems = link(pipeline.stages)
    document.problems.extend(document.problem(("stages", *place), text) for place, text in problems)
    document.raise_problems()
    return Pipeline(path, root, pipeline.title, pipeline.stages, links, document)


def missing_inputs(pipeline: Pipeline, stages: Sequence[Stage]) -> list[Problem]:
    """Inputs of these stages that are not there, each pointed at where the file names it."""
    problems = []
    for number, stage in enumerate(pipeline.stages):
        for wanted in stage.inputs() if stage in stages else ():
            if not wanted.exists():
                place = _place_of(pipeline.document, number, pipeline.root, wanted)
                problems.append(pipeline.document.problem(place, f"{wanted} does not exist{files.nearest(wanted)}"))
    return problems


def assign(document: Document, text: str) -> None:
    """Apply one `--set STAGE.key=value`. Raises UsageError if it names nothing or is not of that form."""
    origin = f"--set {text}"
    left, equals, right = text.partition("=")
    steps: list[str | int] = [int(step) if step.isdigit() else step for step in left.strip().split(".")]
    if not equals or "" in steps:
        raise UsageError(f"{origin}: not of the form STAGE.key=value")
    value = _value_of(right, origin)
    if not isinstance(document.value, dict):
        return  # the validation of the file reports it better
    names = _names(document)
    if steps[0] in names and len(steps) > 1:
        document.assign(("stages", names.index(str(steps[0])), *steps[1:]), value, origin)
    elif steps[0] in ("title", "stages"):
        document.assign(tuple(steps), value, origin)
    else:
        near = did_you_mean(str(steps[0]), names)
        raise UsageError(f"{origin}: no stage {steps[0]!r} (stages: {', '.join(names)}).{near}")


def _value_of(text: str, origin: str) -> Any:
    if not text.strip():
        return ""
    if text.strip() in ("null", "~"):
        return None
    try:
        document = yamlfile.parse(text)
        document.raise_problems()
    except ConfigError as err:
        raise UsageError(f"{origin}: {err.problems[0].message}") from None
    return document.value


def _names(document: Document) -> list[str]:
    entries = document.value.get("stages")
    if not isinstance(entries, list):
        return []
    return [str(e.get("name") or e.get("kind", "")) if isinstance(e, dict) else "" for e in entries]


def _root(path: Path, document: Document) -> Path:
    stated = document.value.get("root") if isinstance(document.value, dict) else None
    return Path(os.path.normpath(path.parent / (stated if isinstance(stated, str) else ".")))


def _place_of(document: Document, number: int, root: Path, wanted: Path) -> tuple[str | int, ...]:
    """Where in the file a stage names an input: the text that leads to that path."""
    stack: list[tuple[tuple[str | int, ...], Any]] = [(("stages", number), document.value["stages"][number])]
    while stack:
        place, value = stack.pop()
        if isinstance(value, str) and Path(os.path.normpath(root / value)) == wanted:
            return place
        parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        stack.extend(((*place, key), part) for key, part in parts)
    return ("stages", number)
