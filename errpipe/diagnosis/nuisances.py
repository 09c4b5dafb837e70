"""Columns that may be off in any simulation without anything missing: datums, its gain, the gains of its parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Nuisance:
    """What one column stands for; `label`: how a report shows it; effect and `part`: whose it is, and its label.

    datum: a constant; session datum: a constant of one session; whole: the simulated signal; part: what the signal
    holds of one effect; departure: of that effect from its textbook form, or what may belong to another part.
    """

    kind: Literal["datum", "session datum", "whole", "part", "departure"]
    label: str
    effect: str = ""
    part: str = ""

    @property
    def is_datum(self) -> bool:
        """Whether it is a constant."""
        return self.kind in ("datum", "session datum")


DATUM = Nuisance("datum", "datum")
WHOLE = Nuisance("whole", "simulation")
