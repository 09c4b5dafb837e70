"""Sequences of faults through the exported component in LinuxCNC's realtime thread, without a machine beside it.

A small component gives the pins one row of a file per cycle and takes the corrections down into another, so that none
is lost or printed. The thread runs 128 times faster than a servo thread and the table's times are 128 times shorter:
a power of two, so that the bits of the corrections are those of the table of 1 ms.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from errpipe.domain import table as t
from errpipe.kernels.table_codes import HOLD, OFF, ON
from errpipe.targets.linuxcnc_hal import COMPONENT, LinuxcncHal
from tests.e2e.linuxcnc import session
from tests.faults import runners, sequences
from tests.faults.sequences import Part

TABLES = 3
FASTER = 128
AWAY = 300  # cycles in which a correction ramps to 0 between two sequences
AT_ONCE = 500  # sequences in a session of LinuxCNC
LONGEST_S = 300.0
UNCONNECTED = 1e31  # what a pin reads that nobody drives
FRESH_NUT, FRESH_COLUMN, ENABLE, HOMED, NOT_WANTED, RESET = (1 << k for k in range(6))
ROW = np.dtype([("readings", "<f8", 4), ("bits", "<u8")])

REPLAY = r"""component replay;
pin out float x; pin out float nut; pin out float column; pin out float velocity;
pin out bit fresh_nut; pin out bit fresh_column;
pin out bit enable; pin out bit homed; pin out bit off; pin out bit reset;
pin in float correction_x; pin in float correction_z; pin out u32 left = 1;
option singleton yes; option extra_setup yes;
function give fp; function take fp;
license "Apache-2.0"; author "errpipe";
;;
#include <fcntl.h>
#include <sys/mman.h>
static const struct { double v[4]; uint64_t bits; } *given;
static double *taken;
static unsigned at;
EXTRA_SETUP() {
    int in = open("@FOLDER@/given", O_RDONLY), out = open("@FOLDER@/taken", O_RDWR);
    (void)__comp_inst; (void)prefix; (void)extra_arg;
    given = mmap(0, @COUNT@ * sizeof *given, PROT_READ, MAP_SHARED, in, 0);
    taken = mmap(0, @COUNT@ * 2 * sizeof *taken, PROT_READ | PROT_WRITE, MAP_SHARED, out, 0);
    return in < 0 || out < 0 || given == MAP_FAILED || taken == MAP_FAILED ? -EINVAL : 0;
}
FUNCTION(give) {
    (void)period;
    if (at >= @COUNT@) return;
    const uint64_t b = given[at].bits;
    x = given[at].v[0]; nut = given[at].v[1]; column = given[at].v[2]; velocity = given[at].v[3];
    fresh_nut = b & 1; fresh_column = b >> 1 & 1; enable = b >> 2 & 1; homed = b >> 3 & 1; off = b >> 4 & 1;
    reset = b >> 5 & 1;
}
FUNCTION(take) {
    (void)period;
    if (at < @COUNT@) { taken[2 * at] = correction_x; taken[2 * at + 1] = correction_z; at++; }
    left = @COUNT@ - at;
}
"""
NETS = f"""loadrt threads name1=servo-thread period1={1_000_000 // FASTER}
loadrt replay
loadrt errpipe
addf replay.give servo-thread
addf errpipe servo-thread
addf replay.take servo-thread
net x replay.x => errpipe.in-x
net nut replay.nut => errpipe.in-t-nut
net column replay.column => errpipe.in-t-column
net v replay.velocity => errpipe.in-v
net fresh-nut replay.fresh-nut => errpipe.fresh-t-nut
net fresh-column replay.fresh-column => errpipe.fresh-t-column
net on replay.enable => errpipe.enable
net homed replay.homed => errpipe.homed
net off replay.off => errpipe.off
net anew replay.reset => errpipe.reset
net cx errpipe.correction-x => replay.correction-x
net cz errpipe.correction-z => replay.correction-z
"""


def faster(table: t.CompensationTable) -> t.CompensationTable:
    """The same table for a thread that is FASTER times as fast: the same corrections in every bit."""
    inputs = [
        i.model_copy(
            update={
                "max_rate": i.max_rate and i.max_rate * FASTER,
                "stale_after_s": i.stale_after_s and i.stale_after_s / FASTER,
                "hold_s": i.hold_s and i.hold_s / FASTER,
            }
        )
        for i in table.inputs
    ]
    nodes = [
        n.model_copy(update={"tau_up": n.tau_up / FASTER, "tau_down": n.tau_down / FASTER})
        if isinstance(n, t.LagNode)
        else n
        for n in table.nodes
    ]
    outputs = [
        o.model_copy(
            update={"slew": o.slew and o.slew * FASTER, "acceleration": o.acceleration and o.acceleration * FASTER**2}
        )
        for o in table.outputs
    ]
    times = {n: getattr(table, n) / FASTER for n in ("position_cycle_s", "ramp_s", "fade_s")}
    return table.model_copy(update={"inputs": tuple(inputs), "nodes": tuple(nodes), "outputs": tuple(outputs), **times})


def of_one_table(seed: int) -> list[Part]:
    """The sequence of a seed as HAL can have it: one table throughout, what is not new does not change, resets rise."""
    parts: list[Part] = []
    last, before = np.array([500.0, 27.0, 24.0, 0.0]), False
    for part in sequences.sequence(seed):
        readings = np.where(np.abs(part.readings) < 1e6, part.readings, UNCONNECTED)  # NaN fails this too
        for k in range(len(readings)):
            last = readings[k] = np.where(part.fresh[k] == 1, readings[k], last)
        begins = "reset" if part.begins == "reset" and not before else "" if parts else "table"
        before = begins == "reset" and len(readings) == 1
        fresh = part.fresh.copy()
        fresh[:, [0, sequences.VELOCITY]] = 1
        parts.append(replace(part, begins=begins, number=seed % TABLES, readings=readings, fresh=fresh))
    return parts


def rows(parts: list[Part], seed: int) -> np.ndarray:
    """A sequence as rows, the cycles that take the corrections to 0 before it; its first cycle is a reset."""
    mode = np.concatenate([p.mode for p in parts])
    out = np.zeros(AWAY + len(mode), ROW)
    out["readings"][:AWAY], out["bits"][:AWAY] = parts[0].readings[0], FRESH_NUT | FRESH_COLUMN | HOMED | NOT_WANTED
    body = out[AWAY:]
    body["readings"] = np.vstack([p.readings for p in parts])
    fresh = np.vstack([p.fresh for p in parts]).astype(np.uint64)
    by_homing = HOMED if seed % 2 else 0  # off by one pin or by the other
    bits = np.select([mode == ON, mode == HOLD, mode == OFF], [ENABLE | HOMED, HOMED, by_homing and HOMED | NOT_WANTED])
    body["bits"] = fresh[:, 1] * FRESH_NUT + fresh[:, 2] * FRESH_COLUMN + bits.astype(np.uint64)
    begins = np.cumsum([0, *(len(p.mode) for p in parts[:-1])])
    for part, at in zip(parts, begins, strict=True):
        body["bits"][at] |= np.uint64(RESET if part.begins else 0)
    return out


def corrections(seeds: list[int]) -> Iterator[tuple[list[Part], np.ndarray]]:
    """Each sequence of some seeds with one table, and its corrections in um per cycle, shape (cycles, 2)."""
    (number,) = {s % TABLES for s in seeds}
    many = [of_one_table(s) for s in seeds]
    given = np.concatenate([rows(parts, s) for parts, s in zip(many, seeds, strict=True)])
    with session.alone() as folder:
        given.tofile(folder / "given")
        taken = 1e3 * _run(folder, faster(sequences.table(number)), len(given))
    at = 0
    for parts in many:
        cycles = sum(len(p.mode) for p in parts)
        assert at == 0 or not taken[at + AWAY - 1].any(), "corrections had not gone out before a sequence"
        yield parts, taken[at + AWAY : at + AWAY + cycles]
        at += AWAY + cycles


def _run(folder: Path, table: t.CompensationTable, count: int) -> np.ndarray:
    """Corrections in mm of all rows."""
    np.full((count, 2), np.nan).tofile(folder / "taken")
    (folder / "nets.hal").write_text(NETS)
    (folder / COMPONENT).write_text(LinuxcncHal.write(table)[COMPONENT])
    (folder / "replay.comp").write_text(REPLAY.replace("@FOLDER@", str(folder)).replace("@COUNT@", f"{count}u"))
    modules = [session.install(folder / name) for name in (COMPONENT, "replay.comp")]
    env = session.environment(folder)
    session.end(env, folder)
    try:
        assert session.quiet(["halcmd", "-f", "nets.hal"], env, folder, 30) == 0, session.said(folder)
        assert session.quiet(["halcmd", "start"], env, folder, 10) == 0
        until, seen = time.monotonic() + LONGEST_S, ""
        while seen != "0":
            assert time.monotonic() < until, f"LinuxCNC is not through: {seen} cycles are left"
            time.sleep(0.5)
            (folder / "talk.txt").write_text("")
            session.quiet(["halcmd", "getp", "replay.left"], env, folder, 10)
            seen = str(int([*session.values(folder), "1"][0], 0))
        (folder / "talk.txt").write_text("")
        session.quiet(["halcmd", "getp", "errpipe.wrong-rate"], env, folder, 10)
        assert session.values(folder) == ["FALSE"]
    finally:
        session.end(env, folder)
        for module in modules:
            module.unlink()
    return np.fromfile(folder / "taken").reshape(count, 2)


def batches(count: int) -> Iterator[list[int]]:
    """Seeds 0 to count - 1 in batches of one table."""
    for number in range(TABLES):
        seeds = list(range(number, count, TABLES))
        for at in range(0, len(seeds), AT_ONCE):
            yield seeds[at : at + AT_ONCE]


def differ(parts: list[Part], found: np.ndarray) -> bool:
    """Whether corrections of LinuxCNC differ from the kernels' in any bit."""
    return not np.array_equal(found, runners.by_numba(parts))
