"""Static push tests and the geometry of tool and workpiece in, the deviation under a cutting force out."""

from __future__ import annotations

from typing import ClassVar, Literal

from errpipe.models.force import FIGURES, Force
from errpipe.stages import _artefacts
from errpipe.stages.fit import FitStage


class IdentifyForce(Force, FitStage):
    """Compliance of machine, workpiece and tool over the cut, times a force that the controller reads every cycle.

    Push tests hold one error column, the deviation between tool and work, or one for each gauge, whose place is its
    `location` (tool_post, spindle, workpiece): the compliance of each is reported, and their sum corrected. A missing
    force reading gives no force correction. Validation is on push tests: no public recording of cutting force against
    part size was found.
    """

    kind: Literal["identify_force"]  # type: ignore[assignment]
    variant_key: ClassVar[str] = ""
    default_variant: ClassVar[str] = ""
    of: ClassVar[type[Force]] = Force

    def outputs(self) -> tuple[str, ...]:
        return (_artefacts.MODEL, _artefacts.PROCEDURE, FIGURES)
