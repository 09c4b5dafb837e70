"""The simulation's side of a diagnosis: a CSV aligned by time, errpipe's own fitted model, or an FMU over the inputs.

Each gives the recording further columns of role `simulated`, one for each response it knows; an FMU also gives
the sensitivity of every response to its tunable parameters, so that another parameter value is never taken for
missing physics.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Recording
from errpipe.errors import DataError, did_you_mean

TIME_LIMIT = 120.0  # s, for one run of an FMU over the recording
STEP = 0.02  # share by which a tunable parameter is moved to see its effect
SENSITIVITY = "sensitivity of "  # names of columns that hold what a tunable parameter does


def with_twins(recording: Recording, twins: Mapping[str, np.ndarray]) -> Recording:
    """The recording with simulated columns, component -> values (rows,); those it had are replaced."""
    columns, kinds = {}, {}
    for component, values in twins.items():
        error = recording.name("error", component=component)
        if error is None:
            continue
        name = recording.name("simulated", component=component) or f"{error}_sim"
        columns[name] = np.asarray(values, dtype=float)
        kinds[name] = Column(role="simulated", component=component, unit=recording.manifest.columns[error].unit)
    if not columns:
        raise DataError(
            f"the simulation knows {', '.join(twins) or 'nothing'}, the recording {', '.join(recording.components())}: "
            "no response in common"
        )
    return recording.with_columns(columns, kinds)


def from_csv(recording: Recording, path: Path) -> Recording:
    """Simulated values from a CSV with a time column and one column per response, interpolated to the rows' times.

    The time column is called as in the recording (or `t`, `time`), in s; a response's column is its component, its
    error column or that with `_sim`; values in the unit of the error column.
    """
    import pandas as pd

    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as err:
        raise DataError(f"{path}: not a CSV table: {err}") from None
    clock = next((c for c in (recording.name("time"), "t", "time") if c in table.columns), None)
    if clock is None or recording.name("time") is None:
        raise DataError(f"{path}: needs a time column (found {', '.join(map(str, table.columns))})")
    at = pd.to_numeric(table[clock], errors="coerce").to_numpy(dtype=float)
    t = recording.time()
    twins = {}
    for component in recording.components():
        error = recording.name("error", component=component)
        name = next((c for c in (f"{error}_sim", f"{component}_sim", component, error) if c in table.columns), None)
        if name is None:
            continue
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float)
        good = np.isfinite(at) & np.isfinite(values)
        if good.sum() < 2:
            raise DataError(f"{path}: column {name} holds fewer than two values")
        order = np.argsort(at[good], kind="stable")
        first, last = at[good][order][[0, -1]]
        inside = (t >= first) & (t <= last)
        twins[component] = np.where(inside, np.interp(t, at[good][order], values[good][order]), np.nan)
    return with_twins(recording, twins)


def from_model(recording: Recording, model: ErrorModel) -> Recording:
    """errpipe's own fitted model as the simulation."""
    from errpipe.fitting.components import evaluate

    return with_twins(recording, evaluate(model, recording))


def from_fmu(recording: Recording, path: Path, time_limit: float = TIME_LIMIT) -> tuple[Recording, tuple[str, ...]]:
    """An FMU run over the recorded inputs; also the tunable parameters whose effect was found.

    Inputs of the FMU are columns of the recording with the same names, its outputs components (or error columns).
    It runs in a process of its own: one that crashes, hangs or writes nonsense is a DataError here, no more.
    """
    if not Path(path).is_file():
        raise DataError(f"{path}: there is no such file")
    facts = _run(recording, path, {}, time_limit)
    twins = _outputs(recording, facts, path)
    parameters = facts["parameters"]
    columns, kinds, moved = {}, {}, []
    for name, value in parameters.items():
        step = STEP * abs(value) or STEP
        shifted = _outputs(recording, _run(recording, path, {name: value + step}, time_limit), path)
        for component, values in shifted.items():
            effect = (values - twins[component]) / step * (abs(value) or 1.0)
            if np.nanmax(np.abs(effect)) > 0:
                key = f"{SENSITIVITY}{component} to {name}"
                columns[key], kinds[key] = effect, Column(role="ignore")
                moved.append(name)
    out = with_twins(recording, twins)
    return (out.with_columns(columns, kinds) if columns else out), tuple(dict.fromkeys(moved))


def _outputs(recording: Recording, facts: Mapping, path: Path) -> dict[str, np.ndarray]:
    twins = {}
    for component in recording.components():
        error = recording.name("error", component=component)
        name = next((n for n in (component, error, f"{error}_sim") if n in facts["outputs"]), None)
        if name is not None:
            values = np.asarray(facts["outputs"][name], dtype=float)
            twins[component] = np.where(np.isfinite(values), values, np.nan)
    if not twins:
        known = list(facts["outputs"])
        hint = did_you_mean(recording.components()[0], known)
        raise DataError(
            f"{path}: none of its outputs ({', '.join(known)}) is a response of the recording "
            f"({', '.join(recording.components())}).{hint}"
        )
    return twins


def _run(recording: Recording, path: Path, parameters: Mapping[str, float], time_limit: float) -> dict:
    """One run in a process of its own, exchanged through files."""
    with tempfile.TemporaryDirectory() as folder:
        ask, answer = Path(folder) / "ask.json", Path(folder) / "answer.json"
        inputs = {
            name: np.nan_to_num(recording.array(name)).tolist()
            for name, column in recording.manifest.columns.items()
            if column.role not in ("run", "group", "error", "simulated", "ignore") and name in recording.frame.columns
        }
        question = {"fmu": str(path), "t": recording.time().tolist(), "inputs": inputs, "set": dict(parameters)}
        ask.write_text(json.dumps(question), encoding="utf-8")
        command = [sys.executable, "-m", "errpipe.diagnosis.fmu_process", str(ask), str(answer)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=time_limit, check=False, cwd=folder)
        except subprocess.TimeoutExpired:
            raise DataError(f"{path}: still not done after {time_limit:g} s; stopped") from None
        if done.returncode != 0 or not answer.is_file():
            last = (done.stderr.strip().splitlines() or ["it ended without a word"])[-1]
            raise DataError(f"{path}: the FMU failed: {last}")
        return json.loads(answer.read_text(encoding="utf-8"))
