"""What a pydantic annotation can hold: the few questions that explaining and converting ask of it."""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from errpipe.yamlfile.choice import Choice


def members(annotation: Any) -> list[Any]:
    """The parts of a union without None; Annotated stripped."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, types.UnionType):
        return [m for part in get_args(annotation) for m in members(part) if part is not type(None)]
    return [annotation]


def is_model(member: Any) -> bool:
    return isinstance(member, type) and issubclass(member, BaseModel)


def tags_of(member: Any, discriminator: str | None = None) -> list[Any]:
    """Values of the Literal fields of a model (or of the one field that distinguishes the members)."""
    if isinstance(member, Choice):
        return list(member.tags)
    if not is_model(member):
        return []
    return [
        tag
        for name, info in member.model_fields.items()
        if get_origin(info.annotation) is Literal and discriminator in (None, name, info.alias)
        for tag in get_args(info.annotation)
    ]


def is_tagged(member: Any, tag: Any) -> bool:
    return tag in tags_of(member) or getattr(member, "__name__", None) == tag


def entry_of(inside: Sequence[Any], number: int) -> Any:
    """Annotation of one entry of a list; Any where none of the annotations is a list."""
    for member in inside:
        origin, arguments = get_origin(member), get_args(member)
        if origin is tuple and arguments and arguments[-1] is not Ellipsis:
            return arguments[min(number, len(arguments) - 1)]
        if arguments and origin not in (dict, Mapping, Literal):
            return arguments[0]
    return Any


def _matches(model: type[BaseModel], data: Mapping[str, Any]) -> int:
    """How many of the written keys with a choice of words hold a word of this model."""
    literal = {info.alias or name: info for name, info in model.model_fields.items()}
    return sum(
        get_origin(info.annotation) is Literal and data.get(key) in get_args(info.annotation)
        for key, info in literal.items()
        if key in data and isinstance(data[key], str | int)
    )


def model_for(inside: Sequence[Any], data: Mapping[str, Any]) -> type[BaseModel] | None:
    """The model meant by a mapping: the only one, the one most of whose Literal fields hold what is written, else the
    only one that has no such field."""
    models = [member for member in inside if is_model(member)]
    chosen = next((member for member in inside if isinstance(member, Choice)), None)
    if chosen is not None:
        tag = data.get(chosen.key, chosen.default)
        return model_for([chosen[tag]], data) if isinstance(tag, str) and tag in chosen.tags else None
    if len(models) < 2:
        return models[0] if models else None
    counts = [_matches(model, data) for model in models]
    if max(counts) > 0:
        return models[counts.index(max(counts))]
    untagged = [model for model in models if not tags_of(model)]
    return untagged[0] if len(untagged) == 1 else None
