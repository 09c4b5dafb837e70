"""Components measured directly by laser and level; zero, straightedge and beam belong to the set-up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_error_motion
from errpipe.domain.laser import Laser
from errpipe.domain.machine import Machine
from errpipe.errors import UsageError
from errpipe.models._base import Family, Fitted, Progress, no_progress

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut
    from errpipe.kinematics.chain import Chain

MOST_FOLDS = 5  # folds of targets if whole runs cannot be held out


class Direct(Family):
    """Components of a machine from direct records; fitted by the stage that identifies the machine."""

    family: Literal["direct"] = Field("direct", description="Model family.")
    machine: Machine = Field(description="Machine whose components are read.")
    modes: int = Field(20, ge=2, description="Waves per error motion.")
    components: tuple[str, ...] = Field(description="Components in the recording.")
    lasers: dict[str, Laser] = Field({}, description="Laser set-up of each component.")
    default_scheme: ClassVar[str] = "leave-one-run-out"
    solved_by: ClassVar[str] = "direct records"

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Raises UsageError: its error model comes from the stage that identifies the machine."""
        raise UsageError("direct records are fitted by the stage that identifies the machine")

    def folds(self, recording: Recording, scheme: HoldOut | str | None) -> tuple[str, list[Fold]]:
        """Without a scheme: whole runs if each direction was run twice, else every fifth target."""
        from errpipe.fitting.holdout import Fold

        if scheme is not None:
            return super().folds(recording, scheme)
        name, splits = direct_folds(recording)
        return name, [Fold(*fold) for fold in splits]

    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Fit on one side of a fold, validate on the other."""
        from errpipe.fitting.judging import HeldOut
        from errpipe.kinematics.chain import compile_chain

        chain = compile_chain(self.machine)
        held = validate_fold(chain, recording, fold.train, fold.test, modes=self.modes, lasers=self.lasers)
        return {x.component: HeldOut(fold.label, x.rows, x.before, x.after, np.zeros(len(x.rows)), 0.0) for x in held}


@dataclass(frozen=True)
class HeldOutComponent:
    """One component on held-out rows: before (n,), the machine's deviation; after (n,), minus the model."""

    component: str
    rows: np.ndarray
    before: np.ndarray
    after: np.ndarray


def validate_fold(
    chain: Chain,
    recording: Recording,
    train: np.ndarray,
    test: np.ndarray,
    *,
    modes: int = 12,
    lasers: Mapping[str, Laser] | None = None,
) -> list[HeldOutComponent]:
    """Every component with readings on both sides. Zero, straightedge and beam are set-up: in neither before nor after.

    train, test: masks of rows. The zero and alignment of a set-up come from the fitted rows.
    """
    from errpipe.kinematics import direct, identify, records

    lasers = dict(lasers or {})
    judged = _components(recording, train) & _components(recording, test)
    if not judged:
        return []
    axes = {direct.axis_of(c) for c in judged}
    without = tuple(c for c in chain.components if c[0] != "E" or c[2:] not in axes)
    model = identify.Parametrisation.of(chain, modes, without)
    own = {n: s for n, s in lasers.items() if direct.axis_of(n) in axes}
    used_rows = _rows_at_targets(recording, train | test, axes)
    readings = records.observations(chain, {"": recording}, lasers=own, take=used_rows)
    parts = records.read(chain, {"": recording}, lasers=own, take=used_rows)
    sits_out = test[np.concatenate([r.rows for r in parts])]
    # one design for both sides: a run in one direction uses the reversal identified from the other runs
    train_readings = records.observations(
        chain, {"": recording}, lasers=own, take=_rows_at_targets(recording, train, axes)
    )
    fitted = replace(readings.take(np.flatnonzero(~sits_out)), noise=train_readings.noise)
    identified = identify.identify(model, fitted)
    design = model.design(readings)
    setup = np.array([identified.setup[n][0] for n in readings.nuisance_names])
    turning = np.array([": reversal" in n for n in readings.nuisance_names], dtype=bool)
    out, start = [], 0
    for record in parts:
        rows = np.arange(start, start + len(record.rows))
        start += len(rows)
        rows, at = rows[sits_out[rows]], record.rows[sits_out[rows]]
        if record.component not in judged:
            continue
        own_columns = model.prior.component == chain.index(record.component)
        other_parts = (
            design[rows][:, ~own_columns] @ identified.mean[~own_columns]
            + readings.nuisance[rows][:, ~turning] @ setup[~turning]
        )
        before = readings.value[rows] - other_parts
        after = (
            before
            - design[rows][:, own_columns] @ identified.mean[own_columns]
            - readings.nuisance[rows][:, turning] @ setup[turning]
        )
        if record.component in lasers and lasers[record.component].zero_each_run:
            before, after = (_without_zeros(v, recording.run_codes()[at]) for v in (before, after))
        out.append(HeldOutComponent(record.component, at, before, after))
    return out


def _without_zeros(values: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Values (n,) minus the mean of their run: the zero of a held-out run cannot be known otherwise."""
    _, number = np.unique(run, return_inverse=True)
    return values - (np.bincount(number, values) / np.bincount(number))[number]


def _components(recording: Recording, rows: np.ndarray) -> set[str]:
    components = set()
    for c in recording.components():
        name = recording.name("error", component=c)
        if is_error_motion(c) and name is not None and np.isfinite(recording.array(name)[rows]).any():
            components.add(c)
    return components


def _rows_at_targets(recording: Recording, rows: np.ndarray, axes: set[str]) -> np.ndarray:
    """Those rows at which one of some axes is at a target."""
    from errpipe.kinematics import direct

    rows_of_axis = np.zeros(len(recording), dtype=bool)
    for component in recording.components():
        if is_error_motion(component) and direct.axis_of(component) in axes:
            rows_of_axis |= np.isfinite(recording.array(direct.position_of(recording, component)))
    return rows & rows_of_axis


def direct_folds(recording: Recording) -> tuple[str, list[tuple[str, np.ndarray, np.ndarray]]]:
    """Folds of direct records: whole runs if every component has several, else every n-th target.

    Returns the scheme's name and (label, train, test) masks.
    """
    from errpipe.kinematics import direct

    codes, labels = recording.run_codes(), recording.run_labels()
    several = True
    for c in sorted(_components(recording, np.ones(len(recording), dtype=bool))):
        seen = np.isfinite(recording.array(str(recording.name("error", component=c))))
        sides = [_sides(recording, c, seen & (codes == k)) for k in np.unique(codes[seen])]
        several &= all(sum(way in s for s in sides) > 1 for way in set().union(*sides))
    if several:
        return "leave-one-run-out", [(str(n), codes != k, codes == k) for k, n in enumerate(labels)]
    number = np.full(len(recording), -1)
    for c in recording.components():
        if is_error_motion(c):
            p = recording.array(direct.position_of(recording, c))
            known = np.isfinite(p)
            number[known] = direct.targets_of(p[known])[1]
    out = [
        (
            f"targets {k + 1}, {k + 1 + MOST_FOLDS} ...",
            number % MOST_FOLDS != k,
            (number % MOST_FOLDS == k) & (number >= 0),
        )
        for k in range(MOST_FOLDS)
    ]
    return f"every {MOST_FOLDS}th target", out


def _sides(recording: Recording, component: str, rows: np.ndarray) -> set[float]:
    from errpipe.kinematics import direct

    position = recording.array(direct.position_of(recording, component))
    return set(direct.side_of(recording, direct.axis_of(component), position, rows & np.isfinite(position)).tolist())
