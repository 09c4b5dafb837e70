"""One pass over a recording that is never whole in memory: what least squares needs of it, batch by batch.

What a batch leaves is one matrix of sums of products (Gram) of [1 | design | fixed part | response] per cell, a cell
being the rows of one run, group and block. Those of cells add up: that of any set of cells, such as all runs but one,
follows from theirs. Columns count from their first rows' mean, so that a large mean costs no digits, and what is solved
is the triangular factor of the scaled sum (Golub and Van Loan, Matrix Computations, 4th edition, section 5.3: normal
equations lose what the collinearity of scaled columns squares, and that is refused long before). Beside it stands a
sample of whole stretches of every run, for what needs single rows; up to `SAMPLE_ROWS` rows it is all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout, solve
from errpipe.fitting.design import Problem, Slot, fixed_part, response_name, slots_of
from errpipe.fitting.spec import ComponentSpec, ModelSpec

SAMPLE_ROWS = 200_000  # a 90 % quantile of so many independent rows is known to 0.2 % of the rows
STRETCH = 2000  # rows side by side in the sample: ten times the memory of noise that is correlated by 0.99
FIRST_ROWS = 10_000  # rows whose mean the sums of products count from
SHORTEST = 20  # rows of a run in the sample, however many runs there are
ROUNDING = 1e-15  # of the scaled sum of products, per column: smaller eigenvalues are zero


@dataclass(frozen=True)
class Source:
    """A recording on disk.

    ends: two rows, the smallest and the largest value of every column. batches: names of columns -> its rows in order,
    batch by batch, each with what the rows before it leave behind. complete: columns in which no value is missing.
    """

    rows: int
    ends: Recording
    batches: Callable[[Sequence[str]], Iterator[Recording]]
    complete: frozenset[str] = frozenset()

    @property
    def manifest(self) -> Manifest:
        """The manifest of the recording."""
        return self.ends.manifest


@dataclass(frozen=True)
class Layout:
    """Runs in their order with their rows, the hold-out that suits them, and the column that groups are read from."""

    runs: tuple[str, ...]
    lengths: np.ndarray
    scheme: holdout.HoldOut
    rows: int


@dataclass
class History:
    """What one pass leaves of one component. keys: (run, group) of each cell; sums: Gram matrix of each, (k, k)."""

    component: str
    slots: tuple[Slot, ...]
    width: int
    names: tuple[str, ...]
    layout: Layout
    keys: dict[tuple[str, str], int] = field(default_factory=dict)
    sums: list[np.ndarray] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    rows: list[np.ndarray] = field(
        default_factory=list
    )  # of the sample: [1 | design | fixed | response], NaN where missing
    cells: list[np.ndarray] = field(default_factory=list)  # of the sample: number of the cell
    places: list[np.ndarray] = field(default_factory=list)  # of the sample: row of the recording
    centre: np.ndarray | None = None  # what the columns of `sums` count from, (k,)
    frames: list[pd.DataFrame] = field(default_factory=list)

    def columns(self, batch: Recording) -> np.ndarray:
        """[1 | design | fixed part | response] of a batch, (rows, k = width + 3); NaN where something is missing."""
        problem = Problem(
            batch,
            (self.component,),
            (np.arange(len(batch)),),
            np.zeros(len(batch)),
            np.zeros(0),
            self.slots,
            self.width,
            (),
        )
        out = np.empty((self.width + 3, len(batch))).T  # columns side by side in memory: four times as fast to add up
        out[:, 0] = 1.0
        inside, none = out[:, 1:-2], np.empty(0)
        for slot in self.slots:
            inside[:, slot.columns] = problem.basis_of(slot, 0, none)
        out[:, -2] = fixed_part(batch, 0, self.slots)
        out[:, -1] = batch.array(response_name(batch, self.component))
        return out

    def add(self, part: Part) -> None:
        """Take the rows of a batch."""
        rows = self.columns(part.batch)
        number = np.empty(rows.shape[0], dtype=np.int64)
        kept = np.flatnonzero(part.sampled)
        self.rows.append(np.ascontiguousarray(rows[kept]))
        if self.centre is None:
            self.centre = np.nan_to_num(np.nanmean(rows[:FIRST_ROWS], axis=0))
            self.centre[0] = 0.0
        rows -= self.centre
        for key, first, end in part_stretches(part):
            k = self.keys.setdefault(key, len(self.sums))
            if k == len(self.sums):
                self.sums.append(np.zeros((rows.shape[1], rows.shape[1])))
                self.counts.append(0)
            number[first:end] = k
            sums, count = _products(rows[first:end])
            self.sums[k] += sums
            self.counts[k] += count
        self.cells.append(number[kept])
        self.places.append(kept + part.at)
        self.frames.append(part.batch.frame.iloc[kept])

    def sample(self, manifest: Manifest) -> Recording:
        """The rows of the sample as a recording."""
        return Recording(manifest, pd.concat(self.frames, ignore_index=True))

    def rows_of_recording(self) -> np.ndarray:
        """Row of the recording that each row of the sample is."""
        return np.concatenate(self.places)

    def factor(self, cells: np.ndarray | None = None) -> np.ndarray:
        """The triangular factor of some cells (all where None), (k, k)."""
        chosen = self.sums if cells is None else [self.sums[k] for k in np.flatnonzero(cells)]
        total = np.sum(chosen, axis=0)
        size = np.sqrt(np.diag(total))
        size[size == 0.0] = 1.0
        with solve.one_thread():
            values, vectors = np.linalg.eigh(total / size / size[:, None])
            values[values < ROUNDING * size.size * values[-1]] = 0.0
            root: np.ndarray = np.sqrt(values)[:, None] * vectors.T * size
            return np.asarray(np.linalg.qr(root @ self._uncentred(), mode="r"))

    def pull(self, cell: int, weights: np.ndarray) -> np.ndarray:
        """design' (design weighted) of a cell, (k,)."""
        back = self._uncentred()
        return back.T @ (self.sums[cell] @ (back @ weights))

    def _uncentred(self) -> np.ndarray:
        """What turns rows that count from their centre into rows, (k, k)."""
        back = np.eye(self.width + 3)
        back[0] += 0.0 if self.centre is None else self.centre
        return back

    def weights(self, coefficients: np.ndarray) -> np.ndarray:
        """What each column counts for in response less fixed part less model, (k,)."""
        return np.r_[0.0, -coefficients, -1.0, 1.0]


def _products(rows: np.ndarray) -> tuple[np.ndarray, int]:
    """Sums of products of the complete rows of (n, k), (k, k), and their number."""
    with solve.one_thread():
        sums = rows.T @ rows
        if not np.isfinite(sums).all():
            rows = rows[np.isfinite(rows.sum(axis=1))]
            sums = rows.T @ rows
    return sums, rows.shape[0]


def part_stretches(part: Part) -> Iterator[tuple[tuple[str, str], int, int]]:
    """(key, first row, row after the last) of each stretch of a batch."""
    ends = [*part.starts[1:].tolist(), len(part.batch)]
    return zip(part.keys, part.starts.tolist(), ends, strict=True)


def few_rows(factor: np.ndarray) -> np.ndarray:
    """k + 1 rows with the sums of squares and products of all rows, and their correlations about the mean.

    factor: of [1 | ...], (k, k). Whatever least squares and collinearity ask of all rows, these answer alike.
    """
    k = factor.shape[0]
    basis = np.linalg.qr(np.column_stack([np.ones(k + 1), np.eye(k + 1)[:, : k - 1]]))[0]
    return basis @ factor


def survey(source: Source, spec: ModelSpec, scheme: holdout.HoldOut | str | None = None) -> Layout:
    """Runs and hold-out of a recording, from its labels and responses alone. Raises DataError where runs are mixed."""
    manifest, asked = source.manifest, spec.holdout if scheme is None else scheme
    responses = [n for n, c in manifest.columns.items() if c.role == "error"]
    all_measured = not source.complete.isdisjoint(responses)
    names = [*manifest.names("run"), *([] if all_measured else responses)]
    lengths: dict[str, int] = {}
    measured: set[str] = set()
    last = ""
    for batch in source.batches(names):
        run, labels = batch.run_codes(), batch.run_labels()
        seen = np.ones(run.size, dtype=bool) if all_measured else holdout.measured(batch)
        for first, end in _stretches(run):
            label = labels[run[first]]
            if label in lengths and label != last:
                raise DataError(f"run {label} comes back after run {last}: in batches the rows of a run stand together")
            lengths[label] = lengths.get(label, 0) + int(end - first)
            last = label
            if seen[first:end].any():
                measured.add(label)
    few = Recording(
        Manifest(recording=1, tables=("-",), columns={"run": Column(role="run")}),
        pd.DataFrame({"run": sorted(measured)}),
    )
    chosen = holdout.resolved(few, asked)
    if chosen.gap > 0:
        raise DataError(
            "hold-out: a gap around the judged rows cannot be kept in batches (gap: 0, or raise rows_in_memory)"
        )
    return Layout(tuple(lengths), np.array(list(lengths.values())), chosen, source.rows)


@dataclass(frozen=True)
class Part:
    """A batch. keys: (run, group) of each stretch of rows that begins at `starts`; sampled: which of its rows are in
    the sample, (rows,); at: row of the recording that it begins at.
    """

    batch: Recording
    keys: list[tuple[str, str]]
    starts: np.ndarray
    sampled: np.ndarray
    at: int


Prepare = Callable[[Recording], Recording]


def parts(source: Source, layout: Layout, names: Sequence[str], prepare: Prepare) -> Iterator[Part]:
    """The batches of a recording, each cut where the run or the group changes. prepare: what is done to each first."""
    numbers = {label: k for k, label in enumerate(layout.runs)}
    at, in_run, last = 0, 0, ""
    for batch in map(prepare, source.batches(names)):
        run, labels = batch.run_codes(), batch.run_labels()
        groups = _groups(batch, layout, at)
        changes = np.diff(run) != 0 if groups is None else (np.diff(run) != 0) | (groups[1:] != groups[:-1])
        starts = np.flatnonzero(np.r_[True, changes])
        keys = [(labels[run[s]], "" if groups is None else str(groups[s])) for s in starts]
        sampled = np.zeros(len(batch), dtype=bool)
        for first, end in _stretches(run):
            label = labels[run[first]]
            in_run = in_run if label == last else 0
            sampled[first:end] = _sampled(layout, numbers[label], in_run, end - first)
            in_run, last = in_run + end - first, label
        yield Part(batch, keys, starts, sampled, at)
        at += len(batch)


def gather(source: Source, spec: ModelSpec, layout: Layout, prepare: Prepare) -> list[History]:
    """One pass over the recording: a history per component. Raises DataError where a component has no row."""
    histories = [_begun(source.ends, component, layout, prepare) for component in spec.components]
    names = sorted({n for h in histories for n in h.names})
    for part in parts(source, layout, names, prepare):
        for history in histories:
            history.add(part)
    for history in histories:
        if not sum(history.counts):
            raise DataError(f"fit: no row has both {history.component} and everything its terms need")
    return histories


def _begun(ends: Recording, component: ComponentSpec, layout: Layout, prepare: Prepare) -> History:
    watched = _Watched(ends.manifest, prepare(ends).frame)
    slots, width, _ = slots_of(watched, [(component.component, component.terms)])
    history = History(component.component, slots, width, (), layout)
    history.columns(watched)
    roles = {"run", "command", "position", "direction"}
    roles |= set() if layout.scheme.scheme == "leave-one-run-out" else {"group"}
    roles |= {"time"} if layout.scheme.of in holdout.CALENDAR else set()
    columns = ends.manifest.columns
    names = {n for n, c in columns.items() if c.role in roles or c.component == component.component}
    names |= watched.seen | {n for s in slots for n in s.term.drivers(watched)}
    history.names = tuple(n for n in columns if n in names)
    return history


class _Watched(Recording):
    """A recording that notes which columns are read."""

    @property
    def seen(self) -> set[str]:
        return self.__dict__.setdefault("_seen", set())

    def array(self, name: str) -> np.ndarray:
        self.seen.add(name)
        return super().array(name)


def _stretches(codes: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.r_[True, np.diff(codes) != 0, True]) if codes.size else np.zeros(1, dtype=int)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _blocked(scheme: holdout.HoldOut) -> bool:
    return scheme.scheme == "blocks" or (scheme.scheme == "forward" and scheme.of is None)


def _groups(batch: Recording, layout: Layout, at: int) -> np.ndarray | None:
    """Group of each row where the hold-out is not by run, (rows,)."""
    scheme = layout.scheme
    if _blocked(scheme):
        number = (at + np.arange(len(batch))) * scheme.blocks // layout.rows
        return np.array([f"block {k + 1} of {scheme.blocks}" for k in range(scheme.blocks)], dtype=object)[number]
    of = scheme.of
    if scheme.scheme == "leave-one-group-out" and of is None and batch.manifest.names("group"):
        of = batch.manifest.names("group")[0]
    if of is None or of == "run":
        return None
    return holdout.labels(holdout.with_calendar(batch, of), of)


def _sampled(layout: Layout, run: int, begin: int, count: int) -> np.ndarray:
    """Which rows of a part of a run are in the sample, (count,). begin: rows of the run before the part."""
    every = -(-layout.rows // SAMPLE_ROWS)
    stretch = max(SHORTEST, min(STRETCH, SAMPLE_ROWS // len(layout.runs)))
    room = max(1, min(int(layout.lengths[run]), every * stretch) - stretch + 1)
    first = (run * 2_654_435_761) % room  # Knuth's multiplicative hash: another place in every run
    return (begin + np.arange(count) - first) % (every * stretch) < stretch
