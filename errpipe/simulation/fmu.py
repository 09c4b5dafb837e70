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
import math
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
from errpipe.simulation.responses import names_of
from errpipe.simulation.twin_options import MAX_TUNABLE, FmuInput, FmuOptions, FmuOutput, Tunable

MAX_EVALUATIONS = 15  # of the residual, without gradients; chosen for at most two minutes with one parameter
MIN_GAIN = 0.01  # share of the mismatch that a recalibration must remove to be used (chosen, not measured)


def recalibrated(
    recording: Recording, how: FmuOptions, plan: Plan, start: dict[str, float], begin: dict[str, np.ndarray], progress
) -> tuple[dict[str, np.ndarray], list[dict[str, Any]]]:
    """The simulation with its tunable parameters fitted within their bounds, and the result for each."""
    from scipy.optimize import least_squares

    low, high = (np.array([getattr(t, end) for t in how.recalibrate]) for end in ("low", "high"))
    names = [t.parameter for t in how.recalibrate]
    mismatch = _Mismatch(recording, begin)
    cache: dict[bytes, np.ndarray] = {}

    def residual(share: np.ndarray) -> np.ndarray:
        key = share.tobytes()
        if key not in cache:
            progress(min(0.2 + 0.7 * len(cache) / (MAX_EVALUATIONS * (len(names) + 1)), 0.9), "recalibrating")
            cache[key] = mismatch(plan.simulate(dict(zip(names, low + share * (high - low), strict=True))))
        return cache[key]

    inside = np.clip((np.array([start[n] for n in names]) - low) / (high - low), 1e-3, 1 - 1e-3)
    robust = {"loss": "soft_l1", "f_scale": 3.0, "max_nfev": MAX_EVALUATIONS, "xtol": 1e-5, "ftol": 1e-6}
    optimum = least_squares(residual, inside, bounds=(0.0, 1.0), diff_step=1e-3, **robust)
    tuned = dict(zip(names, map(float, low + optimum.x * (high - low)), strict=True))
    values = plan.simulate(tuned)
    improved = mismatch.rms(values) < (1 - MIN_GAIN) * mismatch.rms(begin)
    if not improved:
        plan.notes.append("recalibration did not reduce the mismatch: the parameters are unchanged")
    sensitive = [
        mismatch.is_sensitive(values, plan.simulate(tuned | {n: _other_value(tuned[n], a, b)}))
        for n, a, b in zip(names, low, high, strict=True)
    ]
    parameters = [
        {
            "parameter": n,
            "start": start[n],
            "value": tuned[n] if improved else start[n],
            "low": float(a),
            "high": float(b),
            "at_a_bound": bool(improved and not 1e-3 < x < 1 - 1e-3),
            "shows": s,
        }
        for n, a, b, x, s in zip(names, low, high, optimum.x, sensitive, strict=True)
    ]
    plan.notes += [
        f"{t['parameter']} changes only the datum: it is not determined" for t in parameters if not t["shows"]
    ]
    plan.notes += [f"{t['parameter']} ends at one of its bounds" for t in parameters if t["at_a_bound"]]
    return (values if improved else begin), parameters


def _other_value(value: float, low: float, high: float) -> float:
    """A value a tenth of the range away, inside it."""
    step = 0.1 * (high - low)
    return float(value + step if value + step <= high else value - step)


class _Mismatch:
    """Recorded minus simulated, without the datum, over each response's spread."""

    def __init__(self, recording: Recording, begin: Mapping[str, np.ndarray]):
        self.recorded = {c: recording.array(str(recording.name("error", component=c))) for c in begin}
        self.rows = {c: np.flatnonzero(np.isfinite(v) & np.isfinite(begin[c])) for c, v in self.recorded.items()}
        for component, rows in self.rows.items():
            if rows.size < 10:
                raise DataError(f"twin: {component}: only {rows.size} rows to recalibrate on (at least 10)")
        self.scale = {c: self._spread(c, begin[c]) for c in begin}

    def _spread(self, component: str, begin: np.ndarray) -> float:
        residual = (self.recorded[component] - begin)[self.rows[component]]
        step = 1.4826 * np.median(np.abs(np.diff(residual))) / math.sqrt(2)
        return float(max(step, 0.01 * np.std(residual), 1e-9))

    def __call__(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        parts = []
        for component, rows in self.rows.items():
            residual = (self.recorded[component] - values[component])[rows]
            rejected = 1e6 * self.scale[component]  # so large that the search rejects the step
            residual = np.where(np.isfinite(residual), residual, rejected)
            parts.append((residual - np.median(residual)) / self.scale[component])
        return np.concatenate(parts)

    def is_sensitive(self, values: Mapping[str, np.ndarray], moved: Mapping[str, np.ndarray]) -> bool:
        """Whether a change of a parameter changes some response by more than a constant and the noise."""
        for component, rows in self.rows.items():
            change = (moved[component] - values[component])[rows]
            change = change[np.isfinite(change)]
            shape = float(np.quantile(np.abs(change - np.median(change)), 0.95)) if change.size else 0.0
            if shape > 0.02 * self.scale[component] and shape > 0.02 * abs(float(np.median(change))):
                return True
        return False

    def rms(self, values: Mapping[str, np.ndarray]) -> float:
        """Root mean square without the widest tenth (outliers), over all responses."""
        residual = np.sort(np.abs(self(values)))
        return float(np.sqrt(np.mean(residual[: int(0.9 * residual.size)] ** 2)))


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
