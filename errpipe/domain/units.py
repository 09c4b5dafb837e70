"""Units of input: which ones each role may use, and their conversion to canonical units.

A conversion is affine, `canonical = (value - zero) * factor`, so that degF and K are as plain as inch.
After reading, all is in mm, deg, s, mm/s, mm/s2, mm/min, rpm, degC, hPa, N, kg; deviations um, urad; torques N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from errpipe.domain.recording import ROLE_UNITS, UNITLESS_BY_DEFAULT

# canonical unit -> {unit: (zero, factor)}; factors are exact by definition of the units.
_INTO: dict[str, dict[str, tuple[float, float]]] = {
    "mm": {"mm": (0, 1), "m": (0, 1e3), "um": (0, 1e-3), "inch": (0, 25.4), "km": (0, 1e6)},
    "m": {"m": (0, 1), "mm": (0, 1e-3), "km": (0, 1e3)},
    "deg": {"deg": (0, 1), "rad": (0, 180 / math.pi)},
    "s": {"s": (0, 1), "ms": (0, 1e-3), "min": (0, 60), "h": (0, 3600), "d": (0, 86400)},
    "mm/s": {"mm/s": (0, 1), "m/s": (0, 1e3), "mm/min": (0, 1 / 60), "m/min": (0, 1e3 / 60)},
    "deg/s": {"deg/s": (0, 1)},
    "mm/s2": {"mm/s2": (0, 1), "m/s2": (0, 1e3)},
    "deg/s2": {"deg/s2": (0, 1)},
    "mm/min": {"mm/min": (0, 1), "m/min": (0, 1e3), "mm/s": (0, 60)},
    "deg/min": {"deg/min": (0, 1)},
    "rpm": {"rpm": (0, 1), "1/s": (0, 60)},
    "degC": {"degC": (0, 1), "degF": (32, 5 / 9), "K": (273.15, 1)},
    "hPa": {"hPa": (0, 1), "mbar": (0, 1), "Pa": (0, 1e-2), "kPa": (0, 10), "bar": (0, 1e3)},
    "%": {"%": (0, 1)},
    "N": {"N": (0, 1), "kN": (0, 1e3)},
    "N m": {"N m": (0, 1), "kN m": (0, 1e3), "N mm": (0, 1e-3), "N cm": (0, 1e-2)},
    "A": {"A": (0, 1), "mA": (0, 1e-3)},
    "kg": {"kg": (0, 1), "g": (0, 1e-3), "t": (0, 1e3)},
    "um": {"um": (0, 1), "mm": (0, 1e3), "nm": (0, 1e-3)},
    "urad": {"urad": (0, 1), "mrad": (0, 1e3), "arcsec": (0, math.pi / 648e3 * 1e6)},
}

# Canonical units of each role, the usual one first; the unit written decides between several.
_CANONICAL: dict[str, tuple[str, ...]] = {
    "time": ("s",),
    "position": ("mm", "deg"),
    "command": ("mm", "deg"),
    "actual": ("mm", "deg"),
    "velocity": ("mm/s", "deg/s"),
    "acceleration": ("mm/s2", "deg/s2"),
    "feed": ("mm/min", "deg/min"),
    "spindle_speed": ("rpm",),
    "temperature": ("degC",),
    "pressure": ("hPa",),
    "humidity": ("%",),
    "force": ("N",),
    "current": ("A",),
    "torque": ("N m",),
    "load": ("kg",),
    "depth_of_cut": ("mm",),
    "overhang": ("mm",),
    "cut_length": ("m",),
    "size": ("mm",),
    "uncertainty": ("um", "urad"),
    "error": ("um", "urad", "N", "N m"),
    "simulated": ("um", "urad", "N", "N m"),
}


# l/min from which coolant counts as flowing: pumps of machine tools move several, a flow meter at rest shows less (by
# judgement). How much more flows is not modelled: heat passes through a film that hardly changes with it.
FLOWING = 0.5


@dataclass(frozen=True)
class Conversion:
    """canonical = (value - zero) * factor, in `unit`; with a threshold 1 from there on, else 0, without a unit."""

    unit: str
    zero: float = 0.0
    factor: float = 1.0
    threshold: float | None = None

    @property
    def identity(self) -> bool:
        """True where the written unit is already canonical."""
        return self.zero == 0.0 and self.factor == 1.0 and self.threshold is None

    def __call__(self, value: Any) -> Any:
        """One number or an array, converted."""
        if self.threshold is not None:
            return np.where(np.isnan(value), value, np.greater_equal(value, self.threshold))
        return value if self.identity else (value - self.zero) * self.factor


def conversion(role: str, unit: str | None) -> Conversion | None:
    """How a column of `role` written in `unit` becomes canonical; None where the role has no unit.

    Raises ValueError if the unit is not one of the role's, or is missing and not implied.
    """
    if role == "coolant" and unit is not None:
        return Conversion("", threshold=FLOWING)
    if role not in _CANONICAL:
        return None
    if unit is None:
        unit = UNITLESS_BY_DEFAULT.get(role)
        if unit is None:
            raise ValueError(f"a column of role {role} needs a unit (allowed: {', '.join(ROLE_UNITS[role])})")
    for canonical in _CANONICAL[role]:
        known = _INTO[canonical].get(unit)
        if known is not None and unit in ROLE_UNITS[role]:
            return Conversion(canonical, *map(float, known))
    allowed = ROLE_UNITS[role]
    raise ValueError(f"{unit!r} is not a unit of role {role} (allowed: {', '.join(allowed)}).")


# Canonical units among constants: a deviation, a temperature rise.
_AS_THEY_STAND = ("um", "urad", "K", "%")


def constant(unit: str) -> Conversion | None:
    """The conversion of a constant's unit into the canonical one of its dimension; None where unknown.

    Lengths become mm, but a `um` is a deviation and a `K` a rise, and both stay.
    """
    if unit in _AS_THEY_STAND:
        return Conversion(unit)
    for canonical in ("mm", "deg", "s", "mm/s", "mm/min", "mm/s2", "rpm", "degC", "hPa", "N", "kg", "urad"):
        if unit in _INTO[canonical]:
            return Conversion(canonical, *map(float, _INTO[canonical][unit]))
    return None
