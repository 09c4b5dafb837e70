"""Direct identification: laser and level records of one axis to its curves EXX ... ECX, one for each direction.

Errors of the beam are removed first; each one's sign in words:

* air       displayed - true = displacement x (n / n_used - 1): warmer air, shorter reading.
* dead path displayed - true = dead path x (n / n_reset - 1): an offset that drifts with the weather, also if
            the laser corrects the wavelength over the displacement.
* cosine    a beam misaligned by t reads displacement x cos t: always short.
* Abbe      the beam is offset from the functional line; the angle of the carriage times that offset is added.
* material  the scale's own expansion is not corrected: it is the machine's, not the laser's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from errpipe.domain.components import is_error_motion, parse
from errpipe.domain.laser import Laser
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.kinematics.air import UNMEASURED_HUMIDITY, index_change, index_uncertainty
from errpipe.kinematics.chain import Chain

SAME_PLACE = 1e-3  # mm or deg: readings closer than this belong to one target
FEWEST_READINGS = 3  # of a curve: two have no shape
PLACE_MATTERS = 1.0  # um: range by which a straightness may depend on where it was read, unstated (by judgement)


def corrected(
    position: np.ndarray,
    deviation: np.ndarray,
    laser: Laser,
    *,
    air: np.ndarray | float = 0.0,
    display: np.ndarray | float | None = None,
) -> np.ndarray:
    """Deviation along the beam, um, from the displayed one; the laser was set to zero at the first position.

    position (mm), deviation (um): as displayed; air: n / n_reset - 1; display: n / n_used - 1 of the index that an
    uncorrected display used (default: air).
    """
    position = np.asarray(position, dtype=float)
    travelled = position - position[0]
    shown = travelled * 1e3 + np.asarray(deviation, dtype=float)  # um
    air = np.asarray(air, dtype=float)
    true = shown - laser.dead_path * 1e3 * air
    if not laser.wavelength_corrected:
        true = true / (1.0 + (air if display is None else np.asarray(display, dtype=float)))
    return true / np.cos(laser.misalignment * 1e-6) - travelled * 1e3


@dataclass(frozen=True)
class Curve:
    """One component along its axis: position (n,), means by direction (NaN where not measured), counts, scatter.

    mean: of both directions; error: standard error of the mean. um or urad.
    """

    component: str
    position: np.ndarray
    up: np.ndarray
    down: np.ndarray
    error: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Mean of the measured directions, shape (n,)."""
        both = np.vstack([self.up, self.down])
        seen = np.isfinite(both)
        return np.where(seen, both, 0.0).sum(axis=0) / seen.sum(axis=0)


def curves(recording: Recording, chain: Chain, lasers: Mapping[str, Laser] | None = None) -> dict[str, Curve]:
    """Curves of every error-motion column of a recording (EXX, EYX, EBX ...), laser corrections included.

    lasers: set-up by component. Raises DataError if a component's axis has no position.
    """
    motions = [c for c in recording.components() if is_error_motion(c)]
    if not motions:
        raise DataError("the recording has no error column of an error motion such as EXX, EYX or EBX")
    known: dict[str, Curve] = {}
    for component in sorted(motions, key=lambda c: parse(c).unit != "urad"):  # angles first: Abbe needs them
        known[component] = _curve(recording, component, (lasers or {}).get(component), known, chain)
    return {c: known[c] for c in motions}


def axis_of(component: str) -> str:
    """Letter of the axis that an error motion belongs to."""
    return str(parse(component).axis)


def position_of(recording: Recording, component: str) -> str:
    """Column with the position of a component's axis, commanded if available. Raises DataError without one."""
    axis = axis_of(component)
    name = recording.name("command", axis=axis) or recording.name("position", axis=axis)
    if name is None:
        raise DataError(f"{component}: the recording has no position of axis {axis}")
    return name


def _readings(recording: Recording, component: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and values of a component, and the mask of the rows with both."""
    measured = recording.name("error", component=component)
    if measured is None:
        raise DataError(f"{component}: the recording has no error column of it")
    p, value = recording.array(position_of(recording, component)), recording.array(measured)
    return p, value, np.isfinite(p) & np.isfinite(value)


def _curve(recording: Recording, component: str, laser: Laser | None, known, chain) -> Curve:
    axis = axis_of(component)
    p, value, rows = _readings(recording, component)
    if rows.sum() < FEWEST_READINGS:
        raise DataError(f"{component}: at least {FEWEST_READINGS} readings are needed (found {int(rows.sum())})")
    if laser is not None:
        value = value.copy()
        value[rows] = without_beam_errors(component, recording, p[rows], value[rows], laser, rows)
        turn = _turn(axis, p[rows], known)
        if turn is not None and any(laser.offset):
            direction = np.asarray(direction_of(chain, component), dtype=float)
            value[rows] += np.cross(turn, np.asarray(laser.offset)) @ direction * 1e-3
    side = side_of(recording, axis, p, rows)
    targets, number = targets_of(p[rows])
    up, down = (_means(number, value[rows], side == s, len(targets)) for s in (1, -1))
    error = _scatter(number, value[rows], side, len(targets))
    return _conventions(Curve(component, targets, up, down, error), chain.machine.axes[axis].zero)


def without_beam_errors(
    component: str, recording: Recording, position: np.ndarray, value: np.ndarray, laser: Laser, rows: np.ndarray
) -> np.ndarray:
    """Readings of a component (um) corrected for dead path, air and cosine error; not for Abbe's offset.

    rows: mask of the recording's rows that position and value are of. Raises DataError if the set-up does not
    fit the component, or the air was not recorded that the correction needs.
    """
    c = parse(component)
    if c.kind != "positioning" and not c.is_straightness:
        raise DataError(f"lasers.{component}: an angle has no dead path, no cosine error and no Abbe offset")
    if c.is_straightness and (laser.dead_path or laser.misalignment or not laser.wavelength_corrected):
        raise DataError(f"lasers.{component}: a straightness has an offset alone; dead path and cosine are of EXX")
    if c.is_straightness:
        return value
    if laser.display_air is not None and laser.wavelength_corrected:
        raise DataError(
            f"lasers.{component}: display_air is of a display that was not corrected; set wavelength_corrected: false"
        )
    needs = "dead path" if laser.dead_path else "" if laser.wavelength_corrected else "wavelength"
    if needs and not any(_air_columns(recording)):
        raise DataError(
            f"lasers.{component}: to correct the {needs}, record the air: temperature, pressure or humidity "
            "(a column whose location says air)"
        )
    if not needs:
        return corrected(position, value, laser)
    if laser.display_air is not None and not all(_air_columns(recording)[:2]):
        raise DataError(
            f"lasers.{component}: display_air takes the air's temperature and pressure of the record, too "
            f"(found: {', '.join(n for n in _air_columns(recording)[:2] if n) or 'neither'}; a temperature is the "
            "air's where its location says air)"
        )
    display = None if laser.display_air is None else _air(recording, rows, laser.display_air)
    return corrected(position, value, laser, air=_air(recording, rows), display=display)


def air_uncertainty(recording: Recording, laser: Laser) -> float:
    """Standard uncertainty of the index used for a laser's displacement, um/m."""
    kelvin, hectopascal, percent = laser.air_uncertainty
    if not laser.wavelength_corrected and _air_columns(recording)[2] is None:
        percent = max(percent, UNMEASURED_HUMIDITY)
    return index_uncertainty((kelvin, hectopascal, percent))


def direction_of(chain: Chain, component: str) -> np.ndarray:
    """Direction in which a positioning or straightness component counts, shape (3,)."""
    c = parse(component)
    if c.kind == "positioning":
        return np.asarray(chain.machine.direction(str(c.axis)))
    return np.eye(3)["XYZ".index(c.direction)]


def arms(chain: Chain, axis: str, laser: Laser, position: np.ndarray) -> np.ndarray:
    """From the point that the components are defined at to the one at which a straightness is read, mm (n, 3).

    Both coincide (up to the offset) where the axis is at 0. What travels with a carriage that holds the workpiece goes
    against the direction of the axis.
    """
    machine = chain.machine
    travels = int(laser.read_on == "carriage") - int(machine.axes[axis].errors_travel)
    sense = -travels if machine.side_moved_by(axis) == "workpiece" else travels
    along = np.asarray(machine.direction(axis), dtype=float)
    return sense * np.asarray(position)[:, None] * along - np.asarray(laser.offset, dtype=float)


def refuse_unstated_places(chain: Chain, recordings: Mapping[str, Recording], lasers: Mapping[str, Laser]) -> None:
    """Raise DataError for straightnesses of axes that carry the work, read on the table or at the tool: unknown.

    The angle of the axis times its position, which was recorded too, is the difference; it may turn the curve over.
    """
    known: dict[str, Curve] = {}
    for r in recordings.values():
        motions = [c for c in r.components() if is_error_motion(c) and c in chain.components]
        known |= {c: _curve(r, c, None, {}, chain) for c in motions if _readings(r, c)[2].sum() >= FEWEST_READINGS}
    unstated: dict[str, float] = {}
    for name, curve in known.items():
        axis, stated = axis_of(name), lasers.get(name, Laser()).model_fields_set
        turn = _turn(axis, curve.position, known)
        of_table = parse(name).is_straightness and chain.machine.side_moved_by(axis) != "tool"
        if turn is None or not of_table or "read_on" in stated:
            continue
        way = np.asarray(chain.machine.direction(axis), dtype=float)
        apart = np.cross(turn, curve.position[:, None] * way) @ direction_of(chain, name) * 1e-3
        apart = float(np.ptp(apart - np.polyval(np.polyfit(curve.position, apart, 1), curve.position)))
        unstated |= {name: apart} if apart > PLACE_MATTERS else {}
    if unstated:
        answer = ", ".join(f"{name}: {{read_on: carriage}}" for name in unstated)
        axes = " and ".join(dict.fromkeys(map(axis_of, unstated)))
        raise DataError(
            f"{', '.join(unstated)}: the work travels on {axes}, which turns it: "
            "read at a point of the table (a reflector on it), or at the tool (a gauge in the spindle, a straightedge "
            f"on the table), a curve differs by {max(unstated.values()):.3g} um. State it in the stage: lasers: "
            f"{{{answer}}} for the table, read_on: guideway for the tool"
        )


def _air_columns(recording: Recording) -> list[str | None]:
    """Names of the air's temperature, pressure and humidity: with location air, or no location."""
    chosen = []
    for role in ("temperature", "pressure", "humidity"):
        names = recording.names(role)
        in_air = [n for n in names if "air" in (recording.manifest.columns[n].location or "").lower()]
        if role != "temperature" and not in_air:
            in_air = [n for n in names if recording.manifest.columns[n].location is None]
        chosen.append(in_air[0] if in_air else None)
    return chosen


def _air(recording: Recording, rows: np.ndarray, since: tuple[float, float, float] | None = None) -> np.ndarray | float:
    """Index change of the air along some rows, against the first of them or the air `since`."""
    columns = (None if n is None else recording.array(n)[rows] for n in _air_columns(recording))
    temperature, pressure, humidity = columns
    return index_change(temperature, pressure, humidity, since)


def _turn(axis: str, p: np.ndarray, known: Mapping[str, Curve]) -> np.ndarray | None:
    curves = [known.get(f"E{d}{axis}") for d in "ABC"]
    if not any(curves):
        return None
    return np.column_stack([np.zeros(len(p)) if c is None else np.interp(p, c.position, c.mean) for c in curves])


def side_of(recording: Recording, axis: str, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Approach direction of each target, for the selected rows: the direction column, else the previous step.

    The first reading of a run takes the side of the second: the previous motion of the axis is unknown.
    """
    name = recording.name("direction", axis=axis)
    if name is not None:
        return np.sign(recording.array(name)[rows])
    position, run = p[rows], recording.run_codes()[rows]
    out = np.ones(len(position))
    for code in np.unique(run):
        rows_of_run = np.flatnonzero(run == code)
        if len(rows_of_run) < 2:
            continue
        step = np.diff(position[rows_of_run], prepend=position[rows_of_run][0])
        step[0] = step[1]
        for i in range(1, len(step)):
            step[i] = step[i - 1] if step[i] == 0 else step[i]
        out[rows_of_run] = np.where(step < 0, -1.0, 1.0)
    return out


def targets_of(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Target positions in ascending order, and the target of each reading."""
    order = np.argsort(p, kind="stable")
    new = np.r_[True, np.diff(p[order]) > SAME_PLACE]
    number = np.empty(len(p), dtype=int)
    number[order] = np.cumsum(new) - 1
    return np.array([p[number == i].mean() for i in range(number.max() + 1)]), number


def _means(number: np.ndarray, value: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    total = np.bincount(number[rows], weights=value[rows], minlength=count)
    counts = np.bincount(number[rows], minlength=count)
    return np.where(counts > 0, total / np.maximum(counts, 1), np.nan)


def _scatter(number: np.ndarray, value: np.ndarray, side: np.ndarray, count: int) -> np.ndarray:
    """Standard error of each target's mean from the pooled scatter of repeats; NaN without repeats."""
    square, free = 0.0, 0
    for s in (1, -1):
        for i in range(count):
            rows = (number == i) & (side == s)
            if rows.sum() > 1:
                square += float(np.var(value[rows]) * rows.sum())
                free += int(rows.sum()) - 1
    if free == 0:
        return np.full(count, np.nan)
    return np.sqrt(square / free / np.bincount(number, minlength=count))


def _conventions(curve: Curve, zero: float) -> Curve:
    """Positioning zero at its datum, straightness without line, angles without offset."""
    c, p, mean = parse(curve.component), curve.position, curve.mean
    if c.kind in ("positioning", "angular positioning"):
        line = np.full(len(p), np.interp(zero, p, mean))
    elif c.is_straightness:
        line = np.polyval(np.polyfit(p, mean, 1), p)
    else:
        line = np.full(len(p), np.trapezoid(mean, p) / (p[-1] - p[0]))
    return replace(curve, up=curve.up - line, down=curve.down - line)
