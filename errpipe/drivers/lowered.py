"""What a compiled model is a sum of: a profile over position times a driver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from errpipe.domain import driver as d


@dataclass(frozen=True)
class Lowered:
    """One compiled pair: profile(position of `axis`) * driver(state), in the response's unit.

    profile: vectorised function of positions in mm (deg), or None for the constant 1.
    period: repeat length of the profile, where it has one; nodes: ascending positions between which it is straight.
    """

    driver: d.Driver
    axis: str | None = None
    profile: Callable[[np.ndarray], np.ndarray] | None = None
    period: float | None = None
    nodes: tuple[float, ...] = ()
