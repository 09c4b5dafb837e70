"""A sequence of faults through each evaluator: corrections in um per cycle, shape (cycles, outputs)."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np

from errpipe.kernels import table_cycle
from errpipe.tables import ect, pack
from errpipe.tables.reference import Evaluator
from tests.faults.sequences import Part, table
from tests.unit.tables.made import modes

UM_PER_MM = 1e3


def by_reference(parts: list[Part]) -> np.ndarray:
    """The plain-Python evaluator."""
    evaluator, out = Evaluator(table(parts[0].number)), []
    names = [i.name for i in evaluator.table.inputs]
    for part in parts:
        if part.begins == "reset":
            evaluator.reset()
        elif part.begins == "table" and part is not parts[0]:
            other = Evaluator(table(part.number))
            other.continue_from(evaluator)
            evaluator = other
        for row, news, mode in zip(part.readings, part.fresh, part.mode, strict=True):
            given = {n: v for n, v, new in zip(names, row.tolist(), news, strict=True) if new}
            out.append(list(evaluator.cycle(given, **modes(mode)).correction.values()))
    return UM_PER_MM * np.array(out)


def by_numba(parts: list[Part]) -> np.ndarray:
    """The kernels of the batch evaluators."""
    program, state, out = None, None, []
    for part in parts:
        if part.begins == "table":
            program, before = pack.program(table(part.number)), state
            state = pack.state(program)
            if before is not None:
                state.outputs["limited"] = state.outputs["target"] = before.outputs["limited"]
                state.common["ramp"] = before.common["ramp"]
        elif part.begins == "reset":
            table_cycle.reset(program, state)
        shape = (len(part.mode), len(state.outputs))
        deviation, correction, status = np.empty(shape), np.empty(shape), np.empty(shape[0], dtype=np.int64)
        table_cycle.stream(program, state, part.readings, part.fresh, part.mode, deviation, correction, status)
        out.append(correction)
    return UM_PER_MM * np.vstack(out)


class Shared:
    """A shared library with a session of a table: the C runtime, or Structured Text translated to C."""

    def __init__(self, path, real=np.float64):
        self.dll, self.real = ctypes.CDLL(str(path)), real
        self.dll.session_open.restype = ctypes.c_void_p

    def __call__(self, parts: list[Part]) -> np.ndarray:
        """Corrections of a sequence."""
        session, out = None, []
        for part in parts:
            if session is None:
                session = self.open(_bytes(part.number))
            elif part.begins == "table":
                assert self.reload(session, _bytes(part.number)) == 1
            elif part.begins == "reset":
                self.dll.session_reset(session)
            out.append(self.part(session, part, len(table(part.number).outputs)))
        self.dll.session_close(session)
        return np.vstack(out)

    def open(self, data: bytes) -> ctypes.c_void_p:
        """A session of a table."""
        session = ctypes.c_void_p(self.dll.session_open(data, ctypes.c_size_t(len(data))))
        assert session.value, "the table was refused"
        return session

    def reload(self, session: ctypes.c_void_p, data: bytes) -> int:
        """1 where another table took over."""
        return self.dll.session_reload(session, data, ctypes.c_size_t(len(data)))

    def part(self, session: ctypes.c_void_p, part: Part, outputs: int) -> np.ndarray:
        """Corrections, um, of the cycles of one part."""
        correction = np.empty((len(part.mode), outputs), dtype=self.real)
        with np.errstate(over="ignore"):
            readings = np.ascontiguousarray(part.readings, dtype=self.real)
        arrays = (readings, part.fresh, part.mode, correction, np.empty(len(part.mode), np.uint32))
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        self.dll.session_run(session, ctypes.c_size_t(len(part.mode)), *pointers)
        return UM_PER_MM * correction.astype(float)


@cache
def _bytes(number: int) -> bytes:
    return ect.dumps(table(number))
