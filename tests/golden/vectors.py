"""Golden vectors of the compensation table: made by the reference evaluator, read by anyone.

`python -m tests.golden.vectors` writes `schemas/ect-2.golden.txt` anew; a test says when it should be. Changing it
means that the meaning of a table has changed: that needs a new format version. `ect-1.golden.txt`, of version 1, is
read only: tables of that version are still run by its rules. Ties (a travel of exactly the
threshold) are exact in single precision too; elsewhere comparisons stay away from them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from errpipe import jsonfile
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.tables import ComponentSource, Limits, MonomialSource, OutputSource, compile_table, ect, with_limits
from errpipe.tables.reference import Evaluator
from tests.golden import edges, edges_of_outputs
from tests.unit.tables.made import everything, modes, stimulus

SCHEMAS = Path(__file__).parents[2] / "schemas"
FILE = SCHEMAS / "ect-2.golden.txt"
FILE_1 = SCHEMAS / "ect-1.golden.txt"
HEAD = """# Golden vectors of the compensation table, binary form, version 2 (ect-2.md).
#
# Each block: `table NAME`, the bytes of the file in hexadecimal, then one line per cycle from a fresh start:
#     MODE  one field per input  >  one deviation per output, one correction per output, status (hexadecimal)
# MODE is 0 off, 1 on, 2 hold. A field is - where there is no new reading, nan or inf where it failed, else a number as
# C's %a writes it (binary64, exact). An evaluator in binary64 must give every bit; one in binary32 keeps
# the deviations within 0.005 um or 2e-6 of the largest of the table, whichever is more (mixed-1: 3e-5, mixed-81: 5e-6);
# a limited correction on its way may be one cycle early or late.
#
# straight to volumetric, turning: machines one can check by hand. readings, fading, operations, sums, motion,
# doubts, slowly, bounded, undone: each rule of sections 5 to 8 exactly at its bound and beside it, on a cycle of
# 2^-10 s. mixed-N: random tables that use everything.
"""
NAMES = (
    "straight",
    "curves",
    "thermal",
    "reversal",
    "limits",
    "volumetric",
    "mixed-6",
    "mixed-13",
    "readings",
    "fading",
    "operations",
    "sums",
    "motion",
    "doubts",
    "slowly",
    "bounded",
    "undone",
    "mixed-1",
    "mixed-28",
    "mixed-81",
    "mixed-174",
    "mixed-181",
    "turning",
)
MIXED = {6: 60, 13: 60, 1: 200, 28: 200, 81: 200, 174: 200, 181: 200}  # seed: cycles
# What binary32 may lose of a deviation: um or urad, or a share of the table's largest, which is more where powers of
# large numbers are multiplied.
SINGLE = 0.005
SINGLE_SHARE = dict.fromkeys(NAMES, 2e-6) | {"mixed-1": 3e-5, "mixed-81": 5e-6}


def golden() -> list[tuple[str, bytes, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """All blocks of both files, those of version 1 behind the others and named `v1/NAME`."""
    new, old = (read(file.read_text(encoding="utf-8")) for file in (FILE, FILE_1))
    return [*new, *((f"v1/{block[0]}", *block[1:]) for block in old)]


def names() -> list[str]:
    """Names of all blocks of both files, in their order."""
    return [block[0] for block in golden()]


@dataclass(frozen=True)
class Block:
    """One table and its cycles: readings (cycles, inputs), fresh and mode as in the kernels."""

    name: str
    table: t.CompensationTable
    readings: np.ndarray
    fresh: np.ndarray
    enable: np.ndarray


def axis(letter: str, low=-100.0, high=1100.0) -> t.TableInput:
    return t.TableInput(name=letter.lower(), kind="position", axis=letter, unit="mm", low=low, high=high, default=0.0)


def warm(name: str, **more) -> t.TableInput:
    return t.TableInput(name=name, kind="sensor", unit="degC", low=-20.0, high=120.0, default=20.0, **more)


def block(name: str, table: t.CompensationTable, rows: list[dict], enable=None) -> Block:
    """Cycles from dictionaries: an input that is not named has no new reading."""
    names = [i.name for i in table.inputs]
    fresh = np.array([[n in row for n in names] for row in rows], dtype=np.uint8)
    readings = np.array([[row.get(n, 0.0) for n in names] for row in rows], dtype=float)
    on = np.ones(len(rows), dtype=np.uint8) if enable is None else np.array(enable, dtype=np.uint8)
    return Block(name, table, readings, fresh, on)


def straight() -> Block:
    """A machine 10 um too long at +X (x = 1000): both ends, beyond them, not a number, out of range."""
    source = ComponentSource("EXX", "um", (Lowered(d.ONE, "X", lambda x: 0.01 * x),))
    table = compile_table([source], inputs=[axis("X")], travel={"X": (0.0, 1000.0)}, ramp_s=0.0, title="10 um too long")
    ends = [0.0, 1000.0, -0.0, 500.0, -1.0, 1001.0, -100.0, 1100.0, 1100.1, -100.1, math.nan, math.inf, -math.inf]
    ulps = [math.nextafter(v, s) for v in (0.0, 1000.0) for s in (-math.inf, math.inf)]
    return block("straight", table, [{"x": v} for v in (*ends, *ulps, 250.0)] + [{}])


def curves() -> Block:
    """A curve and a periodic part over one axis: every knot and one ulp to both sides of it."""
    pairs = (
        Lowered(d.ONE, "X", lambda x: 6.0 * np.sin(x / 80.0)),
        Lowered(d.ONE, "X", lambda x: 1.5 * np.cos(2 * np.pi * x / 10.0), 10.0),
    )
    source, travel = ComponentSource("EXX", "um", pairs), {"X": (0.0, 300.0)}
    table = compile_table([source], inputs=[axis("X")], travel=travel, error_bound=0.2, ramp_s=0.0)
    rows = []
    for p in table.profiles:
        for k in range(len(p.values)):
            x = p.start + p.step * k
            rows += [{"x": v} for v in (math.nextafter(x, -math.inf), x, math.nextafter(x, math.inf))]
    return block("curves", table, rows + [{"x": v} for v in (-37.3, -10.0, 1095.0, 123.456)])


def thermal() -> Block:
    """Lags fast and slow, a latched reference, lost, stale, implausible and substituted sensors, fade."""
    spare = (t.Substitute(input="T_bed", weight=0.5), t.Substitute(input="T_air", weight=0.5))
    inputs = [
        axis("X"),
        warm(
            "T_nut",
            max_rate=100.0,
            stale_after_s=0.035,
            hold_s=0.055,
            substitute=spare,
            substitute_offset=1.5,
            valid=(15.0, 40.0),
            margin=5.0,
        ),
        warm("T_bed", hold_s=0.025),
        warm("T_air", fade_on_default=False),
    ]
    slow = d.Lag(of=d.rise("T_nut"), tau_up=0.5, tau_down=0.9)
    fast = d.Lag(of=d.above("T_bed", 20.0), tau_up=0.04, tau_down=0.02, start="zero")
    pairs = (
        Lowered(d.ONE, "X", lambda x: 0.004 * x),
        Lowered(slow, "X", lambda x: 0.011 * x),
        Lowered(fast),
        Lowered(d.Affine(weights=(0.3,), of=(d.Input(name="T_air"),))),
    )
    table = compile_table(
        [ComponentSource("EXX", "um", pairs)],
        inputs=inputs,
        travel={"X": (0.0, 1000.0)},
        position_cycle_s=0.01,
        thermal_cycle_s=0.02,
        ramp_s=0.0,
        fade_s=0.1,
    )
    rows: list[dict] = []
    for k in range(60):
        row = {"x": 40.0 * (k % 25), "T_nut": 21.0 + 0.4 * k, "T_bed": 20.0 + 0.2 * k, "T_air": 19.0}
        if k < 3:
            row["T_nut"] = math.nan
        if 12 <= k < 20:
            row["T_nut"] = math.nan
        if 14 <= k < 20:
            row["T_bed"] = 400.0
        if 24 <= k < 30:
            del row["T_nut"]
        if 34 <= k < 37:
            row["T_nut"] = 90.0
        if 44 <= k < 52:
            row["T_nut"] = row["T_bed"] = math.nan
        rows.append(row)
    return block("thermal", table, rows)


def reversal() -> Block:
    """Direction of travel with its threshold, a direction that is known, and pre-sliding."""
    known = t.TableInput(name="dir", kind="direction", axis="X", low=-1.0, high=1.0, default=0.0, optional=True)
    pairs = (
        Lowered(d.Direction(axis="X", threshold=0.0625), None, lambda x: np.full(np.shape(x), -4.0)),
        Lowered(d.Direction(axis="X", threshold=0.0625), "X", lambda x: -0.006 * x),
        Lowered(d.Approach(axis="X", length=0.2, threshold=0.0625), None, lambda x: np.full(np.shape(x), -1.5)),
    )
    table = compile_table(
        [ComponentSource("EXX", "um", pairs)], inputs=[axis("X"), known], travel={"X": (0.0, 1000.0)}, ramp_s=0.0
    )
    way = [500.0, 499.97, 499.9375, 499.93, 499.8, 499.5, 499.5625, 499.55, 500.0, 501.0, 700.0, 699.96, 699.93, 699.0]
    rows: list[dict] = [{"x": x} for x in way]
    rows += [{"x": 699.0, "dir": 1.0}, {"x": 690.0, "dir": 1.0}, {"x": 690.0}, {"dir": -0.5}]
    return block("reversal", table, rows)


def limits() -> Block:
    """Ramp in and out, magnitude, slew and acceleration, on jumps and on smooth motion."""
    source = [
        ComponentSource(name, "um", (Lowered(d.ONE, "X", lambda x: 0.1 * x),)) for name in ("EXX", "EYX", "EZX")
    ] + [ComponentSource("EBX", "urad", (Lowered(d.ONE, "X", lambda x: 0.05 * x),))]
    table = compile_table(source, inputs=[axis("X")], travel={"X": (0.0, 1000.0)}, ramp_s=0.008)
    limits = {
        "EXX": Limits(60.0, None, None),
        "EYX": Limits(200.0, 4000.0, None),
        "EZX": Limits(200.0, 4000.0, 4e5),
        "EBX": Limits(200.0, None, 2e5),
    }
    way = [0.0] * 3 + [300.0] * 25 + [900.0] * 45 + [20.0 * k for k in range(45, 0, -1)] + [500.0] * 40
    enable = [1] * 130 + [0] * (len(way) - 130)
    return block("limits", with_limits(table, limits), [{"x": x} for x in way], enable)


def volumetric() -> Block:
    """Three axes: angles times arms, tool length, sine by lookup, a power, a switch, a clip, up to four factors."""
    tool = t.TableInput(name="tool", kind="tool", unit="mm", low=0.0, high=500.0, default=0.0)
    speed = t.TableInput(name="n", kind="speed", unit="rpm", low=0.0, high=30000.0, default=0.0)
    turn = d.Lookup(of=d.Input(name="x"), start=0.0, step=125.0, values=tuple(math.sin(0.785 * k) for k in range(9)))
    growth = d.Power(of=d.Affine(weights=(1e-4,), of=(d.Input(name="n"),)), exponent=1.37)
    heavy = d.Switch(of=d.Input(name="n"), on=12000.0, off=9000.0)
    capped = d.Clip(of=d.Affine(weights=(0.01,), of=(d.Input(name="y"),)), low=-1.0, high=4.0)
    arm = d.Affine(offset=-30.0, weights=(-1.0, -1.0), of=(d.Input(name="z"), d.Input(name="tool")))
    components = [
        ComponentSource("EXX", "um", (Lowered(d.ONE, "X", lambda x: 4 * np.sin(x / 150.0)),)),
        ComponentSource("EBX", "urad", (Lowered(d.ONE, "X", lambda x: 12 * np.cos(x / 200.0)),)),
        ComponentSource("C0Y", "urad", (Lowered(d.Constant(value=21.5)),)),
        ComponentSource("EZZ", "um", (Lowered(growth), Lowered(d.Product(of=(heavy, capped))))),
    ]
    outputs = [
        OutputSource(
            "E_X",
            (
                MonomialSource(1.0, "EXX"),
                MonomialSource(1e-3, "EBX", (arm,)),
                MonomialSource(-1e-3, "C0Y", (d.Input(name="y"),)),
                MonomialSource(0.2, "EXX", (turn, turn, capped, heavy)),
            ),
            "X",
        ),
        OutputSource("E_Z", (MonomialSource(1.0, "EZZ"), MonomialSource(0.5, "EZZ", (turn, capped))), "Z"),
        OutputSource("E_B", (MonomialSource(1.0, "EBX"),), "B", "urad", "deg"),
    ]
    table = compile_table(
        components,
        inputs=[axis("X"), axis("Y"), axis("Z"), tool, speed],
        outputs=outputs,
        ramp_s=0.0,
        travel={"X": (0.0, 1000.0)},
        thermal_cycle_s=0.002,
        error_bound=0.1,
    )
    rng = np.random.default_rng(7)
    rows = []
    for k in range(50):
        x, y, z = (float(v) for v in rng.uniform(-50, 1050, 3).round(3))
        rows.append({"x": x, "y": y, "z": z, "tool": 120.0 + (k // 10) * 11.0, "n": float(600 * (k % 29))})
    return block("volumetric", table, rows)


def turning() -> Block:
    """Two axes that turn on, measured over a turn that does not close and over less; a third that only reverses."""
    turns = [
        t.TableInput(name=a.lower(), kind="position", axis=a, unit="deg", low=-1e4, high=1e4, default=0.0) for a in "BC"
    ]
    table = compile_table(
        [
            ComponentSource("EBB", "urad", (Lowered(d.ONE, "B", lambda b: 40 * np.sin(np.deg2rad(b)) + b / 90),)),
            ComponentSource("ECC", "urad", (Lowered(d.ONE, "C", lambda c: 60 * np.cos(np.deg2rad(c)) + c / 30),)),
            ComponentSource("EXX", "um", (Lowered(d.Direction(axis="X"), None, lambda x: np.full(np.shape(x), -3.0)),)),
        ],
        inputs=[axis("X"), *turns],
        travel={"X": (0.0, 500.0), "B": (-180.0, 180.0), "C": (0.0, 330.0)},
        turning=("C",),
        ramp_s=0.0,
        error_bound=0.5,
    )
    table = with_limits(table, {"EBB": Limits(magnitude=41.0)})
    rows = [{"x": 12.5 * k, "b": 340.0 + k, "c": (350.0 + 0.75 * k) % 360.0} for k in range(42)]
    rows += [
        {"x": 501.0 - k, "b": -181.0 + 90.0 * k, "c": v} for k, v in enumerate((-0.0, 360.0, -30.0, 719.5, -3600.0))
    ]
    return block("turning", table, rows)


def mixed(seed: int) -> Block:
    """A random table that uses everything."""
    table = everything(seed)
    return Block(f"mixed-{seed}", table, *stimulus(table, MIXED[seed], seed))


def blocks() -> Iterator[Block]:
    """All blocks, in the order of the file."""
    yield from (straight(), curves(), thermal(), reversal(), limits(), volumetric(), mixed(6), mixed(13))
    for make in (
        edges.readings,
        edges.fading,
        edges_of_outputs.operations,
        edges_of_outputs.sums,
        edges_of_outputs.motion,
        edges.doubts,
        edges.slowly,
        edges_of_outputs.bounded,
        edges_of_outputs.undone,
    ):
        yield block(make.__name__, *make())
    yield from (mixed(seed) for seed in MIXED if seed not in (6, 13))
    yield turning()


def text() -> str:
    """The whole file, computed anew."""
    out = [HEAD]
    for b in blocks():
        data = ect.dumps(b.table)
        out.append(f"\ntable {b.name}\n")
        out += [data[k : k + 48].hex() + "\n" for k in range(0, len(data), 48)]
        evaluator = Evaluator(b.table)
        names = [i.name for i in b.table.inputs]
        for row, news, on in zip(b.readings, b.fresh, b.enable, strict=True):
            given = {n: row[k] for k, n in enumerate(names) if news[k]}
            cycle = evaluator.cycle(given, **modes(on))
            shown = " ".join(number(v) if new else "-" for v, new in zip(row, news, strict=True))
            results = " ".join(number(v) for v in (*cycle.deviation.values(), *cycle.correction.values()))
            out.append(f"{on} {shown} > {results} {cycle.status:x}\n")
    return "".join(out)


def number(value: float) -> str:
    """As C's %a: exact."""
    return float(value).hex()


def single_bound(name: str, deviations: np.ndarray) -> float:
    """What binary32 may lose of the deviations (cycles, outputs) of a table, um or urad."""
    return max(SINGLE, SINGLE_SHARE[name.removeprefix("v1/")] * float(np.abs(deviations).max()))


def read(content: str) -> list[tuple[str, bytes, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """(name, bytes, readings, fresh, enable, results, status) of each block, from the text alone."""
    values: list[tuple[str, list[str], list[str]]] = []
    for line in content.splitlines():
        if line.startswith("table "):
            values.append((line[6:], [], []))
        elif line and not line.startswith("#"):
            values[-1][2 if ">" in line else 1].append(line)
    out = []
    for name, hexed, cycles in values:
        sides = [line.split(" > ") for line in cycles]
        left = [s[0].split() for s in sides]
        right = [s[1].split() for s in sides]
        fresh = np.array([[v != "-" for v in row[1:]] for row in left], dtype=np.uint8)
        readings = np.array([[0.0 if v == "-" else float.fromhex(v) for v in row[1:]] for row in left])
        enable = np.array([int(row[0]) for row in left], dtype=np.uint8)
        results = np.array([[float.fromhex(v) for v in row[:-1]] for row in right])
        status = np.array([int(row[-1], 16) for row in right])
        out.append((name, bytes.fromhex("".join(hexed)), readings, fresh, enable, results, status))
    return out


if __name__ == "__main__":
    jsonfile.write_text(FILE, text())
