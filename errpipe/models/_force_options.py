"""Options of the force family: what was pushed, what is cut, and where."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, model_validator

from errpipe.domain.recording import FrozenModel, Recording
from errpipe.errors import DataError
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    from errpipe.kinematics import beam


class Section(FrozenModel):
    """A prismatic part of a shaft or tool: round by `diameter`, else rectangular by `width` and `height`."""

    length: float = quantity("mm", "Along the axis.", gt=0)
    diameter: float = quantity("mm", "Outer diameter.", 0.0, ge=0)
    bore: float = quantity("mm", "Inner diameter.", 0.0, ge=0)
    width: float = quantity("mm", "Across the force.", 0.0, ge=0)
    height: float = quantity("mm", "Along the force.", 0.0, ge=0)

    @model_validator(mode="after")
    def _one_shape(self) -> Section:
        if (self.diameter > 0) == (self.width > 0 and self.height > 0) or self.bore >= max(self.diameter, 1e-9):
            raise ValueError("give a diameter (with a smaller bore), or a width and a height")
        return self


class Body(FrozenModel):
    """A stepped shaft or tool, from its clamped end outwards."""

    sections: tuple[Section, ...] = Field(min_length=1, max_length=100, description="From the clamped end outwards.")
    young: float = quantity("N/mm2", "Young's modulus.", 210e3, gt=0)
    poisson: float = quantity("1", "Poisson's ratio.", 0.3, ge=0, lt=0.5)
    clamp_stiffness: float | None = quantity("N/um", "Radial stiffness of the clamping; none: rigid.", None, gt=0)
    clamp_turning: float | None = quantity("N m/urad", "Its stiffness against tilt; none: rigid.", None, gt=0)
    tailstock: float = quantity("N/um", "Stiffness of a centre at the far end; 0: none.", 0.0, ge=0)

    def at(self, places: np.ndarray | None = None) -> np.ndarray:
        """Compliance at distances from the clamped end (default: the far end), um/N."""

        from errpipe.kinematics import beam

        parts: list[beam.Section] = [beam.Section(**s.model_dump()) for s in self.sections]
        support = beam.Support(self.clamp_stiffness, self.clamp_turning, self.tailstock)
        where = np.array([self.length]) if places is None else places
        try:
            return beam.compliance(parts, where, support, self.young, self.poisson)
        except ValueError as err:
            raise DataError(f"push tests: {err}: give `chuck_face` and all sections") from None

    @property
    def length(self) -> float:
        """From the clamped to the far end, mm."""
        return sum(s.length for s in self.sections)


class ForceOptions(FrozenModel):
    """Options of the family in a pipeline file."""

    family: Literal["force"] = Field("force", description="Model family.")
    configuration: Literal["turning", "milling"] = Field(
        "turning", description="turning: workpiece compliance along the axis of the cut; milling: tool and structure."
    )
    component: str = Field("E_X", description="Component that the force moves, such as E_X, or E_D (twice the radius).")
    force: str = Field(description="Column of the force, in the direction of the deviation.")
    axis: str | None = Field(None, pattern="^[A-Z]$", description="Axis along which the cut moves (turning: Z).")
    chuck_face: float = quantity("mm", "Position of the axis at the clamped end of the workpiece.", 0.0)
    outwards: Literal[1, -1] = Field(1, description="Direction of the axis away from the clamped end.")
    sign: Literal[1, -1] = Field(1, description="Direction of the deviation under a positive force; 1: away from it.")
    workpiece: Body | None = Field(None, description="The workpiece that is cut.")
    tool: Body | None = Field(None, description="The tool that cuts, from its holder outwards.")
    pushed_workpiece: Body | None = Field(None, description="Workpiece of the push tests; default: rigid.")
    pushed_tool: Body | None = Field(None, description="The tool of the tests; default: rigid.")
    gauge_datum: Literal["neighbour", "bed"] = Field(
        "neighbour",
        description="Reference of a gauge at the workpiece if several gauges were recorded: the spindle "
        "(neighbour), or the bed as for the others.",
    )

    @model_validator(mode="after")
    def _complete(self) -> ForceOptions:
        if self.configuration == "turning" and self.axis is None:
            raise ValueError("turning needs the axis of the cut (axis: Z)")
        if self.configuration == "milling" and (self.workpiece or self.pushed_workpiece):
            raise ValueError("milling takes the workpiece as rigid: omit it")
        return self

    def missing_input(self, recording: Recording) -> str:
        """The force, and the position of the axis of the cut."""
        forces = recording.names("force")
        axes = [recording.manifest.columns[name].axis for name in recording.names("position")]
        if self.force not in forces:
            return f"push tests: no column {self.force!r} of role force (there are: {', '.join(forces) or 'none'})"
        if self.axis is not None and self.axis not in axes:
            return f"push tests: no position of axis {self.axis} (there are: {', '.join(map(str, axes)) or 'none'})"
        return ""
