"""A simulated measuring test: the machine's geometry is a file, its errors are random and smooth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from errpipe import yamlfile
from errpipe.domain.laser import Laser
from errpipe.domain.protocols import PROTOCOLS
from errpipe.pipeline.stage import Context, InputPath, Stage
from errpipe.stages._artefacts import TRUTH
from errpipe.stages.identify import LASERS, SQUARES
from errpipe.yamlfile import quantity

RECORDS = ("laser", "level")  # of one axis each: `direct` simulates all of them
if TYPE_CHECKING:
    Protocol = str
else:
    Protocol = Literal[("direct", *(name for name in PROTOCOLS if name not in RECORDS))]


class SimulateTest(Stage):
    """Simulate one measuring protocol on a machine by full homogeneous transforms, with set-up errors and noise.

    The seed defines the machine: tests with equal seeds are of the same machine.
    """

    kind: Literal["simulate_test"]
    machine: InputPath = Field(description="Machine file with the kinematic chain.")
    protocol: Protocol = Field(
        "point_cloud", description="Which test; direct: laser and level along each axis, both ways."
    )
    points: int = Field(150, ge=20, le=5000, description="Places of a point cloud, each seen with three tools.")
    targets: int = Field(17, ge=5, le=500, description="Targets along each axis of a direct measurement.")
    cycles: int = Field(
        3, ge=1, le=50, description="Number of passes of each axis in both directions in a direct measurement."
    )
    reversal: float = quantity("um", "Typical reversal of an axis in a direct measurement.", 4.0, ge=0)
    noise: float = quantity("um", "Standard deviation of a reading.", 0.5, gt=0)
    seed: int = Field(1, ge=0, description="Seed of the machine's errors and of the noise.")
    lasers: dict[str, Laser] = LASERS
    squares: dict[str, float] = SQUARES
    gives: ClassVar[tuple[str, ...]] = ("raw_recording", "simulated_truth")
    writes: ClassVar[tuple[str, ...]] = ("recording.yaml", "recording.csv", TRUTH)
    code_version: ClassVar[int] = 2

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.domain.machine import Machine
        from errpipe.kinematics import residual_error
        from errpipe.kinematics.chain import compile_chain
        from errpipe.simulation import folder, metrology

        chain = compile_chain(yamlfile.load(self.machine, Machine))
        values = metrology.smooth_machine(chain, self.seed)
        recording = self._direct(chain, values) if self.protocol == "direct" else self._indirect(chain, values)
        folder.write(context.folder, recording)
        context.write_json(TRUTH, residual_error.truth_document(chain, values))
        return {"rows": len(recording), "components": len(chain.components)}

    def _indirect(self, chain: Any, values: Any) -> Any:
        from errpipe.simulation import measuring_runs, metrology

        if self.protocol == "point_cloud":
            runs = measuring_runs.cloud(chain, self.points, self.seed)
        else:
            runs = measuring_runs.PROTOCOLS[self.protocol](chain)
        return metrology.simulate_runs(chain, values, self.protocol, runs, self.seed, noise=self.noise)

    def _direct(self, chain: Any, values: Any) -> Any:
        from errpipe.simulation import direct_records as d

        setup = d.SetUp(
            targets=self.targets,
            cycles=self.cycles,
            noise=self.noise,
            angle_noise=self.noise,
            reversal=self.reversal,
            beams=self.lasers,
            squares=self.squares,
        )
        return d.record(chain, values, setup, self.seed)
