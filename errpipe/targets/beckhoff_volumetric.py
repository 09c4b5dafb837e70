"""TwinCAT CNC TF5280 / ISG volumetric table: components over each axis, `X EXX EYX ... ECX`, blocks between `#`.

Value     the component itself (a deviation) in mm or rad; arguments in mm, of rotary axes in DEGREES.
Sign      components after ISO 230-1, straightness without its slope; squareness as its own rows.
Limits    the controller makes the synthesis for its own kinematics; position only, no tool orientation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain import components as iso
from errpipe.domain.table import CompensationTable, Component
from errpipe.errors import GateError
from errpipe.tables import batch, by_component
from errpipe.targets import _sample
from errpipe.targets._base import Curve, ReadBack, Target, expect

FILE = "volumetric.csv"
POINTS = 201  # of each curve
SCALE = {"um": 1e-3, "urad": 1e-6}  # to mm and rad


class BeckhoffVolumetric(Target):
    """Error motions of each axis as columns; the reader gives back those along the axes themselves."""

    name = "beckhoff_volumetric"
    controller = "TwinCAT CNC TF5280, ISG kernel"
    confidence = "documented"
    sign = "a positive EXX means the axis travels too far (a deviation); the controller moves it in minus"
    limits = "components over one axis; 5 compensations of 10 files; static: temperatures are at their default"
    unit = "mm and rad; positions in mm (deg)"
    holds = ("screw",)
    synthesised = True
    source = "TF5280 volumetric compensation, ISG CSV; ISG kernel units page"
    activation = (
        "list the file in the volumetric compensation's configuration; mm and rad, arguments of rotary axes in degrees",
        "compare the axis' compensation at three points along X with the table's EXX, sign included",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        _refuse_other_signs(table)
        blocks = []
        for axis, name in _sample.positions_of(table).items():
            own = [c for c in table.components if _axis_of(c.name) == axis]
            if own:
                blocks.append(_block(table, axis, name, own))
        if not blocks:
            raise GateError("beckhoff_volumetric: the table holds no error motion of an axis")
        return {FILE: "#\n".join(blocks)}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        curves = []
        for block in files[FILE].split("#\n"):
            lines = [line.split() for line in block.splitlines() if line.strip() and not line.startswith("//")]
            names, rows = lines[0], np.array(lines[1:], dtype=float)
            expect(bool(np.all(np.diff(rows[:, 0]) > 0)), FILE, f"{names[0]} is not ascending")
            for column, component in enumerate(names[1:], 1):
                parsed = iso.parse(component)
                if parsed.kind in ("positioning", "angular positioning"):
                    value = -rows[:, column] * _sample.MACHINE_UNITS["rad" if parsed.unit == "urad" else "mm"]
                    curves.append(Curve(names[0], names[0], rows[:, 0], value, value))
        return ReadBack(curves=tuple(curves))


def _refuse_other_signs(table: CompensationTable) -> None:
    """Raise GateError for components that count against their axis: the controller would move it the opposite way."""
    for output in table.outputs:
        for term in (t for t in output.terms if output.axis and not t.factors and t.weight < 0):
            if _axis_of(term.component) == output.axis == term.component[1:2]:
                raise GateError(
                    f"beckhoff_volumetric: {term.component} of this machine file counts against the motion of "
                    f"{output.axis} (errors_of: carriage, or a direction against its letter), in the file it would not"
                )


def _axis_of(component: str) -> str | None:
    """Axis whose motion a component is; none for a name that ISO 230-1 does not know."""
    try:
        return iso.parse(component).axis
    except ValueError:
        return None


def _block(table: CompensationTable, axis: str, name: str, own: Sequence[Component]) -> str:
    low, high = _sample.span(table, axis)
    x = np.linspace(low, high, POINTS)
    values = component_values(table, name, x)
    header = " ".join([axis, *(c.name for c in own)])
    rows = [
        " ".join([f"{p:.6f}", *(f"{values[c.name][n] * SCALE[c.unit]:.12g}" for c in own)]) for n, p in enumerate(x)
    ]
    return "\n".join([f"// mm and rad; deviations after ISO 230-1 over {axis}", header, *rows, ""])


def component_values(table: CompensationTable, name: str, x: np.ndarray) -> dict[str, np.ndarray]:
    """Components along one position input, others in the middle, in um or urad: mean of both directions."""
    bare = by_component(table)
    start = {i.name: i.default for i in bare.inputs if not i.optional} | _sample.reference_readings(table)
    total: dict[str, np.ndarray] = {}
    for side in (1.0, -1.0):
        order = x if side > 0 else x[::-1]
        path = np.r_[order[0] - side, order]
        columns = {i: np.full(path.size, v) for i, v in start.items()} | {name: path}
        replay = batch.evaluate(bare, columns, np.zeros(path.size), np.zeros(path.size, dtype=int))
        for component, values in replay.deviation.items():
            total[component] = total.get(component, 0.0) + values[1:][:: int(side)] / 2
    return total
