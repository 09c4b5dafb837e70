"""What a plausibility check takes (a response with its axis) and returns (a finding)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import Recording

URAD_PER_DEG = 1e6 * np.pi / 180
FEWEST = 6  # finite rows; fewer say nothing about a slope


@dataclass(frozen=True)
class Finding:
    """One implausible declaration. code: its name, for `allow`; found: the evidence; meant: what was probably meant."""

    code: str
    column: str
    found: str
    meant: str
    level: Literal["refuse", "ask"] = "refuse"

    def __str__(self) -> str:
        return f"{self.column}: {self.found}. Probably meant: {self.meant} [{self.code}]"


@dataclass(frozen=True)
class Response:
    """One error column and the position of its own axis, on the rows where both are finite.

    deviation: um, urad or N, shape (n,); position: mm or deg, shape (n,), None where the recording has none;
    direction: +1 or -1, shape (n,), None where there is none; run: run number of each row, shape (n,).
    """

    recording: Recording
    column: str
    component: components.Component
    rows: np.ndarray
    deviation: np.ndarray
    position: np.ndarray | None
    direction: np.ndarray | None
    run: np.ndarray

    @property
    def per_unit(self) -> float | None:
        """Deviation of one unit of position (1000 um per mm); None where the two are of different kinds."""
        rotary = self.component.axis is not None and self.component.axis[0] in "ABC"
        if self.component.kind == "force" or rotary != (self.component.unit == "urad"):
            return None
        return URAD_PER_DEG if rotary else 1000.0

    @property
    def span(self) -> float:
        """Range of the positions of this response, mm or deg; 0 without a position."""
        return 0.0 if self.position is None or not self.position.size else float(np.ptp(self.position))


Check = Callable[[Response], Finding | None]
LARGEST = 1e15  # of a position or a deviation in its unit; sums of squares of larger ones overflow


def responses(recording: Recording) -> list[Response]:
    """Every error column of a recording; without the readings that are too large to be any, which a door refuses."""
    out = []
    for name in recording.names("error"):
        component = components.parse(str(recording.manifest.columns[name].component))
        d = recording.array(name)
        place = _own(recording, ("command", "position"), component.axis)
        side = _own(recording, ("direction",), component.axis)
        good = np.abs(d) < LARGEST
        if place is not None:
            good &= np.abs(recording.array(place)) < LARGEST
        rows = np.flatnonzero(good)
        out.append(
            Response(
                recording,
                name,
                component,
                rows,
                d[rows],
                None if place is None else recording.array(place)[rows],
                None if side is None else recording.array(side)[rows],
                recording.run_codes()[rows],
            )
        )
    return out


def _own(recording: Recording, roles: Sequence[str], axis: str | None) -> str | None:
    """The first column of one of the roles that belongs to an axis."""
    if axis is None:
        return None
    return next((n for role in roles if (n := recording.name(role, axis=axis)) is not None), None)
