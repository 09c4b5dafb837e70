"""An error model compiled into the table a controller runs, proved against the model before it is called exported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from errpipe import jsonfile
from errpipe.domain import components
from errpipe.domain.recording import Recording
from errpipe.errors import GateError
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts
from errpipe.stages._compile import CompileOptions, compile_model, not_exported
from errpipe.stages._signed import SignOptions
from errpipe.validation.codes import Code
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.table import CompensationTable
    from errpipe.stages._guarded import TableGuard
    from errpipe.validation.gate import GatedModel


class Export(CompileOptions, SignOptions, Stage):
    """Compile the models of all fits into one compensation table and the files of controllers."""

    kind: Literal["export"]
    guard: bool | None = Field(
        None,
        description="Compare the temperatures with each other in the table, and replace one that fails; default: where "
        "the recording allows it and it costs healthy sensors at most 3 %. false: a failed sensor is not detected.",
    )
    targets: tuple[str, ...] = Field((), description="Controller formats to write, by name (`errpipe targets`).")
    limit: float | None = quantity(
        "um", "Largest plausible correction; default: 0.5 mm, or 1/1000 of the travel if that is larger.", None, gt=0
    )
    allow: tuple[Code, ...] = Field((), description="Implausible declarations that are true, by name.")
    ungated: bool = Field(
        False, description="Export although the model was not validated, or is not better than no compensation."
    )
    readings_per_shift: Literal[1, 2, 4, 8, 16] | None = Field(
        None,
        description="Number of readings of the deviation in eight hours; the table gets an input `datum_<component>`: "
        "the last reading minus the prediction without it at that time. None: no such input.",
    )
    takes: ClassVar[Mapping[str, Need]] = {
        "recording": Need("recording"),
        "error_model": Need("error_model", every=True),
        "validation": Need("validation", optional=True, every=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("table",)
    writes: ClassVar[tuple[str, ...]] = (_artefacts.TABLE, _artefacts.TWIN, _artefacts.MODEL, "export.json")

    def missing_input(self, recording: Recording) -> str:
        """What cannot be of the axes stated to correct its components (a header is enough), in words; or ''."""
        for name in self.acts_on:
            if name not in recording.components():
                return not_exported(name, recording.components())
        by_column = {c.component for c in recording.manifest.columns.values() if c.acts_on is not None}
        stated = by_column | set(self.acts_on)
        without = [c for c in recording.components() if components.parse(c).direction in "RD" and c not in stated]
        return _no_axis(without) if self.targets and without and without == list(recording.components()) else ""

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.domain.error_model import joined
        from errpipe.stages import _plausible, _verification

        models = [_artefacts.read_model(at / _artefacts.MODEL) for at in context.every("error_model").values()]
        model = joined(models)
        recording = _artefacts.recording_in(context.needed("recording"))
        if _artefacts.sign_noted(model) or _artefacts.sign_assumed([recording]):
            model = model.model_copy(update={"title": _artefacts.sign_title(model.title)})
        checks = _plausible.refuse(recording, model, self.allow, self.limit)
        passed = _gate(model, models, self, context)
        model = passed.model
        context.progress(0.1, "compiling")
        plain = compile_model(model, self, None, recording)
        chosen = _guard_of(self, replace(passed, model=model), plain, recording, context)
        table = plain
        if chosen is not None:
            model = model.model_copy(update={"title": chosen.title(model.title)})
            table = compile_model(model, self, chosen.guard, recording)
        context.progress(0.5, "comparing table and model")
        proof = _verification.compare(table, model, recording, plain)
        checks += _verification.remarks(proof, passed)
        from errpipe.stages.targets import checksums

        files = _write(context, table, model, self)
        document = {"proof": proof, "files": files, "left_out": list(passed.left_out), "judged": list(passed.judged)}
        document |= {"ungated": _artefacts.UNGATED} if self.ungated else {}
        document |= {"checks": checks, "consequences": _plausible.of_table(table)}
        document |= {"guard": {"says": chosen.sentence, **chosen.document}} if chosen is not None else {}
        document["sha256"] = checksums(context.folder, files, [_artefacts.MODEL])
        context.write_json("export.json", {"export": 1, "inputs": context.fingerprint, **document})
        worst = max((p["largest_difference_um"] for p in proof), default=0.0)
        unit = "urad" if {p["unit"] for p in proof} == {"urad"} else "um"
        summary = {"table": _artefacts.TABLE, f"largest_difference_from_the_model_{unit}": worst}
        summary |= {"guard": chosen.sentence} if chosen is not None else {}
        worse = ". ".join(dict.fromkeys(sentence for row in files for sentence in row.get("worse", ())))
        summary |= {"worse": worse} if worse else {}
        held = {p["component"]: p["rows_held_back"] for p in proof if p["rows_held_back"]}
        return summary | ({"rows_held_back": ", ".join(f"{n} {rows}" for n, rows in held.items())} if held else {})


def _no_axis(names: Sequence[str]) -> str:
    if all(components.unit(name) == "urad" for name in names):
        return f"{' and '.join(names)}: no axis corrects an angle at the tool (targets: [] exports the table alone)"
    stated = f"acts_on: {{{names[0]}: {{axis: X, factor: 0.5}}}}"
    return f"no axis corrects {' and '.join(names)}: state the axis, such as {stated}"


def _gate(model: ErrorModel, fits: Sequence[ErrorModel], options: Export, context: Context) -> GatedModel:
    """The model at the gain that was judged; the whole of it, marked in its title, where it is exported ungated.

    fits: the models of which it is composed, each with its validations.
    """
    from errpipe.fitting.recalibration import with_readings
    from errpipe.validation.gate import GatedModel, not_validated, pass_gate

    folders = context.every("validation").values()
    validations: list[dict[str, Any]] = []
    for fit in fits:
        own = _artefacts.validations_of(fit, folders)
        if not own and not options.ungated:
            raise not_validated(fit)
        validations += own
    if options.ungated:
        title = _artefacts.ungated_title(model.title)
        passed = GatedModel(model.model_copy(update={"title": title}), (), ())
    else:
        passed = pass_gate(model, validations)
    if options.readings_per_shift is None:
        return passed
    return replace(passed, model=with_readings(passed.model, validations, options.readings_per_shift))


def _guard_of(
    options: Export, passed: GatedModel, plain: CompensationTable, recording: Recording, context: Context
) -> TableGuard | None:
    """The guard of a table's temperatures, written beside it; None where it reads none.

    Raises GateError where a guard was asked for and none can be learnt.
    """
    from errpipe.stages import _guarded

    if not _guarded.sensors_read(plain, recording):
        return None
    if options.guard is False:
        return _guarded.no_guard("guard: false")
    context.progress(0.2, "regressing each temperature on the others")
    folders = context.every("validation").values()
    schemes = (jsonfile.read(folder / _artefacts.VALIDATION)["scheme"] for folder in folders)
    chosen = _guarded.choose_guard(_guarded.baseline_of(passed, options, recording, plain), next(schemes, None))
    if options.guard and (chosen.guard is None or not chosen.guard.compares):
        raise GateError(f"export: guard: true: {chosen.sentence}")
    if chosen.guard is not None:
        context.write_json("sensor_guard.json", chosen.guard.model_dump(mode="json"))
    return chosen


def _write(context: Context, table: CompensationTable, model: ErrorModel, options: Export) -> list[dict[str, str]]:
    _artefacts.write_table(context.folder, table)
    context.write_json(_artefacts.MODEL, _artefacts.model_json(model))
    remarks = options.write_signature(table, context.folder / _artefacts.TABLE)
    files = [
        {"file": _artefacts.TABLE, "what": "compensation table, binary", "error": "0", "read_back": "equal"},
        {"file": _artefacts.TWIN, "what": "its JSON twin", "error": "0", "read_back": "equal"},
    ]
    if options.targets:
        from errpipe.stages.targets import write_targets

        if not any(o.axis for o in table.outputs):
            raise GateError(f"export: {_no_axis([o.name for o in table.outputs])}")

        files += write_targets(table, options.targets, context.folder, remarks)
    return files
