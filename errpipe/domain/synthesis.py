"""The synthesis of a machine as plain data: outputs = sum of weight x component x product of drivers.

Derived by `kinematics` and passed by a stage to `tables`, which do not import each other.
"""

from __future__ import annotations

from typing import Literal

from errpipe.domain.driver import Driver
from errpipe.domain.recording import Frozen


class SynthesisTerm(Frozen):
    """weight x component x product of drivers (coordinates in mm, tool length, sine, cosine)."""

    weight: float
    component: str
    factors: tuple[Driver, ...] = ()


class SynthesisOutput(Frozen):
    """One deviation: of the tool point along an axis (um), or of its orientation (urad)."""

    name: str
    axis: str = ""
    unit: Literal["um", "urad"] = "um"
    terms: tuple[SynthesisTerm, ...]
