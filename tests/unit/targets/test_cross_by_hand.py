"""Cross tables, beds, temperatures and whole tables, read by the manual's words alone on the machines of by_hand.

Nothing of errpipe's readers or helpers stands behind these: each takes the files and gives what the control adds.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.targets import TARGETS
from tests.contract import second_reader
from tests.contract.second_cycle import Evaluator
from tests.unit.targets.by_hand import MACHINES, PLACES, of

BY_NAME = {t.name: t for t in TARGETS}
ROOM = 0.25  # um: interpolation of a format besides its rounding


def place(letter, low, high):
    return TableInput(name=letter.lower(), kind="position", axis=letter, low=low - 50, high=high + 50, default=low)


def moving(axis, parts, inputs, travel):
    """A table of one output: `axis` deviates by the sum of the parts, um."""
    name = f"E{axis}{parts[0].axis}"
    output = tables.OutputSource(axis, (tables.MonomialSource(1.0, name),), axis)
    source = [tables.ComponentSource(name, "um", tuple(parts))]
    return tables.compile_table(source, outputs=[output], inputs=inputs, travel=travel, error_bound=0.01)


# ------------------------------------------------------------------ one axis over another


def sinumerik_cec(files, axis, over):
    """Values of the tables whose input is `over` and output `axis`, each in its direction, taken away."""
    text = files["NC_CEC.INI"]
    ax = {letter: number for number, letter in re.findall(r"^; (AX\d+) = (\w)$", text, re.M)}
    rows = re.findall(r"^\$AN_CEC\[(\d+),(\d+)\]=(\S+)$", text, re.M)
    fact = {(k, int(n)): v for k, n, v in re.findall(r"^\$AN_CEC_(\w+)\[(\d+)\]=\(?(\w[^\s)]*|-\S+)\)?$", text, re.M)}
    numbers = [n for k, n in fact if k == "STEP" and fact["INPUT_AXIS", n] == ax[over]]
    assert numbers and all(fact["OUTPUT_AXIS", n] == ax[axis] for n in numbers)

    def moved(x, side):
        total = 0.0
        for n in numbers:
            values = [float(v) for t, _, v in rows if int(t) == n]
            low, step, way = (float(fact[k, n]) for k in ("MIN", "STEP", "DIRECTION"))
            if way * side >= 0:
                total -= np.interp(x, low + step * np.arange(len(values)), values)
        return total

    return moved


def beckhoff_crosscomp(files, axis, over):
    """The list of the slave axis; setpoint of the master and correction in 0.1 um (0.0001 deg), added to the slave."""
    (text,) = [t for t in files.values() if re.search(rf"^kopf.log_achs_name {axis}$", t, re.M)]
    number = int(re.search(r"^kw.crosscomp.master_ax_nr (\d+)$", text, re.M)[1])
    machine = {"X", "Z"} if {axis, over} == {"X", "Z"} else {*"XYZ", axis, over}  # a lathe, or a machine of X, Y, Z
    assert number == 1 + sorted(machine, key="XYZABC".index).index(over)
    assert re.search(r"^kw.crosscomp.unit 1$", text, re.M)
    x, v = ([int(n) * 1e-4 for n in re.findall(rf"\.{k} (-?\d+)$", text, re.M)] for k in ("setpoint", "correction"))
    assert len(x) == 1 + int(re.search(r"last_index (\d+)$", text, re.M)[1])
    return lambda at, side: np.interp(at, x, v)


def heidenhain_com(files, axis, over):
    """Column of the compensated axis in the table of the axis it depends on, which config.CMA names in that column.

    Of an axis of rotation entries from 0 to 360 deg.
    """
    names, line = (row.split() for row in files["CONFIG.CMA"].splitlines() if row.startswith(("NR", "0 *")))
    assert line[names.index(over)] == over
    head = re.search(r"^NR (.*)$", files[f"{over}.COM"], re.M)[1].split()
    rows = [row.split()[1:] for row in files[f"{over}.COM"].splitlines() if row[:1].isdigit()]
    x, v = ([float(row[head.index(k)]) for row in rows] for k in ("AXISPOS", axis))
    turns = over in "ABC" and x[0] == 0.0 and x[-1] >= 360.0
    return lambda at, side: -np.interp(at % 360.0 if turns else at, x, v)


CROSS = [sinumerik_cec, beckhoff_crosscomp, heidenhain_com]
OVER = {name: axes[0] for name, axes in MACHINES.items()}


def cross_gap(reader, machine, sign=1.0):
    """Largest difference between what a control adds and minus the deviation, um; sign -1: a fault that is planted."""
    letter, low, high, mean, half = OVER[machine]
    axis = "Y" if letter != "Y" else "X"
    scale = 0.1 if letter in "AC" else 1.0  # deviations of linear axes are tens of micrometres
    parts = (
        Lowered(d.ONE, letter, lambda x: scale * mean(x)),
        Lowered(d.Direction(axis=letter), letter, lambda x: scale * half(x)),
    )
    table = moving(axis, parts, [place(letter, low, high), place(axis, 0, 100)], {letter: (low, high), axis: (0, 100)})
    target = BY_NAME[reader.__name__]
    moved = reader(target.write(table), axis, letter)
    x, gaps = np.linspace(low, high, PLACES)[1:-1], []
    for side in (1, -1):
        way = side if "both directions" in target.holds and reader is sinumerik_cec else 0
        want = -scale * (mean(x) + way * half(x))
        matches = [1e3 * sign * float(moved(p, side)) for p in x]
        gaps.append(np.abs(matches - want).max())
    return max(gaps)


@pytest.mark.parametrize("machine", OVER)
@pytest.mark.parametrize("reader", CROSS, ids=lambda r: r.__name__)
def test_a_cross_table_takes_the_deviation_back(reader, machine):
    assert cross_gap(reader, machine) < ROOM
    assert cross_gap(reader, machine, -1.0) > 5.0


def test_every_format_of_cross_curves_is_read():
    whole = {t.name for t in TARGETS if {"screw", "temperature"} <= set(t.holds)}
    assert {r.__name__ for r in CROSS} == {t.name for t in TARGETS if "cross" in t.holds} - whole


# ------------------------------------------------------------------ Z over a bed


def klipper_sections(files):
    """Rows of y, columns of x, between min and max; mm, added to Z."""
    text = files["errpipe.cfg"]
    fact = dict(re.findall(r"^(\w+) = (\S+)$", text, re.M))
    rows = [[float(v) for v in row.split(",")] for row in text.split("points =\n")[1].split("\n\n")[0].splitlines()]
    x, y = (np.linspace(float(fact[f"min_{a}"]), float(fact[f"max_{a}"]), int(fact[f"{a}_count"])) for a in "xy")
    return {(x[i], y[j]): v for j, row in enumerate(rows) for i, v in enumerate(row)}


def marlin_gcode(files):
    """M421 I(x) J(y) Z(mm), added to Z, over the range that the file names."""
    text = files["errpipe.gcode"]
    n, m, x0, x1, y0, y1 = (
        float(v) for v in re.search(r"mesh of (\d+) x (\d+): X (\S+) to (\S+), Y (\S+) to (\S+)", text).groups()
    )
    x, y = np.linspace(x0, x1, int(n)), np.linspace(y0, y1, int(m))
    return {(x[int(i)], y[int(j)]): float(z) for i, j, z in re.findall(r"^M421 I(\d+) J(\d+) Z(\S+)$", text, re.M)}


def reprap_heightmap(files):
    """Third line: axes, ends, radius, spacing, counts; then a line for each Y, ascending, with a value for each X."""
    lines = files["heightmap.csv"].splitlines()
    fact = dict(zip(lines[1].split(","), lines[2].split(","), strict=True))
    assert (fact["axis0"], fact["axis1"]) == ("X", "Y")
    at = [float(fact[f"min{k}"]) + float(fact[f"spacing{k}"]) * np.arange(int(fact[f"num{k}"])) for k in (0, 1)]
    rows = [[float(v) for v in line.split(",")] for line in lines[3:]]
    return {(at[0][i], at[1][j]): v for j, row in enumerate(rows) for i, v in enumerate(row)}


BEDS = {"0 up": (0.0, 500.0, 0.0, 400.0), "below 0": (-300.0, 0.0, -700.0, -9.5), "far": (5000.0, 5400.0, -20.0, 30.0)}
BED = [klipper_sections, marlin_gcode, reprap_heightmap]


@pytest.mark.parametrize("bed", BEDS)
@pytest.mark.parametrize("reader", BED, ids=lambda r: r.__name__)
def test_a_bed_is_lifted_where_it_is_low(reader, bed):
    x0, x1, y0, y1 = BEDS[bed]
    over_x, over_y = (lambda x: 20 * ((x - x0) / (x1 - x0)) ** 2), (lambda y: 9.0 * (y - y0) / (y1 - y0))
    parts = (Lowered(d.ONE, "X", over_x), Lowered(d.ONE, "Y", over_y))
    inputs = [place("X", x0, x1), place("Y", y0, y1), place("Z", -100, 0)]
    table = moving("Z", parts, inputs, {"X": (x0, x1), "Y": (y0, y1), "Z": (-100.0, 0.0)})
    contents = reader(BY_NAME[reader.__name__].write(table))
    assert len(contents) >= 25 and {x for x, _ in contents} >= {x0, x1} and {y for _, y in contents} >= {y0, y1}
    gaps = [1e3 * z + over_x(x) + over_y(y) for (x, y), z in contents.items()]
    assert np.abs(gaps).max() < ROOM
    assert max(abs(-1e3 * z + over_x(x) + over_y(y)) for (x, y), z in contents.items()) > 5.0  # a wrong sign is seen


def test_every_format_of_a_bed_is_read():
    assert {r.__name__ for r in BED} == {t.name for t in TARGETS if "bed" in t.holds}


# ------------------------------------------------------------------ temperature


def sinumerik_temperature(files, axis, x, t):
    """dK = K0(T) + tan beta(T) * (P - P0), taken away."""
    text = files["TEMP_COMP.SPF"]
    number = re.search(rf"^; {axis}\[(AX\d+)\]", text, re.M)[1]
    p0 = float(re.search(rf"^\$SA_TEMP_COMP_REF_POSITION\[{number}\]=(\S+)$", text, re.M)[1])
    level, slope = (
        float(v) * (t - float(t0))
        for key in ("ABS_VALUE", "SLOPE")
        for v, t0 in re.findall(rf"add: \$SA_TEMP_COMP_{key}\[{number}\] = (\S+)\*\(T-(\S+)\)$", text, re.M)
    )
    return -(level + slope * (x - p0))


def beckhoff_temperature(files, axis, x, t):
    """ds = offset + coefficient * (s - s0): 0.1 um, um/m, 0.1 um (0.0001 deg alike); an error, taken away."""
    part = files["temp_comp.lis"].split(f"# {axis} T T0")[1].split("\n# Z T")[0]
    s0 = 1e-4 * int(re.search(r"^lr_param.temp_comp_position_0 (-?\d+)$", part, re.M)[1])
    offset, coefficient = (
        float(v) * (t - float(t0))
        for key in ("offset_0", "coefficient")
        for v, t0 in re.findall(rf"^# PLC: add to temp_comp_{key}: (\S+)\*\(T-(\S+)\)$", part, re.M)
    )
    return -(1e-4 * offset + 1e-6 * coefficient * (x - s0))


TEMPERATURE = [sinumerik_temperature, beckhoff_temperature]
WARM = TableInput(name="T", kind="sensor", unit="degC", low=-40, high=100, default=20, valid=(15, 30), margin=5)


@pytest.mark.parametrize("machine", [m for m, (letter, *_) in OVER.items() if letter in "XYZ"])
@pytest.mark.parametrize("reader", TEMPERATURE, ids=lambda r: r.__name__)
def test_a_warm_axis_is_commanded_less_far(reader, machine):
    letter, low, high, _, _ = OVER[machine]
    growth = Lowered(d.above("T", 20.0), letter, lambda x: 2.0 + 0.011 * (x - low))
    table = moving(letter, (growth,), [place(letter, low, high), WARM], {letter: (low, high)})
    files = BY_NAME[reader.__name__].write(table)
    for t in (16.0, 20.0, 27.0):
        for x in np.linspace(low, high, 5):
            want = -(t - 20.0) * (2.0 + 0.011 * (x - low))
            assert 1e3 * reader(files, letter, x, t) == pytest.approx(want, abs=ROOM)
    assert 1e3 * reader(files, letter, high, 27.0) < -10.0  # a wrong sign is seen


def test_klipper_takes_the_drift_of_z_away():
    """z' = z - temp_coeff * (T - T_ref)."""
    growth = Lowered(d.Affine(weights=(2.0,), of=(d.above("T", 20.0),)), "Z", lambda z: np.ones(np.shape(z)))
    table = moving("Z", (growth,), [place("Z", -300.0, 0.0), WARM], {"Z": (-300.0, 0.0)})
    text = BY_NAME["klipper_sections"].write(table)["errpipe.cfg"]
    assert float(re.search(r"^temp_coeff: (\S+)$", text, re.M)[1]) == pytest.approx(2e-3, rel=1e-3)


def test_every_format_of_a_temperature_is_read():
    assert {r.__name__ for r in TEMPERATURE} == {t.name for t in TARGETS if set(t.holds) == {"temperature"}}


# ------------------------------------------------------------------ the whole table


def bytes_in(files):
    """The longest list of bytes in any of the files: the table as a controller gets it."""
    lists = []
    for text in files.values():
        lists += re.findall(r"[\[{]\s*((?:(?:16#)?[0-9A-Fa-fx]+\s*,\s*){100,}(?:16#)?[0-9A-Fa-fx]+)\s*,?\s*[\]}]", text)
    longest = max(lists, key=len)
    return bytes(int(v.strip().replace("16#", "0x"), 0) for v in longest.split(","))


WHOLE = [t for t in TARGETS if {"screw", "temperature"} <= set(t.holds)]


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("target", WHOLE, ids=lambda t: t.name)
def test_a_whole_table_takes_the_deviation_back(target, machine):
    """The bytes in the files, read and run by the evaluator that was written from the specification alone."""
    axes = MACHINES[machine]
    table = second_reader.load(bytes_in(target.write(of(*axes, ramp_s=0.0))))
    names = [o.axis for o in table.outputs]
    for letter, low, high, mean, half in axes:
        unit = np.rad2deg(1e-6) * 1e3 if letter in "ABC" else 1.0
        for x in np.linspace(low, high, PLACES)[2:-2:6]:
            for side in (1, -1):
                cycles = Evaluator(table)
                for at in (x - 2.0 * side, x - side, x):
                    there = {i.name: (at if i.axis == letter else i.default) for i in table.inputs}
                    made = cycles.cycle(1, [there[i.name] for i in table.inputs])
                moved = 1e3 * made.corrections[names.index(letter)]
                want = -unit * float(mean(np.array([x]))[0] + side * half(np.array([x]))[0])
                assert moved == pytest.approx(want, abs=0.05)
