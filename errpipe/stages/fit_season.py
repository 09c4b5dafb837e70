"""A thermal model that is meant to hold in a season it has not seen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.fitting.season_options import SeasonOptions
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts


class FitSeason(Stage):
    """Causes of known sign, shrunk towards nothing, with a correction that fades where it was not learnt."""

    kind: Literal["fit_season"]
    component: str = Field(description="Response of the recording, such as E_D or E_Z.")
    options: SeasonOptions = Field(SeasonOptions(), description="How it is fitted; the defaults are the tested ones.")
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording")}
    gives: ClassVar[tuple[str, ...]] = ("error_model",)

    def outputs(self) -> tuple[str, ...]:
        return (_artefacts.MODEL, "fit.json", "season.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.fitting import thermal_season

        recording = _artefacts.recording_in(context.needed("recording"))
        context.progress(0.1, "fitting")
        found = thermal_season.fit(recording, self.component, self.options)
        model = found.error_model(recording).model_copy(
            update={"title": context.title or recording.manifest.title, "inputs": {"recording": context.fingerprint}}
        )
        context.write_json(_artefacts.MODEL, _artefacts.model_json(model))
        options = self.options.model_dump(mode="json")
        context.write_json("fit.json", {"fit": 1, "family": "season", "component": self.component, "options": options})
        causes = [{"cause": name, "gain": gain} for name, gain, _ in found.parts]
        context.write_json("season.json", {"season": 1, "causes": causes, "report": _plain(found.report)})
        (c,) = model.components
        return {c.component: f"{c.rms_before:.3g} -> {c.rms_after:.3g} {c.unit} on the rows that fitted"}


def _plain(value: Any) -> Any:
    """Report values as JSON: arrays and tuples as lists, numbers as numbers."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value.tolist() if hasattr(value, "tolist") else value
