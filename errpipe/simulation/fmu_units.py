"""Units as FMUs spell them, and their conversion: a temperature is not a temperature rise."""

from __future__ import annotations

import math
from typing import Any

from errpipe.errors import DataError
from errpipe.yamlfile import UNITS

# dimension -> {unit: (zero, factor)}: base = (value - zero) * factor; in an FMU all speeds of rotation are one
TABLE = {name: {u: (float(zero), float(factor)) for u, (zero, factor) in of.items()} for name, of in UNITS.items()}
ROTATION = {"rad/s": 1, "rpm": math.pi / 30, "1/s": 2 * math.pi, "deg/s": math.pi / 180, "deg/min": math.pi / 10800}
TABLE["angular speed"] = {unit: (0.0, factor) for unit, factor in ROTATION.items()}
RISE = "temperature rise"
TABLE[RISE] = {"K": (0.0, 1.0), "degC": (0.0, 1.0), "degF": (0.0, 5 / 9)}
for name in ("rotational speed", "temperature difference"):
    del TABLE[name]
WRITTEN_AS = {
    "degC": ("C", "Cel", "celsius", "deg_C"),
    "degF": ("F",),
    "um": ("µm", "μm"),
    "inch": ("in",),
    "rpm": ("rev/min", "1/min", "r/min"),
    "1/s": ("Hz",),
    "m/s": ("m.s-1",),
    "m/s2": ("m/s^2", "m.s-2"),
    "mm/s2": ("mm/s^2",),
    "rad/s": ("rad.s-1",),
    "1": ("-", ""),
}
SPELLINGS = {spelling: unit for unit, spellings in WRITTEN_AS.items() for spelling in spellings}


def convert(values: Any, own: str, unit: str, why: str, rise: bool = False) -> Any:
    """Convert values from one unit to another. Raises DataError starting with `why` for different quantities."""
    kinds = [k for k, units in TABLE.items() if own in units and unit in units]
    kinds = [k for k in kinds if (k == RISE) == rise] if own in ("K", "degC", "degF") else kinds
    if not kinds:
        of = {u: next((k for k, known in TABLE.items() if u in known), "not a known unit") for u in (own, unit)}
        raise DataError(f"{why}: {own} is {of[own]}, {unit} is {of[unit]}")
    (zero, factor), (to_zero, to_factor) = TABLE[kinds[0]][own], TABLE[kinds[0]][unit]
    if own == unit:
        return values
    return (values - zero) * factor / to_factor + to_zero
