"""An NC program rewritten with a table, so that the uncorrected machine cuts the wanted part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from errpipe.errors import DataError, GateError, UsageError
from errpipe.stages import _artefacts

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable
    from errpipe.ncprogram.correct import Deviation
    from errpipe.ncprogram.modal import Setup

MM = {"mm": 1.0, "um": 1e-3}  # per correction unit
MOVED = ("X", "Y", "Z")


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
) -> dict[str, Any]:
    """Write the corrected program. Raises DataError naming the line of anything that is not understood."""
    from errpipe import jsonfile
    from errpipe.ncprogram.correct import correct as rewrite

    try:
        text = Path(program).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError(f"{program}: there is no such file (an NC program is needed)") from None
    except OSError as err:
        raise DataError(f"{program}: cannot be read: {(err.strerror or str(err)).lower()}") from None
    except UnicodeDecodeError as err:
        raise DataError(f"{program}: not UTF-8 text (byte 0x{err.object[err.start]:02x})") from None
    found = _artefacts.read_table(table)
    deviation = deviation_of(found, at)
    try:
        corrected, done = rewrite(
            text, deviation, setup_of(offsets, tools, start), chord_error=chord_error, longest=longest
        )
    except DataError as err:
        raise DataError(f"{program}, {err}") from None
    result: dict[str, Any] = {
        "moves": done.moves,
        "blocks_in": done.blocks_in,
        "blocks_out": done.blocks_out,
        "largest_correction_um": 1e3 * done.largest_correction,
        "largest_chord_error_um": 1e3 * done.largest_chord_error,
    }
    if knows_direction(found):
        result["direction"] = "the mean of both directions of travel: lost motion is not corrected in a program"
    if out is None:
        return {**result, "program": corrected, "says": corrected.rstrip("\n")}
    jsonfile.write_text(Path(out), corrected)
    return {**result, "written": str(out)}


def knows_direction(table: CompensationTable) -> bool:
    """Whether corrections depend on the direction of travel."""
    return any(n.op in ("direction", "approach") for n in table.nodes) or any(
        i.kind == "direction" for i in table.inputs
    )


def _travelling(table: CompensationTable, side: int) -> CompensationTable:
    """The table as it stands in the first cycle of a run where every axis travels to one side."""
    nodes = [n.model_copy(update={"start": side}) if n.op == "direction" else n for n in table.nodes]
    inputs = [i.model_copy(update={"default": float(side)}) if i.kind == "direction" else i for i in table.inputs]
    return table.model_copy(update={"nodes": tuple(nodes), "inputs": tuple(inputs)})


def deviation_of(table: CompensationTable, at: Mapping[str, float]) -> Deviation:
    """The table as deviation of the tool point, mm, in settled states; lengths of tools go to its tool input.

    Where the table knows directions of travel, the mean of both.
    """
    import numpy as np

    from errpipe.tables import batch

    ways = [_travelling(table, side) for side in (1, -1)] if knows_direction(table) else [table]

    axes = {i.axis: i.name for i in table.inputs if i.kind == "position"}
    angular = [o.name for o in table.outputs if o.axis in MOVED and o.correction_unit not in MM]
    if angular:
        raise GateError(f"correct: {', '.join(angular)} moves a linear axis by an angle")
    rotary = [a for a in axes if a not in "XYZ"]
    if rotary:
        raise GateError(f"correct: the table reads {', '.join(rotary)}; programs are corrected in X, Y and Z only")
    tool = next((i.name for i in table.inputs if i.kind == "tool"), None)
    outputs = [(n, o.axis, MM[o.correction_unit] * o.factor) for n, o in enumerate(table.outputs) if o.axis in MOVED]
    moving = tuple(axes)

    def deviation(points: np.ndarray, length: float) -> np.ndarray:
        readings = dict(at) | ({tool: length} if tool is not None and tool not in at else {})
        there, names = points[:, ["XYZ".index(a) for a in moving]], tuple(axes[a] for a in moving)
        found = np.mean([batch.position(way, there, names, readings) for way in ways], axis=0)
        out = np.zeros_like(points)
        for number, axis, factor in outputs:
            out[:, "XYZ".index(axis)] += found[:, number] * factor
        return out

    return deviation


def setup_of(offsets: Sequence[str], tools: Sequence[str], start: str | None) -> Setup:
    """The set-up from words such as G54=10,20,-30 and H1=120. Raises UsageError for anything else."""
    from errpipe.ncprogram.modal import OFFSETS, Setup

    zeros: dict[str, tuple[float, float, float]] = {"G54": (0.0, 0.0, 0.0)}
    for word in offsets:
        name, _, rest = word.partition("=")
        if name not in OFFSETS:
            raise UsageError(f"--offset {word}: {name!r} is not a work offset (allowed: {', '.join(OFFSETS)})")
        zeros[name] = _three(f"--offset {word}", rest)
    lengths = {}
    for word in tools:
        name, _, rest = word.partition("=")
        if not name.startswith("H") or not name[1:].isdigit():
            raise UsageError(f"--tool {word}: write H and its number, such as H1=120")
        lengths[int(name[1:])] = _number(f"--tool {word}", rest)
    return Setup(zeros, lengths, None if start is None else _three(f"--start {start}", start))


def _three(what: str, text: str) -> tuple[float, float, float]:
    parts = text.split(",")
    if len(parts) != 3:
        raise UsageError(f"{what}: three numbers are needed, such as 10,20,-30")
    x, y, z = (_number(what, part) for part in parts)
    return x, y, z


def _number(what: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{what}: {text!r} is not a number") from None
