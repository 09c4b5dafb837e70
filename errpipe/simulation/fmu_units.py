"""Units as FMUs spell them, and their conversion: a temperature is not a temperature rise."""

from __future__ import annotations

import math
from typing import Any

from errpipe.errors import DataError

# dimension -> {unit: (zero, factor)}: base = (value - zero) * factor
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "length": {
        "m": (0, 1),
        "mm": (0, 1e-3),
        "um": (0, 1e-6),
        "nm": (0, 1e-9),
        "cm": (0, 1e-2),
        "inch": (0, 0.0254),
        "km": (0, 1e3),
    },
    "angle": {
        "rad": (0, 1),
        "mrad": (0, 1e-3),
        "urad": (0, 1e-6),
        "deg": (0, math.pi / 180),
        "arcsec": (0, math.pi / 648e3),
    },
    "time": {"s": (0, 1), "ms": (0, 1e-3), "min": (0, 60), "h": (0, 3600), "d": (0, 86400)},
    "speed": {"m/s": (0, 1), "mm/s": (0, 1e-3), "mm/min": (0, 1e-3 / 60), "m/min": (0, 1 / 60)},
    "acceleration": {"m/s2": (0, 1), "mm/s2": (0, 1e-3)},
    "rotation": {
        "rad/s": (0, 1),
        "rpm": (0, math.pi / 30),
        "1/s": (0, 2 * math.pi),
        "deg/s": (0, math.pi / 180),
        "deg/min": (0, math.pi / 10800),
    },
    "temperature": {"degC": (-273.15, 1), "K": (0, 1), "degF": (-459.67, 5 / 9)},
    "temperature rise": {"K": (0, 1), "degC": (0, 1), "degF": (0, 5 / 9)},
    "force": {"N": (0, 1), "kN": (0, 1e3)},
    "mass": {"kg": (0, 1), "g": (0, 1e-3), "t": (0, 1e3)},
    "pressure": {"Pa": (0, 1), "hPa": (0, 100), "mbar": (0, 100), "kPa": (0, 1e3), "bar": (0, 1e5)},
    "number": {"1": (0, 1), "%": (0, 0.01)},
}
SPELLINGS = {
    "C": "degC",
    "Cel": "degC",
    "celsius": "degC",
    "deg_C": "degC",
    "F": "degF",
    "µm": "um",
    "μm": "um",
    "in": "inch",
    "rev/min": "rpm",
    "1/min": "rpm",
    "r/min": "rpm",
    "Hz": "1/s",
    "m/s^2": "m/s2",
    "m.s-2": "m/s2",
    "m.s-1": "m/s",
    "rad.s-1": "rad/s",
    "mm/s^2": "mm/s2",
    "-": "1",
    "": "1",
}


def convert(values: Any, own: str, unit: str, why: str, rise: bool = False) -> Any:
    """Convert values from one unit to another. Raises DataError starting with `why` for different quantities."""
    kinds = [k for k, units in UNITS.items() if own in units and unit in units]
    kinds = [k for k in kinds if (k == "temperature rise") == rise] if own in ("K", "degC", "degF") else kinds
    if not kinds:
        of = {u: next((k for k, known in UNITS.items() if u in known), "not a known unit") for u in (own, unit)}
        raise DataError(f"{why}: {own} is {of[own]}, {unit} is {of[unit]}")
    (zero, factor), (to_zero, to_factor) = UNITS[kinds[0]][own], UNITS[kinds[0]][unit]
    if own == unit:
        return values
    return (values - zero) * factor / to_factor + to_zero
