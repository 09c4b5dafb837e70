"""Input of a plausibility check (a response with its axis) and its result (a finding)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import Recording

URAD_PER_DEG = 1e6 * np.pi / 180
RARE = 1e-4  # probability that two equal variances have such a ratio; four orders are tried on each recording
RARE_NOISE = 1e-3  # probability that rows in correct order differ by more than the repeats allow
SINGLE_RUN_RATIO = 16.0  # of variances: of 1023 correct single runs none passes even the F test alone
FINE = 200.0  # levels within the span; a dial of 0.01 mm has 30 of them over an error of 0.3 mm
MIN_FINITE_ROWS = 6  # finite rows; fewer do not determine a slope


@dataclass(frozen=True)
class Finding:
    """One implausible declaration. code: its name, for `allow`; found: the evidence; meant: the probable intention.

    of_sign: whether it is evidence against the sign of the whole column.
    """

    code: str
    column: str
    found: str
    meant: str
    level: Literal["refuse", "ask"] = "refuse"
    of_sign: bool = False

    def __str__(self) -> str:
        return f"{self.column}: {self.found}. Probably meant: {self.meant} [{self.code}]"


@dataclass(frozen=True)
class Response:
    """One error column and the position of its own axis, on the rows where both are finite.

    deviation: um, urad or N, shape (n,); position: mm or deg, shape (n,), None if the recording has none;
    direction: +1 or -1, shape (n,), None if there is none; run: run number of each row, shape (n,).
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
        """Deviation per unit of position (1000 um per mm); None if the two are different quantities."""
        rotary = self.component.axis is not None and components.is_rotary(self.component.axis)
        if self.component.kind == "force" or rotary != (self.component.unit == "urad"):
            return None
        return URAD_PER_DEG if rotary else 1000.0

    @property
    def span(self) -> float:
        """Range of the positions of this response, mm or deg; 0 without a position."""
        return 0.0 if self.position is None or not self.position.size else float(np.ptp(self.position))

    def side(self) -> np.ndarray:
        """Approach direction of each row, +1 or -1, shape (n,); 0 without a direction."""
        return np.zeros(self.rows.size) if self.direction is None else self.direction

    def cells(self) -> np.ndarray:
        """Number of each row's target and side, shape (n,)."""
        return numbered(np.round(np.asarray(self.position), 3), self.side())

    def groupings(self) -> list[tuple[str, np.ndarray]]:
        """Groupings of rows: the run and, if recorded, the direction; each with its label, (n,)."""
        return [("run", self.run)] + ([] if self.direction is None else [("direction", self.direction)])

    def label_of(self, what: str, value: float) -> str:
        """A label of `groupings` as text."""
        return self.recording.run_labels()[int(value)] if what == "run" else f"{value:+g}"

    def repeats(self) -> tuple[float, int]:
        """Variance of the deviation among runs at the same target from the same side, and its degrees of freedom.

        Each run and side about its own mean, so that a run's offset is not noise; (0, 0) without repeats.
        """
        if self.position is None:
            return 0.0, 0
        visit, cell = numbered(self.run, self.side()), self.cells()
        rest = self.deviation - group_means(self.deviation, visit)
        freedom = int(rest.size - np.unique(cell).size - np.unique(visit).size + np.unique(self.side()).size)
        squares = float(np.sum((rest - group_means(rest, cell)) ** 2))
        return (squares / freedom, freedom) if freedom > 0 else (0.0, 0)


def numbered(*keys: np.ndarray) -> np.ndarray:
    """Number of each row's combination of keys, shape (n,)."""
    return np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)[1].ravel()


def group_means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Mean of each row's group, shape (n,)."""
    code = np.unique(group, return_inverse=True)[1]
    return (np.bincount(code, values) / np.bincount(code))[code]


def noise_of_difference(r: Response) -> float:
    """Variance that the repeats expect of the difference of the mean curves of the two directions."""
    visits = [max(np.unique(r.run[r.direction == side]).size, 1) for side in (1.0, -1.0)]
    return r.repeats()[0] * (1 / visits[0] + 1 / visits[1])


def _f_quantile(first: int, second: int, level: float) -> float:
    from scipy.special import fdtri

    return float(fdtri(first, second, 1 - level))


def is_rearranged(r: Response, as_declared: float, rearranged: float, targets: int, noise: float) -> bool:
    """Whether two curves differ only by noise in another order of their rows, and by more in the declared one.

    as_declared, rearranged: variances of their difference, each with two parameters removed. noise: variance that the
    repeats expect of the difference, 0 without repeats (only the ratio of the two can then be tested,
    which justifies a question, no refusal: smooth curves have fewer free values than targets).
    Two F tests: against each other (level RARE), and against the repeats (level RARE_NOISE).
    """
    freedom = max(targets - 2, 1)
    if as_declared < _f_quantile(freedom, freedom, RARE) * rearranged:
        return False
    repeats = r.repeats()[1]
    return repeats == 0 or rearranged <= _f_quantile(freedom, repeats, RARE_NOISE) * noise


def has_fine_resolution(values: np.ndarray) -> bool:
    """Whether readings have so many possible levels that none repeats by chance: a laser's, not a dial's."""
    steps = np.diff(np.unique(values))
    return steps.size > 0 and float(np.ptp(values)) > FINE * float(steps.min())


def level_of_rearranged(r: Response, as_declared: float, rearranged: float) -> Literal["refuse", "ask"]:
    """Level of a finding that `is_rearranged`: without repeats only a far better agreement refuses."""
    return "refuse" if r.repeats()[1] or as_declared > SINGLE_RUN_RATIO * rearranged else "ask"


Check = Callable[[Response], Finding | None]
MAX_MAGNITUDE = 1e15  # of a position or a deviation in its unit; sums of squares of larger ones overflow


def responses(recording: Recording) -> list[Response]:
    """Every error column of a recording; without implausibly large readings, which are refused on import."""
    out = []
    for name in recording.names("error"):
        component = components.parse(str(recording.manifest.columns[name].component))
        d = recording.array(name)
        place = _column_of_axis(recording, ("command", "position"), component.axis)
        side = _column_of_axis(recording, ("direction",), component.axis)
        good = np.abs(d) < MAX_MAGNITUDE
        if place is not None:
            good &= np.abs(place) < MAX_MAGNITUDE
        rows = np.flatnonzero(good)
        position, direction = (None if v is None else v[rows] for v in (place, side))
        run = recording.run_codes()[rows]
        out.append(Response(recording, name, component, rows, d[rows], position, direction, run))
    return out


def _column_of_axis(recording: Recording, roles: Sequence[str], axis: str | None) -> np.ndarray | None:
    """The first column of one of the roles that belongs to an axis."""
    names = (recording.name(role, axis=axis) for role in roles if axis is not None)
    return next((recording.array(name) for name in names if name is not None), None)


def means_at(places: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Mean of the values at each of some positions, shape (at,), all of them among `places`; places, values: (n,)."""
    levels, code = np.unique(places, return_inverse=True)
    means = np.bincount(code, values) / np.bincount(code)
    return np.asarray(means[np.searchsorted(levels, at)])
