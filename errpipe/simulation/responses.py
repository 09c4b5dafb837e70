"""Possible names of a recording's responses in a simulation, and the columns that hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.design import response_name


@dataclass(frozen=True)
class Values:
    """Simulated values of one response, (rows,), in the response's unit; why: reason -> rows without a value."""

    values: np.ndarray
    source: str
    why: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    datum: str = "absolute"


def names_of(recording: Recording, component: str) -> tuple[str, ...]:
    """Possible names of a response's simulated values."""
    error = error_column(recording, component)
    return (f"{error}_sim", f"{component}_sim", component, error)


def error_column(recording: Recording, component: str) -> str:
    """Name of a response's column. Raises DataError with the existing ones."""
    return response_name(recording, component, "twin")
