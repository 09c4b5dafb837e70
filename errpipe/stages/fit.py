"""Terms fitted to a recording: parameters with intervals, covariance, validity box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from errpipe.fitting.spec import ModelSpec
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts


class Fit(ModelSpec, Stage):
    """Fit the terms of every component on all rows of the recording; refuse what the rows cannot tell apart."""

    kind: Literal["fit"]
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording")}
    gives: ClassVar[tuple[str, ...]] = ("error_model",)

    def outputs(self) -> tuple[str, ...]:
        return (_artefacts.MODEL, "fit.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.fitting import model

        recording = _artefacts.recording_in(context.needed("recording"))
        context.progress(0.1, "fitting")
        fitted = model.fit(recording, self.spec()).model_copy(
            update={"title": context.title or recording.manifest.title, "inputs": {"recording": context.fingerprint}}
        )
        context.write_json(_artefacts.MODEL, _artefacts.model_json(fitted))
        context.write_json("fit.json", {"fit": 1, "family": "terms", "spec": self.spec().model_dump(mode="json")})
        return {
            c.component: f"{c.rms_before:.3g} -> {c.rms_after:.3g} {c.unit} on the rows that fitted"
            for c in fitted.components
        }

    def spec(self) -> ModelSpec:
        """What to fit, without what only the stage needs."""
        return ModelSpec.model_validate({name: getattr(self, name) for name in ModelSpec.model_fields})
