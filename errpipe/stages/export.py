"""An error model compiled into the table a controller runs, proved against the model before it is called exported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from errpipe import yamlfile
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts
from errpipe.validation.codes import Code

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.domain.table import CompensationTable
    from errpipe.drivers.lowered import Lowered
    from errpipe.guard.description import SensorGuard


class ActsOn(yamlfile.Options):
    """The axis that corrects a component without an axis of its own."""

    axis: str = Field(description="Letter of the axis, such as X.", pattern="^[A-Z][A-Z0-9]{0,6}$")
    factor: float | None = Field(
        None,
        ge=-10,
        le=10,
        description="Deviation along the axis per deviation of the component. A diameter on X: 0.5 (the default) where "
        "the axis counts in radius, as the joints of a control do whatever the program says, 1 where its compensation "
        "counts in diameter; with a minus where the tool stands on the minus side of the spindle. Others: 1.",
        json_schema_extra={"unit": "1"},
    )


class Export(Stage):
    """Compile the model into a compensation table and the files of controllers."""

    kind: Literal["export"]
    error_bound: float = Field(
        0.01, gt=0, description="Largest interpolation error of any profile.", json_schema_extra={"unit": "um"}
    )
    position_cycle: float = Field(
        0.001, gt=0, description="Time between two corrections.", json_schema_extra={"unit": "s"}
    )
    thermal_cycle: float = Field(
        1.0, gt=0, description="Time between two updates of slow drivers.", json_schema_extra={"unit": "s"}
    )
    magnitude: float | None = Field(
        None, gt=0, description="Largest correction; default: what it can reach.", json_schema_extra={"unit": "um"}
    )
    slew: float | None = Field(
        None, gt=0, description="Largest rate of a correction.", json_schema_extra={"unit": "um/s"}
    )
    acceleration: float | None = Field(
        None, gt=0, description="Largest change of that rate.", json_schema_extra={"unit": "um/s2"}
    )
    acts_on: dict[str, ActsOn] = Field(
        {}, description="Component -> axis that corrects it: for E_D, E_R and others that name no axis themselves."
    )
    guard: bool = Field(
        False, description="Watch the temperatures against each other in the table, and stand in for one that fails."
    )
    targets: tuple[str, ...] = Field((), description="Controller formats to write, by name (`errpipe targets`).")
    limit: float | None = Field(
        None,
        gt=0,
        description="Largest plausible correction; default: 0.5 mm, or 1/1000 of the travel where that is more.",
        json_schema_extra={"unit": "um"},
    )
    allow: tuple[Code, ...] = Field((), description="Implausible declarations that are true, by name.")
    gate: Literal["better-than-nothing", "none"] = Field(
        "better-than-nothing", description="Refuse a model that is not better than nothing on held-out rows."
    )
    takes: ClassVar[Mapping[str, Need]] = {
        "recording": Need("recording"),
        "error_model": Need("error_model"),
        "validation": Need("validation", optional=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("table",)

    def outputs(self) -> tuple[str, ...]:
        return (_artefacts.TABLE, _artefacts.TWIN, _artefacts.MODEL, "export.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.stages import _plausible

        model = _artefacts.read_model(context.needed("error_model") / _artefacts.MODEL)
        recording = _artefacts.recording_in(context.needed("recording"))
        checks = _plausible.refuse(recording, model, self.allow, self.limit)
        validation = context.maybe("validation")
        left_out: list[str] = []
        if self.gate != "none" and validation is not None:
            model, left_out = better_than_nothing(model, validation / "validation.json")
        guard = _guard(context, recording, model) if self.guard else None
        context.progress(0.2, "compiling")
        table = compile_model(model, self, guard)
        context.progress(0.5, "comparing table and model")
        proof = compare(table, model, recording)
        from errpipe.stages.targets import checksums

        files = _write(context, table, model, self.targets)
        document = {"proof": proof, "files": files, "left_out": left_out}
        document |= {"checks": checks, "consequences": _plausible.of_table(table)}
        document["sha256"] = checksums(context.folder, files, [_artefacts.MODEL])
        context.write_json("export.json", {"export": 1, "inputs": context.fingerprint, **document})
        worst = max((p["largest_difference_um"] for p in proof), default=0.0)
        return {"table": _artefacts.TABLE, "largest_difference_from_the_model_um": worst}


def better_than_nothing(model: ErrorModel, path: Path) -> tuple[ErrorModel, list[str]]:
    """The model with only those components that earned it on the rows that sat out, and the names of the others.

    Doing nothing wins ties. Raises GateError where no component is left.
    """
    from errpipe import jsonfile
    from errpipe.errors import GateError

    worse = {c["component"]: c for c in jsonfile.read(path)["components"] if c["verdict"] == "do nothing"}
    kept = tuple(c for c in model.components if c.component not in worse)
    if not kept:
        told = "; ".join(f"{n} {c['rms_before']:.3g} -> {c['rms_after']:.3g} {c['unit']}" for n, c in worse.items())
        raise GateError(f"export: not better than nothing on held-out rows ({told}). Nothing was exported.")
    return model.model_copy(update={"components": kept}), sorted(worse)


def _guard(context: Context, recording: Recording, model: ErrorModel) -> SensorGuard:
    """What the sensors say of each other, learnt on the recording; kept beside the table."""
    from errpipe.fitting.lowering import lower
    from errpipe.guard import learn

    context.progress(0.1, "learning what the sensors say of each other")
    drivers = [pair.driver for pairs in lower(model).values() for pair in pairs]
    guard = learn.hold(learn.learn(recording), recording, drivers)
    context.write_json("sensor_guard.json", guard.model_dump(mode="json"))
    return guard


def compile_model(model: ErrorModel, options: Export, guard: SensorGuard | None = None) -> CompensationTable:
    """The table of a model. Raises GateError for what a controller cannot be given."""
    from errpipe import __version__, jsonfile, tables
    from errpipe.errors import GateError
    from errpipe.fitting.lowering import left_behind, lower
    from errpipe.stages import _inputs

    lowered = lower(model)
    empty = [name for name, pairs in lowered.items() if not pairs]
    if len(empty) == len(lowered):
        behind = ", ".join(sorted({t for terms in left_behind(model).values() for t in terms})) or "no term"
        raise GateError(f"export: a controller can compensate nothing of this model (it holds {behind})")
    _inputs.unknown_inputs(_inputs.read_by([p.driver for pairs in lowered.values() for p in pairs]), model)
    if guard is not None:
        lowered = {name: [_guarded(p, guard) for p in pairs] for name, pairs in lowered.items()}
    keep = None if model.validity.fades else False  # no box in the table, but it still fades where a sensor is lost
    sources = [
        tables.ComponentSource(c.component, c.unit, tuple(lowered[c.component]), keep)
        for c in model.components
        if lowered[c.component]
    ]
    limits = {
        s.name: tables.Limits(options.magnitude, options.slew, options.acceleration)
        for s in sources
        if any(v is not None for v in (options.magnitude, options.slew, options.acceleration))
    }
    return tables.compile_table(
        sources,
        outputs=tables.outputs_of(sources, _acts_on(options.acts_on, [s.name for s in sources])),
        inputs=_inputs.table_inputs(model, guard),
        travel=_inputs.travel(model),
        limits=limits,
        error_bound=options.error_bound,
        position_cycle_s=options.position_cycle,
        thermal_cycle_s=options.thermal_cycle,
        machine=model.machine,
        title=model.title,
        version=__version__,
        fingerprint=jsonfile.fingerprint(_artefacts.model_json(model)),
    )


def _acts_on(stated: Mapping[str, ActsOn], known: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Component -> (axis, factor). Raises UsageError for a component that is not exported, and for a factor of 0."""
    from errpipe.domain import components
    from errpipe.errors import UsageError, did_you_mean

    out = {}
    for name, on in stated.items():
        if name not in known:
            raise UsageError(
                f"export: acts_on: {name!r} is not exported ({', '.join(known)}).{did_you_mean(name, known)}"
            )
        factor = on.factor
        if factor is None:
            factor = 0.5 if components.parse(name).kind == "diameter" else 1.0
        if factor == 0.0:
            raise UsageError(f"export: acts_on: {name}: a factor of 0 corrects nothing")
        out[name] = (on.axis, factor)
    return out


def _guarded(pair: Lowered, guard: SensorGuard) -> Lowered:
    from dataclasses import replace

    from errpipe.guard.replace import guarded

    return replace(pair, driver=guarded(pair.driver, guard))


def compare(table: CompensationTable, model: ErrorModel, recording) -> list[dict[str, Any]]:
    """Table beside model on the recording's own rows: largest and rms difference per component, um or urad."""
    import numpy as np

    from errpipe.fitting.components import evaluate
    from errpipe.fitting.lowering import left_behind
    from errpipe.stages.predict import table_values

    by_model, by_table = evaluate(model, recording), table_values(table, model, recording)
    behind = left_behind(model)
    out = []
    for name, values in by_table.items():
        gap = values - by_model[name]
        gap = gap[np.isfinite(gap)]
        out.append(
            {
                "component": name,
                "rows": int(gap.size),
                "largest_difference_um": float(np.abs(gap).max()) if gap.size else 0.0,
                "rms_difference_um": float(np.sqrt(np.mean(gap**2))) if gap.size else 0.0,
                "not_compensated": behind.get(name, []),
            }
        )
    return out


def _write(context: Context, table: CompensationTable, model: ErrorModel, targets: Sequence[str]) -> list[dict]:
    from errpipe.errors import GateError, VerifyError
    from errpipe.tables import ect

    ect.write(table, context.folder / _artefacts.TABLE)
    ect.write_json(table, context.folder / _artefacts.TWIN)
    context.write_json(_artefacts.MODEL, _artefacts.model_json(model))
    if ect.read(context.folder / _artefacts.TABLE) != table or ect.read_json(context.folder / _artefacts.TWIN) != table:
        raise VerifyError("export: the table read back from its file is not the table that was written")
    files = [
        {"file": _artefacts.TABLE, "what": "compensation table, binary", "error": "0", "read_back": "equal"},
        {"file": _artefacts.TWIN, "what": "its JSON twin", "error": "0", "read_back": "equal"},
    ]
    if targets:
        from errpipe.stages.targets import write_targets

        if not any(o.axis for o in table.outputs):
            named = " and ".join(o.name for o in table.outputs)
            raise GateError(
                f"export: no axis corrects {named}: state which one it acts on, such as "
                f"acts_on: {{{table.outputs[0].name}: {{axis: X, factor: 0.5}}}}"
            )

        files += write_targets(table, targets, context.folder)
    return files
