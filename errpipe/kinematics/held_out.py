"""Direct records judged: fitted on some readings, what is left on others, component by component."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.kinematics import direct, identify, records
from errpipe.kinematics.chain import Chain


@dataclass(frozen=True)
class Left:
    """One component on rows that sat out: before (n,), the machine's deviation; after (n,), less the model."""

    component: str
    rows: np.ndarray
    before: np.ndarray
    after: np.ndarray


def judge(
    chain: Chain,
    recording: Recording,
    train: np.ndarray,
    test: np.ndarray,
    *,
    modes: int = 12,
    lasers: Mapping[str, direct.Laser] | None = None,
) -> list[Left]:
    """Every component with readings on both sides. Zero, straightedge and beam are set-up: out of before and after.

    train, test: masks of rows. The zero and lay of a set-up come from the rows that fit.
    """
    lasers = dict(lasers or {})
    judged = _components(recording, train) & _components(recording, test)
    if not judged:
        return []
    axes = {direct.axis_of(c) for c in judged}
    without = tuple(c for c in chain.components if c[0] != "E" or c[2:] not in axes)
    model = identify.Parametrisation.of(chain, modes, without)
    own = {n: s for n, s in lasers.items() if direct.axis_of(n) in axes}
    taken = _of(recording, train | test, axes)
    every = records.observations(chain, {"": recording}, lasers=own, take=taken)
    parts = records.read(chain, {"": recording}, lasers=own, take=taken)
    sits_out = test[np.concatenate([r.rows for r in parts])]
    # one design for both sides: a run that goes one way has no reversal of its own, but obeys the one found
    alone = records.observations(chain, {"": recording}, lasers=own, take=_of(recording, train, axes))
    fitted = replace(every.take(np.flatnonzero(~sits_out)), noise=alone.noise)
    found = identify.identify(model, fitted)
    whole = model.design(every)
    setup = np.array([found.setup[n][0] for n in every.nuisance_names])
    turning = np.array([": reversal" in n for n in every.nuisance_names], dtype=bool)
    out, start = [], 0
    for record in parts:
        rows = np.arange(start, start + len(record.rows))
        start += len(rows)
        rows, at = rows[sits_out[rows]], record.rows[sits_out[rows]]
        if record.component not in judged:
            continue
        mine = model.prior.component == chain.index(record.component)
        beside = whole[rows][:, ~mine] @ found.mean[~mine] + every.nuisance[rows][:, ~turning] @ setup[~turning]
        before = every.value[rows] - beside
        after = before - whole[rows][:, mine] @ found.mean[mine] - every.nuisance[rows][:, turning] @ setup[turning]
        out.append(Left(record.component, at, before, after))
    return out


def _components(recording: Recording, rows: np.ndarray) -> set[str]:
    found = set()
    for c in recording.components():
        name = recording.name("error", component=c)
        if direct.is_motion(c) and name is not None and np.isfinite(recording.array(name)[rows]).any():
            found.add(c)
    return found


def _of(recording: Recording, rows: np.ndarray, axes: set[str]) -> np.ndarray:
    """Those rows at which one of some axes stands at a target."""
    here = np.zeros(len(recording), dtype=bool)
    for component in recording.components():
        if direct.is_motion(component) and direct.axis_of(component) in axes:
            here |= np.isfinite(recording.array(direct.position_of(recording, component)))
    return rows & here


def folds(recording: Recording, most: int = 5) -> tuple[str, list[tuple[str, np.ndarray, np.ndarray]]]:
    """How direct records sit out: whole runs where every component has several, else every so many targets.

    Returns the scheme in words and (label, train, test) masks.
    """
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
        if direct.is_motion(c):
            p = recording.array(direct.position_of(recording, c))
            known = np.isfinite(p)
            number[known] = direct.targets_of(p[known])[1]
    out = [
        (f"targets {k + 1}, {k + 1 + most} ...", number % most != k, (number % most == k) & (number >= 0))
        for k in range(most)
    ]
    return f"every {most}th target", out


def _sides(recording: Recording, component: str, rows: np.ndarray) -> set[float]:
    position = recording.array(direct.position_of(recording, component))
    return set(direct.side_of(recording, direct.axis_of(component), position, rows & np.isfinite(position)).tolist())
