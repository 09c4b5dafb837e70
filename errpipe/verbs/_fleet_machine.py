"""One machine of a fleet, in a worker: its pipeline is run, and what the fleet needs of it is given back."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from errpipe import jsonfile
from errpipe.domain.error_model import ErrorModel, joined
from errpipe.domain.recording import Recording
from errpipe.errors import ErrpipeError, NotIdentifiable
from errpipe.pipeline import runner
from errpipe.pipeline.graph import models_of
from errpipe.pipeline.lock import leftover_note, read_lock
from errpipe.pipeline.spec import load_pipeline
from errpipe.stages import STAGES, _artefacts
from errpipe.stages.validate import HELD_OUT
from errpipe.validation.cusum import level_drift
from errpipe.validation.held_out import summarise_reasons
from errpipe.validation.input_drift import sensor_drift

if TYPE_CHECKING:
    from errpipe.pipeline.spec import Pipeline


def run_machine(pipeline: str, name: str, sets: Sequence[str], out: str) -> dict[str, Any]:
    """One machine's pipeline, in this process: what became of it, seconds and the peak of its memory, MB.

    Never raises: one machine's failure is a result.
    """
    begin, state, message = time.perf_counter(), "done", ""
    figures: dict[str, Any] = {"responses": {}, "drift": [], "model": "", "undetermined": False}
    folder, brought_up_to_date = Path(out) / "machines" / name, set()
    callbacks = runner.Callbacks(finished=lambda step: brought_up_to_date.add(step.name))
    with suppress(OSError):  # the peak of this process' memory counts from now (Linux)
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    try:
        spec = load_pipeline(Path(pipeline), STAGES, sets=sets)
        runner.run(spec, folder, callbacks=callbacks)
        figures = facts(spec, folder)
    except ErrpipeError as err:
        state, message = ("refused" if err.exit_code == 4 else "failed"), str(err).replace(out, "OUT")
        figures["undetermined"] = isinstance(err, NotIdentifiable)
    except OSError as err:  # a full disk, a share that went away
        what = f"{err.filename}: {err.strerror.lower()}" if err.filename and err.strerror else str(err)
        state, message = "failed", what
    except MemoryError:
        state, message = "failed", "out of memory: fewer --jobs at a time, or a larger machine"
    except Exception as err:
        state, message = "failed", f"internal error, please report it: {type(err).__name__}: {err}"
    message = message.replace(out, "OUT").replace(f"{Path(pipeline).parent}{os.sep}", "")
    message += leftover_note(folder, brought_up_to_date) if state != "done" else ""
    seconds = time.perf_counter() - begin
    result = {"name": name, "state": state, "message": message, "attempts": 1, "seconds": seconds}
    return figures | result | {"peak_mb": _peak_mb()}


def _peak_mb() -> float:
    """Peak of resident memory, MB; 0 where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), 0.0)


def facts(pipeline: Pipeline, out: Path) -> dict[str, Any]:
    """What the fleet needs of one finished run: held-out figures per response, what drifts, and the model.

    OUT may be a folder of the machine that ran it, which no other machine can read.
    """
    validations = [out / stage.label for stage in pipeline.stages if "validation" in stage.gives]
    fits = [out / name for name in models_of(pipeline.stages, pipeline.links)]
    recordings = [out / stage.label for stage in pipeline.stages if "recording" in stage.gives]
    figures: dict[str, Any] = {"responses": {}, "drift": [], "model": "", "readings": "", "not_judged": []}
    for folder in validations:
        document = jsonfile.read(folder / _artefacts.VALIDATION)
        for c in document["components"]:
            keys = ("rms_before", "rms_after", "noise_floor", "unit")
            figures["responses"][c["component"]] = {key: c[key] for key in keys}
        figures["not_judged"] += summarise_reasons(document.get("not_judged", ()))
    if fits:
        figures["model"] = ", ".join(f"{folder.name}/{_artefacts.MODEL}" for folder in fits)
        models = {folder.name: jsonfile.read(folder / _artefacts.MODEL) for folder in fits}
        figures["fits"] = {c["component"]: name for name, model in models.items() for c in model["components"]}
        several = [ErrorModel.model_validate(model) for model in models.values()] if len(fits) > 1 else []
        figures["parameters"] = _artefacts.model_json(joined(several)) if several else models[fits[0].name]
    if recordings:
        recording = _artefacts.recording_in(recordings[-1])
        figures["drift"] = [*_sensors(recording), *_residuals(recording, validations)]
        record = read_lock(out).get(recordings[-1].name)
        outputs = {} if record is None else record.outputs
        figures["readings"] = next((h for name, h in outputs.items() if name.endswith(".parquet")), "")
    return figures


def _sensors(recording: Recording) -> list[dict[str, Any]]:
    """Sensors that left the others in the second half of the runs."""
    early = recording.run_codes() < (len(recording.run_labels()) + 1) // 2
    return [
        {"what": f"sensor {d.column}" + " or another" * (not d.isolated), "since": d.since, "size": d.size, "unit": "K"}
        for d in sensor_drift(recording, early)
        if d.flagged
    ]


def _residuals(recording: Recording, validations: Sequence[Path]) -> list[dict[str, Any]]:
    """Responses whose mean per run changed its level in the second half, each run predicted without itself."""
    run, labels, out = recording.run_codes(), recording.run_labels(), []
    parts = [p for v in validations for p in pd.read_parquet(v / HELD_OUT).groupby("component", sort=False)]
    for component, part in dict(parts).items():
        means = part.groupby(run[part["row"].to_numpy()])["after"].mean()
        half = (len(means) + 1) // 2
        drift = level_drift(means.iloc[:half].tolist(), means.iloc[half:].tolist())
        if drift is not None:
            size = float(means.iloc[half + drift[1] :].mean() - means.iloc[:half].mean())
            since = labels[int(means.index[half + drift[1]])]
            out.append({"what": f"residual of {component}", "since": since, "size": size, "unit": "um"})
    return out
