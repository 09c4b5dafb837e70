"""Vendor files in, a recording in canonical units out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe import formats
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.pipeline.stage import Context, InputPath, Need, Stage
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording


class Ingest(Stage):
    """Read a recording: roles and units are checked, values are converted to canonical units."""

    kind: Literal["ingest"]
    recording: InputPath | None = Field(
        None, description="Folder with a recording manifest, or a file of a known format; default: the simulated one."
    )
    format: str | None = Field(None, description="Name of the file format; default: the one that recognises the file.")
    options: dict[str, str | float | bool] = quantity("of each", "Options of the format.", {})

    compensated_by: InputPath | None = Field(
        None,
        description="Table (.ect) that was active during the recording: its correction is removed from the "
        "deviations, which are then those of the uncompensated machine.",
    )
    compensated_as: tuple[str, ...] = Field(
        (),
        description="Controller formats whose files of that table were active, with the numbers that their checklists "
        "state; default: the controller ran the whole table.",
    )
    compensated_entered: bool = Field(
        True,
        description="Whether the numbers that those checklists have a person enter were entered, too; false: the files "
        "acted alone.",
    )
    compensated_since: str | None = Field(
        None, description="First run recorded with that table; default: the first of all."
    )
    since_run: str | None = Field(
        None, description="First run that is used; earlier runs are discarded, such as those before a repair."
    )
    without_runs: tuple[str, ...] = Field((), description="Runs that are not used, such as faulty measurements.")

    takes: ClassVar[Mapping[str, Need]] = {"simulated": Need("raw_recording", optional=True)}
    gives: ClassVar[tuple[str, ...]] = ("recording", "ingestion")
    file_types: ClassVar[Mapping[str, str]] = {"ingest.json": "ingestion"}
    writes: ClassVar[tuple[str, ...]] = ("recording.yaml", "recording.parquet", "ingest.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.formats import manifest_folder

        path = self.recording or context.optional("simulated")
        if path is None:
            raise UsageError("ingest: no recording is named and there is no simulate stage before it")
        if self.compensated_as and self.compensated_by is None:
            raise UsageError("ingest: compensated_as needs compensated_by, the table of these files")
        if not self.compensated_entered and not self.compensated_as:
            raise UsageError("ingest: compensated_entered: false needs compensated_as, the formats of the files")
        context.progress(0.1, "reading")
        if self.compensated_by is not None or self.since_run is not None or self.without_runs:
            return self._summary(context, *self._whole(context, path))
        if manifest_folder.sniff(path) and self.format in (None, manifest_folder.name):
            rows = manifest_folder.to_parquet(path, context.folder)
        else:
            rows = manifest_folder.write(formats.read(path, self.format, self.options), context.folder)
        return self._summary(context, rows)

    def _whole(self, context: Context, path: Path) -> tuple[int, Mapping[str, Any] | None]:
        """Write the runs that are kept, as without the table that was on. Returns the rows, and what was added."""
        from errpipe.formats import manifest_folder

        recording, compensated = formats.read(path, self.format, self.options), None
        if self.compensated_by is not None:
            from errpipe.stages._uncompensated import uncompensated

            recording, compensated = uncompensated(
                recording,
                self.compensated_by,
                self.compensated_as,
                self.compensated_since,
                entered=self.compensated_entered,
            )
        return manifest_folder.write(self._kept(recording), context.folder), compensated

    def _kept(self, recording: Recording) -> Recording:
        """The requested runs. Raises DataError if none remains; an excluded run need not exist."""
        labels = recording.run_labels()
        if self.since_run is not None and self.since_run not in labels:
            raise DataError(f"since_run: no run {self.since_run!r}.{did_you_mean(self.since_run, labels)}")
        codes = range(0 if self.since_run is None else labels.index(self.since_run), len(labels))
        kept = [c for c in codes if labels[c] not in self.without_runs]
        if not kept:
            raise DataError("without_runs: no run is left")
        return recording.take(np.isin(recording.run_codes(), kept))

    def _summary(self, context: Context, rows: int, compensated: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        from errpipe.formats import manifest_folder

        manifest = manifest_folder.load_manifest(context.folder)
        columns = {name: column.model_dump(exclude_none=True) for name, column in manifest.columns.items()}
        context.write_json(
            "ingest.json",
            {
                "ingest": 1,
                "inputs": context.fingerprint,
                "title": manifest.title,
                "machine": manifest.machine,
                "rows": rows,
                "columns": columns,
                "simulated": self.recording is None,
                **({"compensated": compensated} if compensated else {}),
            },
        )
        added = {f"added_{c}_um": size for c, size in compensated["rms_um"].items()} if compensated else {}
        return {"rows": rows, "columns": len(columns), **added}
