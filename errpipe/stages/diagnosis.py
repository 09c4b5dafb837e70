"""What a simulation leaves out, and the terms of it that the next export may compensate."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts
from errpipe.stages._acceptance import Accept

if TYPE_CHECKING:
    from errpipe.fitting.spec import ModelSpec

OTHER_FAMILY = "the model fitted before is a {} model, which takes no further terms"


class Diagnose(Stage):
    """Compare recorded and simulated values; fit what is missing, refuse what must not be compensated."""

    kind: Literal["diagnose"]
    accept: Accept = Field(Accept(), description="Which findings become terms of the error model.")
    takes: ClassVar[Mapping[str, Need]] = {
        "recording": Need("recording"),
        "error_model": Need("error_model", optional=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("error_model", "diagnosis")

    def outputs(self) -> tuple[str, ...]:
        return ("diagnosis.json", "report.html", _artefacts.MODEL, "fit.json", "acceptance.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe import jsonfile
        from errpipe.domain.diagnosis import Diagnosis
        from errpipe.stages import _acceptance
        from errpipe.stages.diagnose import diagnose

        folder = context.needed("recording")
        diagnose(folder, context.folder, lambda share, text: context.progress(0.9 * share, text))
        found = Diagnosis.model_validate(jsonfile.read(context.folder / "diagnosis.json"))
        recording = _artefacts.recording_in(folder)
        context.progress(0.9, "fitting what was accepted")
        family, existing = _before(context.maybe("error_model"))
        decisions = _acceptance.decide(found, recording, self.accept, whole=existing is not None)
        if family in ("terms", ""):
            model, spec, decisions = _acceptance.fit_accepted(decisions, found, existing, recording)
            fit = {"fit": 1, "family": "terms" if existing is not None else "mismatch"}
            update = {"title": context.title or recording.manifest.title, "inputs": {"recording": context.fingerprint}}
            notes = [
                f"not compensated: {d.finding.effect} of {d.component} ({d.reason})"
                for d in decisions
                if not d.accepted
            ]
            model = model.model_copy(update={**update, "notes": (*model.notes, *notes)})
            context.write_json(_artefacts.MODEL, _artefacts.model_json(model))
            context.write_json("fit.json", {**fit, "spec": spec.model_dump(mode="json")})
        else:
            decisions = [d.refused(OTHER_FAMILY.format(family)) for d in decisions]
            for name in (_artefacts.MODEL, "fit.json"):
                shutil.copyfile(context.needed("error_model") / name, context.folder / name)
        document = {
            "acceptance": 1,
            "accepted": [d.plain() for d in decisions if d.accepted],
            "refused": [d.plain() for d in decisions if not d.accepted],
        }
        context.write_json("acceptance.json", {**document, "inputs": context.fingerprint})
        return _summary(found, document)


def _before(folder: Path | None) -> tuple[str, ModelSpec | None]:
    """Family and specification of the fit before, if there is one."""
    from errpipe import jsonfile
    from errpipe.fitting.spec import ModelSpec

    if folder is None:
        return "", None
    document = jsonfile.read(folder / "fit.json")
    spec = ModelSpec.model_validate(document["spec"]) if document["family"] == "terms" else None
    return document["family"], spec


def _summary(found: Any, document: Mapping[str, Any]) -> dict[str, Any]:
    told = {r.component: r.says or r.verdict for r in found.responses}
    for what in ("accepted", "refused"):
        rows = [f"{d['effect']} ({d['component']})" for d in document[what]]
        told[what] = ", ".join(rows) or "nothing"
    return told
