"""Numbers with units in YAML: `20 um` in a field whose schema says um, or mm, is a number."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, TypeGuard, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticUndefined

from errpipe.errors import did_you_mean
from errpipe.yamlfile.annotations import entry_of, members, model_for
from errpipe.yamlfile.places import Place

_PI = Fraction(math.pi)
# dimension -> {unit: (zero, factor)}: value in the dimension's base = (number - zero) * factor, exactly.
_AS_WRITTEN: dict[str, dict[str, tuple[int | str, int | str | Fraction]]] = {
    "length": {
        "nm": (0, "1e-9"),
        "um": (0, "1e-6"),
        "mm": (0, "1e-3"),
        "cm": (0, "1e-2"),
        "m": (0, 1),
        "km": (0, 1000),
        "inch": (0, "0.0254"),
    },
    "angle": {
        "rad": (0, 1),
        "mrad": (0, "1e-3"),
        "urad": (0, "1e-6"),
        "nrad": (0, "1e-9"),
        "deg": (0, _PI / 180),
        "arcmin": (0, _PI / 10800),
        "arcsec": (0, _PI / 648000),
        "rev": (0, 2 * _PI),
    },
    "time": {"us": (0, "1e-6"), "ms": (0, "1e-3"), "s": (0, 1), "min": (0, 60), "h": (0, 3600), "d": (0, 86400)},
    "speed": {"mm/s": (0, "1e-3"), "m/s": (0, 1), "mm/min": (0, Fraction(1, 60000)), "m/min": (0, Fraction(1, 60))},
    "angular speed": {"deg/s": (0, 1), "deg/min": (0, Fraction(1, 60))},
    "acceleration": {"mm/s2": (0, "1e-3"), "m/s2": (0, 1)},
    "rotational speed": {"rpm": (0, 1), "1/s": (0, 60)},
    "temperature": {"degC": (0, 1), "K": ("273.15", 1), "degF": (32, Fraction(5, 9))},
    "temperature difference": {"K": (0, 1), "delta_degC": (0, 1), "delta_degF": (0, Fraction(5, 9))},
    "pressure": {"Pa": (0, 1), "hPa": (0, 100), "mbar": (0, 100), "kPa": (0, 1000), "bar": (0, 100000)},
    "ratio": {"1": (0, 1), "%": (0, "0.01")},
    "force": {"N": (0, 1), "kN": (0, 1000)},
    "mass": {"kg": (0, 1), "g": (0, "1e-3"), "t": (0, 1000)},
}
UNITS = {
    dimension: {unit: (Fraction(zero), Fraction(factor)) for unit, (zero, factor) in units.items()}
    for dimension, units in _AS_WRITTEN.items()
}
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)\s*([^\s\d].*?)\s*$")


def convert(text: str, unit: str) -> float:
    """The number that a text such as `20 um` stands for, in `unit`; rounded once, so `68 degF` is 20 degC exactly.

    Raises ValueError naming the allowed units where the text has another dimension or is no quantity.
    """
    # K measures a difference where the field is in K; a point where the field is in degC.
    tables = [table for name, table in UNITS.items() if unit in table and not (unit == "K" and name == "temperature")]
    allowed = list(tables[0]) if tables else [unit]
    match = _QUANTITY.match(text)
    if match is None:
        raise ValueError(f"found {text!r} (a number or a number with its unit, such as '1 {unit}', is needed)")
    number, written = Fraction(match[1]), match[2]
    if written != unit and written not in allowed:
        raise ValueError(f"found unit {written!r} (allowed: {', '.join(allowed)}).{did_you_mean(written, allowed)}")
    if written != unit:
        (zero, factor), (own_zero, own_factor) = tables[0][written], tables[0][unit]
        number = (number - zero) * factor / own_factor + own_zero
    try:
        return float(number)
    except OverflowError:
        raise ValueError(f"{text!r} is not a finite number of {unit}") from None


class Options(BaseModel):
    """Base of every model a person writes in YAML: frozen, unknown keys refused, no infinities."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


def quantity(unit: str, description: str, default: Any = PydanticUndefined, **more: Any) -> Any:
    """A field with a unit; more: what `pydantic.Field` takes."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **more)


class InvalidKey(ValueError):
    """Raised in a validator of a whole model to point at one key inside it: InvalidKey(("terms", 1), "...")."""

    def __init__(self, place: tuple[str | int, ...], message: str):
        self.place = place
        super().__init__(message)


def is_unit(value: Any) -> TypeGuard[str]:
    """Whether what a field says of its unit is one: `of the input` points at another field or file instead."""
    return isinstance(value, str) and not value.startswith("of ")


def convert_quantities(model: Any, data: Any, place: Place = ()) -> tuple[Any, list[tuple[Place, str]]]:
    """The data with every quantity converted that stands in a field with a unit, and what cannot be (place, why).

    Done before validation, so that validation sees numbers only and can be strict.
    """
    wrong: list[tuple[Place, str]] = []
    inside = members(model)
    if isinstance(data, dict):
        chosen = model_for(inside, data)
        values = next((get_args(m)[1] for m in inside if get_origin(m) in (dict, Mapping)), Any)
        fields = {info.alias or name: info for name, info in chosen.model_fields.items()} if chosen else {}
        new: Any = {}
        for key, value in data.items():
            info = fields.get(key)
            extra = info.json_schema_extra if info is not None else None
            unit = extra.get("unit") if isinstance(extra, dict) else None
            if is_unit(unit):
                new[key], problems = _with_unit(value, unit, (*place, key))
            else:
                kind = info.annotation if info is not None else values if chosen is None else Any
                new[key], problems = convert_quantities(kind, value, (*place, key))
            wrong += problems
        return new, wrong
    if isinstance(data, list):
        new = []
        for number, value in enumerate(data):
            converted, problems = convert_quantities(entry_of(inside, number), value, (*place, number))
            new.append(converted)
            wrong += problems
        return new, wrong
    return data, wrong


def _with_unit(value: Any, unit: str, place: Place) -> tuple[Any, list[tuple[Place, str]]]:
    """One value of a field with a unit, or a list or mapping of such; words (`auto`) are left for the model."""
    if isinstance(value, list | dict):
        new, wrong = (value.copy(), [])
        for key, part in enumerate(value) if isinstance(value, list) else value.items():
            new[key], problems = _with_unit(part, unit, (*place, key))
            wrong += problems
        return new, wrong
    if isinstance(value, str) and _QUANTITY.match(value):
        try:
            return convert(value, unit), []
        except ValueError as err:
            return value, [(place, str(err))]
    return value, []
