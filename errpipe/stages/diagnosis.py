"""Effects missing from a simulation, and those terms of them that the next export may compensate."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe import jsonfile
from errpipe.models.terms import Terms
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _acceptance, _artefacts
from errpipe.stages._acceptance import Accept

OTHER_FAMILY = "the model fitted before is a {} model, which takes no further terms"


class Diagnosis(Stage):
    """Compare recorded and simulated values; fit what is missing, refuse what must not be compensated."""

    kind: Literal["diagnose"]
    accept: Accept = Field(Accept(), description="Which findings become terms of the error model.")
    takes: ClassVar[Mapping[str, Need]] = {
        "recording": Need("recording"),
        "error_model": Need("error_model", optional=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("error_model", "diagnosis")
    writes: ClassVar[tuple[str, ...]] = (
        "diagnosis.json",
        "report.html",
        _artefacts.MODEL,
        _artefacts.PROCEDURE,
        "acceptance.json",
    )

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.domain.diagnosis import Diagnosis
        from errpipe.stages.diagnose import diagnose

        folder = context.needed("recording")
        diagnose(folder, context.folder, lambda share, text: context.progress(0.9 * share, text))
        diagnosed = Diagnosis.model_validate(jsonfile.read(context.folder / "diagnosis.json"))
        recording = _artefacts.recording_in(folder)
        context.progress(0.9, "fitting what was accepted")
        before = context.optional("error_model")
        family = _artefacts.family_in(before) if before is not None else None
        existing = family if isinstance(family, Terms) else None
        decisions = _acceptance.decide(diagnosed, recording, self.accept, whole=existing is not None)
        if before is None or family is None or existing is not None:
            model, spec, decisions = _acceptance.fit_accepted(decisions, diagnosed, existing, recording)
            refused = [d for d in decisions if not d.accepted]
            notes = [f"not compensated: {d.finding.effect} of {d.component} ({d.reason})" for d in refused]
            model = model.model_copy(update={"notes": (*model.notes, *notes)})
            _artefacts.write_model(context, recording, model, Terms.of(spec, less_simulated=existing is None))
        else:
            decisions = [d.refused(OTHER_FAMILY.format(family.family_name())) for d in decisions]
            for name in (_artefacts.MODEL, _artefacts.PROCEDURE, *_artefacts.documents_in(before, family)):
                shutil.copyfile(before / name, context.folder / name)
        document = {
            "acceptance": 1,
            "accepted": [d.plain() for d in decisions if d.accepted],
            "refused": [d.plain() for d in decisions if not d.accepted],
        }
        context.write_json("acceptance.json", {**document, "inputs": context.fingerprint})
        says = {r.component: r.says or r.verdict for r in diagnosed.responses}
        summary = {name: text.removeprefix(f"{name}: ").rstrip(".") for name, text in says.items()}
        for what, decided in (("accepted", True), ("refused", False)):
            rows = [f"{d.finding.effect} ({d.component})" for d in decisions if d.accepted is decided]
            summary[what] = ", ".join(rows) or "nothing"
        return summary
