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
        recording = _artefacts.recording_in(context.needed("recording"))
        document, rows = judged(recording, context.needed("error_model"), self.holdout, context.progress)
        if self.iso230_2:
            from errpipe.validation import iso230_2

            document["iso230_2"] = iso230_2.figures(recording).model_dump(mode="json")
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


def judged(recording, fit_folder: Path, scheme: HoldOut | None, progress=lambda share, text: None):
    """The document of `validation.json`, and per component the rows that sat out with what was left on them."""
    from errpipe.stages._families import family_of
    from errpipe.validation import held_out

    family = family_of(fit_folder)
    name, folds = family.folds(recording, scheme)
    found: dict[str, list] = {name: [] for name in family.components}
    for number, fold in enumerate(folds):
        progress(number / len(folds), f"without {fold.label}")
        for component, left in family.judge(recording, fold).items():
            found[component].append(left)
    document = {
        "validation": held_out.VERSION,
        "scheme": name,
        "method": family.method,
        "components": [held_out.component_figures(recording, c, left) for c, left in found.items()],
    }
    further = family.further(recording, progress)
    if "seasons" in further:
        _cover(document, further["seasons"])
    return {**document, **further}, found


def _cover(document: dict[str, Any], seasons: Mapping[str, Any]) -> None:
    """The coverage of the model's own intervals, instead of one width taken from the other groups."""
    told = {row["left_out"]: row["coverage"] for row in seasons["groups"]}
    for component in document["components"]:
        for group in component["groups"]:
            group["coverage90"] = told.get(group["label"], group["coverage90"])


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
