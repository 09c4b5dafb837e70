"""Screw formats read a second time, from the manuals alone: none of errpipe's readers or helpers stands behind these.

Each takes the files and an axis, and gives what the control adds to a command, mm (deg): moved(position, side), side
+1 on the way up and -1 on the way down. A format that holds the reversal alone moves by half of it either way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

Moved = Callable[[float, int], float]
Files = Mapping[str, str]
NUMBER = r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"


def _line(x: Sequence[float], y: Sequence[float]) -> Callable[[float], float]:
    order = np.argsort(x)
    at, value = np.asarray(x, dtype=float)[order], np.asarray(y, dtype=float)[order]
    return lambda position: float(np.interp(position, at, value))


def _both(up: Callable[[float], float], down: Callable[[float], float] | None = None, sign: float = 1.0) -> Moved:
    other = up if down is None else down
    return lambda x, side: sign * (up(x) if side > 0 else other(x))


def _turning(moved: Moved, low: float = 0.0) -> Moved:
    """One turn from `low` on, repeated."""
    return lambda x, side: moved(low + (x - low) % 360.0, side)


def _rows(text: str, columns: int, start: str = "", between: str = r"[ \t]+") -> list[tuple[float, ...]]:
    matches = re.finditer(rf"^{start}" + between.join([f"({NUMBER})"] * columns) + r"$", text, re.M)
    return [tuple(float(v) for v in row.groups()) for row in matches]


def _half(text: str, pattern: str, parts: float = 0.5) -> Moved:
    value = float(re.search(pattern, text, re.M)[1]) * parts  # type: ignore[index]
    return lambda x, side: side * value


def aerotech_cal(files: Files, axis: str) -> Moved:
    """Corrections that are added, from OFFSET on, SAMPLEDIST apart."""
    text = files[f"{axis}.cal"]
    start, step = (float(re.search(rf"{k}=({NUMBER})", text)[1]) for k in ("OFFSET", "SAMPLEDIST"))  # type: ignore[index]
    values = [v for (v,) in _rows(text, 1)]
    return _both(_line([start + step * n for n in range(len(values))], values))


def beckhoff_ssfk(files: Files, axis: str) -> Moved:
    """Errors in 0.1 um, which the kernel takes away; `pos` on the way up."""
    (text,) = (t for t in files.values() if re.search(rf"^kopf.log_achs_name +{axis}$", t, re.M))
    facts = dict(line.split() for line in text.splitlines())
    at = [int(facts["kw.ssfk.kw_startpos"]) + n * int(facts["kw.ssfk.interval"]) for n in range(len(facts))]
    count = int(facts["kw.ssfk.kw_nr_max"])
    sides = (
        _line([x * 1e-4 for x in at[:count]], [1e-4 * int(facts[f"kw.ssfk.table[{n}].{side}"]) for n in range(count)])
        for side in ("pos", "neg")
    )
    once = _both(*sides, sign=-1.0)
    if facts["kw.ssfk.modulo"] == "0":
        return once
    assert at[count - 1] - at[0] == 3_600_000  # P-COMP-00022: the first and the last entry stand for one position
    return _turning(once, at[0] * 1e-4)


def beckhoff_volumetric(files: Files, axis: str) -> Moved:
    """Deviations in mm, of rotary axes in rad; the column of the axis' own positioning error."""
    for block in files["volumetric.csv"].split("#\n"):
        head, *rows = [line.split() for line in block.splitlines() if line and not line.startswith("//")]
        if head[0] == axis:
            unit = 180.0 / np.pi if axis in "ABC" else 1.0
            column = head.index(f"E{axis}{axis}")
            return _both(_line([float(r[0]) for r in rows], [unit * float(r[column]) for r in rows]), sign=-1.0)
    raise AssertionError(f"no block of {axis}")


def codesys_backlash(files: Files, axis: str) -> Moved:
    """fBacklash further in the direction of travel: twice that at a reversal."""
    return _half(files["PRG_Backlash.st"], rf"fb{axis}\(.*fBacklash := ({NUMBER}),", 1.0)


def ecmc_lut(files: Files, axis: str) -> Moved:
    """Added to what the encoder reads, so that the loop takes it away from the axis."""
    return _both(_line(*zip(*_rows(files[f"{axis}_lut.dat"], 2), strict=True)), sign=-1.0)


def fagor_lscrw(files: Files, axis: str) -> Moved:
    """Position, error in plus, error in minus; errors are taken away."""
    x, up, down = zip(*_rows(files[f"LSCRW_{axis}.txt"], 3, r"P\d+ "), strict=True)
    once = _both(_line(x, up), _line(x, down), sign=-1.0)
    return _turning(once) if axis in "ABC" and (x[0], x[-1], up[0]) == (0.0, 360.0, up[-1]) else once


def fanuc_pitch(files: Files, axis: str) -> Moved:
    """Pulses of 1 um one after the other from the reference position (point 3620, machine coordinate 0).

    On the way up, number k + 1 is put out between points k and k + 1; below the reference it is taken back. With 3625
    the points after the reference's go round once, and whatever they add up to is added by every turn.
    """
    text = files["PITCH.TXT"]
    number = re.search(rf"^\(A(\d+) {axis}\)$", text, re.M)[1]  # type: ignore[index]
    facts = {int(k): int(v) for k, v in re.findall(rf"N0(36\d\d)Q1A{number}P(-?\d+);", text)}
    pulses = {int(k): int(v) for k, v in re.findall(r"N1(\d{4})Q0P(-?\d+);", text)}
    step, turn = facts[3624] * 1e-3, facts.get(3625, 0)

    def walked(x: float, first: int) -> float:
        total, shift = 0.0, first - facts[3621]
        if turn:
            assert facts[3621] == facts[3620] and facts[3620] + turn / facts[3624] == facts[3622]  # B-63980EN p. 100
            assert pulses[facts[3620] + shift] == pulses[facts[3622] + shift]
            round_trip = sum(pulses[n + shift] for n in range(facts[3620] + 1, facts[3622] + 1))
            turns, x = np.floor(x / 360.0), x % 360.0
            total = float(turns) * round_trip
        for n in range(facts[3621], facts[3622] + 1):
            begin = (n - 1 - facts[3620]) * step  # the interval that ends at point n
            part = np.clip(x, begin, begin + step) - np.clip(0.0, begin, begin + step)
            total += float(part) / step * pulses[n + shift]
        return total * 1e-3

    offset = facts[3627] * 1e-3
    return lambda x, side: walked(x, facts[3621]) if side > 0 else walked(x, facts[3626]) + offset


def grblhal_backlash(files: Files, axis: str) -> Moved:
    """$160 is X."""
    return _half(files["backlash.gcode"], rf"^\${160 + 'XYZABCUV'.index(axis)}=({NUMBER})$")


def haas_pitch(files: Files, axis: str) -> Moved:
    """Inches, every half inch from machine zero downwards."""
    text = files[f"leadscrew_{axis}.txt"]
    top = float(re.search(rf"machine zero at ({NUMBER}) mm", text)[1])  # type: ignore[index]
    number, value = zip(*_rows(text, 2), strict=True)
    return _both(_line([top - 12.7 * n for n in number], [25.4 * v for v in value]))


def heidenhain_com(files: Files, axis: str) -> Moved:
    """Errors, taken away; on the way down the axis goes further in minus by the reversal value. Turns: 0 to 360 deg."""
    text = files[f"{axis}.COM"]
    names = re.search(r"^NR AXISPOS BACKLASH (.*)$", text, re.M)[1].split()  # type: ignore[index]
    _, x, gap, *errors = zip(*_rows(text.replace("+", ""), 3 + len(names)), strict=True)
    error = errors[names.index(axis)]
    once = _both(_line(x, error), _line(x, np.add(error, gap)), sign=-1.0)
    return _turning(once) if axis in "ABC" and x[0] == 0.0 and x[-1] >= 360.0 else once


def linuxcnc_screw(files: Files, axis: str) -> Moved:
    """Trims: position, added on the way up, added on the way down."""
    x, up, down = zip(*_rows(files[f"{axis.lower()}.comp"], 3), strict=True)
    return _both(_line(x, up), _line(x, down))


def mach4_screw_map(files: Files, axis: str) -> Moved:
    """Expected minus actual, one section a direction."""
    sides = []
    for side in "+-":
        facts = dict(
            re.findall(r"^(\w+)=(\S+)$", files[f"screwmap_{axis}.txt"].split(f"[{axis}{side}]")[1], re.M)[::-1]
        )
        count = int(facts["Points"])
        x = np.linspace(0.0, float(facts["Length"]), count) + float(facts["Start"])
        sides.append(_line(x.tolist(), [float(facts[f"Error{n}"]) for n in range(count)]))
    return _both(*sides)


def marlin_gcode(files: Files, axis: str) -> Moved:
    return _half(files["errpipe.gcode"], rf"^M425 F1.* {axis}({NUMBER})")


def mitsubishi_pitch(files: Files, axis: str) -> Moved:
    """Half units of 1 um, outwards from the reference point: added going up, taken back going down."""
    facts = dict(re.findall(r"^#(\d+) = (\S+)", files["machine_error.txt"], re.M))
    (base,) = (k for k in range(4001, 4090, 10) if facts.get(str(k)) == axis)
    zero, low, high, step = (int(facts[str(base + n)]) for n in (2, 3, 4, 6))
    value = {n: int(facts[str(4100 + n)]) * 0.5e-3 for n in range(low, high + 1)}
    x = {n: (n - zero) * step * 1e-3 for n in value}
    moved = {zero: 0.0}
    for n in range(zero + 1, high + 1):
        moved[n] = moved[n - 1] + value[n]
    for n in range(zero - 1, low - 1, -1):
        moved[n] = moved[n + 1] - value[n]
    return _both(_line([x[n] for n in moved], list(moved.values())))


def pmac_comp(files: Files, axis: str) -> Moved:
    """Sixteenths of a count, 10000 a mm; entry 1 one spacing above zero, the last at zero and at the table's length."""
    text = files["comp.pmc"]
    number = re.search(rf"^; #(\d+) = {axis},", text, re.M)[1]  # type: ignore[index]
    own = text.split(f"\n#{number}\n")[1].split("\n;")[0]
    gap = int(re.search(rf"^I{number}86=(-?\d+)$", text, re.M)[1])  # type: ignore[index]

    def table(word: str) -> Callable[[float], float]:
        count, length, rows = re.search(rf"DEFINE {word} (\d+),(\d+)\n([-\d\s]+)", own).groups()  # type: ignore[union-attr]
        entries = [int(v) for v in rows.split()]
        assert len(entries) == int(count)
        round_trip = _line([n * int(length) / int(count) for n in range(int(count) + 1)], [entries[-1], *entries])
        return lambda x: round_trip((x * 10_000) % int(length)) / 160_000

    comp, backlash = table("COMP"), table("BLCOMP")
    return lambda x, side: comp(x) - (0.0 if side > 0 else backlash(x) + gap / 160_000)


def reprap_heightmap(files: Files, axis: str) -> Moved:
    return _half(files["errpipe.g"], rf"^M425.* {axis}({NUMBER})")


def _sinumerik(text: str, table: str) -> Callable[[float], float]:
    values = {int(n): float(v) for n, v in re.findall(rf"^\$A\w+\[{table},(\d+)[^\]]*\]=(\S+)$", text, re.M)}
    low, step = (
        float(re.search(rf"^\$A\w+_{k}\[{table}[^\]]*\]=(\S+)$", text, re.M)[1])  # type: ignore[index]
        for k in ("MIN", "STEP")
    )
    return _line([low + step * n for n in sorted(values)], [values[n] for n in sorted(values)])


def _from(text: str, table: str = "0") -> float:
    """MIN of a table that repeats every 360 deg."""
    low, high = (
        float(re.search(rf"COMP_{k}\[{table}[^\]]*\]=(\S+)", text.replace("CEC_", "COMP_"))[1])  # type: ignore[index]
        for k in ("MIN", "MAX")
    )
    assert high - low == 360.0
    return low


def sinumerik_cec(files: Files, axis: str) -> Moved:
    """Errors, taken away, each table in its direction of travel."""
    text = files["NC_CEC.INI"]
    machine_axis = {letter: ax for ax, letter in re.findall(r"^; (AX\d+) = (\w+)$", text, re.M)}[axis]
    parts, low = [], None
    for table in dict.fromkeys(re.findall(r"\$AN_CEC\[(\d+),", text)):
        ends = re.findall(rf"CEC_(?:INPUT|OUTPUT)_AXIS\[{table}\]=\((\w+)\)", text)
        if ends == [machine_axis, machine_axis]:
            way = int(re.search(rf"CEC_DIRECTION\[{table}\]=(-?\d)", text)[1])  # type: ignore[index]
            parts.append((way, _sinumerik(text, table)))
            low = _from(text, table) if f"IS_MODULO[{table}]=1" in text else None
    once = lambda x, side: -sum(error(x) for way, error in parts if way * side >= 0)  # noqa: E731
    return once if low is None else _turning(once, low)


def sinumerik_lec(files: Files, axis: str) -> Moved:
    """A positive value moves the axis in negative direction; with IS_MODULO the table repeats from MIN to MAX."""
    (text,) = (t for name, t in files.items() if f"_{axis}_" in name)
    once = _both(_sinumerik(text, "0"), sign=-1.0)
    return _turning(once, _from(text)) if re.search(r"IS_MODULO\[0,\w+\]=1", text) else once


def smoothie_pitch(files: Files, axis: str) -> Moved:
    """Motor travel per commanded travel, integrated from 0."""
    known, factors = np.array(sorted(_rows(files["pitch_compensation.dat"], 2, f"{axis} "))).T

    def moved(x: float, side: int) -> float:
        at = np.linspace(0.0, x, 4001)
        extra = np.interp(at, known, factors) - 1.0
        return float((extra[1:] + extra[:-1]).sum() / 2 * (at[1] - at[0]))

    return moved


def twincat_nc_table(files: Files, axis: str) -> Moved:
    """Added to the set point, one array a direction of travel."""
    text, sides = files[f"GVL_Compensation_{axis}.st"], []
    for way in ("Positive", "Negative"):
        name = re.search(rf"stParameter(\w+) : [^;]*WorkDirection{way}", text)[1]  # type: ignore[index]
        array = re.search(rf"aCompensation{name} : [^;]*;", text)[0]  # type: ignore[index]
        rows = re.findall(r"Position := (\S+), Compensation := ([^)]+)\)", array)
        sides.append(_line([float(x) for x, _ in rows], [float(v) for _, v in rows]))
    low = re.search(r"MinPosition := (\S+),", text)
    return _turning(_both(*sides), float(low[1])) if low and "Modulo := TRUE" in text else _both(*sides)


def weihong_axeserr(files: Files, axis: str) -> Moved:
    """Errors in mm, taken away: position, moving up, moving down."""
    part = files["axeserr.dat"].split(f"[{axis}]\n")[1].split("[")[0]
    x, up, down = zip(*_rows(part, 3, between=r",\s*"), strict=True)
    return _both(_line(x, up), _line(x, down), sign=-1.0)
