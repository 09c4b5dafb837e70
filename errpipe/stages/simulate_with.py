"""An external simulation of the recording: each response gets a simulated column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.domain.error_model import ErrorModel
from errpipe.pipeline.stage import Context, InputPath, Need, Stage
from errpipe.simulation import external
from errpipe.simulation.external import AnySource
from errpipe.stages import _artefacts


class SimulateWith(Stage):
    """Simulated values for every row: from the recording itself, a CSV, an error model, or an FMU."""

    kind: Literal["twin"]
    by: AnySource = Field(description="What simulates.")
    file: InputPath | None = Field(None, description="The CSV, the FMU or the error model.")
    takes: ClassVar[Mapping[str, Need]] = {
        "recording": Need("recording"),
        "error_model": Need("error_model", optional=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("recording",)
    writes: ClassVar[tuple[str, ...]] = ("recording.yaml", "recording.parquet", "twin.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.formats import manifest_folder

        recording = _artefacts.recording_in(context.needed("recording"))
        with_twins, twins, figures = external.with_twins(
            recording, self.by, self.file, self._model(context), context.progress
        )
        manifest_folder.write(with_twins, context.folder)
        document = {"twin": 1, "by": self.by.kind, "twins": [asdict(t) for t in twins], "figures": figures}
        context.write_json("twin.json", {**document, "inputs": context.fingerprint})
        return {t.component: f"{t.with_twin} of {t.rows} rows simulated by {t.source}" for t in twins}

    def _model(self, context: Context) -> ErrorModel | None:
        if self.by.kind != "error_model":
            return None
        if self.file is not None:
            return _artefacts.read_model(self.file)
        folder = context.optional("error_model")
        return _artefacts.read_model(folder / _artefacts.MODEL) if folder is not None else None
