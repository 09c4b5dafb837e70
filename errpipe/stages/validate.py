"""Leave-one-group-out validation of a fitted model's procedure; figures of ISO 230-2 where the test is one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import Field

from errpipe import jsonfile, yamlfile
from errpipe.errors import DataError
from errpipe.fitting.holdout import HALVES, HoldOut
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts

HELD_OUT = "held_out.parquet"
MORE_RUNS = "; one half predicted by the other: how further runs go is not shown"


class Validate(Stage):
    """Leave-one-group-out cross-validation, compared with no compensation and the noise floor.

    An identified machine is identified again with each line, circle, plate, socket or run of its tests held out.
    """

    kind: Literal["validate"]
    holdout: HoldOut | None = Field(None, description="Rows held out of an error model's fit; default: as in the fit.")
    iso230_2: bool = Field(False, description="Add the figures of ISO 230-2 (bidirectional positioning tests).")
    takes: ClassVar[Mapping[str, Need]] = {
        "recording": Need("recording"),
        "error_model": Need("error_model", unless="identified_machine"),
        "identified_machine": Need("identified_machine", optional=True),
        "recordings": Need("recording", every=True, only_with="identified_machine"),
    }
    gives: ClassVar[tuple[str, ...]] = ("validation",)
    writes: ClassVar[tuple[str, ...]] = ("validation.json",)

    def run(self, context: Context) -> Mapping[str, Any]:
        document: dict[str, Any] = {"components": []}
        summary: dict[str, Any] = {}
        folder = context.optional("error_model")
        if folder is not None:
            from errpipe.validation import between_runs, clocks, held_out, steps

            document |= self._of_model(context, folder)
            remark = MORE_RUNS if document["scheme"] == HALVES else ""
            remark += "".join(f"; {why}" for why in held_out.summarise_reasons(document.get("not_judged", ())))
            for c in document["components"]:
                found = steps.in_words(c, "; ") + clocks.in_words(c, "; ") + between_runs.in_words(c, "; ")
                summary[c["component"]] = headline(c) + found + remark
        machine = context.optional("identified_machine")
        if machine is not None:
            document["machine"] = _of_machine(context, machine)
            summary |= {name: _between(figures) for name, figures in document["machine"]["tests"].items()}
        context.write_json(_artefacts.VALIDATION, {**document, "inputs": context.fingerprint})
        return summary

    def _of_model(self, context: Context, folder: Path) -> dict[str, Any]:
        from errpipe.validation import held_out

        at = context.needed("recording")
        family, model = _artefacts.family_in(folder), _artefacts.read_model(folder / _artefacts.MODEL)
        source = _artefacts.source_in(at)
        if source is not None and family.in_batches(source):
            if self.iso230_2:
                raise DataError("validate: the figures of ISO 230-2 need the whole recording (raise rows_in_memory)")
            document, rows = held_out.cross_validate_in_batches(source, family, self.holdout)
            write_rows(context.folder / HELD_OUT, rows)
            return document | {"model": _artefacts.fingerprint_of(model)}
        recording = _artefacts.recording_in(at)
        document, rows = held_out.cross_validate(recording, family, self.holdout, progress=context.progress)
        if self.iso230_2:
            from errpipe.validation import iso230_2

            try:
                document["iso230_2"] = iso230_2.figures(recording).model_dump(mode="json")
            except DataError as err:
                raise DataError(
                    f"{err}. With iso230_2: false, validate judges the model without these figures"
                ) from None
        write_rows(context.folder / HELD_OUT, rows)
        return document | {"model": _artefacts.fingerprint_of(model)}


def _of_machine(context: Context, folder: Path) -> dict[str, Any]:
    """Figures of every test of an identified machine, and which identification they are of."""
    from errpipe.domain.machine import Machine
    from errpipe.stages.identify import IDENTIFICATION, MACHINE
    from errpipe.validation import machine

    document = jsonfile.read(folder / IDENTIFICATION)
    tests = {name: _artefacts.recording_in(at) for name, at in context.every("recordings").items()}
    figures = machine.cross_validate(yamlfile.load(folder / MACHINE, Machine), document, tests, context.progress)
    return {"identification": jsonfile.fingerprint(document), "tests": figures}


def _between(figures: Mapping[str, Any]) -> str:
    groups = len(figures["groups"])
    return f"{figures['rms_before']:.3g} -> {figures['rms_after']:.3g} um on held-out readings, {groups} groups"


def headline(component: Mapping[str, Any]) -> str:
    """The three main figures in one line; a fourth if the gate accepts only a part of the correction."""
    floor, gain = component["noise_floor"], component["gain"]
    part = f"{component['rms_at_gain']:.3g} with {gain:g} of the correction, " if 0.0 < gain < 1.0 else ""
    return (
        f"{component['rms_before']:.3g} -> {component['rms_after']:.3g} {component['unit']} on held-out rows, "
        f"{part}noise floor {'unknown' if floor is None else f'{floor:.3g}'}"
    )


def write_rows(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """One line per held-out row and component: the deviation, and the residual of the model."""
    parts = [
        pd.DataFrame({"component": name, "group": f.label, "row": f.rows, "before": f.before, "after": f.after})
        for name, folds in columns.items()
        for f in folds
    ]
    table = pa.Table.from_pandas(pd.concat(parts, ignore_index=True), preserve_index=False)
    pq.write_table(table.replace_schema_metadata(None), path)
