"""PMAC / Turbo PMAC leadscrew and backlash tables: `DEFINE COMP` and `DEFINE BLCOMP` for each motor.

Value     whole sixteenths of a count. COMP: added to the motor in both directions; nothing at the motor's zero, by
          definition. BLCOMP and Ixx86: subtracted while the motor moves in minus (reference manual, DEFINE BLCOMP),
          so what the correction upwards exceeds that downwards. That a positive COMP entry moves the motor in plus is
          read off "adds its correction to this motor" (user manual, Leadscrew Compensation): prove it on the machine.
Order     entry 1 belongs to one spacing from the motor's zero, the last one to zero itself; a position below zero is
          rolled over by the length of the table, so positions below zero are the upper entries. Beyond its ends the
          table begins again: entries over a tenth of the travel at either end hold the value there, further the axis
          must not go.
Turns     the table of an axis that turns on is one turn long and rolls over (user manual p. 80).
Limits    10000 counts per mm (deg) are taken: for another resolution multiply lengths and entries. Tables are defined
          from the highest motor to the lowest. I51 = 1 enables them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain.components import is_rotary
from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, TURN, ByHand, Curve, ReadBack, expect, matched, too_many, unit_of
from errpipe.targets._screw_map import ScrewMap

COUNTS = 10_000  # per mm (deg)
PART = 16  # of a count: unit of the entries
FILE = "comp.pmc"
HELD = 0.1  # of the travel, held beyond its ends: a test seldom reaches the limit switches (by judgement)
PER_LINE = 8  # entries


class PmacComp(ScrewMap):
    """Leadscrew and backlash table of each motor."""

    name = "pmac_comp"
    controller = "Delta Tau PMAC, Turbo PMAC"
    confidence = "experimental"
    sign = "a positive COMP entry moves the motor in plus (prove it on the machine); BLCOMP acts while moving down"
    limits = "10000 counts per mm; equidistant from the motor's zero; the axis' own position; no temperature"
    unit = "sixteenths of a count at 10000 counts per mm (deg)"
    holds = ("screw", "both directions")
    keeps_level = False
    remark = {"": "; {}"}
    numbering = "#{1}"
    source = "PMAC 2 Software Reference p. 207, 208 (DEFINE BLCOMP, COMP), Turbo PMAC p. 301, 303; user manual p. 79"
    activation = (
        "the motor must have 10000 counts per mm (deg); else multiply all lengths and entries by its counts / 10000",
        "DELETE the old tables from the lowest motor to the highest; send the file; home; I51 = 1",
        "move 1 mm at a time past one entry: the compensation of motor xx (Mxx69) must read the entry / 16 counts",
    )

    max_points, error_um = 1000, 0.1

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        blocks = []
        for number, axis in cls.own_axes(table):
            points, error = _sample.uniform(table, axis, axis, cls.max_points, cls.error_um)
            low, high = _sample.span(table, axis)
            step = int(np.ceil(points.step * COUNTS - 1e-6))
            turns = _sample.turns(table, axis)
            way = step / COUNTS
            held = max(way, HELD * (high - low))  # further entries at either end have its value
            at = np.arange(points.count - 1) if turns else _sample.around_zero(low - held, high + held, way)
            if at.size > 2 * cls.max_points:
                raise too_many(cls.name, at.size, 2 * cls.max_points, error)
            blocks.append(_block(number, axis, step, at, _sample.at_nodes(table, axis, axis, at * step / COUNTS)))
        return {FILE: "\n".join([f"; {CAUTION}", "CLOSE", *blocks[::-1], "I51=1", ""])}

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        out = []
        for number, axis in cls.own_axes(table):
            text = f"leave I{number}86, the motor's backlash, as the file sets it: its tables count from there"
            out.append(ByHand(f"{axis}: {text}"))
            if not _sample.turns(table, axis):
                low, high = next((c.positions[0], c.positions[-1]) for c in read.curves if c.axis == axis)
                text = f"software limits (I{number}13, I{number}14) within {low:g} to {high:g} {unit_of(axis)}"
                out.append(ByHand(f"{axis}: {text}: beyond, the table repeats from its other end"))
        return tuple(out)

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.rstrip().endswith("I51=1"), FILE, "is cut off: it does not end with I51=1")
        axes = re.findall(r"^; #(\d+) = (\w+), (-?\d+) to (-?\d+) spacings$", text, re.M)
        return ReadBack(curves=tuple(_read(text, *facts) for facts in axes))


def _block(number: int, axis: str, step: int, at: np.ndarray, curve: Curve) -> str:
    zero = int(np.flatnonzero(at == 0)[0])
    part = COUNTS * PART
    comp = np.round((curve.up - curve.up[zero]) * part).astype(int)
    gap = (curve.up - curve.down) * part
    constant = int(np.round(gap[zero]))
    backlash = np.round(gap).astype(int) - constant
    order = np.r_[zero + 1 : at.size, 0 : zero + 1]  # from one spacing above zero, rolled over, zero last
    lines = [f"; #{number} = {axis}, {at[0]} to {at[-1]} spacings", f"I{number}86={constant}", f"#{number}"]
    for word, values in (("BLCOMP", backlash), ("COMP", comp)):
        entries = values[order].tolist()
        lines.append(f"DEFINE {word} {at.size},{at.size * step}")
        lines += [" ".join(map(str, entries[k : k + PER_LINE])) for k in range(0, len(entries), PER_LINE)]
    return "\n".join(lines)


def _read(text: str, number: str, axis: str, low: str, high: str) -> Curve:
    """As the controller does: an entry for each spacing, positions below zero rolled over."""
    part = text.split(f"\n#{number}\n")[1].split("\n;")[0]
    constant = matched(rf"^I{number}86=(-?\d+)$", text, FILE, f"#{number} lacks a table")
    at, tables = np.arange(int(low), int(high) + 1), {}
    step, turns = 0, is_rotary(axis) and re.search(rf"DEFINE COMP \d+,{int(TURN * COUNTS)}$", part, re.M)
    if turns:
        at = np.arange(-at.size, at.size + 1)
    for word, count, length, rows in re.findall(r"DEFINE (\w+) (\d+),(\d+)\n((?:[-\d ]+\n?)+)", part):
        values = [int(v) for v in rows.split()]
        expect(
            len(values) == int(count) and int(length) % int(count) == 0, FILE, f"#{number}: {len(values)} of {count}"
        )
        step = int(length) // int(count)
        tables[word] = np.array(values)[(at - 1) % int(count)]
    expect(set(tables) == {"COMP", "BLCOMP"}, FILE, f"#{number} lacks a table")
    up = tables["COMP"] / (COUNTS * PART)
    return Curve(axis, axis, at * step / COUNTS, up, up - (tables["BLCOMP"] + int(constant[1])) / (COUNTS * PART))
