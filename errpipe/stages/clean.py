"""A recording in, a recording out, and every row that was touched with its reason."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from errpipe.cleaning import DEFAULT, RULES, Rule
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts

if TYPE_CHECKING:
    AnyRule = Rule
else:
    AnyRule = RULES


class Clean(Stage):
    """Apply cleaning rules; refuse where one would remove more than its share."""

    kind: Literal["clean"]
    rules: tuple[AnyRule, ...] = Field(DEFAULT, description="Rules in their order; default: the usual ones.")
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording")}
    gives: ClassVar[tuple[str, ...]] = ("recording", "cleaning")

    def outputs(self) -> tuple[str, ...]:
        return ("recording.yaml", "recording.parquet", "cleaning.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.cleaning import clean
        from errpipe.formats import manifest_folder

        recording = _artefacts.recording_in(context.needed("recording"))
        context.progress(0.2, "cleaning")
        cleaned, report = clean(recording, self.rules)
        manifest_folder.write(cleaned, context.folder)
        context.write_json("cleaning.json", {**report.plain(), "inputs": context.fingerprint})
        return {"rows": report.rows_after, "removed": report.rows_before - report.rows_after}
