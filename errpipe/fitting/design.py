"""From terms and a recording to the columns of a least-squares problem, for one response or several at once.

Responses that share a nuisance (a workpiece's rotation affects two deviations) are stacked into one problem.
Terms are evaluated on the whole recording, so that a lag includes what happened before a test block; then the
rows chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError, did_you_mean
from errpipe.fitting.identifiability import DesignColumn
from errpipe.terms import Parameter, Term


@dataclass(frozen=True)
class Slot:
    """A term in a problem: the block in which it acts (-1: all), and its linear columns."""

    term: Term
    block: int
    columns: slice
    nuisance: bool
    free: tuple[Parameter, ...]  # linear parameters that are not fixed
    searched: slice  # its part of the vector of non-linear parameters


@dataclass
class Problem:
    """Stacked rows of one or several components.

    rows: row numbers of the recording per block; response: (n,); sequence: integer per row, one per run and block.
    """

    recording: Recording
    components: tuple[str, ...]
    rows: tuple[np.ndarray, ...]
    response: np.ndarray
    sequence: np.ndarray
    slots: tuple[Slot, ...]
    width: int
    unknowns: tuple[Parameter, ...]
    _still: dict[int, np.ndarray] = field(default_factory=dict)

    def columns_of(self, slot: Slot, nonlinear: np.ndarray) -> np.ndarray:
        """Design columns of one slot over the stacked rows, shape (n, free linear parameters)."""
        key = id(slot)
        if slot.searched.start == slot.searched.stop and key in self._still:
            return self._still[key]
        out = np.zeros((self.response.size, len(slot.free)))
        start = 0
        for b, chosen in enumerate(self.rows):
            if slot.block in (b, -1):
                out[start : start + chosen.size] = self.basis_of(slot, b, nonlinear)[chosen]
            start += chosen.size
        if slot.searched.start == slot.searched.stop:
            self._still[key] = out
        return out

    def basis_of(self, slot: Slot, block: int, nonlinear: np.ndarray) -> np.ndarray:
        """Design columns of one slot over all rows of the recording, shape (rows, free linear parameters)."""
        term = slot.term
        values = inner_values(term, nonlinear[slot.searched])
        shared = getattr(term, "shared", None)
        columns = shared(self.recording, self.components[block]) if shared else term.basis(self.recording, *values)
        keep = [k for k, p in enumerate(term.linear()) if p.name not in term.fixed]
        return columns if len(keep) == columns.shape[1] else columns[:, keep]

    def design(self, nonlinear: np.ndarray) -> np.ndarray:
        """All columns, shape (n, width)."""
        out = np.empty((self.response.size, self.width))
        for slot in self.slots:
            out[:, slot.columns] = self.columns_of(slot, nonlinear)
        return out

    def derivative(self, nonlinear: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """d(design @ coefficients)/d(non-linear), shape (n, q), by central differences through the terms."""
        out = np.zeros((self.response.size, len(self.unknowns)))
        for slot in self.slots:
            for j in range(slot.searched.start, slot.searched.stop):
                step = 1e-4 * max(abs(nonlinear[j]), 1e-9)
                up, down = nonlinear.copy(), nonlinear.copy()
                up[j] += step
                down[j] -= step
                gains = coefficients[slot.columns]
                change = self.columns_of(slot, up) @ gains - self.columns_of(slot, down) @ gains
                out[:, j] += change / (2 * step)
        return out

    def penalties(self) -> list[np.ndarray]:
        """Penalty matrices of the terms that have one, each (width, width)."""
        matrices = []
        for slot in self.slots:
            inner = slot.term.penalty()
            if inner is not None:
                whole = np.zeros((self.width, self.width))
                whole[slot.columns, slot.columns] = inner
                matrices.append(whole)
        return matrices

    def names(self) -> list[DesignColumn]:
        out = []
        for slot in self.slots:
            drivers = slot.term.drivers(self.recording)
            out += [DesignColumn(p.name, slot.term.term, drivers) for p in slot.free]
        return out


def inner_values(term: Term, searched: np.ndarray) -> list[float]:
    """All non-linear parameters of a term: fixed ones from the term, the others in order from `searched`."""
    remaining = list(map(float, searched))
    return [term.fixed[p.name] if p.name in term.fixed else remaining.pop(0) for p in term.nonlinear()]


def response_name(recording: Recording, component: str, asked_by: str = "fit") -> str:
    """Name of a component's error column. Raises DataError with the existing ones."""
    name = recording.name("error", component=component)
    if name is None:
        known = recording.components()
        hint = did_you_mean(component, known)
        raise DataError(f"{asked_by}: the recording has no response {component} (present: {', '.join(known)}).{hint}")
    return name


def assemble(
    recording: Recording,
    blocks: Sequence[tuple[str, Sequence[Term]]],
    nuisance: Sequence[Term],
    rows: np.ndarray | None = None,
) -> Problem:
    """The problem of fitting each component with its terms, on the rows of a mask (default: all).

    Terms are settled on those rows. Rows without the response or without an input of a term are dropped.
    Raises DataError if no row remains.
    """
    mask = np.ones(len(recording), dtype=bool) if rows is None else np.asarray(rows, dtype=bool)
    seen = recording if mask.all() else recording.take(mask)
    slots, width, unknowns = slots_of(seen, blocks, nuisance)
    return _stack(recording, tuple(c for c, _ in blocks), mask, slots, width, unknowns)


def slots_of(
    seen: Recording, blocks: Sequence[tuple[str, Sequence[Term]]], nuisance: Sequence[Term] = ()
) -> tuple[tuple[Slot, ...], int, tuple[Parameter, ...]]:
    """(slots, number of linear columns, non-linear parameters) of the terms, settled on the rows of `seen`."""
    slots: list[Slot] = []
    unknowns: list[Parameter] = []
    width = 0
    placed = [(t.settled(seen), b, False) for b, (_, terms) in enumerate(blocks) for t in terms]
    for term in (t.settled(seen) for t in nuisance):
        placed += [(term, -1, True)] if hasattr(term, "shared") else [(term, b, True) for b in range(len(blocks))]
    for term, block, is_nuisance in placed:
        free = tuple(p for p in term.linear() if p.name not in term.fixed)
        begin = len(unknowns)
        unknowns += term.free()
        slots.append(Slot(term, block, slice(width, width + len(free)), is_nuisance, free, slice(begin, len(unknowns))))
        width += len(free)
    return tuple(slots), width, tuple(unknowns)


def _stack(recording, components, mask, slots, width, unknowns) -> Problem:
    middle = np.array([_middle(p) for p in unknowns])
    run, kept, response, sequence = recording.run_codes(), [], [], []
    probe = Problem(recording, components, (), np.empty(0), np.empty(0), slots, width, unknowns)
    for b, component in enumerate(components):
        y = recording.array(response_name(recording, component)).astype(float)
        complete = np.isfinite(y) & mask
        for slot in slots:
            if slot.block in (b, -1):
                complete &= np.isfinite(probe.basis_of(slot, b, middle)).all(axis=1)
        chosen = np.flatnonzero(complete)
        if chosen.size == 0:
            raise DataError(f"fit: no row has both {component} and everything its terms need")
        kept.append(chosen)
        response.append(y[chosen] - fixed_part(recording, b, slots)[chosen])
        sequence.append(run[chosen] + b * (int(run.max()) + 1))
    stacked = tuple(kept), np.concatenate(response), np.concatenate(sequence)
    return Problem(recording, components, *stacked, slots, width, unknowns)


def _middle(parameter: Parameter) -> float:
    low, high = parameter.typical
    return float(np.sqrt(low * high)) if low > 0 else 0.5 * (low + high)


def fixed_part(recording: Recording, block: int, slots: Sequence[Slot]) -> np.ndarray:
    """Contribution of the fixed linear parameters, shape (rows,)."""
    total = np.zeros(len(recording))
    for slot in slots:
        term = slot.term
        given = [k for k, p in enumerate(term.linear()) if p.name in term.fixed]
        if slot.block == block and given:
            if slot.searched.stop > slot.searched.start:
                raise DataError(f"fit: {term.term} fixes a linear parameter, so its non-linear ones must be fixed too")
            basis = term.basis(recording, *inner_values(term, np.empty(0)))
            total = total + basis[:, given] @ np.array([term.fixed[term.linear()[k].name] for k in given])
    return total
