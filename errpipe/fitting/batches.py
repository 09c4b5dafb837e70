"""One pass over a recording larger than memory: the statistics that least squares needs, batch by batch.

A batch is reduced to one matrix of sums of products (Gram) of [1 | design | fixed part | response] per cell, a cell
being the rows of one run, group and block. Matrices of cells add up: that of any set of cells, such as all runs but
one, is their sum. Columns count from the mean of their first rows, so that a large mean costs no digits, and the
factor of the scaled sum is triangular (Golub and Van Loan, Matrix Computations, 4th edition, section 5.3: normal
equations square the condition number of the scaled columns; collinearity is rejected long before). In addition a
sample of whole stretches of every run is kept for what needs single rows; up to `SAMPLE_ROWS` rows it is all of them.

A recording may lie in parts of whole runs (`Source.over`): a pass is then one pass over each, and what they give is
joined in their order, whoever made it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from errpipe.domain.batch import joined
from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout, solve
from errpipe.fitting.design import Problem, Slot, fixed_part, response_name, slots_of
from errpipe.fitting.parallel import no_warnings
from errpipe.fitting.source import Layout, Source, stretches
from errpipe.fitting.spec import ComponentSpec, ModelSpec

SAMPLE_ROWS = 200_000  # a 90 % quantile of so many independent rows is known to 0.2 % of the rows
STRETCH = 2000  # consecutive rows in the sample: ten times the memory of noise with a correlation of 0.99
FIRST_ROWS = 10_000  # rows whose mean is subtracted before the sums of products
SHORTEST = 20  # rows of a run in the sample, however many runs there are
ROUNDING = 1e-15  # of the scaled sum of products, per column: smaller eigenvalues are zero


@dataclass
class History:
    """Result of one pass for one component. keys: (run, group) of each cell; sums: Gram matrix of each, (k, k)."""

    component: str
    slots: tuple[Slot, ...]
    moving: tuple[Slot, ...]  # those with columns that vary from row to row
    width: int
    names: tuple[str, ...]
    layout: Layout
    constants: np.ndarray  # value of each column that does not vary from row to row, else 0, (k,)
    keys: dict[tuple[str, str], int] = field(default_factory=dict)
    sums: list[np.ndarray] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    sampled: list[np.ndarray] = field(default_factory=list)  # varying columns of the sample before the response
    cells: list[np.ndarray] = field(default_factory=list)  # of the sample: number of the cell
    places: list[np.ndarray] = field(default_factory=list)  # of the sample: row of the recording
    centre: np.ndarray | None = None  # reference subtracted from the columns of `sums`, (k,)
    kept: list[Recording] = field(default_factory=list)  # rows of the sample
    buffer: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))  # [1 | varying less centre], (columns, rows)
    whole: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))  # of all columns of a batch, (k, rows)

    def columns(self, batch: Recording) -> np.ndarray:
        """[1 | design | fixed part | response] of a batch, (rows, k = width + 3); NaN for missing values.

        The memory of the previous batch is reused: allocating it again costs as much as the sums.
        """
        if self.whole.shape[1] < len(batch):
            self.whole = np.repeat(self.constants[:, None], len(batch), axis=1)
        out = self.whole[:, : len(batch)]
        for k, values in self._varying(batch):
            out[k] = values
        return out.T  # columns contiguous in memory

    def _varying(self, batch: Recording) -> Iterator[tuple[int, np.ndarray]]:
        """(number, values) of the columns of a batch that vary from row to row, in the order of `varying`."""
        for slot in self.moving:
            yield from zip(range(1 + slot.columns.start, 1 + slot.columns.stop), self.basis(batch, slot), strict=True)
        if self.fixes:
            yield self.width + 1, fixed_part(batch, 0, self.slots)
        yield self.width + 2, batch.array(response_name(batch, self.component))

    def basis(self, batch: Recording, slot: Slot) -> np.ndarray:
        """Design columns of a slot, (columns, rows)."""
        empty = np.zeros(0)
        problem = Problem(batch, (self.component,), (), empty, empty, self.slots, self.width, ())
        return problem.basis_of(slot, 0, empty).T

    @cached_property
    def fixes(self) -> bool:
        """Whether a linear parameter is fixed."""
        return any(p.name in s.term.fixed for s in self.slots for p in s.term.linear())

    @cached_property
    def cross(self) -> tuple[np.ndarray, ...]:
        """Index of the sums of the columns that vary from row to row."""
        return np.ix_(self.varying, self.varying)

    @cached_property
    def varying(self) -> list[int]:
        """Columns that vary from row to row, and the first one."""
        inside = [1 + k for s in self.moving for k in range(s.columns.start, s.columns.stop)]
        return [0, *inside, *([self.width + 1] if self.fixes else []), self.width + 2]

    def add(self, part: Part) -> None:
        """Add the rows of a batch."""
        batch, kept = part.batch, part.sampled
        if self.centre is None:
            opening = self.columns(batch.take(slice(FIRST_ROWS)))[:, self.varying[1:]]
            self.centre = np.r_[0.0, self.constants[1:]]
            with no_warnings():  # a column may have no reading yet
                self.centre[self.varying[1:]] = np.nan_to_num(np.nanmean(opening, axis=0))
        if self.buffer.shape[1] < len(batch):
            self.buffer = np.ones((len(self.varying), len(batch)))
        sampled = np.empty((len(self.varying) - 2, len(kept)))
        for row, (number, values) in enumerate(self._varying(batch)):
            np.subtract(values, self.centre[number], out=self.buffer[1 + row, : len(batch)])
            if row < len(sampled):
                sampled[row] = values[kept]
        self.sampled.append(sampled)
        numbers = []
        for key, first, end in part_stretches(part):
            k = self.keys.setdefault(key, len(self.sums))
            if k == len(self.sums):
                self.sums.append(np.zeros((self.width + 3, self.width + 3)))
                self.counts.append(0)
            numbers.append(k)
            sums, count = _products(self.buffer[:, first:end])
            self.sums[k][self.cross] += sums
            self.counts[k] += count
        self.cells.append(np.repeat(numbers, np.diff(np.searchsorted(kept, part.starts), append=len(kept))))
        self.places.append(kept + part.at)
        self.kept.append(part.batch.take(kept))

    def join(self, following: History) -> None:
        """Add the rows of the next part, which has runs of its own."""
        shift, begin = np.eye(self.width + 3), len(self.sums)
        if self.centre is not None and following.centre is not None:
            shift[0] += following.centre - self.centre
        self.keys |= {key: begin + k for key, k in following.keys.items()}
        self.sums += [shift.T @ sums @ shift for sums in following.sums]
        self.counts += following.counts
        self.sampled += following.sampled
        self.cells += [begin + cells for cells in following.cells]
        self.places += following.places
        self.kept += following.kept

    def without_rows(self) -> History:
        """What evaluates the columns of a batch, and the numbers of the cells, alone."""
        nothing: Any = {name: [] for name in ("sums", "counts", "sampled", "cells", "places", "kept")}
        return replace(self, **nothing, buffer=np.empty((0, 0)), whole=np.empty((0, 0)))

    def rows(self) -> np.ndarray:
        """[1 | design | fixed part | response] of the sample, (rows, k); NaN where something is missing."""
        out = np.repeat(self.constants[None], sum(map(len, self.kept)), axis=0)
        out[:, self.varying[1:-1]] = np.hstack(self.sampled).T
        out[:, -1] = np.concatenate([part.array(response_name(part, self.component)) for part in self.kept])
        return out

    def sample(self, manifest: Manifest) -> Recording:
        return Recording(manifest, joined(self.kept))

    def rows_of_recording(self) -> np.ndarray:
        """Row of the recording of each row of the sample."""
        return np.concatenate(self.places)

    def factor(self, cells: np.ndarray | None = None) -> np.ndarray:
        """The triangular factor of some cells (default: all), (k, k)."""
        chosen = self.sums if cells is None else [self.sums[k] for k in np.flatnonzero(cells)]
        total = np.sum(chosen, axis=0)
        size = np.sqrt(np.diag(total))
        size[size == 0.0] = 1.0
        with solve.one_thread():
            values, vectors = np.linalg.eigh(total / size / size[:, None])
            values[values < ROUNDING * size.size * values[-1]] = 0.0
            root: np.ndarray = np.sqrt(values)[:, None] * vectors.T * size
            return np.asarray(np.linalg.qr(root @ self._uncentred(), mode="r"))

    def gradient(self, cell: int, weights: np.ndarray) -> np.ndarray:
        """design' (design weighted) of a cell, (k,)."""
        back = self._uncentred()
        return back.T @ (self.sums[cell] @ (back @ weights))

    def _uncentred(self) -> np.ndarray:
        """Transformation from centred rows to rows, (k, k)."""
        back = np.eye(self.width + 3)
        back[0] += 0.0 if self.centre is None else self.centre
        return back

    def weights(self, coefficients: np.ndarray) -> np.ndarray:
        """Weight of each column in response minus fixed part minus model, (k,)."""
        return np.r_[0.0, -coefficients, -1.0, 1.0]


def _products(columns: np.ndarray) -> tuple[np.ndarray, int]:
    """Sums of products of the complete rows of columns (k, n): (k, k), and the number of these rows."""
    sums = _gram(columns)
    if not np.isfinite(sums).all():
        columns = columns[:, np.isfinite(columns.sum(axis=0))]
        sums = _gram(columns)
    return sums, columns.shape[1]


def _gram(columns: np.ndarray) -> np.ndarray:
    """columns @ columns.T; of few long columns three times as fast, one after the other, as by one product."""
    sums = np.zeros((columns.shape[0], columns.shape[0]))
    for k in range(columns.shape[0]):
        sums[k, : k + 1] = sums[: k + 1, k] = columns[: k + 1] @ columns[k]
    return sums


def part_stretches(part: Part) -> Iterator[tuple[tuple[str, str], int, int]]:
    """(key, first row, row after the last) of each stretch of a batch."""
    ends = [*part.starts[1:].tolist(), len(part.batch)]
    return zip(part.keys, part.starts.tolist(), ends, strict=True)


def equivalent_rows(factor: np.ndarray) -> np.ndarray:
    """k + 1 rows with the sums of squares and products of all rows, and their correlations about the mean.

    factor: of [1 | ...], (k, k). For least squares and collinearity they are equivalent to all rows.
    """
    k = factor.shape[0]
    basis = np.linalg.qr(np.column_stack([np.ones(k + 1), np.eye(k + 1)[:, : k - 1]]))[0]
    return basis @ factor


@dataclass(frozen=True)
class Part:
    """A batch. keys: (run, group) of each stretch of rows that starts at `starts`; sampled: its rows in the
    sample, ascending; at: row of the recording at which it starts.
    """

    batch: Recording
    keys: list[tuple[str, str]]
    starts: np.ndarray
    sampled: np.ndarray
    at: int


Prepare = Callable[[Recording], Recording]


def parts(source: Source, layout: Layout, names: Sequence[str], prepare: Prepare) -> Iterator[Part]:
    """The batches of a recording, each cut where the run or the group changes. prepare: applied to each first."""
    numbers = {label: k for k, label in enumerate(layout.runs)}
    at, in_run, last = source.at, 0, ""
    for batch in map(prepare, source.batches(names, runs=layout.runs_of(source))):
        groups = _groups(batch, layout, at)
        runs, starts = batch.run_stretches
        keys = [(run, "") for run in runs]
        if groups is not None:
            begins = np.union1d(starts, np.flatnonzero(groups[1:] != groups[:-1]) + 1)
            of = np.searchsorted(starts, begins, side="right") - 1
            keys, starts = [(runs[k], str(groups[s])) for k, s in zip(of, begins, strict=True)], begins
        sampled = []
        for label, first, end in stretches(batch):
            in_run = in_run if label == last else 0
            sampled.append(first + _sampled(layout, numbers[label], in_run, end - first))
            in_run, last = in_run + end - first, label
        yield Part(batch, keys, starts, np.concatenate(sampled), at)
        at += len(batch)


def gather(source: Source, spec: ModelSpec, layout: Layout, prepare: Prepare) -> list[History]:
    """One pass over the recording: a history per component. Raises DataError if a component has no row."""
    histories, *others = source.over(_gathered, spec, layout, prepare)
    for other in others:
        for history, following in zip(histories, other, strict=True):
            history.join(following)
    for history in histories:
        if not sum(history.counts):
            raise DataError(f"fit: no row has both {history.component} and everything its terms need")
    return list(histories)


def _gathered(source: Source, spec: ModelSpec, layout: Layout, prepare: Prepare) -> list[History]:
    histories = [_new_history(source.ends, component, layout, prepare) for component in spec.components]
    names = sorted({n for h in histories for n in h.names})
    with solve.one_thread():
        for part in parts(source, layout, names, prepare):
            for history in histories:
                history.add(part)
    for history in histories:
        history.buffer = history.whole = np.empty((0, 0))
    return histories


def _new_history(ends: Recording, component: ComponentSpec, layout: Layout, prepare: Prepare) -> History:
    watched = _ReadColumns(ends.manifest, prepare(ends).frame)
    slots, width, _ = slots_of(watched, [(component.component, component.terms)])
    moving = tuple(s for s in slots if s.term.drivers(watched) or not s.term.rowwise)
    history = History(component.component, slots, moving, width, (), layout, np.r_[1.0, np.zeros(width + 2)])
    for slot in (s for s in slots if s not in moving):
        history.constants[1:-2][slot.columns] = history.basis(watched, slot)[:, 0]
    history.columns(watched)
    roles = {"run", "command", "position", "direction"}
    roles |= set() if layout.scheme.scheme == "leave-one-run-out" else {"group"}
    roles |= {"time"} if layout.scheme.of in holdout.CALENDAR else set()
    columns = ends.manifest.columns
    names = {n for n, c in columns.items() if c.role in roles or c.component == component.component}
    names |= watched.seen | {n for s in slots for n in s.term.drivers(watched)}
    history.names = tuple(n for n in columns if n in names)
    return history


class _ReadColumns(Recording):
    """A recording that lists the columns read from it."""

    @property
    def seen(self) -> set[str]:
        return self.__dict__.setdefault("_seen", set())

    def array(self, name: str) -> np.ndarray:
        self.seen.add(name)
        return super().array(name)


def _groups(batch: Recording, layout: Layout, at: int) -> np.ndarray | None:
    """Group of each row if the hold-out is not by run, (rows,)."""
    scheme = layout.scheme
    if scheme.blocked:
        number = (at + np.arange(len(batch))) * scheme.blocks // layout.rows
        return np.array([f"block {k + 1} of {scheme.blocks}" for k in range(scheme.blocks)], dtype=object)[number]
    of = scheme.of
    if scheme.scheme == "leave-one-group-out" and of is None and batch.manifest.names("group"):
        of = batch.manifest.names("group")[0]
    if of is None or of == "run":
        return None
    return holdout.labels(holdout.with_calendar(batch, of), of)


def _sampled(layout: Layout, run: int, begin: int, count: int) -> np.ndarray:
    """Rows of a part of a run that are in the sample, ascending. begin: rows of the run before the part."""
    every = -(-layout.rows // SAMPLE_ROWS)
    stretch = max(SHORTEST, min(STRETCH, SAMPLE_ROWS // len(layout.runs)))
    period = every * stretch
    buffer = max(1, min(int(layout.lengths[run]), period) - stretch + 1)
    first = (run * 2_654_435_761) % buffer  # Knuth's multiplicative hash: a different offset in every run
    starts = first - begin + period * np.arange((begin - first) // period, (begin + count - first) // period + 1)
    rows = (starts[:, None] + np.arange(stretch)).ravel()
    return rows[(rows >= 0) & (rows < count)]
