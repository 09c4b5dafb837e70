"""A measuring test on a machine that never existed: its geometry is a file, its errors are random and smooth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from errpipe.pipeline.stage import Context, InputPath, Stage

TOOLS = ((80.0, (0.0, 0.0, 0.0)), (200.0, (0.0, 0.0, 0.0)), (120.0, (60.0, 40.0, 0.0)))


class SimulateTest(Stage):
    """Point clouds with three tools over the work space, as a tracker or multilateration gives them."""

    kind: Literal["simulate_test"]
    machine: InputPath = Field(description="Machine file with the kinematic chain.")
    points: int = Field(150, ge=20, le=5000, description="Places in the work space, each seen with three tools.")
    noise: float = Field(0.5, gt=0, description="Standard deviation of a reading.", json_schema_extra={"unit": "um"})
    seed: int = Field(1, ge=0, description="Seed of the machine's errors and of the noise.")

    def outputs(self) -> tuple[str, ...]:
        return ("recording.yaml", "recording.csv")

    def run(self, context: Context) -> Mapping[str, Any]:
        import numpy as np

        from errpipe import yamlfile
        from errpipe.domain.machine import Machine
        from errpipe.kinematics.chain import compile_chain
        from errpipe.simulation import folder, metrology

        chain = compile_chain(yamlfile.load(self.machine, Machine))
        rng = np.random.default_rng(self.seed)
        low, high = chain.travel.T
        share = np.column_stack([(rng.permutation(self.points) + 0.5) / self.points for _ in chain.axes])
        places = low + share * (high - low)
        runs = [metrology.Run(f"tool {n}", places, length, offset) for n, (length, offset) in enumerate(TOOLS)]
        values = metrology.smooth_machine(chain, self.seed)
        recording = metrology.record(chain, values, "point_cloud", runs, self.seed, noise=self.noise)
        folder.write(context.folder, recording)
        return {"rows": len(recording), "components": len(chain.components)}
