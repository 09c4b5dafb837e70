"""A fitted model's procedure judged on whole groups that sat out; figures of ISO 230-2 where the test is one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.fitting.holdout import HoldOut
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts

HELD_OUT = "held_out.parquet"


class Validate(Stage):
    """Refit without each group, judge on it, beside doing nothing and the noise floor."""

    kind: Literal["validate"]
    holdout: HoldOut | None = Field(None, description="Who sits out; default: as the fit says.")
    iso230_2: bool = Field(False, description="Add the figures of ISO 230-2 (bidirectional positioning tests).")
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording"), "error_model": Need("error_model")}
    gives: ClassVar[tuple[str, ...]] = ("validation",)

    def outputs(self) -> tuple[str, ...]:
        return ("validation.json", HELD_OUT)

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.validation import held_out

        recording = _artefacts.recording_in(context.needed("recording"))
        folder = context.needed("error_model")
        family, model = _artefacts.family_in(folder), _artefacts.read_model(folder / _artefacts.MODEL)
        document, rows = held_out.judged(recording, family, self.holdout, progress=context.progress)
        if self.iso230_2:
            from errpipe.validation import iso230_2

            document["iso230_2"] = iso230_2.figures(recording).model_dump(mode="json")
        document["model"] = _artefacts.fingerprint_of(model)
        context.write_json("validation.json", {**document, "inputs": context.fingerprint})
        _write_rows(context.folder / HELD_OUT, rows)
        return {c["component"]: headline(c) for c in document["components"]}


def headline(component: Mapping[str, Any]) -> str:
    """The three numbers that matter, in one line."""
    floor = component["noise_floor"]
    return (
        f"{component['rms_before']:.3g} -> {component['rms_after']:.3g} {component['unit']} on held-out rows, "
        f"noise floor {'unknown' if floor is None else f'{floor:.3g}'}"
    )


def _write_rows(path: Path, found: Mapping[str, list]) -> None:
    """One line per held-out row and component: what was there, and what the model left."""
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    parts = [
        pd.DataFrame({"component": name, "group": f.label, "row": f.rows, "before": f.before, "after": f.after})
        for name, folds in found.items()
        for f in folds
    ]
    table = pa.Table.from_pandas(pd.concat(parts, ignore_index=True), preserve_index=False)
    pq.write_table(table.replace_schema_metadata(None), path)
