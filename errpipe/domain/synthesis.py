"""An output of a table before it is compiled: the sum of weight x component x product of drivers.

`kinematics` derives it from a machine, `tables` compiles it; they do not import each other.
"""

from __future__ import annotations

from dataclasses import dataclass

from errpipe.domain.driver import Driver


@dataclass(frozen=True)
class MonomialSource:
    """weight x component x product of at most four drivers (coordinates in mm, tool length, sine, cosine)."""

    weight: float
    component: str
    factors: tuple[Driver, ...] = ()


@dataclass(frozen=True)
class OutputSource:
    """One output: the sum of its monomials, in `unit` of deviation, corrected along `axis`."""

    name: str
    terms: tuple[MonomialSource, ...]
    axis: str = ""
    unit: str = "um"
    correction_unit: str = "mm"
