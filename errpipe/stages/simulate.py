"""A simulated measurement: a recording folder made by errpipe's own simulation of a machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.pipeline.stage import Context, Stage


class Simulate(Stage):
    """Write a simulated recording; equal seeds give equal bytes."""

    kind: Literal["simulate"]
    machine: Literal["ball-screw-axis", "spindle-drift"] = Field(
        "ball-screw-axis", description="Simulated machine: an axis in nine thermal states, or a spindle that warms up."
    )
    seed: int = Field(1, ge=0, description="Seed of the noise and of the room's weather.")

    gives: ClassVar[tuple[str, ...]] = ("raw_recording",)
    writes: ClassVar[tuple[str, ...]] = ("recording.yaml", "recording.csv")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.simulation import ball_screw_axis, folder, spindle_drift

        if self.machine == "ball-screw-axis":
            recording = ball_screw_axis.simulate(self.seed).recording
        else:
            recording, _ = spindle_drift.simulate(self.seed)
        folder.write(context.folder, recording)
        return {"rows": len(recording), "simulated": "yes"}
