"""Every recording of a machine's tests as one set of readings: those at the tool first, then records of components."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from errpipe.domain.components import is_error_motion, parse
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.kinematics import direct, protocols, records, synthesis
from errpipe.kinematics import observations as o
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.direct import Laser
from errpipe.kinematics.errors import MachineErrors

# Waves of a curve: of tests at the tool; of records, smallest and largest number. `curve_misfit` is the lack of fit.
AT_THE_TOOL, FEWEST, MOST = 12, 20, 48
OUTSIDE = 0.1  # of a travel: a round number in many machine files; the tolerance of recordings that state it, too
WHOLE, LEAST_TURN = 65, 1.0  # points of a travel; urad: half the range of a turn worth a remark (by judgement)
MIN_MISSED = 0.05  # um, urad: smaller values are no shape


def of_tests(
    chain: Chain,
    tests: Mapping[str, Recording],
    lasers: Mapping[str, Laser] | None = None,
    squares: Mapping[str, float] | None = None,
) -> tuple[o.Observations, dict[str, int]]:
    """Readings of tests by name, and the number of each test at the tool, in order.

    Raises DataError for a test that cannot be read.
    """
    single = {name: r for name, r in tests.items() if records.is_direct(r)}
    parts = {name: protocols.observations(chain, r) for name, r in tests.items() if name not in single}
    counts = {name: len(part) for name, part in parts.items()}
    every = list(parts.values())
    if single:
        _refuse_outside(chain, single)
        every.append(records.observations(chain, single, lasers=lasers, squares=squares))
    return o.concatenate(every), counts


def _refuse_outside(chain: Chain, single: Mapping[str, Recording]) -> None:
    """Raise DataError for a record that leaves the travel of its linear axis: of another axis, unit or zero."""
    for label, recording in single.items():
        for name in (c for c in recording.components() if is_error_motion(c) and c in chain.components):
            axis = chain.axes[chain.drives[chain.index(name)]]
            if chain.machine.axes[axis].kind != "linear":
                continue  # a turn more or less is the same place
            low, high = chain.travel[chain.axes.index(axis)]
            at = recording.array(direct.position_of(recording, name))
            at = at[np.isfinite(at)]
            if at.size and (at.min() < low - OUTSIDE * (high - low) or at.max() > high + OUTSIDE * (high - low)):
                raise DataError(
                    f"{label}: {name} was recorded from {at.min():.6g} to {at.max():.6g} mm, but the travel of {axis} "
                    f"in the machine file is {low:g} to {high:g} mm: is it of another axis, in another unit or "
                    "from another zero? Correct the recording, or the travel"
                )


def squareness_uncertainty(
    chain: Chain, tests: Mapping[str, Recording], squares: Mapping[str, float], found: MachineErrors
) -> str:
    """By how much a squareness may be wrong as a line's place along an axis that turns it is not recorded; or ''."""
    single = {name: r for name, r in tests.items() if records.is_direct(r)}
    causes = []
    for square, r in ((s, r) for s in squares for r in records.read(chain, single) if s in chain.components):
        if r.component not in (records.lines_of(chain, square) or ()):
            continue
        ends = np.tile(chain.travel.mean(axis=1), (2, 1))
        ends[:, chain.axes.index(r.axis)] = chain.travel[chain.axes.index(r.axis)]
        along = np.diff(direct.direction_of(chain, r.component) @ synthesis.jacobian(chain, ends)[:, :3], axis=0)[0]
        along *= 1e3 / np.ptp(ends[:, chain.axes.index(r.axis)])
        for axis in (a for a in chain.axes if a != r.axis and a not in r.others):
            angles = [chain.index(n) for n in chain.of_axis(axis) if parse(n).unit == "urad"]
            q = np.tile(ends[0], (WHOLE, 1))
            low, high = chain.travel[chain.axes.index(axis)]
            q[:, chain.axes.index(axis)] = np.linspace(low, high, WHOLE)
            most = 0.5 * float(np.ptp(found.at(q)[:, angles] @ along[angles]))
            if most > LEAST_TURN:
                causes.append(f"{square} by up to {most:.3g} urad, as {r.component} has no position of {axis}")
    return f"may be wrong: {'; '.join(causes)}: add it as a column, constant where it stood" if causes else ""


def modes(tests: Mapping[str, Recording]) -> int:
    """Waves per error motion that the readings can resolve: two fewer than the targets of the densest record."""
    dense = 0
    for recording in tests.values():
        for component in (c for c in recording.components() if is_error_motion(c)):
            at = recording.array(direct.position_of(recording, component))
            value = recording.array(str(recording.name("error", component=component)))
            dense = max(dense, len(direct.targets_of(at[np.isfinite(at) & np.isfinite(value)])[0]))
    return min(MOST, max(FEWEST, dense - 2)) if dense else AT_THE_TOOL


def curve_misfit(chain: Chain, obs: o.Observations, residual: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
    """Lack of fit of a component's curve to the mean of repeated readings at its targets: rms, largest; um or urad.

    rms: of the mean residual of each target, minus the contribution of the scatter of single readings. largest: mean
    residual of a target, including its scatter. For the components with such a lack of fit.
    """
    rms: dict[str, float] = {}
    largest: dict[str, float] = {}
    for label in dict.fromkeys(obs.label.tolist() if obs.own is not None else ()):
        name = records.component_of(label)
        rows = np.flatnonzero((obs.label == label) & ~np.isnan(obs.own).any(axis=1)) if obs.own is not None else ()
        if name not in chain.components or len(rows) == 0:
            continue
        place = direct.targets_of(obs.q[rows, chain.drives[chain.index(name)]])[1]
        count = np.maximum(np.bincount(place), 1)
        mean = np.bincount(place, weights=residual[rows]) / count
        left = float(np.mean(mean**2) - np.mean(obs.noise[rows] ** 2) * np.mean(1.0 / count))
        if left > MIN_MISSED**2:
            rms[name] = max(rms.get(name, 0.0), float(np.sqrt(left)))
            largest[name] = max(largest.get(name, 0.0), float(np.abs(mean).max()))
    return rms, largest
