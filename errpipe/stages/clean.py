"""A recording in, a recording out, and every row that was touched with its reason."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from errpipe.cleaning import DEFAULT, RULES, CleaningReport, Rule, clean
from errpipe.errors import DataError
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    AnyRule = Rule
else:
    AnyRule = RULES


ANNOUNCED = ("blank cells", "set column aside")  # what is reported on the screen; all else is in cleaning.json


class Clean(Stage):
    """Apply cleaning rules; refuse if one would remove more than its permitted share."""

    kind: Literal["clean"]
    rules: tuple[AnyRule, ...] = Field(
        DEFAULT, description="Rules, applied in this order; default: the standard rules."
    )
    rows_in_memory: int = quantity(
        "1",
        "A longer recording is cleaned in batches of whole runs, and a longer run in pieces: limits on the share "
        "removed, and statistics over a run, then refer to the batch or piece.",
        1_000_000,
        ge=1000,
    )
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording")}
    gives: ClassVar[tuple[str, ...]] = ("recording", "cleaning")
    file_types: ClassVar[Mapping[str, str]] = {"cleaning.json": "cleaning"}
    writes: ClassVar[tuple[str, ...]] = ("recording.yaml", "recording.parquet", "cleaning.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.formats import manifest_folder

        folder = context.needed("recording")
        context.progress(0.2, "cleaning")
        if self._in_pieces(folder):
            report = self._piece_by_piece(folder, context.folder)
        else:
            cleaned, report = clean(_artefacts.recording_in(folder), self.rules)
            manifest_folder.write(cleaned, context.folder)
        context.write_json("cleaning.json", {**report.plain(), "inputs": context.fingerprint})
        done = {
            d.column: f"{d.what}: {d.reason}" for r in report.rules for d in r.done if d.what in ANNOUNCED and d.column
        }
        return {"rows": report.rows_after, "removed": report.rows_before - report.rows_after, **done}

    def _in_pieces(self, folder: Path) -> bool:
        from errpipe.cleaning import _pieces
        from errpipe.formats import manifest_folder

        rows = manifest_folder.rows_written(folder)
        if rows <= self.rows_in_memory:
            return False
        manifest = manifest_folder.load_manifest(folder)
        run = manifest.names("run")
        back = _pieces.returning_run(manifest_folder.iter_batches(folder, run)) if run else None
        if back is not None and rows * len(manifest.columns) > manifest_folder.max_cells():
            raise DataError(
                f"clean: run {back} comes back after another one, and {rows} rows do not fit into memory: sort the"
                " tables by run, so that they can be cleaned piece by piece"
            )
        return back is None

    def _piece_by_piece(self, folder: Path, out: Path) -> CleaningReport:
        from errpipe.cleaning import _pieces
        from errpipe.formats import manifest_folder

        manifest = manifest_folder.canonical(manifest_folder.load_manifest(folder))
        cleaning = _pieces.Cleaning(self.rules, manifest)
        pieces = _pieces.in_pieces(manifest_folder.iter_batches(folder), self.rows_in_memory // 2)
        manifest_folder.write_pieces(cleaning.pieces(pieces), cleaning.written(), cleaning.manifest, out)
        return cleaning.report()
