"""What formats of a positioning test of one axis share: columns, and numbers as their texts hold them."""

from __future__ import annotations

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import Column
from errpipe.errors import DataError


def columns_of(axis: str) -> dict[str, Column]:
    """Columns of a test of a linear axis: run, position, direction, deviation, in this order."""
    component = components.positioning(axis)
    return {
        "run": Column(role="run"),
        axis.lower(): Column(role="position", axis=axis, unit="mm"),
        "direction": Column(role="direction", axis=axis),
        component: Column(role="error", component=component, unit="um"),
    }


def finite(text: str, place: str) -> float:
    """A finite number. Raises DataError that names its place."""
    try:
        value = float(text) if "_" not in text else np.nan
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        hint = " (a decimal comma? save with decimal points)" if "," in text else ""
        raise DataError(f"{place}: {text!r} is not a number{hint}")
    return value
