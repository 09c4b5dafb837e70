"""From pydantic's errors to problems a person can act on: where, what was found, what is allowed.

Pydantic's locations carry tags of unions that no one wrote; they are dropped here. An unknown key is
pointed at itself, a missing one at the mapping that lacks it, everything else at its value.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from errpipe.errors import Problem, did_you_mean
from errpipe.yamlfile.annotations import entry_of, is_model, is_tagged, members, tags_of
from errpipe.yamlfile.choice import Choice
from errpipe.yamlfile.events import plain
from errpipe.yamlfile.places import Place, describe
from errpipe.yamlfile.quantities import is_unit

# pydantic's error types of a wrong kind of value -> what is needed instead
_NEEDED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "path_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "set_type": "a list",
    "frozen_set_type": "a list",
    "iterable_type": "a list",
    "dict_type": "a mapping",
    "mapping_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dataclass_type": "a mapping",
    "none_required": "nothing",
    "date_type": "a date",
    "datetime_type": "a date and time",
}
_BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
    "multiple_of": ("multiple_of", "a multiple of"),
}
MAX_CHOICES_LISTED = 16  # a longer list of allowed values hides the message; the nearest ones are named instead
_TRUTH = {"yes": "true", "on": "true", "y": "true", "no": "false", "off": "false", "n": "false"}


def explain(
    problem: Callable[..., Problem], data: Any, model: Any, errors: Iterable[Mapping[str, Any]]
) -> list[tuple[Place, Problem]]:
    """Place and problem for each place that pydantic complains about. `problem` makes one from place and message."""
    needed: dict[Place, list[str]] = {}
    choices: dict[Place, list[str]] = {}
    problems: list[tuple[Place, Problem]] = []
    for error in errors:
        trail = _Trail(model, data, error["loc"])
        kind = error["type"]
        if kind in _NEEDED:
            needed.setdefault(trail.place, []).append(_NEEDED[kind])
        elif kind in ("literal_error", "enum"):
            words = trail.choices or [str(error["ctx"]["expected"]).replace("'", "")]
            choices.setdefault(trail.place, []).extend(map(str, words))
        elif not _is_long_enough(kind, error, _at(data, trail.place)):
            place, message, at = _words(kind, error, trail, _at(data, trail.place))
            problems.append((place, problem(place, message, at=at)))
    for place in dict.fromkeys([*needed, *choices]):
        # a union of a number and a mapping: where a mapping was written, only the mapping's own faults matter
        if not any(other[: len(place)] == place for other, _ in problems):
            kinds, allowed = (list(dict.fromkeys(part.get(place, []))) for part in (needed, choices))
            problems.append((place, problem(place, _wrong_kind(_at(data, place), kinds, allowed))))
    return list(dict.fromkeys(problems))


def _is_long_enough(kind: str, error: Mapping[str, Any], value: Any) -> bool:
    """Entries that are wrong themselves are not counted by pydantic: the list is long enough all the same."""
    return kind == "too_short" and isinstance(value, list | dict) and len(value) >= error["ctx"]["min_length"]


def _words(kind: str, error: Mapping[str, Any], trail: _Trail, value: Any) -> tuple[Place, str, str]:
    """Place, message and what to point at, for one error that is not a wrong kind of value."""
    place, extra = trail.place, error.get("ctx", {})
    if kind == "extra_forbidden":
        allowed = trail.allowed_keys
        return place, f"unknown key{_allowed(allowed, place[-1])}{_near(place[-1], allowed)}", "key"
    if kind == "missing":
        return place, f"is missing{trail.meaning}", "parent"
    if kind == "union_tag_not_found":
        key = extra["discriminator"].strip("'")
        return (*place, key), f"is missing{_allowed(trail.tags(key))}", "parent"
    if kind == "union_tag_invalid":
        key, tag = extra["discriminator"].strip("'"), extra["tag"]
        return (*place, key), f"found {tag!r}{_allowed(trail.tags(key), tag)}{_near(tag, trail.tags(key))}", "value"
    if kind in _BOUNDS:
        name, word = _BOUNDS[kind]
        return place, f"{value} is not {word} {extra[name]:g}{trail.unit}", "value"
    return _rest(kind, error, place, value)


def _rest(kind: str, error: Mapping[str, Any], place: Place, value: Any) -> tuple[Place, str, str]:
    extra = error.get("ctx", {})
    if kind == "finite_number":
        return place, f"{value} is not a finite number", "value"
    if kind in ("too_short", "string_too_short"):
        return place, f"has {_count(value)} (at least {extra['min_length']} needed)", "value"
    if kind in ("too_long", "string_too_long"):
        return place, f"has {_count(value)} (at most {extra['max_length']} allowed)", "value"
    if kind == "string_pattern_mismatch":
        return place, f"found {value!r} (allowed: texts like {extra['pattern']})", "value"
    if kind in ("value_error", "assertion_error"):
        cause = extra.get("error")
        return (*place, *getattr(cause, "place", ())), str(cause), "value"
    return place, f"{error['msg'][0].lower()}{error['msg'][1:]}", "value"


def _wrong_kind(value: Any, wanted: Sequence[str], choices: Sequence[str]) -> str:
    """Message for a value of the wrong type, or none of the choices, or both."""
    if not wanted:
        text = repr(value) if isinstance(value, str) and len(value) <= 60 else describe(value)
        return f"found {text}{_allowed(choices, value)}{_near(value, choices)}"
    wanted = [*wanted, f"one of {', '.join(choices)}"] if choices else wanted
    message = f"found {describe(value)} ({' or '.join(wanted)} is needed)"
    if not isinstance(value, str):
        quotes = "a text" in wanted and isinstance(value, int | float)
        quoted = ("true" if value else "false") if isinstance(value, bool) else value
        return f"{message}. Did you mean '{quoted}', in quotes?" if quotes else message
    if "true or false" in wanted and value.lower() in _TRUTH:
        return f"{message}. Did you mean {_TRUTH[value.lower()]}?"
    if wanted[0] == "a list" and value and "\n" not in value:
        return f"{message}. Did you mean [{value}]?"
    number = plain(value.strip())
    if wanted[0] in ("a number", "a whole number") and isinstance(number, int | float) and not isinstance(number, bool):
        return f"{message}. Did you mean {value.strip()}, without quotes?"
    return message


def _allowed(words: Iterable[Any], value: Any = "") -> str:
    """' (allowed: a, b, c).'; of a long list only the nearest ones."""
    names = list(map(str, words))
    if len(names) > MAX_CHOICES_LISTED:
        near = difflib.get_close_matches(str(value), names, n=5, cutoff=0.3) or names[:5]
        return f" (allowed: {', '.join(near)} and {len(names) - len(near)} others)."
    return f" (allowed: {', '.join(names)})." if names else "."


def _near(word: Any, allowed: Iterable[Any]) -> str:
    return did_you_mean(str(word), list(map(str, allowed)))


def _count(value: Any) -> str:
    number = len(value)
    return f"{number} {'character' if isinstance(value, str) else 'entry' if number == 1 else 'entries'}"


def _at(data: Any, place: Place) -> Any:
    for step in place:
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return None
    return data


class _Trail:
    """Follows a location through data and annotations side by side.

    place: the location without union tags. members: the annotations possible at its end. model: the model
    whose key is last. field: that key's field, or None.
    """

    def __init__(self, annotation: Any, data: Any, location: Sequence[str | int]):
        self.place: Place = ()
        self.model: type[BaseModel] | None = None
        self.field: FieldInfo | None = None
        self.members = members(annotation)
        for step in location:
            choice = self.members[0]
            if isinstance(choice, Choice):
                self.members = members(choice[str(step)]) if step in choice.tags else [Any]
                continue
            if len(self.members) > 1:
                # inside a union the next step is a tag: the discriminator's value or the name of a type
                self.members = [m for m in self.members if is_tagged(m, step)] or [Any]
                continue
            inner = self._inside(step)
            if inner is None and not (isinstance(data, dict) and step in data):
                continue  # a tag of something that is no union to us, such as `function-after[...]`
            self.place = (*self.place, step)
            self.members = inner or [Any]
            data = _at(data, (step,))

    def _inside(self, step: str | int) -> list[Any] | None:
        """Annotations one step further in, or None where the annotation has no such inside."""
        member = self.members[0]
        self.field = self.field if isinstance(step, int) else None  # a list's unit is that of its entries
        if is_model(member):
            self.model = member
            for name, info in member.model_fields.items():
                if step in (info.alias, info.validation_alias) or (step == name and info.alias is None):
                    self.field = info
                    return members(info.annotation)
            return [Any]
        origin, arguments = get_origin(member), get_args(member)
        if origin in (dict, Mapping):
            return members(arguments[1])
        return members(entry_of([member], step)) if isinstance(step, int) else None

    @property
    def allowed_keys(self) -> list[str]:
        """Keys of the mapping that holds the last step."""
        if self.model is None:
            return []
        return [str(info.alias or name) for name, info in self.model.model_fields.items()]

    def tags(self, discriminator: str) -> list[str]:
        """Tags of the discriminated union at the end, sorted."""
        return sorted({str(tag) for member in self.members for tag in tags_of(member, discriminator)})

    @property
    def choices(self) -> list[Any]:
        """Values of the Literal (or of the members of the enumeration) at the end."""
        return [choice for member in self.members if get_origin(member) is Literal for choice in get_args(member)]

    @property
    def unit(self) -> str:
        """' mm' where the field has that unit, else ''."""
        extra = self.field.json_schema_extra if self.field is not None else None
        unit = extra.get("unit") if isinstance(extra, dict) else None
        return f" {unit}" if is_unit(unit) and unit != "1" else ""

    @property
    def meaning(self) -> str:
        """' (what the field means)' where it has a description."""
        text = (self.field.description or "") if self.field is not None else ""
        if not text and self.choices:
            text = ", ".join(map(str, self.choices))
        return f" ({text[0].lower() + text[1:].rstrip('.')})" if text else ""
