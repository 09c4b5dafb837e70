"""An NC program rewritten with a table, so that the uncorrected machine cuts the wanted part."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from errpipe import files
from errpipe.domain.table import CompensationTable
from errpipe.errors import DataError, GateError, UsageError, did_you_mean
from errpipe.ncprogram.correct import Summary, rewrite
from errpipe.ncprogram.modal import OFFSETS, Setup
from errpipe.ncprogram.writer import Deviation
from errpipe.stages import _artefacts
from errpipe.tables import batch, ect
from errpipe.targets import _sample

MM = {"mm": 1.0, "um": 1e-3}  # per correction unit
MOVED = ("X", "Y", "Z")
CHUNK = 1_000_000  # bytes of the program read at a time
MAX_PRINTED_BYTES = 8_000_000  # of a program that goes to standard output
MAX_OVERRUN = 1.0  # mm; a program may overrun the ends of what was measured by so much without a remark
_LENGTH = re.compile(r"[XYZ][ \t]*[+-]?[\d.]*[1-9]", re.IGNORECASE | re.ASCII)
_WORDS = {  # key of the result -> a word of a program, and what it leaves open
    "whole_numbers": (  # 0 is the same in every unit
        re.compile(r"[XYZIJKR][ \t]*[+-]?0*[1-9]\d*(?![\d.])", re.IGNORECASE | re.ASCII),
        "has no decimal point and is taken as a whole length, as LinuxCNC does: a control that counts it in least "
        "increments (Fanuc 3401#0 DPI = 0) would go 1000 times further by the corrected program",
    ),
    "diameters": (  # surface speed, its largest rpm, a tool with its offset as Fanuc's lathes call it
        re.compile(r"G(?:96(?!\d)|(?:50|92)[ \t]*S[ \t]*\d+)|T(?:0\d(?!00)\d\d|1([0-6])1\1)(?!\d)", re.IGNORECASE),
        "is a lathe's, and X was taken as a radius and no tool offset but that of G43, as LinuxCNC does: where the "
        "control counts X in diameters (Fanuc 1006#3 DIA, Siemens DIAMON), do not use the corrected program; if T sets "
        "an offset, the correction is evaluated at a position wrong by that offset",
    ),
    "rotary": (
        re.compile(r"[ABC][ \t]*[+-]?\.?\d+", re.IGNORECASE | re.ASCII),
        "is taken as of an axis that counts on, and not corrected: where the sign of an angle says which way round "
        "(LinuxCNC WRAPPED_ROTARY, Fanuc 1008#1 RAB = 1), do not use the corrected program",
    ),
}
_MODAL_STATES = (
    (re.compile(r"G0*2[01](?![\d.])", re.IGNORECASE), "G20 or G21 (taken as mm)"),
    (re.compile(r"G0*9[01](?![\d.])", re.IGNORECASE), "G90 or G91 (taken as absolute)"),
)
_COMMENT = re.compile(r"\([^)]*\)?|;.*")
_HEAD = re.compile(r"%|(?:N\d+\s*)?O\s*\d", re.IGNORECASE | re.ASCII)  # what a control wants first: tape mark, number
_MARK = "CORRECTED BY ERRPIPE, TABLE "  # in capitals: some controls have no others
MAX_LENGTH = 1e5  # mm; of an offset, a tool, a start


def correct(
    program: Path,
    table: Path,
    out: Path | None,
    at: Mapping[str, float],
    *,
    offsets: Sequence[str] = (),
    tools: Sequence[str] = (),
    start: str | None = None,
    chord_error: float = 0.001,
    longest: float = 25.0,
    again: bool = False,
) -> dict[str, Any]:
    """Write the corrected program, with a comment at its head that names the table.

    again: a program may be one that was corrected before. Raises DataError naming the line of anything that is not
    understood.
    """
    if out is not None and Path(out).exists() and Path(out).samefile(program):
        raise UsageError(f"--out {out}: is the program itself, which corrected twice is wrong by as much: name another")
    compensation_table = _artefacts.read_table(table)
    readings = readings_of(compensation_table, at)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    deviation = _with_extent(deviation_of(compensation_table, readings), low, high)
    setup = setup_of(offsets, tools, start)

    def rewritten(write: Callable[[bytes], object]) -> Summary:
        try:
            marked = _marked(write, next(chunks_of(program), b""), ect.fingerprint(compensation_table))
            chunks = chunks_of(program) if again else _corrected_once(chunks_of(program))
            return rewrite(chunks, marked, deviation, setup, chord_error=chord_error, longest=longest)
        except DataError as err:
            mark = "," if str(err).startswith("line ") else ":"
            raise DataError(f"{program}{mark} {err}") from None

    parts: list[bytes] = []
    if out is None:
        _refuse_large(program)
        summary = rewritten(parts.append)
    else:
        with files.whole(Path(out)) as stream:
            summary = rewritten(stream.write)
    result: dict[str, Any] = {
        "moves": summary.moves,
        "blocks_in": summary.blocks_in,
        "blocks_out": summary.blocks_out,
        "largest_correction_um": 1e3 * summary.largest_correction,
        "largest_chord_error_um": 1e3 * summary.largest_chord_error,
    }
    result |= _remarks(compensation_table, offsets, next(chunks_of(program), b"").decode())
    beyond = [outside_validity(compensation_table, readings), outside_travel(compensation_table, low, high)]
    if any(beyond):
        result["outside_what_was_measured"] = "; ".join(filter(None, beyond))
    if out is None:
        return {**result, "program": b"".join(parts).decode()}
    return {**result, "written": str(out)}


def _remarks(table: CompensationTable, offsets: Sequence[str], beginning: str) -> dict[str, str]:
    """What a table, the work offsets that were given and the beginning of a program leave open, in words."""
    result = {}
    if depends_on_direction(table):
        result["direction"] = "the mean of both directions of travel: lost motion is not corrected in a program"
    if left := [o.name for o in table.outputs if o.axis not in MOVED]:
        result["not_corrected"] = f"{', '.join(left)}: programs are corrected in X, Y and Z only"
    if not any(option.startswith("G54=") for option in offsets):
        result["offsets"] = "no --offset of G54 was given: G54 is taken as 0,0,0, machine coordinates"
    if missing := unset_modal_states(beginning):
        result["taken_as"] = missing
    return result | remarks_on_words(beginning)


def chunks_of(program: Path) -> Iterator[bytes]:
    """The program in pieces of whole lines. Raises DataError if it cannot be read.

    A line too long for any program comes in pieces, the first of which is refused.
    """
    rest = b""
    try:
        with files.open_regular(Path(program)) as stream:
            while piece := stream.read(CHUNK):
                lines, feed, rest = (rest + piece).rpartition(b"\n")
                if feed:
                    yield lines + feed
                elif len(rest) >= CHUNK:
                    yield rest
                    rest = b""
            if rest:
                yield rest
    except FileNotFoundError:
        raise DataError("there is no such file (an NC program is needed)") from None
    except OSError as err:
        raise DataError(files.why(err)) from None


def _marked(write: Callable[[bytes], object], beginning: bytes, table: str) -> Callable[[bytes], object]:
    """Writes a corrected program with a comment that names the table below the head, which stays first.

    beginning: of the program. Its comments are in parentheses, unless it has those behind a semicolon alone.
    """
    head, text = 0, beginning.decode(errors="replace")
    for number, line in enumerate(text.split("\n"), 1):
        if _HEAD.match(line.strip()):
            head = number
        elif line.strip():
            break
    comment = f";{_MARK}{table.upper()}\n" if ";" in text and "(" not in text else f"({_MARK}{table.upper()})\n"
    left = head

    def marked(data: bytes) -> None:
        nonlocal left, comment
        at = 0
        while comment and left and (feed := data.find(b"\n", at)) >= 0:
            at, left = feed + 1, left - 1
        if not comment or left:
            write(data)
            return
        write(b"".join([data[:at], comment.encode(), data[at:]]))
        comment = ""

    return marked


def _corrected_once(chunks: Iterator[bytes]) -> Iterator[bytes]:
    """The pieces of a program. Raises DataError if it names a table that corrected it before."""
    lines = 0
    for chunk in chunks:
        if (at := chunk.upper().find(_MARK.encode())) >= 0:
            number, first = lines + chunk.count(b"\n", 0, at) + 1, chunk.rfind(b"\n", 0, at) + 1
            comment = chunk[first:].split(b"\n", 1)[0].decode(errors="replace").strip()
            raise DataError(
                f"line {number}: {comment!r}: this program is corrected already, and would be corrected twice; correct "
                "the original program, or use --again"
            )
        lines += chunk.count(b"\n")
        yield chunk


def remarks_on_words(text: str) -> dict[str, str]:
    """What the first word of a program with a length as a whole number, of turning, of a rotary axis leaves open."""
    first = {key: (*_first_match(pattern, text), what) for key, (pattern, what) in _WORDS.items()}
    return {key: f"line {number}: {word} {what}" for key, (number, word, what) in first.items() if word}


def unset_modal_states(text: str) -> str:
    """Modal states that a program does not set and its control's start state decides; '' if it sets all."""
    number, word = _first_match(_LENGTH, text)
    above = "\n".join(_COMMENT.sub("", line) for line in text.splitlines()[:number])
    missing = [missing_word for pattern, missing_word in _MODAL_STATES if not pattern.search(above)]
    return "" if not word or not missing else f"line {number}: {word} comes before any {' and any '.join(missing)}"


def _first_match(pattern: re.Pattern[str], text: str) -> tuple[int, str]:
    """Number of the first line of a program with a match outside of comments, and the match; (0, '') without one."""
    for number, line in enumerate(text.splitlines(), 1):
        if match := pattern.search(_COMMENT.sub("", line)):
            return number, match[0].strip()
    return 0, ""


def _refuse_large(program: Path) -> None:
    """Raises UsageError if a program is too long to be printed."""
    path = Path(program)
    if path.is_file() and path.stat().st_size > MAX_PRINTED_BYTES:
        raise UsageError(f"{program}: too long to be printed ({path.stat().st_size} bytes): name a file (--out FILE)")


def readings_of(table: CompensationTable, at: Mapping[str, float]) -> dict[str, float]:
    """What the table reads besides positions, all of it given. Raises UsageError for what is missing or impossible.

    A temperature that is not given would silently stand at its default, and the correction with it.
    """
    needed = [i for i in table.inputs if i.kind not in ("position", "direction", "tool") and not i.optional]
    allowed = {i.name: i for i in table.inputs if i.kind != "position"}
    for name, value in at.items():
        if name not in allowed:
            known = ", ".join(allowed) or "none"
            raise UsageError(
                f"--at {name}: the table has no such input (inputs: {known}).{did_you_mean(name, allowed)}"
            )
        channel = allowed[name]
        if not (math.isfinite(value) and channel.low <= value <= channel.high):
            raise UsageError(f"--at {name}={value:g}: not plausible (allowed: {channel.low:g} to {channel.high:g})")
    missing = [i for i in needed if i.name not in at]
    if missing:
        words = " ".join(f"--at {i.name}={i.unit or 'VALUE'}" for i in missing)
        raise UsageError(f"correct: the table reads {', '.join(i.name for i in missing)}: give the value ({words})")
    return dict(at)


def outside_validity(table: CompensationTable, at: Mapping[str, float]) -> str:
    """Readings outside what the fit has seen, where the correction fades, in words; '' if there are none."""
    outside = []
    for channel in table.inputs:
        if channel.valid is not None and channel.name in at:
            low, high = channel.valid
            if not low <= at[channel.name] <= high:
                outside.append(
                    f"{channel.name}={at[channel.name]:g} lies outside {low:g} to {high:g}: the correction fades"
                )
    return "; ".join(outside)


def outside_travel(table: CompensationTable, low: np.ndarray, high: np.ndarray) -> str:
    """Places of a program beyond the table's curves, where their ends hold, in words; '' if there are none.

    low, high: (3,) of the commands, machine coordinates, mm. A wrong offset shows here, and inches or least increments.
    """
    outside = []
    for axis in (a for a in MOVED if a in _sample.positions_of(table)):
        n, (first, last) = MOVED.index(axis), _sample.span(table, axis)
        if low[n] < first - MAX_OVERRUN or high[n] > last + MAX_OVERRUN:
            way = f"from {round(low[n], 1):g} to {round(high[n], 1):g} mm of the machine"
            outside.append(f"{axis} moves {way}, the table covers {first:g} to {last:g}: its ends are held beyond")
    return "; ".join(outside)


def _with_extent(deviation: Deviation, low: np.ndarray, high: np.ndarray) -> Deviation:
    """The deviation, which keeps the lowest and highest place that it was asked for."""

    def recorded(points: np.ndarray, length: float) -> np.ndarray:
        np.fmin(low, points.min(axis=0), out=low)
        np.fmax(high, points.max(axis=0), out=high)
        return deviation(points, length)

    return recorded


def depends_on_direction(table: CompensationTable) -> bool:
    """Whether corrections depend on the direction of travel."""
    return any(n.op in ("direction", "approach") for n in table.nodes) or any(
        i.kind == "direction" for i in table.inputs
    )


def _in_direction(table: CompensationTable, side: int) -> CompensationTable:
    """The table in its state at the first cycle of a run in which every axis travels to one side."""
    nodes = [n.model_copy(update={"start": side}) if n.op == "direction" else n for n in table.nodes]
    inputs = [i.model_copy(update={"default": float(side)}) if i.kind == "direction" else i for i in table.inputs]
    return table.model_copy(update={"nodes": tuple(nodes), "inputs": tuple(inputs)})


def deviation_of(table: CompensationTable, at: Mapping[str, float]) -> Deviation:
    """The table as deviation of the tool point, mm, in settled states; lengths of tools go to its tool input.

    Where the table distinguishes directions of travel, the mean of both.
    """
    _refuse_other_axes(table)
    variants = [_in_direction(table, side) for side in (1, -1)] if depends_on_direction(table) else [table]
    axes = {i.axis: i.name for i in table.inputs if i.kind == "position"}
    columns = ["XYZ".index(axis) for axis in axes]
    tool = next((i.name for i in table.inputs if i.kind == "tool"), None)
    outputs = [(n, o.axis, MM[o.correction_unit] * o.factor) for n, o in enumerate(table.outputs) if o.axis in MOVED]

    @cache
    def evaluators(length: float) -> list[batch.Positions]:
        readings = dict(at) | ({tool: length} if tool is not None and tool not in at else {})
        return [batch.Positions(variant, tuple(axes.values()), readings) for variant in variants]

    def deviation(points: np.ndarray, length: float) -> np.ndarray:
        coordinates = np.ascontiguousarray(points.T[columns])
        first, *others = (evaluate.rows(coordinates) for evaluate in evaluators(length))
        corrections = sum(others, first) / len(variants) if others else first
        out = np.zeros(points.shape[::-1])
        for number, axis, factor in outputs:
            out["XYZ".index(axis)] += corrections[number] * factor
        return out.T

    return deviation


def _refuse_other_axes(table: CompensationTable) -> None:
    """Raises GateError for a table that reads or moves what a program is not corrected in."""
    angular = [o.name for o in table.outputs if o.axis in MOVED and o.correction_unit not in MM]
    if angular:
        raise GateError(f"correct: {', '.join(angular)} moves a linear axis by an angle")
    rotary = [i.axis for i in table.inputs if i.kind == "position" and i.axis not in ("X", "Y", "Z")]
    if rotary:
        raise GateError(
            f"correct: the table reads {', '.join(map(str, rotary))}; programs are corrected in X, Y and Z only"
        )
    if not any(o.axis in MOVED for o in table.outputs):
        names = ", ".join(f"{o.name} ({f'axis {o.axis}' if o.axis else 'no axis'})" for o in table.outputs)
        raise GateError(f"correct: the table corrects {names}; programs are corrected in X, Y and Z only")


def setup_of(offsets: Sequence[str], tools: Sequence[str], start: str | None) -> Setup:
    """The set-up from words such as G54=10,20,-30 and H1=120. Raises UsageError for anything else."""
    zeros: dict[str, tuple[float, float, float]] = {"G54": (0.0, 0.0, 0.0)}
    for option in offsets:
        name, _, value = option.partition("=")
        if name not in OFFSETS:
            raise UsageError(f"--offset {option}: {name!r} is not a work offset (allowed: {', '.join(OFFSETS)})")
        zeros[name] = _three_numbers(f"--offset {option}", value)
    lengths = {}
    for option in tools:
        name, _, value = option.partition("=")
        if not name.startswith("H") or not name[1:].isdecimal() or len(name) > 9:
            raise UsageError(f"--tool {option}: write H and its number, such as H1=120")
        lengths[int(name[1:])] = _number(f"--tool {option}", value)
    return Setup(zeros, lengths, None if start is None else _three_numbers(f"--start {start}", start))


def _three_numbers(what: str, text: str) -> tuple[float, float, float]:
    parts = text.split(",")
    if len(parts) != 3:
        raise UsageError(f"{what}: three numbers are needed, such as 10,20,-30")
    x, y, z = (_number(what, part) for part in parts)
    return x, y, z


def _number(what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise UsageError(f"{what}: {text!r} is not a number") from None
    if not abs(value) <= MAX_LENGTH:
        raise UsageError(f"{what}: {text} is not a length in mm (at most {MAX_LENGTH:g})")
    return value
