"""Sensors and controllers that fail in use: what the exported table does on a day that was not recorded.

python -m trials.faults_in_use [--seed 1] [--machines gantry,grinder] [--json FILE] [--markdown FILE]

Ten days of each machine of `shop_floor` are fitted and exported by the public commands; the table then runs an
eleventh day cycle by cycle, as a controller does, with a fault from the third hour on. Faults of one sensor are
applied to each in turn, and the worst counts. The kernels run the table: the C runtime and the function blocks give
their bits (`tests/faults`). Ends with 1 where a fault leaves more than no compensation, unless that is `EXPECTED`.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from errpipe.cli.app import main as errpipe
from errpipe.domain.table import STATUS_BIT, CompensationTable
from errpipe.kernels import table_codes, table_cycle
from errpipe.tables import ect, pack
from trials import folder, shop_floor
from trials.command import write_reports
from trials.folder import Array

CYCLE, THERMAL = 0.1, 1.0  # s, of the exported table; sensors are polled once per thermal cycle
ONSET = int(2.5 * 3600)  # s after the start of the day
HOUR = 3600
OUTAGE = 600  # s without power
TOLERANCE = 1.05  # times no compensation: a correction of nothing with the noise of its sensors
ZERO_KEPT = "restart, states lost, zero as before"
# No table can know what a machine had grown before it was switched on: it stays as an offset, also once the machine has
# cooled. Checklists ask for a new zero (`_checklist.FROM_THE_START`; docs/safety.md).
EXPECTED = (ZERO_KEPT,)
SAYS = ("substituted", "held", "defaulted", "fading", "faded", "waiting")
PIPELINE = f"""\
pipeline: 1
title: faults in use
stages:
  - {{kind: ingest, recording: recording}}
  - {{kind: fit, family: lagged, component: E_Z}}
  - {{kind: validate}}
  - {{kind: export, position_cycle: {CYCLE}, thermal_cycle: {THERMAL}}}
"""

Change = Callable[[Array, Array], None]  # readings from the onset on (seconds,), changed in place, and their times, s


def _set(value: float) -> Change:
    return lambda x, t: x.fill(value)


def _shift(of: Callable[[Array], Array]) -> Change:
    return lambda x, t: np.copyto(x, x + of(t))


def _scale(factor: float, offset: float) -> Change:
    return lambda x, t: np.copyto(x, factor * x + offset)


def _until(end: int, change: Change) -> Change:
    return lambda x, t: change(x[:end], t[:end])


def _spikes(size: float, every: int) -> Change:
    return lambda x, t: np.copyto(x[::every], x[::every] + size)


OF_ONE: dict[str, Change] = {
    "plug pulled": _set(np.nan),
    "plug pulled for an hour": _until(HOUR, _set(np.nan)),
    "3.6 mA of 4 to 20 mA, 0 to 100 degC": _set(-2.5),
    "0 degC": _set(0.0),
    "0 degC for an hour": _until(HOUR, _set(0.0)),
    "read in degF": _scale(1.8, 32.0),
    "read in K": _scale(1.0, 273.15),
    "frozen": lambda x, t: x.fill(x[0]),
    "one spike of 100 K": _until(1, _scale(1.0, 100.0)),
    "a spike of 100 K every 10 min": _spikes(100.0, 600),
    "a spike of 5 K every 10 min": _spikes(5.0, 600),
    "drift of 1 K/h": _shift(lambda t: t / 3600.0),
    "jump of 5 K": _scale(1.0, 5.0),
}


@dataclass(frozen=True)
class Course:
    """What a controller is given: readings (seconds, inputs), the second of each thermal cycle, restarts, new zero."""

    readings: Array
    seconds: Array
    restarts: tuple[int, ...] = ()  # thermal cycles before which the states are lost
    zero_at: int | None = None  # second at which the workpiece zero is set anew


@dataclass
class Outcome:
    """Of the rows from the onset on: rms that is left and rms without compensation, um; the largest change in a second,
    um; the largest step of a cycle, of the slew; whether the status says so."""

    left: float
    none: float
    jump: float
    step: float
    said: bool


@dataclass
class Use:
    """A table in use on one day. clean: readings (seconds, inputs); truth: deviation, um (seconds,)."""

    table: CompensationTable
    clean: Array
    truth: Array
    _program: table_cycle.Program = field(init=False)

    def __post_init__(self) -> None:
        self._program = pack.program(self.table)

    def corrections(self, course: Course) -> tuple[Array, Array]:
        """Correction, um, and status of every cycle."""
        program, state = self._program, pack.state(self._program)
        each = self.table.slow_every
        parts, status = [], []
        for at, rows in enumerate(np.split(course.seconds, course.restarts)):
            if at:
                table_cycle.reset(program, state)
            given = np.repeat(course.readings[rows], each, axis=0)
            fresh, mode = np.ones(given.shape, np.uint8), np.full(len(given), table_codes.ON, np.uint8)
            deviation, correction = np.empty((2, len(given), len(self.table.outputs)))
            bits = np.empty(len(given), np.int64)
            table_cycle.stream(program, state, given, fresh, mode, deviation, correction, bits)
            parts.append(correction[:, 0] * 1e3)
            status.append(bits)
        return np.concatenate(parts), np.concatenate(status)

    def outcome(self, course: Course) -> Outcome:
        correction, status = self.corrections(course)
        each, slew = self.table.slow_every, self.table.outputs[0].slew or np.inf
        after = course.seconds >= ONSET
        truth = self.truth - (self.truth[course.zero_at] if course.zero_at is not None else 0.0)
        truth = truth[course.seconds]
        residual = (truth + correction[each - 1 :: each])[after]
        cycles = np.repeat(after, each)
        wanted = sum(STATUS_BIT[name] for name in SAYS)
        change = np.abs(np.diff(correction[each - 1 :: each]))[after[1:]]
        step = float(np.abs(np.diff(correction))[cycles[1:]].max()) / (slew * CYCLE)
        said = bool(np.any(status[cycles] & wanted))
        return Outcome(rms(residual), rms(truth[after]), float(change.max()), step, said)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def prepare(kind: str, seed: int, where: Path) -> Use:
    """The exported table of a machine, and its unseen day."""
    m = shop_floor.machine(kind, seed)
    folder.write(where / "recording", shop_floor.recording(m, seed))
    (where / "pipeline.yaml").write_text(PIPELINE)
    with contextlib.redirect_stdout(sys.stderr):
        code = errpipe(["run", str(where / "pipeline.yaml"), "--out", str(where / "out")])
    if code:
        raise RuntimeError(f"{kind}: errpipe ended with {code}")
    table = ect.loads(next((where / "out").rglob("table.ect")).read_bytes())
    day, rng = shop_floor.unseen(m, seed)
    seconds = np.arange(0.0, day.t[-1])
    read = dict(zip(m.sensors, shop_floor.shown(day, seconds, rng).T, strict=True))
    return Use(table, np.column_stack([read[i.name] for i in table.inputs]), np.interp(seconds, day.t, day.deviation))


def courses(use: Use) -> Iterator[tuple[str, list[Course]]]:
    """Every fault, with its courses: one for each sensor, or pair of sensors, or a single one."""
    clean, count = use.clean, use.clean.shape[1]
    every = np.arange(len(clean))
    late = np.arange(float(len(clean) - ONSET))

    def changed(which: tuple[int, ...], *changes: Change) -> Course:
        readings = clean.copy()
        for k, change in zip(which, changes, strict=True):
            change(readings[ONSET:, k], late)
        return Course(readings, every)

    def swapped(i: int, k: int) -> Course:
        readings = clean.copy()
        readings[ONSET:, [i, k]] = clean[ONSET:, [k, i]]
        return Course(readings, every)

    for name, change in OF_ONE.items():
        yield name, [changed((k,), change) for k in range(count)]
    pairs = [(k, (k + 1) % count) for k in range(count)]
    lost, frozen = OF_ONE["plug pulled"], OF_ONE["frozen"]
    yield "two plugs swapped", [swapped(*pair) for pair in pairs]
    yield "two plugs pulled", [changed(pair, lost, lost) for pair in pairs]
    yield "one pulled, one frozen", [changed(pair, lost, frozen) for pair in pairs]
    yield "all sensors lost", [changed(tuple(range(count)), *[lost] * count)]
    yield "all sensors frozen", [changed(tuple(range(count)), *[frozen] * count)]
    out = np.r_[every[:ONSET], every[ONSET + OUTAGE :]]
    yield "10 min without calls, states kept", [Course(clean, out)]
    yield "an hour without calls, states kept", [Course(clean, np.r_[every[:ONSET], every[ONSET + HOUR :]])]
    yield ZERO_KEPT, [Course(clean, out, (ONSET,))]
    yield "restart, states lost, zero set again", [Course(clean, out, (ONSET,), ONSET + OUTAGE)]
    yield "every tenth call missing", [Course(clean, every[every % 10 != 9])]
    for word, period in (("longer", 1.2), ("shorter", 0.8)):
        yield f"cycle {word} by 20 %", [Course(clean, np.arange(0, len(clean), period).astype(int))]


def worst_of(use: Use) -> dict[str, tuple[Outcome, list[bool]]]:
    """Fault -> its worst outcome, jump and step of any, and of each course whether the status says so."""
    found = {}
    for name, each in [("no fault", [Course(use.clean, np.arange(len(use.clean)))]), *courses(use)]:
        outcomes = [use.outcome(course) for course in each]
        worst = max(outcomes, key=lambda o: o.left)
        worst.jump, worst.step = max(o.jump for o in outcomes), max(o.step for o in outcomes)
        found[name] = (worst, [o.said for o in outcomes])
    return found


def report(found: dict[str, dict[str, tuple[Outcome, list[bool]]]]) -> tuple[str, int]:
    """The table, and how many faults leave a machine worse than no compensation without being `EXPECTED`."""
    lines = ["| fault | " + " | ".join(f"{kind}: left of, um; in 1 s, um; said" for kind in found) + " |"]
    lines.append("| --- |" + " --- |" * len(found))
    worse = 0
    for name in next(iter(found.values())):
        cells = []
        for by_fault in found.values():
            o, said = by_fault[name]
            more, steps = o.left > TOLERANCE * o.none, o.step > 1.0 + 1e-6
            harmful = more or steps
            worse += steps or (more and name not in EXPECTED)
            mark = "**" if harmful else ""
            cells.append(f"{mark}{o.left:.2f}{mark} of {o.none:.1f}; {o.jump:.2f}; {sum(said)}/{len(said)}")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n", worse


def main() -> int:
    """Print the table; 1 where a fault that is not expected leaves more than none, or a step above the slew limit."""
    parser = argparse.ArgumentParser(description="Sensors and controllers that fail in use.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machines", default=",".join(shop_floor.KINDS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)
    a = parser.parse_args()
    found = {}
    for kind in a.machines.split(","):
        with tempfile.TemporaryDirectory() as name:
            found[kind] = worst_of(prepare(kind, a.seed, Path(name)))
    text, worse = report(found)
    print(text, end="")
    numbers = {kind: {f: o.__dict__ | {"each_said": s} for f, (o, s) in of.items()} for kind, of in found.items()}
    write_reports(a, text, {"found": numbers, "worse": worse})
    return int(worse > 0)


if __name__ == "__main__":
    sys.exit(main())
