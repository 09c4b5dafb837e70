"""What no measurement can be: a reading beyond these limits is a slip of unit, a logger's mark or a damaged file.

Refused on reading, because a deviation of 1e10 um would leave as a correction of 10 km that no later step doubts.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from errpipe.errors import DataError

# Role -> largest absolute value in its canonical unit; a deviation of a machine tool is below 10 mm or 10 mrad.
LARGEST: dict[str, dict[str | None, float]] = {
    role: {"um": 1e6, "urad": 1e6, "N": 1e9, "N m": 1e9} for role in ("error", "simulated")
}
LARGEST_OF_ANY = 1e15  # as in a compensation table: single precision controllers compute with these numbers


def refuse_impossible(values: np.ndarray, role: str, unit: str | None, name: str, place: Callable[[int], str]) -> None:
    """Raises DataError at the first value, shape (rows,), beyond what its role can hold; NaN passes."""
    largest = LARGEST.get(role, {}).get(unit, LARGEST_OF_ANY)
    if values.size and values.max() <= largest and values.min() >= -largest:  # neither is so where one is NaN
        return
    with np.errstate(invalid="ignore"):
        beyond = np.abs(values) > largest
    if beyond.any():
        row = int(np.argmax(beyond))
        raise DataError(
            f"{place(row)}  {name}: {values[row]:.10g} {unit or ''}".rstrip()
            + f" is impossible (allowed: up to {largest:g}, or an empty cell where there is no reading)"
        )


def refuse_reverse_flow(values: np.ndarray, noise: float, name: str, place: Callable[[int], str]) -> None:
    """Raises DataError for a flow below zero by more than its noise: a logger's mark for no reading."""
    wrong = values < -noise
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"{place(row)}  {name}: {values[row]:g} is not a flow in l/min (allowed: 0 and more, or empty)")
