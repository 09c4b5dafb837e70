"""Models discriminated by the value of a key, each imported and built on first use.

    TERMS: Choice[type[Term]] = Choice.of_files("errpipe.terms", "term", ("backlash", "offset"))
    class Spec(BaseModel):
        terms: tuple[AnyTerm, ...]       # AnyTerm = TERMS: reads as a discriminated union, loads the members it meets

A discriminated union of pydantic builds every member before it validates the first value; with some fifty models that
takes most of a second. Errors, their locations and the JSON Schema are those of the union.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from importlib import import_module
from typing import Any, Generic, TypeVar, get_args

from pydantic_core import core_schema

from errpipe.errors import UsageError

M = TypeVar("M")


class Choice(Generic[M]):
    """Models by tag; iterating loads all of them. A member may be a choice by a second key.

    key: the field whose value is the tag. default: the tag where none is written, if there is one. several: what a list
    of tags stands for, if it may be written: a tag, and the field of that member that takes the list.
    """

    def __init__(
        self,
        key: str,
        members: Mapping[str, Callable[[], Any]],
        default: str = "",
        several: tuple[str, str] | None = None,
    ):
        self.key = key
        self.default = default
        self.several = several
        self._load = dict(members)
        self._loaded: dict[str, Any] = {}

    @classmethod
    def of_files(cls, package: str, key: str, files: Iterable[str | tuple[str, str]]) -> Choice[M]:
        """The models of a folder, one a file: `tool_wear` is the class ToolWear of that file; a pair is a tag and the
        file where that differs. Raises UsageError if one of them is not what the registry says."""
        pairs = [(entry, entry) if isinstance(entry, str) else entry for entry in files]
        members = {tag: partial(_from_file, package, file, key, tag) for tag, file in pairs}
        if len(members) < len(pairs):
            twice = next(tag for k, (tag, _) in enumerate(pairs) if tag in [t for t, _ in pairs[:k]])
            raise UsageError(f"{_path(package, '__init__')} lists {twice!r} twice")
        return cls(key, members)

    @property
    def tags(self) -> tuple[str, ...]:
        """Every tag, in the order of the registry."""
        return tuple(self._load)

    def __getitem__(self, tag: str) -> Any:
        """The member of a tag. Raises KeyError."""
        if tag not in self._loaded:
            self._loaded[tag] = self._load[tag]()
        return self._loaded[tag]

    def __iter__(self) -> Iterator[M]:
        for tag in self._load:
            member = self[tag]
            yield from member if isinstance(member, Choice) else (member,)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        late = {
            tag: core_schema.with_info_plain_validator_function(partial(self._validate, tag))
            if not isinstance(self._loaded.get(tag), Choice)
            else self[tag].__get_pydantic_core_schema__(source, handler)
            for tag in self._load
        }
        return core_schema.tagged_union_schema(late, self.key)

    def _validate(self, tag: str, value: Any, info: core_schema.ValidationInfo) -> Any:
        member: Any = self[tag]
        if info.mode == "json":  # a file that a person wrote: read strictly, as `Document.check` does
            return member.__pydantic_validator__.validate_json(json.dumps(value), strict=True, context=info.context)
        return member.__pydantic_validator__.validate_python(value, context=info.context)

    def whole_schema(self) -> core_schema.CoreSchema:
        """The core schema of the union of all members."""
        return core_schema.tagged_union_schema({tag: _built(self[tag]) for tag in self._load}, self.key)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Any:
        return handler(self.whole_schema())


def _built(member: Any) -> core_schema.CoreSchema:
    if isinstance(member, Choice):
        return member.whole_schema()
    member.model_rebuild()
    built: core_schema.CoreSchema = member.__pydantic_core_schema__
    return built


def _from_file(package: str, file: str, key: str, tag: str) -> Any:
    name, path = "".join(word.capitalize() for word in file.split("_")), _path(package, file)
    try:
        member = getattr(import_module(f"{package}.{file}"), name, None)
    except ModuleNotFoundError as error:
        if error.name != f"{package}.{file}":
            raise
        raise UsageError(f"{_path(package, '__init__')} lists {tag!r}, and there is no {path}") from None
    if member is None:
        raise UsageError(f"{path} holds no class {name}: the class of a file is named after it")
    field = getattr(member, "model_fields", {}).get(key)
    tags = get_args(field.annotation) if field is not None else (getattr(member, key, tag),)
    if tag not in tags:
        raise UsageError(f"{path}: {name}.{key} says {' or '.join(map(repr, tags))}, its registry {tag!r}")
    return member


def _path(package: str, file: str) -> str:
    return f"{package.replace('.', '/')}/{file}.py"
