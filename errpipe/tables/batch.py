"""A table over recordings (causal replay), whole or in parts, and over many points (no states).

All agree with the reference evaluator to the bit. `evaluate` gives what the reference gives row by row: a short
recording is given to it, a long one to its twin in Numba, which takes seconds to compile. `position` gives what the
reference gives in the first cycle of a run at each point, with missing coordinates giving NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np

from errpipe.domain import table as t
from errpipe.errors import DataError
from errpipe.kernels import table_cycle, table_position, table_replay
from errpipe.kernels.table_codes import KEEP
from errpipe.tables import pack
from errpipe.tables.reference import Evaluator

_OUTSIDE = sum(1 << t.STATUS.index(bit) for bit in ("fading", "defaulted", "beyond_profile"))
REPLAYED = 4000  # rows that the reference evaluator replays: 0.2 s for 3 inputs, Numba takes 0.5 s to load
UNBLOCKED = 500_000  # rows of a table: then in blocks, a third of the time; these take 0.15 s, compiling blocks 8 s
SINGLE = 1024  # rows evaluated singly where a block is invalid; chosen: a call of a kernel costs 20 us
_replayed = 0  # rows, by this process


@dataclass(frozen=True)
class Replay:
    """Evaluation of a table on every row: by output name, shape (rows,), deviation um or urad."""

    deviation: dict[str, np.ndarray]
    correction: dict[str, np.ndarray]
    status: np.ndarray

    def outside(self) -> np.ndarray:
        """True where a row lies outside validity, beyond a profile, or an input was down to its default."""
        return (self.status & _OUTSIDE) != 0


class Rows:
    """A table over a recording that comes in parts: every call continues where the one before it ended.

    compiled: in Numba, else by the reference evaluator; the bits are the same.
    """

    def __init__(self, table: t.CompensationTable, compiled: bool = True):
        self.table = table
        self._compiled = _Compiled(table) if compiled else None
        self._begin()

    def restarted(self) -> Rows:
        """The same table before its first row; what does not change is shared."""
        other = copy(self)
        other._begin()
        return other

    def _begin(self) -> None:
        self._before: tuple[int, float] | None = None  # run and time of the last row
        self._replay_rows = self._plain() if self._compiled is None else self._compiled.replay_rows()

    def __call__(self, columns: Mapping[str, np.ndarray], time: np.ndarray, run: np.ndarray) -> Replay:
        """Evaluation of the next rows; arguments and errors as of `evaluate`."""
        table = self.table
        lacking = [i.name for i in table.inputs if not i.optional and i.name not in columns]
        if lacking:
            raise DataError(f"the recording has no column for the table's input {', '.join(lacking)}")
        rows = len(run)
        readings = np.empty((len(table.inputs), rows))
        for n, i in enumerate(table.inputs):
            readings[n] = columns.get(i.name, np.nan)
        deviation = np.empty((len(table.outputs), rows))
        correction = np.empty_like(deviation)
        status = np.empty(rows, dtype=np.int64)
        time, run = np.asarray(time, dtype=float), np.asarray(run, dtype=np.int64)
        if rows:
            goes_on = self._before is not None and self._before[0] == run[0]
            before = self._before[1] if self._before is not None else 0.0
            self._replay_rows(readings, time, run, goes_on, before, deviation, correction, status)
            self._before = (int(run[-1]), float(time[-1]))
        names = [o.name for o in table.outputs]
        return Replay(dict(zip(names, deviation, strict=True)), dict(zip(names, correction, strict=True)), status)

    def _plain(self) -> Callable[..., None]:
        evaluator, names = Evaluator(self.table), [i.name for i in self.table.inputs]

        def replay_rows(readings, time, run, goes_on, before, deviation, correction, status) -> None:
            times, runs = time.tolist(), run.tolist()
            for k, row in enumerate(readings.T.tolist()):
                dt = 0.0
                if not goes_on or (k > 0 and runs[k] != runs[k - 1]):
                    evaluator.reset()
                elif times[k] > before:
                    dt = times[k] - before
                goes_on, before = True, times[k]
                cycle = evaluator.cycle(dict(zip(names, row, strict=True)), dt=dt)
                deviation[:, k] = list(cycle.deviation.values())
                correction[:, k] = list(cycle.correction.values())
                status[k] = cycle.status

        return replay_rows


class _Compiled:
    """A table as Numba replays it: row by row, and a long recording in blocks."""

    def __init__(self, table: t.CompensationTable):
        self.program = program = pack.program(table)
        moves = [not isinstance(node, t.ConstantNode) for node in table.nodes]
        self.moves = np.array(moves, dtype=np.uint8)
        self.fixed = np.where(moves, 0.0, program.nodes["a"])
        self.plan = _plan(table, program, self.fixed, moves, [p.input is not None for p in table.profiles])
        self.profile_fixed = program.values[program.profiles["first"]] * program.profiles["scale"]
        self.rows = 0  # replayed so far

    def replay_rows(self) -> Callable[..., None]:
        """What replays rows from the first one on."""
        program, plan, state = self.program, self.plan, pack.state(self.program)
        row, fresh = np.empty(state.inputs.size), np.ones(state.inputs.size, dtype=np.uint8)
        work = None

        def replay_rows(columns, time, run, goes_on, before, *results) -> None:
            nonlocal work
            self.rows += run.size
            if work is None and self.rows > UNBLOCKED:
                work = self._workspace(state)
            done, step = 0, run.size if work is None else SINGLE
            while done < run.size:
                if work is not None and goes_on:
                    done = table_replay.replay(program, plan, work, state, columns, time, run, before, done, *results)
                    before = float(time[done - 1]) if done else before
                begin, done = done, min(done + step, run.size)
                if begin < done:
                    rows = columns, time, run, goes_on, before, begin, done
                    table_cycle.replay(program, state, fresh, row, *rows, *results)
                    goes_on, before = True, float(time[done - 1])

        return replay_rows

    def _workspace(self, state: table_cycle.State) -> table_replay.Workspace:
        # Not compiled: that takes seconds, and this a millisecond.
        buffers = table_position.workspace.py_func(self.program, self.plan)
        table_position.fill.py_func(self.program, self.plan, self.fixed, self.profile_fixed, buffers)
        decay, dt = np.empty((2, table_position.BLOCK)), np.empty(table_position.BLOCK)
        return table_replay.Workspace(
            buffers, self.fixed, self.moves, decay, dt, state.inputs.copy(), state.nodes.copy()
        )


def evaluate(
    table: t.CompensationTable, columns: Mapping[str, np.ndarray], time: np.ndarray, run: np.ndarray
) -> Replay:
    """Replay a recording: row k uses rows up to k of its own run only.

    columns: input name -> values, shape (rows,), NaN where missing; time in s; run: an integer per row, states
    restart where it changes. Raises DataError if a required input has no column.
    """
    return Rows(table, worth_compiling(len(run)))(columns, time, run)


def worth_compiling(rows: int) -> bool:
    """Whether rows to be replayed now, with those of this process before them, repay the start of Numba."""
    global _replayed
    _replayed += rows
    return _replayed > REPLAYED


class Positions:
    """A table at fixed readings of all inputs but the moving ones: `evaluator(points)`.

    moving: names of the inputs that `points` holds, in the order of its columns; readings: the other inputs
    (those not named are at their default). Every point is the first cycle of a run: lags stand at their
    operand, directions at their start value unless an input states them. Raises KeyError for an unknown input.
    """

    def __init__(
        self, table: t.CompensationTable, moving: tuple[str, ...], readings: Mapping[str, float] | None = None
    ):
        self.table = table
        self.program = pack.program(table)
        start = {i.name: i.default for i in table.inputs} | dict(readings or {})
        reference = Evaluator(table)
        reference.cycle(start, dt=0.0)
        self.moving = np.array([table.input_index(name) for name in moving], dtype=np.int64)
        moves = set(moving)
        node_moves: list[bool] = []
        for node in table.nodes:
            own = isinstance(node, t.InputNode) and node.input in moves
            node_moves.append(own or any(node_moves[o] for o in node.of))
        self._node_fixed = np.array(reference.nodes())
        self._node_moves = np.array(node_moves, dtype=np.uint8)
        profile_moves = [p.input in moves for p in table.profiles]
        self._plan = _plan(table, self.program, self._node_fixed, node_moves, profile_moves)
        self._profile_fixed = np.array(reference.profiles())
        self._fade = reference.validity_share({i.name for i in table.inputs if i.name not in moves})

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Deviations, shape (n, outputs), um or urad, at points (n, moving inputs) in mm or deg."""
        columns = np.ascontiguousarray(np.asarray(points, dtype=float).T)
        return self.rows(columns).T

    def rows(self, columns: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """The same for points given by row: columns (moving inputs, n) in C order, result (outputs, n), in `out`."""
        out = np.empty((len(self.table.outputs), columns.shape[1])) if out is None else out
        fixed = (self._node_fixed, self._node_moves, self._profile_fixed, self._fade)
        missing = table_position.evaluate(self.program, self._plan, columns, self.moving, *fixed, out)
        if missing:
            out[:, np.isnan(columns).any(axis=0)] = np.nan
        return out


def position(
    table: t.CompensationTable,
    points: np.ndarray,
    moving: tuple[str, ...] | None = None,
    readings: Mapping[str, float] | None = None,
) -> np.ndarray:
    """Deviations (n, outputs) at points (n, inputs that move); `moving` defaults to all position inputs in order."""
    names = moving or tuple(i.name for i in table.inputs if i.kind == "position")
    return Positions(table, names, readings)(points)


def _plan(
    table: t.CompensationTable,
    program: table_cycle.Program,
    node_fixed: np.ndarray,
    node_moves: list[bool],
    profile_moves: list[bool],
) -> table_position.Plan:
    """Order in which the blocks of a table are evaluated.

    A profile is written to its component at once where its only pair is the component's first, is kept outside
    validity, and has a constant driver; before all blocks where the profile is constant too. Two neighbours
    on one grid are evaluated together.
    """
    components = 1 + max(int(records["component"].max(initial=0)) for records in (program.pairs, program.terms))
    opens, alone = np.zeros((2, len(program.pairs)), dtype=np.uint8)
    opens[np.unique(program.pairs["component"], return_index=True)[1]] = 1
    row, factor = components + np.arange(len(table.profiles)), np.ones(len(table.profiles))
    used = np.bincount(program.pairs["profile"], minlength=len(table.profiles))
    shared = np.bincount(program.pairs["component"], minlength=components)
    for k, pair in enumerate(program.pairs):
        p, node, kept = pair["profile"], pair["node"], pair["flags"] & KEEP
        if opens[k] and kept and used[p] == 1 and profile_moves[p] and not node_moves[node]:
            alone[k], row[p], factor[p] = 1, pair["component"], node_fixed[node]
        elif kept and shared[pair["component"]] == 1 and not profile_moves[p] and not node_moves[node]:
            alone[k] = 2
    knots = [np.array([p.values, [*np.diff(p.values), 0]], dtype=float) for p in table.profiles]
    width = np.where(profile_moves, 2, 0)
    for p in range(len(knots) - 1):
        if width[p] == 2 and program.same_grid[p + 1]:
            knots[p] = np.stack([knots[p], knots[p + 1]], axis=1).reshape(4, -1)
            knots[p + 1], width[p], width[p + 1] = np.empty((2, 0)), 4, 0
    first, knots_in_a_row = np.cumsum([0, *(k.size for k in knots)]), np.concatenate([k.T.ravel() for k in knots])
    return table_position.Plan(components, opens, alone, knots_in_a_row, first, width, row, factor)
