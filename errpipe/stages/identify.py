"""Direct and indirect tests in, every error component of a machine out, with what the tests could not see."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.pipeline.stage import Context, InputPath, Need, Stage
from errpipe.stages import _artefacts

IDENTIFICATION = "identification.json"
MACHINE = "machine.yaml"


class Identify(Stage):
    """Solve for all components of a machine from the readings of every ingested test together."""

    kind: Literal["identify"]
    machine: InputPath = Field(description="Machine file with the kinematic chain.")
    modes: int = Field(12, ge=2, le=40, description="Waves per error motion; they are shrunk to what the data say.")
    without: tuple[str, ...] = Field((), description="Components taken to be nothing, such as spindle growth.")
    reads: ClassVar[Mapping[str, Need]] = {"recordings": Need("ingest", "clean", every=True)}

    def outputs(self) -> tuple[str, ...]:
        return (IDENTIFICATION, MACHINE, "identification.html")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe import yamlfile
        from errpipe.domain.machine import Machine
        from errpipe.kinematics import identify, observations, protocols, summary
        from errpipe.kinematics.chain import compile_chain
        from errpipe.stages.measure import ballbar_pages

        chain = compile_chain(yamlfile.load(self.machine, Machine))
        tests = [_artefacts.recording_in(folder) for folder in context.every("recordings").values()]
        seen = observations.concatenate([protocols.observations(chain, test) for test in tests])
        context.progress(0.3, f"{len(chain.components)} components from {len(seen)} readings")
        model = identify.Parametrisation.of(chain, self.modes, self.without)
        found = identify.identify(model, seen)
        document = summary.document(found, seen)
        context.write_json(IDENTIFICATION, {**document, "inputs": context.fingerprint})
        shutil.copyfile(self.machine, context.folder / MACHINE)
        circles = [figure for test in tests if test.names("error", component="E_R") for figure in ballbar_pages(test)]
        context.write_text("identification.html", page(chain, found, document, context.title, circles))
        volumetric = document["volumetric"]
        return {
            "components": len(chain.components),
            "volumetric_rms_um": volumetric["rms_um"],
            "known_to_um": volumetric["standard_error_um"],
            "unseen": len(document["unseen"]),
        }


def page(chain: Any, found: Any, document: Mapping[str, Any], title: str, circles: list[tuple[str, str, str]]) -> str:
    """The machine drawn, its error as vectors and slices before and after, every component, what was not seen."""
    import numpy as np

    from errpipe import __version__
    from errpipe.kinematics import synthesis
    from errpipe.reporting import machine_figures, page

    errors = found.errors()
    rng = np.random.default_rng(0)
    q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1], (200, len(chain.axes)))
    tip = chain.tip()
    before = synthesis.first_order(chain, q, errors.at(q), tip)[:, :3]
    _, spread = found.predict(q)
    figures = [("The machine", machine_figures.sketch(chain), "Drawn from its kinematic chain.")]
    told = "Arrows: deviation of the tool point; what is left is the standard error of the identification."
    figures.append(("Volumetric error", machine_figures.vectors(chain, q, before, spread, tip), told))
    if sum(a.kind == "linear" for a in chain.machine.axes.values()) >= 3:
        figures.append(("Slices", machine_figures.slices(chain, errors, None, tip), "Size of the error, um."))
    figures.append(("Components", machine_figures.components(errors), "After ISO 230-1: um left, urad right."))
    figures += circles
    data = {"title": title or chain.machine.name, "document": document, "figures": figures, "version": __version__}
    return page.render("identification.html.j2", data)
