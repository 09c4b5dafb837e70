"""JSON Schemas (draft-07) of the models that people write or read, for editors and other programs.

Draft-07 and no newer, because editors' language servers stop there. A union discriminated by a key becomes
`allOf: [if key == a then ..., ...]`, so that a validator blames the one branch that was meant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, TypeAdapter

from errpipe.yamlfile import Choice, is_unit

_NUMBER_WITH_UNIT = {"type": "string", "pattern": r"^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*[^\s\d].*$"}
_NUMBERS = ("number", "integer")


def json_schema(model: type[BaseModel], title: str, *, written: bool) -> dict[str, Any]:
    """The draft-07 schema of a model, by the names used in files. written: by people, in YAML, where `20 um` counts."""
    full = TypeAdapter(model).json_schema(by_alias=True, ref_template="#/definitions/{model}")
    kinds: Any = getattr(model, "kinds", None)
    members = [kinds[kind] for kind in kinds.tags] if kinds else []
    defaults = {member.key: member.default for member in members if isinstance(member, Choice)}
    definitions = {name: _draft7(part, defaults) for name, part in sorted(full.pop("$defs", {}).items())}
    schema = {"$schema": "http://json-schema.org/draft-07/schema#", **_draft7(full, defaults), "title": title}
    if definitions:
        schema["definitions"] = definitions
    _accept_lists(schema, frozenset(m.key for m in members if isinstance(m, Choice) and m.several))
    if written:
        for _, _, prop in properties(schema):
            _accept_quantities(prop)
    return schema


def properties(schema: Mapping[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Every property of the schema: name of its model, its own name, its schema."""
    for owner, part in [("", schema), *schema.get("definitions", {}).items()]:
        for name, prop in part.get("properties", {}).items():
            yield owner, name, prop


def _draft7(node: Any, defaults: Mapping[str, str]) -> Any:
    """One schema node, translated."""
    if isinstance(node, list):
        return [_draft7(part, defaults) for part in node]
    if not isinstance(node, dict):
        return node
    node = {key: value for key, value in node.items() if key != "title" or not isinstance(value, str)}
    if "discriminator" in node:
        return _choice(node, defaults)
    new: dict[str, Any] = {}
    for key, value in node.items():
        if key in ("properties", "definitions", "patternProperties"):
            new[key] = {name: _draft7(part, defaults) for name, part in value.items()}
        elif key == "prefixItems":
            new["items"], new["additionalItems"] = _draft7(value, defaults), False
        elif key in ("default", "const", "enum", "examples"):
            new[key] = value
        else:
            new[key] = _draft7(value, defaults)
    if "const" in new:
        new.setdefault("description", f"Always {new['const']}.")
    if "$ref" in new and len(new) > 1:
        new["allOf"] = [{"$ref": new.pop("$ref")}]  # draft-07 ignores keys next to a $ref
    return new


def _choice(node: Mapping[str, Any], defaults: Mapping[str, str]) -> dict[str, Any]:
    """A discriminated union as if/then. defaults: key -> its value where it is not written."""
    key, mapping = node["discriminator"]["propertyName"], node["discriminator"]["mapping"]
    rest = {name: _draft7(value, defaults) for name, value in node.items() if name not in ("discriminator", "oneOf")}
    branches = []
    for tag in sorted(mapping):
        written = {} if defaults.get(key) == tag else {"required": [key]}
        condition = {"properties": {key: {"const": tag}}, **written}
        branches.append({"if": condition, "then": _branch(mapping[tag], defaults)})
    needed = {} if key in defaults else {"required": [key]}
    return rest | {"type": "object", **needed, "properties": {key: {"enum": sorted(mapping)}}, "allOf": branches}


def _accept_lists(node: Any, listed: frozenset[str]) -> None:
    """Accept a list of names in a discriminating key that allows it."""
    for part in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        _accept_lists(part, listed)
    keys = node.get("properties", {}) if isinstance(node, dict) else {}
    for key in listed & set(keys):
        if set(keys[key]) == {"enum"}:
            keys[key] = {"anyOf": [keys[key], {"type": "array", "items": dict(keys[key]), "minItems": 1}]}


def _branch(choice: Any, defaults: Mapping[str, str]) -> dict[str, Any]:
    """One branch of a union: a model, or a nested union discriminated by a second key."""
    if isinstance(choice, str):
        return {"$ref": choice}
    return _draft7(dict(choice), defaults)


def _accept_quantities(prop: dict[str, Any]) -> None:
    """Where a property has a unit, a text such as `20 um` stands for a number."""
    if not is_unit(prop.get("unit")) or prop["unit"] == "1" or "const" in prop:
        return
    if prop.get("type") in _NUMBERS:
        bounds = {key: prop.pop(key) for key in list(prop) if key not in ("description", "unit", "default")}
        prop["anyOf"] = [bounds, dict(_NUMBER_WITH_UNIT)]
        return
    if "anyOf" in prop and any(part.get("type") in _NUMBERS for part in prop["anyOf"]):
        prop["anyOf"] = [*prop["anyOf"], dict(_NUMBER_WITH_UNIT)]
    for part in [prop, *prop.get("anyOf", ())]:
        items = part.get("items")
        for entry in [*(items if isinstance(items, list) else [items]), part.get("additionalProperties")]:
            if isinstance(entry, dict) and entry.get("type") in _NUMBERS:
                number = dict(entry)
                entry.clear()
                entry["anyOf"] = [number, dict(_NUMBER_WITH_UNIT)]
