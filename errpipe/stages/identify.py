"""Direct and indirect tests in, every error component of a machine out, with what is not observable."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.domain.laser import Laser
from errpipe.pipeline.stage import Context, InputPath, Need, Stage
from errpipe.yamlfile import quantity

IDENTIFICATION = "identification.json"
MACHINE = "machine.yaml"
LASERS: Any = Field(
    {}, description="Set-up of the laser, by component: dead path, cosine error and Abbe offset are corrected."
)
SQUARES: Any = quantity(
    "urad",
    "Squareness whose two straightness records were made against one square, and what that square itself "
    "would read on a perfect machine.",
    {},
)


class Identify(Stage):
    """Identify all components of a machine jointly from the readings of all ingested tests.

    A recording of error motions (EXX, EBX ...) is a laser or level record; any other states its protocol
    (docs/recordings.md lists them).
    """

    kind: Literal["identify"]
    machine: InputPath = Field(description="Machine file with the kinematic chain.")
    modes: int | None = Field(
        None,
        ge=2,
        le=120,
        description="Waves per error motion, regularised by the data; default: as many as the targets resolve.",
    )
    without: tuple[str, ...] = Field((), description="Components assumed to be zero, such as spindle growth.")
    lasers: dict[str, Laser] = LASERS
    squares: dict[str, float] = SQUARES
    takes: ClassVar[Mapping[str, Need]] = {
        "recordings": Need("recording", every=True),
        "simulated": Need("simulated_truth", optional=True, every=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("identified_machine",)
    writes: ClassVar[tuple[str, ...]] = (IDENTIFICATION, MACHINE, "identification.html")
    code_version: ClassVar[int] = 4
    reads_tests: ClassVar[bool] = True  # `errpipe check` asks each recording which test it is

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.stages import _machine_page

        solved = _machine_page.solve(self, context)
        document = solved.document
        context.write_json(IDENTIFICATION, {**document, "inputs": context.fingerprint})
        shutil.copyfile(self.machine, context.folder / MACHINE)
        context.write_text("identification.html", _machine_page.page(solved, context.title))
        volumetric = document["volumetric"]
        out = {
            "components": len(solved.chain.components),
            "volumetric_rms_um": volumetric["effect_rms_um"],
            "expected_after_um": volumetric["left_rms_um"],
            "unseen": len(document["unseen"]),
        }
        out |= {"places": document["places"]} if "places" in document else {}
        truth = document.get("simulated_truth")
        return out | ({"true_residual_rms_um": truth["after_rms_um"]} if truth else {})

    def procedure(self) -> dict[str, Any]:
        """Options that repeat the identification on other rows, JSON values."""
        lasers = {name: beam.model_dump(mode="json") for name, beam in self.lasers.items()}
        return {"without": list(self.without), "lasers": lasers, "squares": dict(self.squares)}
