"""Laser and level records of single components as observations of a machine, combined with other tests.

A row reads one component at one position, in um or urad. The beam's own errors are removed first (`direct`);
unknown set-up is fitted together with the components, so that every interval includes it:

* zero      of each record; of each run, if the laser was zeroed again.
* slope     of a straightness: tilt of the straightedge. Two records against one square share one tilt, and their
            difference is the squareness of the machine.
* air       of a positioning by a laser: the index of the air has the uncertainty of its sensors, common to all records.
* reversal  up minus down, as a line over the travel, if a record was made in both directions.
* Abbe      a beam offset from the point at which a component is defined also reads the axis' angles at its arm. If
            they were measured they are subtracted, with their own uncertainty; if not, the interval includes them.

A record has the sign of the machine's coordinates: positive if the tool is too far on the positive side of the
workpiece, whichever of the two moves; a positioning counts along its axis, positive if it goes too far. The machine
file may define an axis' errors as the carriage's own, and an axis may run against its letter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from errpipe.domain.components import is_error_motion, parse
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, did_you_mean
from errpipe.kinematics import direct, synthesis
from errpipe.kinematics import observations as o
from errpipe.kinematics.chain import LETTERS, Chain

ROTATIONS = {"A": LETTERS["X"], "B": LETTERS["Y"], "C": LETTERS["Z"]}
BACKLASH, PER_METRE = 30.0, 60.0  # um (urad), um/m (urad/m): prior sd of a reversal and of its change
MIN_TARGETS_FROM_BOTH_SIDES = 3  # targets approached from both sides, needed to fit a reversal
INCLINED = 1e-6  # of a cosine: 1.4 mrad
MIN_NOISE = 0.02  # um, urad: no laser or level repeats better


@dataclass(frozen=True)
class Record:
    """Readings of one component in one recording.

    position (n,) mm or deg; value (n,) um or urad, the beam's errors out; side (n,) +1 coming from below; rows: of
    the recording; noise: of one reading; label: of the recording, where there are several; zero (n,): number of the
    zero that each reading counts from; air: standard uncertainty of the index of the air, um/m; others: positions
    (n,) of the other axes, mm or deg, if recorded.
    """

    component: str
    axis: str
    position: np.ndarray
    value: np.ndarray
    side: np.ndarray
    rows: np.ndarray
    noise: float
    label: str
    zero: np.ndarray
    air: float = 0.0
    others: Mapping[str, np.ndarray] = field(default_factory=dict)


def component_of(label: object) -> str:
    """The component of a record's rows, or of its set-up, from their label: the last word before a colon."""
    return str(label).partition(":")[0].split(" ")[-1]


def is_direct(recording: Recording) -> bool:
    """Whether a recording contains error motions (EXX, EYX ...) rather than readings at the tool."""
    return any(is_error_motion(c) for c in recording.components())


def observations(
    chain: Chain,
    recordings: Mapping[str, Recording],
    *,
    lasers: Mapping[str, direct.Laser] | None = None,
    squares: Mapping[str, float] | None = None,
    take: np.ndarray | None = None,
) -> o.Observations:
    """Every reading of every error-motion column; rows are ordered by component. recordings: label -> recording.

    lasers: set-up by component. squares: squareness component -> what the square that both straightness records
    were made against would read on a perfect machine, urad. take: mask of the rows to use (of one recording).
    Raises DataError if a set-up does not fit its component, a column is missing, or a correction lacks the air.
    """
    lasers, squares = dict(lasers or {}), dict(squares or {})
    records = read(chain, recordings, lasers=lasers, take=take)
    turns = _square_columns(chain, records, squares)
    return o.concatenate([_rows(chain, r, lasers.get(r.component), squares, turns) for r in records], shared=True)


def read(
    chain: Chain,
    recordings: Mapping[str, Recording],
    *,
    lasers: Mapping[str, direct.Laser] | None = None,
    take: np.ndarray | None = None,
) -> list[Record]:
    """The records of `observations`, in the order of its rows, with beam errors removed."""
    records: list[Record] = []
    for label, recording in recordings.items():
        motions = [c for c in recording.components() if is_error_motion(c)]
        if not motions:
            raise DataError(f"{label}: the recording has no error column of an error motion such as EXX, EYX or EBX")
        for name in motions:
            if name not in chain.components:
                near = did_you_mean(name, chain.components)
                raise DataError(f"{name} was recorded, but {chain.machine.name} has no such component.{near}")
            tag = label if len(recordings) > 1 else ""
            record = _record(recording, name, (lasers or {}).get(name), tag, take)
            records += [] if record is None else [record]
    if not records:
        raise DataError("no recording has a reading of an error motion")
    _check_lasers_used(lasers or {}, records)
    return records


def _check_lasers_used(lasers: Mapping[str, direct.Laser], records: list[Record]) -> None:
    """Raises DataError for a set-up of a component that was not recorded: a misspelt name would be ignored."""
    names = [r.component for r in records]
    for name in lasers:
        if name not in names:
            raise DataError(f"lasers.{name}: no recording holds {name}.{did_you_mean(name, names)}")


def _record(recording: Recording, component: str, laser, label: str, take) -> Record | None:
    axis, name = direct.axis_of(component), direct.position_of(recording, component)
    position, value = recording.array(name), recording.array(str(recording.name("error", component=component)))
    rows = np.isfinite(position) & np.isfinite(value)
    if not rows.any():
        return None
    side = direct.side_of(recording, axis, position, rows)
    value = value[rows]
    if laser is not None:
        value = direct.without_beam_errors(component, recording, position[rows], value, laser, rows)
    number = np.flatnonzero(rows)
    kept = np.ones(len(number), dtype=bool) if take is None else take[number]
    if not kept.any():
        return None
    p, value, side = position[rows][kept], value[kept], side[kept]
    zero = np.zeros(len(p), dtype=int)
    if laser is not None and laser.zero_each_run:
        zero = np.unique(recording.run_codes()[number[kept]], return_inverse=True)[1]
    noise = _repeatability(p, value - _zeros(p, value, side, zero), side)
    by_laser = laser is not None and parse(component).kind == "positioning"
    index = direct.air_uncertainty(recording, laser) if by_laser else 0.0
    others = {
        str(c.axis): recording.array(n)[number[kept]]
        for n, c in recording.manifest.columns.items()
        if c.role in ("position", "command") and c.axis not in (None, axis)
    }
    return Record(component, axis, p, value, side, number[kept], noise, label, zero, index, others)


def _zeros(p: np.ndarray, value: np.ndarray, side: np.ndarray, zero: np.ndarray) -> np.ndarray:
    """Offset of each reading's zero from the first zero, by least squares over targets and sides."""
    if not zero.any():
        return np.zeros(len(p))
    _, cell = np.unique(np.column_stack([direct.targets_of(p)[1], side]), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    design = np.column_stack(
        [cell[:, None] == np.arange(cell.max() + 1), zero[:, None] == np.arange(1, zero.max() + 1)]
    )
    coefficients = np.linalg.lstsq(design.astype(float), value, rcond=None)[0]
    return np.r_[0.0, coefficients[cell.max() + 1 :]][zero]


def _repeatability(p: np.ndarray, value: np.ndarray, side: np.ndarray) -> float:
    """Standard deviation of repeats at one target from one side, um or urad.

    Without repeats: of up minus down about a line, else from fourth differences along the targets (cubic removed).
    """
    targets, number = direct.targets_of(p)
    square, freedom, means = 0.0, 0, []
    for s in (1.0, -1.0):
        from_side = side == s
        count = np.bincount(number[from_side], minlength=len(targets))
        mean = np.bincount(number[from_side], weights=value[from_side], minlength=len(targets)) / np.maximum(count, 1)
        square += float(np.sum((value[from_side] - mean[number[from_side]]) ** 2))
        freedom += int(np.sum(np.maximum(count - 1, 0)))
        means.append(np.where(count > 0, mean, np.nan))
    if freedom >= 3:
        return max(MIN_NOISE, float(np.sqrt(square / freedom)))
    reversal = means[0] - means[1]
    measured = np.isfinite(reversal)
    if measured.sum() >= 5:
        residual = reversal[measured] - np.polyval(
            np.polyfit(targets[measured], reversal[measured], 1), targets[measured]
        )
        return max(MIN_NOISE, float(np.sqrt(residual @ residual / (measured.sum() - 2) / 2.0)))
    fourth_difference = np.diff(np.nanmean(means, axis=0), 4)
    return max(MIN_NOISE, float(np.sqrt(np.mean(fourth_difference**2) / 70.0))) if fourth_difference.size else 1.0


def _rows(chain: Chain, r: Record, laser, squares: Mapping[str, float], turns) -> o.Observations:
    n, c = len(r.position), parse(r.component)
    own = np.zeros((n, len(chain.components)))
    own[:, chain.index(r.component)] = component_sign(chain, r.component)
    if c.kind == "positioning" or c.is_straightness:
        _add_arms(chain, own, r, laser or direct.Laser())
        _add_other_axes(chain, own, r, laser or direct.Laser())
    middle = chain.travel[chain.axes.index(r.axis)].mean()
    metres = (r.position - middle) * 1e-3
    tag = f"{r.label} {r.component}".strip()
    zeros = [(f"{tag}: zero" + (f" {k + 1}" if r.zero.any() else ""), r.zero == k) for k in np.unique(r.zero)]
    value, columns = r.value.copy(), [(name, o.SHIFT, own_rows.astype(float)) for name, own_rows in zeros]
    if c.is_straightness:
        turn = turns.get(r.component)
        if turn is None:
            columns.append((f"{tag}: straightedge", o.TURN, metres))
        else:
            square, name = turn
            lean = _slope_per_squareness(chain, square, r.component)
            columns.append((name, o.TURN, -lean * metres))
            if r.axis == square[2:]:
                value += lean * squares[square] * metres
    if r.air:
        columns.append((f"index of the air, {r.air:.3g} um/m", r.air, metres))
    for square in _squares_of(chain, r.component):
        own[:, chain.index(square)] += _slope_per_squareness(chain, square, r.component) * (r.position - middle) * 1e-3
    if _both_directions(r):
        columns.append((f"{tag}: reversal", BACKLASH, 0.5 * r.side))
        columns.append((f"{tag}: reversal per metre", PER_METRE, 0.5 * r.side * metres))
    q = _positions(chain, r)
    names, spread, values = zip(*columns, strict=True)
    return o.Observations(
        q,
        np.broadcast_to(chain.tip(), (n, 3)).copy(),
        np.zeros((n, 6)),
        value,
        np.column_stack(values),
        names,
        np.array(spread),
        np.full((n, 3), np.nan),
        np.full(n, r.noise),
        np.full(n, tag, dtype=object),
        0.0,
        own,
    )


def _positions(chain: Chain, r: Record) -> np.ndarray:
    """Positions of all axes at the readings; other axes at mid travel where they were not recorded."""
    q = np.tile(chain.travel.mean(axis=1), (len(r.position), 1))
    for axis, position in {**r.others, r.axis: r.position}.items():
        if axis in chain.axes:
            column = q[:, chain.axes.index(axis)]
            column[:] = np.where(np.isfinite(position), position, column)
    return q


def _both_directions(r: Record) -> bool:
    """Whether enough targets were approached from both sides to separate the reversal and its change from the curve."""
    number = direct.targets_of(r.position)[1]
    return len(set(number[r.side > 0]) & set(number[r.side < 0])) >= MIN_TARGETS_FROM_BOTH_SIDES


def component_sign(chain: Chain, component: str) -> float:
    """Sign of a record of a component relative to the component of the machine file, 1 or -1.

    -1 if the machine file counts the errors of a carriage that holds the workpiece, and for the positioning of an axis
    that runs against its letter; 1 if both apply.
    Raises DataError for the positioning of an axis that is inclined to its letter.
    """
    machine, c = chain.machine, parse(component)
    axis = str(c.axis)
    against = machine.axes[axis].errors_of == "carriage" and machine.side_moved_by(axis) == "workpiece"
    sign = -1.0 if against else 1.0
    if c.kind != "positioning":
        return sign
    along = float(np.dot(machine.direction(axis), LETTERS[c.direction]))
    if abs(along) < 1 - INCLINED:
        raise DataError(
            f"{component}: {axis} runs along {', '.join(f'{v:.4g}' for v in machine.direction(axis))}, inclined to "
            f"{c.direction}: what is read along it is no {component} of the machine file. Identify it from readings at "
            "the tool (`identify`), or correct it alone over its own position (`fit`)"
        )
    return float(np.copysign(sign, sign * along))


def _add_arms(chain: Chain, own: np.ndarray, r: Record, laser: direct.Laser) -> None:
    """Add to `own` the Abbe arms, um per urad: the beam is offset from the point that a component is defined at."""
    arm = direct.arms(chain, r.axis, laser, r.position)
    if not arm.any():
        return
    reads = direct.direction_of(chain, r.component)
    for letter, about in ROTATIONS.items():
        name = f"E{letter}{r.axis}"
        own[:, chain.index(name)] += component_sign(chain, name) * (np.cross(about, arm) @ reads) * 1e-3


def _add_other_axes(chain: Chain, own: np.ndarray, r: Record, laser: direct.Laser) -> None:
    """Add to `own` the angles of the other axes at the line's place: they turn it, as a squareness would.

    Only where the recording has their positions, and for a gauge at the tool.
    """
    at_tool = {"tool": "carriage", "workpiece": "guideway"}[chain.machine.side_moved_by(r.axis)]
    if parse(r.component).is_straightness and laser.read_on != at_tool:
        return
    q = _positions(chain, r)
    for axis, position in r.others.items():
        rows = np.isfinite(position)
        if axis not in chain.axes or not rows.any():
            continue
        turned = [chain.index(n) for n in chain.of_axis(axis) if parse(n).unit == "urad"]
        shift = direct.direction_of(chain, r.component) @ synthesis.jacobian(chain, q)[:, :3]
        own[np.ix_(rows, turned)] += shift[np.ix_(rows, turned)]


def _slope_per_squareness(chain: Chain, square: str, component: str) -> float:
    """Slope of a straightness, um/m, for 1 urad of a squareness of its axis; 0 for another axis."""
    turned = np.cross(ROTATIONS[square[0]], chain.machine.direction(direct.axis_of(component)))
    return float(turned @ direct.direction_of(chain, component))


def _squares_of(chain: Chain, component: str) -> list[str]:
    """Squareness of the component's own axis that appears as its slope."""
    c = parse(component)
    if not c.is_straightness:
        return []
    of_axis = [n for n in chain.components if n[0] in ROTATIONS and n[1:] == f"0{c.axis}"]
    return [n for n in of_axis if abs(_slope_per_squareness(chain, n, component)) > 1e-9]


def lines_of(chain: Chain, square: str) -> tuple[str, str] | None:
    """The two straightness components that a square in the plane of a squareness is held against."""
    second = square[2:]
    machine = chain.machine
    across = np.cross(ROTATIONS[square[0]], machine.direction(second))
    letter = max("XYZ", key=lambda d: abs(np.dot(across, LETTERS[d])))
    datum = next((a for a in machine.linear_axes() if abs(np.dot(machine.direction(a), LETTERS[letter])) > 0.9), None)
    if datum is None or machine.axes[second].kind != "linear":
        return None
    other = max("XYZ", key=lambda d: abs(np.dot(machine.direction(second), LETTERS[d])))
    return f"E{letter}{second}", f"E{other}{datum}"


def _square_columns(chain: Chain, records: list[Record], squares: Mapping[str, float]) -> dict[str, tuple[str, str]]:
    """Straightness component -> the squareness measured with its square, and the name of the square's rotation."""
    out: dict[str, tuple[str, str]] = {}
    recorded = {r.component for r in records}
    for square in squares:
        pair = lines_of(chain, square) if square in chain.components else None
        if pair is None:
            near = did_you_mean(square, [n for n in chain.components if n[1] == "0" and n[0] in ROTATIONS])
            raise DataError(f"squares.{square}: {chain.machine.name} has no such squareness of two linear axes.{near}")
        missing = [c for c in pair if c not in recorded]
        if missing:
            raise DataError(f"squares.{square}: needs {pair[0]} and {pair[1]}, but {missing[0]} was not recorded")
        for component in pair:
            if component in out:
                raise DataError(f"{component} cannot be referred to two squares ({out[component][0]} and {square})")
            out[component] = (square, f"{square}: turn of the square")
    return out


def reversals(chain: Chain, setup: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float | str]]:
    """Reversal (up minus down) of each component that was recorded from both sides, with 95 % half widths.

    setup: value and standard error by name, as an identification solves for them. value counts at `middle`.
    """
    out: dict[str, dict[str, float | str]] = {}
    for name, (value, error) in setup.items():
        if not name.endswith(": reversal"):
            continue
        component = component_of(name)
        slope, slope_error = setup[f"{name} per metre"]
        axis = direct.axis_of(component)
        sign = component_sign(chain, component)
        out[component] = {
            "unit": parse(component).unit,
            "value": sign * value,
            "half_width95": 1.96 * error,
            "per_metre": sign * slope,
            "per_metre_half_width95": 1.96 * slope_error,
            "middle": float(chain.travel[chain.axes.index(axis)].mean()),
        }
    return out


def reversal_line(reversal: Mapping[str, float | str]) -> tuple[float, float]:
    """Reversal at the middle and its change per metre, each 0 where its interval does not exclude it."""
    pairs = (("value", "half_width95"), ("per_metre", "per_metre_half_width95"))
    value, slope = (float(reversal[v]) if abs(float(reversal[v])) > float(reversal[h]) else 0.0 for v, h in pairs)
    return value, slope
