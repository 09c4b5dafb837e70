"""SINUMERIK cross-error compensation ($AN_CEC): sag, straightness, squareness, and screw errors in both directions.

Value     the ERROR of the output axis in mm: a positive value is taken to move it in minus, as in the leadscrew table.
          Derived, not proved. For it: the manual draws one figure for both tables, in which the values are points of
          the error curve (p. 237), and of the leadscrew table it says that positive moves minus. A public program
          wrote minus the deviation in one version, and in a longer one the deviation. No sentence of the manual and
          no control was found that settles it: turn the weight on at a dial gauge before cutting ("prove the sign"
          below). The base axis counts by its set point; outside MIN..MAX the end values hold (828D manual of
          08/2018, p. 299).
Direction table DIRECTION 1 acts in plus, -1 in minus, 0 in both: a screw error in two directions is two tables.
Products  a correction that is a curve over one axis times a curve over another (an axis that tilts along its way times
          the height of the tool) is the product of two tables: MULT_BY_TABLE of the first is the second's number, its
          index + 1. The manual says that the product is added to the axis' total; whether the two tables add their own
          values as well, it does not say (its worked example wants the product alone). So each product is written
          as two pairs of tables, P and Q, -P and -Q: the products are equal, the own values cancel, and the file
          means the same under either reading. A file that does not is refused when it is read back.
Turns     over an axis that turns on IS_MODULO is 1 and the table, whose ends are equal, repeats (p. 249).
Limits    828D: 8 tables of 200 points, four for each product; held outside MIN..MAX; millimetres (a product of values
          in inch would be another one).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import (
    ANOTHER_FORMAT,
    CAUTION,
    ByHand,
    Curve,
    NothingToAddError,
    Points,
    Product,
    ReadBack,
    Target,
    expect,
    grid_stated,
    periodic_curve,
    points_in_file,
    unit_of,
)

MAX_POINTS, MAX_TABLES = 200, 8  # points of a table; tables
ERROR_UM = 0.1  # between points, at most
SAME_UM = 0.02  # directions closer than this share one table
PER_PRODUCT = 4  # tables
PRODUCT_POINTS = 101  # of each table of a product
PRODUCT_UM = 0.1  # rms; a product that takes away less is left out
MAX_PRODUCTS = 2  # products of one axis over one pair of axes
FILE = "NC_CEC.INI"


class SinumerikCec(Target):
    """Up to eight tables: each axis over itself in two directions, over other axes, products of two such curves."""

    name = "sinumerik_cec"
    controller = "Siemens SINUMERIK 840D sl, 828D"
    confidence = "experimental"
    sign = "a positive value moves the output axis in minus (as the leadscrew table; derived: prove it on the machine)"
    limits = "8 tables of 200 points, equidistant; sums of curves and (4 tables each) products; no temperature"
    holds = ("screw", "both directions", "cross")
    remark = {"": "; {}"}
    numbering = "AX{1}"
    source = "Function Manual Extended Functions 6FC5397-1BP40-3BA1, K3 (p. 237, 245, 248 to 252, 264); 802D sl p. 222"
    activation = (
        "MD18342 points per table; the option for sag compensation, else alarm 8040",
        "MD32710 CEC_ENABLE = 0 while the file is loaded, then 1 for each output axis; SD41300 CEC_TABLE_ENABLE[n] "
        "= 1; reference again",
        "prove the sign, two minutes, clear of any part: dial gauge on the output axis, standing where $AN_CEC of its "
        "table is largest; SD41310 CEC_TABLE_WEIGHT[n] from 0 to 1: of a positive value the axis must go in minus, by "
        "that value. If it moves in plus, this control uses the opposite sign: SD41300 = 0, turn the sign of "
        "every value of the axis' tables (of a product: of its first and third table), load again; then compare the "
        "three points below",
        "MD32720 CEC_MAX_SUM (mm) above the largest value of the list below, MD32730 CEC_MAX_VELO: the control limits "
        "the sum and its rate with an alarm, and continues",
        "tables with MULT_BY_TABLE (products): enable all four of a product or none; basic system metric (MD10240 = 1)",
        "MD32711 CEC_SCALING_SYSTEM = 1 (metric) of each output axis: 0 takes the values as inches",
        "to learn how this control reads a product, clear of any part: SD41300 = 0 for the second pair of the four, go "
        "where one table of the first pair is 0 and the other is not; no compensation there means that only products "
        "count. The file holds either way once all four are enabled again",
    )
    goes_with = ("sinumerik_lec", "sinumerik_temperature")

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        return cls.write_with(table, ())

    @classmethod
    def write_with(cls, table: CompensationTable, others: Sequence[str]) -> dict[str, str]:
        blocks: list[str] = []
        axes = _sample.axes_of(table)
        screws = "sinumerik_lec" in others  # they hold each axis over itself: here it would act twice
        for axis in _sample.outputs_by_axis(table):
            # Whether another curve includes the constant part: only one curve of an axis may.
            rest = screws and axis in _sample.positions_of(table)
            for over in _sample.axes_own_first(table, axis):
                if not _sample.changes_along(table, axis, over):
                    continue
                points = _sample.exact(_sample.uniform(table, axis, over, MAX_POINTS, ERROR_UM)[0])
                curve = _sample.at_nodes(table, axis, over, points.positions(), relative=rest)
                if screws and over == axis:
                    half = (curve.up - curve.down) / 2  # what one curve for both directions cannot express
                    curve = Curve(curve.axis, curve.over, curve.positions, half, -half)
                    if float(np.abs(curve.up).max()) * 1e3 < SAME_UM:
                        continue
                rest = True
                same = float(np.abs(curve.up - curve.down).max()) * 1e3 < SAME_UM
                sides = {0: curve.up} if same else {1: curve.up, -1: curve.down}
                for side, value in sides.items():
                    ends = (f"AX{axes.index(over) + 1}", f"AX{axes.index(axis) + 1}")
                    blocks.append(_block(len(blocks), *ends, side, points, -value, turns=_sample.turns(table, over)))
        if not blocks and others:
            raise NothingToAddError(f"sinumerik_cec: {' and '.join(others)} say all that it could")
        if not blocks:
            raise GateError("sinumerik_cec: no axis of the table is corrected over a position")
        if len(blocks) > MAX_TABLES:
            needs = f"{len(blocks)} tables are needed, {MAX_TABLES} fit: correct fewer axes or components, or"
            raise GateError(f"sinumerik_cec: {needs} {ANOTHER_FORMAT}")
        remarks = ""
        max_products = (MAX_TABLES - len(blocks)) // PER_PRODUCT
        for factors in _products(table)[:max_products] if max_products else ():
            remarks += (
                f"; tables {len(blocks)} to {len(blocks) + 3}: a product for AX{axes.index(factors.axis) + 1}, in two "
                "pairs whose own values cancel: experimental, the manual\n"
                ";   does not say whether tables that multiply add their own values too; enable all four or none\n"
            )
            blocks += _cancelling_pairs(len(blocks), axes, factors)
        named = "".join(f"; AX{n} = {letter}\n" for n, letter in enumerate(axes, 1))
        sign = "; sign: value = deviation, taken to move the axis by minus the value; not proved (see CHECKLIST.md)\n"
        return {
            FILE: f"%_N_NC_CEC_INI\n; {CAUTION}\n"
            + sign
            + named
            + remarks
            + "CHANDATA(1)\n"
            + "".join(blocks)
            + "M17\n"
        }

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        most = max([points_in_file(c) for c in read.curves] + [x.size for p in read.products for x in p.positions])
        out = [ByHand(f"MD18342 MM_CEC_MAX_POINTS of each table = {most} or more")]
        held = "= 0 (the tables hold both directions)"
        for axis in dict.fromkeys(c.axis for c in read.curves if c.axis == c.over):
            out.append(_sample.backlash_by_hand(table, axis, f"{axis}: MD32450 BACKLASH", None, held))
        for axis in read.axes():
            own = [np.abs([c.up, c.down]).max() for c in read.curves if c.axis == axis]
            max_sum = f"{float(sum(own)):.4f} {unit_of(axis)} (the tables' largest values)"
            out.append(ByHand(f"{axis}: MD32720 CEC_MAX_SUM above {max_sum}"))
        return tuple(out)

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.rstrip().endswith("M17"), FILE, "does not end with M17")
        letters = dict(re.findall(r"; (AX\d+) = (\w+)", text))
        numbers = sorted({int(n) for n in re.findall(r"\$AN_CEC\[(\d+),", text)})
        errors = {n: _read(text, n, letters) for n in numbers}
        links = {int(n): int(m) - 1 for n, m in re.findall(r"\$AN_CEC_MULT_BY_TABLE\[(\d+)\]=(\d+)", text) if int(m)}
        expect(set(links.values()) <= set(numbers), FILE, "multiplies by a table that does not exist")
        for part in (set(links), set(links.values())):
            _check_products_cancel([errors[n] for n in sorted(part)])
        alone = [errors[n] for n in numbers if n not in links and n not in links.values()]
        curves = tuple(Curve(c.axis, c.over, c.positions, -c.up, -c.down) for c in alone)
        return ReadBack(curves=curves, products=tuple(_product(errors[a], errors[b]) for a, b in links.items()))


@dataclass(frozen=True)
class _Factors:
    """A correction in mm: the product of two curves, one over each axis of `over`; rms over the grid."""

    axis: str
    over: tuple[str, str]
    points: tuple[Points, Points]
    values: tuple[np.ndarray, np.ndarray]
    rms: float


def _products(table: CompensationTable) -> list[_Factors]:
    """The remainder that no sum of curves over one axis each can represent, as products; the largest first."""
    factors = []
    for axis in _sample.outputs_by_axis(table):
        for over in combinations(_sample.positions_of(table), 2):
            factors += _separated(table, axis, over)
    return sorted(factors, key=lambda f: -f.rms)


def _separated(table: CompensationTable, axis: str, over: tuple[str, str]) -> list[_Factors]:
    """The interaction of two axes, others in the middle, as the first products of its singular value decomposition."""
    n = PRODUCT_POINTS  # odd: its middle is where the curves over single axes are taken
    first, second = (_sample.exact(_sample.evenly_spaced(table, axis_over, n)) for axis_over in over)
    grids = first, second
    plane = _sample.plane(table, axis, over, grids)
    centred = plane.values - plane.values[n // 2] - plane.values[:, n // 2][:, None] + plane.values[n // 2, n // 2]
    left, sizes, right = np.linalg.svd(centred)
    out = []
    for k in range(MAX_PRODUCTS):
        rms = float(sizes[k]) / n
        if rms * 1e3 < PRODUCT_UM:
            break
        sign = np.sign(right[k][np.argmax(np.abs(right[k]))])  # else it would depend on the library
        a, b = sign * left[:, k] * sizes[k], sign * right[k]
        # Both factors as small as can be: what a single table would do by itself is then small too.
        even = np.sqrt(np.abs(a).max() / np.abs(b).max())
        out.append(_Factors(axis, over, grids, (a / even, b * even), rms))
    return out


def _cancelling_pairs(number: int, axes: list[str], factors: _Factors) -> list[str]:
    """P times Q and -P times -Q, half of the error each."""
    half = np.sqrt(0.5)
    first, second = (half * v for v in factors.values)
    names = [f"AX{axes.index(letter) + 1}" for letter in (*factors.over, factors.axis)]
    out = []
    for pair, sign in ((number, 1.0), (number + 2, -1.0)):
        # The file contains errors, minus the correction: the minus is in the first factor.
        out.append(_block(pair, names[0], names[2], 0, factors.points[0], -sign * first, multiply=pair + 2))
        out.append(_block(pair + 1, names[1], names[2], 0, factors.points[1], sign * second))
    return out


def _check_products_cancel(tables: list[Curve]) -> None:
    """Raise VerifyError if tables that multiply would change an axis by themselves: readings would differ."""
    total: dict[tuple[str, str, bytes], np.ndarray] = {}
    for c in tables:
        key = (c.axis, c.over, c.positions.tobytes())
        total[key] = total.get(key, 0.0) + np.array([c.up, c.down])
    for key, values in total.items():
        problem = f"tables of {key[0]} over {key[1]} that multiply do not cancel: the control may add them"
        expect(float(np.abs(values).max()) < 1e-9, FILE, problem)


def _product(first: Curve, second: Curve) -> Product:
    expect(first.axis == second.axis, FILE, f"a table of {first.axis} is multiplied by one of {second.axis}")
    same = all(np.array_equal(c.up, c.down) for c in (first, second))
    expect(same, FILE, f"a product of {first.axis} acts in one direction only")
    over, positions = (first.over, second.over), (first.positions, second.positions)
    return Product(first.axis, over, positions, (-first.up, second.up))


def _block(
    number: int,
    over: str,
    axis: str,
    side: int,
    points: Points,
    error: np.ndarray,
    multiply: int = 0,
    *,
    turns: bool = False,
) -> str:
    lines = [f"$AN_CEC[{number},{n}]={v + 0.0:.6f}" for n, v in enumerate(error)]
    end = points.start + points.step * (points.count - 1)
    lines += [f"$AN_CEC_INPUT_AXIS[{number}]=({over})", f"$AN_CEC_OUTPUT_AXIS[{number}]=({axis})"]
    facts = {"STEP": points.step, "MIN": points.start, "MAX": end}
    lines += [f"$AN_CEC_{key}[{number}]={_sample.decimal(value)}" for key, value in facts.items()]
    modes = {"DIRECTION": side, "MULT_BY_TABLE": multiply, "IS_MODULO": int(turns)}
    lines += [f"$AN_CEC_{key}[{number}]={value}" for key, value in modes.items()]
    return "\n".join(lines) + "\n"


def _read(text: str, number: int, letters: dict[str, str]) -> Curve:
    """One table as the file has it: errors, in mm."""
    points = {int(n): float(v) for n, v in re.findall(rf"\$AN_CEC\[{number},(\d+)\]=(\S+)", text)}
    facts = {k: float(v) for k, v in re.findall(rf"\$AN_CEC_(STEP|MIN|MAX|DIRECTION)\[{number}\]=(\S+)", text)}
    ends = dict(re.findall(rf"\$AN_CEC_(INPUT|OUTPUT)_AXIS\[{number}\]=\((\w+)\)", text))
    expect(len(facts) == 4 and len(ends) == 2, FILE, f"table {number} lacks STEP, MIN, MAX, DIRECTION or its axes")
    x = grid_stated(facts)
    count = x.size
    expect(sorted(points) == list(range(count)), FILE, f"table {number} has {len(points)} points, not {count}")
    value = np.array([points[n] for n in range(count)])
    nothing = np.zeros(count)
    up, down = (value if facts["DIRECTION"] >= 0 else nothing), (value if facts["DIRECTION"] <= 0 else nothing)
    curve = Curve(letters[ends["OUTPUT"]], letters[ends["INPUT"]], x, up, down)
    if re.search(rf"IS_MODULO\[{number}\]=1", text):
        expect(up[0] == up[-1] and down[0] == down[-1], FILE, f"table {number} does not end on its first value")
        return periodic_curve(curve)
    return curve
