"""An identified machine compiled into a volumetric table: component profiles and the synthesis at the tool point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe import jsonfile, yamlfile
from errpipe.errors import UsageError, VerifyError
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts
from errpipe.stages._signed import SignOptions
from errpipe.stages.identify import IDENTIFICATION, MACHINE
from errpipe.validation.codes import Code
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable, TableInput

STATES = 500  # random poses at which table and identified machine are compared
ROUNDING = 2e-3  # um, as `verify` allows: gridding errors are the largest seen, and profiles are rounded to 1 nm
LATTICE = "lattice.csv"
OVERRUN = 5.0  # mm (deg) beyond the travel that a position may still read: overrun to approach from the other side


class ExportVolumetric(SignOptions, Stage):
    """Tool length and offsets are inputs at run time; the cost of a cycle is fixed."""

    kind: Literal["export_volumetric"]
    error_bound: float = quantity("um", "Largest interpolation error of any profile.", 0.01, gt=0)
    lattice: tuple[int, ...] | None = Field(
        None,
        min_length=2,
        max_length=3,
        description="Points along each linear axis: write the deviation on a lattice "
        "too, as lattice.csv, for a controller that takes nothing else. It holds for one tool.",
    )
    lattice_tool: float = quantity("mm", "Length of that tool.", 100.0, ge=0)
    targets: tuple[str, ...] = Field((), description="Controller formats to write, by name (`errpipe targets`).")
    limit: float | None = quantity(
        "um", "Largest plausible correction of an axis; default: 0.5 mm, or 1/1000 of the travel.", None, gt=0
    )
    allow: tuple[Code, ...] = Field((), description="Implausible corrections that are true, by name.")
    ungated: bool = Field(
        False, description="Export an identification too that is not expected to make the machine better."
    )
    takes: ClassVar[Mapping[str, Need]] = {
        "identified_machine": Need("identified_machine"),
        "validation": Need("validation", optional=True, every=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("table",)
    writes: ClassVar[tuple[str, ...]] = (_artefacts.TABLE, _artefacts.TWIN, "export.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.domain.machine import Machine
        from errpipe.kinematics import summary
        from errpipe.kinematics.chain import compile_chain
        from errpipe.stages import _plausible
        from errpipe.stages.targets import checksums, write_targets
        from errpipe.validation.machine import compensated

        folder = context.needed("identified_machine")
        chain = compile_chain(yamlfile.load(folder / MACHINE, Machine))
        document = jsonfile.read(folder / IDENTIFICATION)
        axes = self._axes_that_gain(context, document, chain)
        factors = dict.fromkeys(chain.components, 1.0) if self.ungated else compensated(document, chain)
        errors = summary.errors(chain, document, factors)
        reversal_lines = {
            n: (factors[n] * value, factors[n] * slope, middle)
            for n, (value, slope, middle) in reversals(document).items()
            if n in factors
        }
        title = _artefacts.ungated_title(context.title) if self.ungated else context.title
        title = _artefacts.sign_title(title) if document.get("sign") == "assumed" else title
        table = compile_machine(
            chain, errors, jsonfile.fingerprint(document), title, self.error_bound, reversal_lines, axes
        )
        _plausible.refuse_table(table, self.allow, self.limit)
        worst, allowed = largest_difference(chain, errors, table, reversal_lines), bound(chain, table)
        verify_bound(worst, allowed)
        _artefacts.write_table(context.folder, table)
        missed = curve_misfit(chain, document)
        stated = {"bound_um": allowed + missed, "interpolation_um": allowed, "unfollowed_um": missed}
        proof = [{"component": "tool point", "largest_difference_um": worst, **stated}]
        files = [{"file": _artefacts.TABLE, "what": "volumetric table", "error": "0", "read_back": "equal"}]
        remarks = self.write_signature(table, context.folder / _artefacts.TABLE)
        left_out = [axis for axis in chain.machine.correcting_axes() if axis not in axes]
        left_out += [component for component in chain.components if component not in factors]
        in_part = {name: factor for name, factor in factors.items() if factor < 1.0}
        note = not_corrected(left_out, in_part)
        files += write_targets(table, self.targets, context.folder, remarks, note, partial(_motion, chain))
        facts: dict[str, Any] = {"proof": proof, "files": files, "left_out": left_out, "in_part": in_part, "note": note}
        if self.lattice is not None:
            facts["lattice"], text = lattice(chain, errors, self.lattice, self.lattice_tool, axes)
            context.write_text(LATTICE, text)
        facts["sha256"] = checksums(context.folder, files, [_artefacts.TWIN, *([LATTICE] if self.lattice else [])])
        context.write_json("export.json", {"export": 1, "inputs": context.fingerprint, **facts})
        worse = ". ".join(dict.fromkeys(sentence for row in files for sentence in row.get("worse", ())))
        figures = {"table": _artefacts.TABLE, "largest_difference_um": worst}
        return {**figures, **({"worse": worse} if worse else {})}

    def _axes_that_gain(self, context: Context, document: Mapping[str, Any], chain: Any) -> tuple[str, ...]:
        """Linear axes that a table corrects. Raises UsageError without one, GateError if the machine may get worse."""
        from errpipe.validation import machine

        if not chain.machine.correcting_axes():
            raise UsageError(
                "export_volumetric: the machine has no linear axis with a fixed direction that a table could move. "
                "Positioning of a rotary axis is exported by `identify_direct`, `validate` and `export`."
            )
        if self.ungated:
            return chain.machine.correcting_axes()
        validations = [jsonfile.read(at / _artefacts.VALIDATION) for at in context.every("validation").values()]
        fingerprint = jsonfile.fingerprint(document)
        judged = [
            v["machine"]["tests"] for v in validations if v.get("machine", {}).get("identification") == fingerprint
        ]
        return machine.pass_gate(document, judged)


def _motion(chain: Any, at: Mapping[str, np.ndarray]) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """`_loss.Motion` of a machine; axes without a position stand in the middle."""
    from errpipe.kinematics import synthesis

    columns = [
        at.get(axis, np.full(1, middle)) for axis, middle in zip(chain.axes, chain.travel.mean(axis=1), strict=True)
    ]
    q = np.stack(np.broadcast_arrays(*columns), axis=1)
    return chain.machine.correcting_axes(), synthesis.linear_motion(chain, q), synthesis.ideal_pose(chain, q)[:, 0]


def not_corrected(names: Sequence[str], in_part: Mapping[str, float]) -> str:
    """What a table corrects not or in part, as sentences for the checklists; nothing where it corrects all."""
    sentences = [f"Not corrected by this table: {', '.join(names)}."] if names else []
    shares = ", ".join(f"{name} {factor:.0%}" for name, factor in in_part.items())
    sentences += [f"Corrected in part: {shares}."] if shares else []
    if not sentences:
        return ""
    why = "The measurements do not show well enough that more correction makes every axis better; the rest stays."
    return " ".join([*sentences, why])


def bound(chain: Any, table: CompensationTable) -> float:
    """How far the table's tool point can be from the identified one anywhere, um, for a tool of 100 mm."""
    from errpipe.kinematics import compensation
    from errpipe.tables import bounds

    off = {c.name: c.gridding for c in bounds.components(table)}
    return compensation.profile_bound(chain, off, chain.tip(100.0, (0.0, 0.0, 0.0)))


def curve_misfit(chain: Any, document: Mapping[str, Any]) -> float:
    """How far what was measured can be from the identified curves, at the tool point of a tool of 100 mm, um.

    Each component counts with the largest mean residual of its targets and its largest arm in the volume.
    """
    from errpipe.kinematics import compensation

    largest = document.get("unfollowed_largest", {})
    return compensation.profile_bound(chain, largest, chain.tip(100.0, (0.0, 0.0, 0.0)))


def lattice(
    chain: Any, errors: Any, counts: tuple[int, ...], length: float, axes: tuple[str, ...]
) -> tuple[dict[str, Any], str]:
    """Deviations on a lattice over the linear axes for one tool, and how far straight lines between may be off.

    axes: those that are corrected; the others' deviation is written as 0.

    Raises UsageError if the counts do not fit the machine.
    """
    from errpipe.kinematics import compensation
    from errpipe.kinematics.chain import combinations

    try:
        sampled = compensation.lattice(errors, counts, chain.tip(length, (0.0, 0.0, 0.0)))
    except ValueError as err:
        raise UsageError(f"export_volumetric: lattice: {err}") from None
    places = combinations(sampled.grids)
    corrected = [float(letter in axes) for letter in "XYZ"]
    rows = np.column_stack([places, sampled.values.reshape(-1, 3) * corrected])
    lines = [",".join([*sampled.axes, "E_X", "E_Y", "E_Z"])]
    lines += [",".join(f"{v + 0.0:.4f}" for v in row) for row in rows]
    facts = {
        "file": LATTICE,
        "axes": list(sampled.axes),
        "counts": list(counts),
        "tool_length_mm": length,
        "bound_um": sampled.bound,
        "largest_seen_um": sampled.largest_seen,
        "says": "deviation in um, positions in mm",
    }
    return facts, "\n".join(lines) + "\n"


def reversals(document: Mapping[str, Any]) -> dict[str, tuple[float, float, float]]:
    """Reversal line and its middle by component; values not significant at 95 % are 0."""
    from errpipe.kinematics import records

    return {n: (*records.reversal_line(r), float(r["middle"])) for n, r in document.get("reversal", {}).items()}


def compile_machine(
    chain: Any,
    errors: Any,
    fingerprint: str,
    title: str,
    error_bound: float,
    turning: Mapping[str, tuple[float, float, float]],
    axes: tuple[str, ...],
) -> CompensationTable:
    """The volumetric table of a machine; `turning`: reversal of a component at the middle, per metre, the middle.

    axes: linear axes that it corrects.
    """
    from errpipe import __version__, tables
    from errpipe.kinematics import compensation

    pairs = compensation.lowered(errors, turning)
    outputs = list(compensation.outputs(chain, tuple(pairs), axes))
    table = tables.compile_table(
        [tables.ComponentSource(name, chain.unit(name), pair) for name, pair in pairs.items()],
        inputs=_inputs(chain),
        outputs=outputs,
        travel={axis: tuple(t) for axis, t in zip(chain.axes, chain.travel, strict=True)},
        error_bound=error_bound,
        machine=chain.machine.name,
        title=title,
        version=__version__,
        fingerprint=fingerprint,
    )
    return tables.limited(table)


def _inputs(chain: Any) -> list[TableInput]:
    from errpipe.domain.table import TableInput

    inputs = []
    for axis, (low, high) in zip(chain.axes, chain.travel.tolist(), strict=True):
        ends = {"low": low - OVERRUN, "high": high + OVERRUN, "default": min(max(0.0, low), high)}
        inputs.append(TableInput(name=axis, kind="position", axis=axis, unit=chain.axis_unit(axis), **ends))
    tool: dict[str, Any] = {"kind": "tool", "unit": "mm"}
    inputs.append(TableInput(name="tool_length", low=0, high=1000, default=100, **tool))
    return inputs + [TableInput(name=f"tool_offset_{d}", low=-500, high=500, default=0, **tool) for d in "XYZ"]


def largest_difference(
    chain: Any, errors: Any, table: CompensationTable, turning: Mapping[str, tuple[float, float, float]] | None = None
) -> float:
    """Table minus identified machine at random poses, um: gridding and rounding. Every axis approached from below.

    Both as a displacement of the tool point in the workpiece's frame: the directions in which the linear axes move it
    are taken at each pose, as rotary axes turn them.
    """
    from errpipe.kinematics import synthesis
    from errpipe.tables import batch

    q = np.random.default_rng(0).uniform(chain.travel[:, 0], chain.travel[:, 1], (STATES, len(chain.axes)))
    tip = chain.tip(100.0, (0.0, 0.0, 0.0))
    values = errors.at(q)
    for name, (value, slope, middle) in (turning or {}).items():
        c = chain.index(name)
        values[:, c] += 0.5 * (value + slope * (q[:, chain.drives[c]] - middle) * 1e-3)
    expected = synthesis.first_order(chain, q, values, tip)[:, :3]
    known = {i.name for i in table.inputs}  # an axis or a tool that nothing depends on is no input
    moving = [n for n, a in enumerate(chain.axes) if a in known]
    readings = {"tool_length": 100.0} if "tool_length" in known else {}
    of_table = batch.position(table, np.ascontiguousarray(q[:, moving]), tuple(chain.axes[n] for n in moving), readings)
    linear = [n for n, o in enumerate(table.outputs) if o.axis in chain.machine.correcting_axes()]
    if not linear:
        return 0.0
    nominal = synthesis.ideal_pose(chain, q, tip)[:, 0]
    steps = [np.eye(len(chain.axes))[chain.axes.index(table.outputs[n].axis)] for n in linear]
    directions = np.stack([synthesis.ideal_pose(chain, q + step, tip)[:, 0] - nominal for step in steps], axis=2)
    reachable = directions @ (np.linalg.pinv(directions) @ expected[:, :, None])  # the part that these axes can move
    difference = reachable[:, :, 0] - np.einsum("nij,nj->ni", directions, of_table[:, linear])
    return float(np.linalg.norm(difference, axis=1).max())


def verify_bound(worst: float, allowed: float) -> None:
    """Raises VerifyError if a proof is larger than its bound: the table is not the machine that was identified."""
    if not worst <= allowed + ROUNDING:
        raise VerifyError(
            f"export: the table differs from the identified machine by {worst:.4g} um, its bound is {allowed:.4g} um. "
            "Nothing was exported."
        )
