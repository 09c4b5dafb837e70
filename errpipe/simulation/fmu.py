"""A Functional Mock-up Unit (FMI 2 or 3, scalar variables), run over a recording's inputs in isolation.

FMPy runs the FMU in a separate process with a time and a memory limit (`fmu_worker`): if it crashes or hangs, the
result is a message. On Linux it can write only in its own folder; it can still read what the user can read and use
the network: run no FMU that you would not run as a program.

Consecutive rows share a state; a new session (see `drivers.sessions`) restarts the FMU at its time 0.
Inputs are converted to the FMU's own units, outputs to deviations in the response's unit. A few tunable
parameters may be recalibrated by bounded least squares before the diagnosis; the datum of the recording
is a nuisance parameter there: a constant between recording and simulation does not change a parameter.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.simulation.fmu_plan import Plan
from errpipe.simulation.fmu_process import FmuProcess
from errpipe.simulation.fmu_recalibration import recalibrated
from errpipe.simulation.responses import names_of
from errpipe.simulation.twin_options import MAX_TUNABLE, FmuInput, FmuOptions, FmuOutput, Tunable

RECALIBRATION_RANGE = 2.0  # without declared bounds a tunable parameter may halve or double (by judgement)


@dataclass(frozen=True)
class FmuResult:
    """values: response -> deviations, (rows,), in its unit; figures: of the run, for `twin.json`."""

    values: Mapping[str, np.ndarray]
    source: str
    notes: tuple[str, ...]
    figures: dict[str, Any]


def run(
    recording: Recording, how: FmuOptions, file: Path, progress: Callable[[float, str], None] = lambda share, text: None
) -> FmuResult:
    """Simulate every session of the recording. Raises UsageError without FMPy, DataError for all other failures."""
    _refuse_missing(Path(file))
    with (
        tempfile.TemporaryDirectory(prefix="errpipe-fmu-") as folder,
        FmuProcess(Path(file), Path(folder), how) as worker,
    ):
        plan = Plan(recording, how, worker)
        progress(0.1, f"running {plan.name}")
        start = {t.parameter: plan.start_value(t.parameter) for t in how.recalibrate}
        values = plan.simulate(start)
        parameters: list[dict[str, Any]] = []
        if how.recalibrate:
            values, parameters = recalibrated(recording, how, plan, start, values, progress)
    figures = {"fmu": plan.name, "fmi": plan.facts["version"], "step_s": plan.step, "parameters": parameters}
    return FmuResult(values, plan.name, tuple(plan.notes), figures)


def by_name(recording: Recording, file: Path) -> dict[str, Any]:
    """`inputs` and `outputs` of an FMU whose variables are named as the recording's columns and responses.

    Units are the recording's own if the FMU declares none. Parameters that the FMU declares tunable are to be
    recalibrated: see `tunable`. Raises DataError if no output is a response.
    """
    _refuse_missing(file)
    how = FmuOptions(outputs={"EXX": FmuOutput(variable="unknown")})
    with tempfile.TemporaryDirectory(prefix="errpipe-fmu-") as folder, FmuProcess(file, Path(folder), how) as worker:
        variables = worker.load()["variables"]
    columns = recording.manifest.columns
    inputs = {
        name: FmuInput(column=name, unit=None if v["unit"] else columns[name].unit)
        for name, v in variables.items()
        if v["causality"] == "input" and name in columns and name in recording.frame.columns
    }
    outputs, given = {}, [n for n, v in variables.items() if v["causality"] == "output"]
    for component in recording.components():
        name = next((n for n in names_of(recording, component) if n in given), None)
        if name is not None:
            unit = columns[str(recording.name("error", component=component))].unit
            outputs[component] = FmuOutput(variable=name, unit=None if variables[name]["unit"] else unit)
    if not outputs:
        responses = ", ".join(recording.components())
        near = did_you_mean(recording.components()[0], given) if recording.components() else ""
        raise DataError(f"{file.name}: none of its outputs ({', '.join(given)}) is a response ({responses}).{near}")
    return {"inputs": inputs, "outputs": outputs, "recalibrate": tunable(variables)}


def tunable(variables: Mapping[str, Mapping[str, Any]]) -> tuple[Tunable, ...]:
    """Tunable parameters of an FMU with their declared bounds, or half to twice the start value.

    A parameter of 0 without declared bounds is not recalibrated: its range is unknown.
    """
    out = []
    for name, v in variables.items():
        numeric = v["type"] in ("Real", "Float64", "Float32") and v["scalar"]
        if v["causality"] != "parameter" or v["variability"] != "tunable" or not numeric or v["start"] is None:
            continue
        start = float(v["start"])
        low, high = sorted((start / RECALIBRATION_RANGE, start * RECALIBRATION_RANGE))
        low = low if v["min"] is None else float(v["min"])
        high = high if v["max"] is None else float(v["max"])
        if low < high and low <= start <= high and np.isfinite([low, high]).all():
            out.append(Tunable(parameter=name, low=low, high=high))
    return tuple(out[:MAX_TUNABLE])


def _refuse_missing(file: Path) -> None:
    if importlib.util.find_spec("fmpy") is None:
        raise UsageError("an FMU is run by FMPy, which is not installed: pip install 'errpipe[fmu]'")
    if not file.is_file():
        raise DataError(f"{file.name}: there is no such file")
