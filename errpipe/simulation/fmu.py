"""A Functional Mock-up Unit (FMI 2 or 3, scalar variables) run over a recording's inputs, where it can do no harm.

FMPy runs the FMU in a process of its own with a time and a memory limit (`fmu_worker`): it may crash or hang, and what
comes of it is a message. That process has the rights of the user: run no FMU that you would not run as a program.

Rows that follow in time share a state; a new session (see `drivers.sessions`) starts the FMU anew, at its time 0.
Inputs are handed over in the FMU's own units, outputs come back as deviations in the response's unit. A few tunable
parameters may be recalibrated by bounded least squares before anything is called missing; the datum of the recording
stays out of that: a constant between recording and simulation moves no parameter.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.simulation.fmu_recalibration import recalibrated
from errpipe.simulation.fmu_units import SPELLINGS, convert
from errpipe.yamlfile import Options

MOST_STEPS = 5_000_000  # communication steps of one session
INNER = 4  # steps between two rows where the FMU states none: an input is held during a step
MOST_TUNABLE = 6  # parameters recalibrated at once
REACH = 2.0  # a tunable parameter without declared bounds may be this many times smaller or larger (from taste)
TAIL = 400  # characters of what the FMU last said
KEPT = (
    "PATH",
    "LANG",
    "LC_ALL",
    "TZ",
    "LD_LIBRARY_PATH",
    "SYSTEMROOT",
    "TEMP",
    "TMP",
    "TMPDIR",
    "HOME",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
)


class FmuInput(Options):
    """Which column drives an input of the FMU."""

    column: str = Field(description="Column of the recording.")
    unit: str | None = Field(None, description="Unit that the FMU means, where it states none.")
    rise_from: float | Literal["first"] | None = Field(
        None,
        description="A temperature becomes a rise: over this one, or over the first reading of the session.",
        json_schema_extra={"unit": "degC"},
    )


class FmuOutput(Options):
    """Which variable of the FMU is the simulated value of a response."""

    variable: str = Field(description="Name in the FMU.")
    unit: str | None = Field(None, description="Unit that the FMU means, where it states none.")
    means: Literal["deviation", "correction"] = Field("deviation", description="Actual minus commanded, or minus that.")


class Tunable(Options):
    """A parameter of the FMU that is set right before anything is called missing."""

    parameter: str = Field(description="Name in the FMU.")
    low: float = Field(description="Lowest value that can be.", json_schema_extra={"unit": "of the parameter"})
    high: float = Field(description="Highest value that can be.", json_schema_extra={"unit": "of the parameter"})

    @model_validator(mode="after")
    def _ordered(self) -> Tunable:
        if not self.low < self.high:
            raise ValueError(f"low {self.low:g} is not below high {self.high:g}")
        return self


class FmuOptions(Options):
    """How an FMU is run over a recording."""

    inputs: dict[str, FmuInput] = Field({}, description="Input of the FMU -> column that drives it.")
    outputs: dict[str, FmuOutput] = Field(min_length=1, description="Response of the recording -> variable of the FMU.")
    parameters: dict[str, float] = Field(
        {}, description="Values to set before the start, in the FMU's units.", json_schema_extra={"unit": "of each"}
    )
    recalibrate: tuple[Tunable, ...] = Field(
        (), max_length=MOST_TUNABLE, description="Parameters to set right on the recording."
    )
    step: float | None = Field(
        None,
        gt=0,
        description="Communication step; default: the FMU's own, else a quarter of the rows' step.",
        json_schema_extra={"unit": "s"},
    )
    time_limit: float = Field(
        60.0, gt=0, description="Longest time that a session may take to simulate.", json_schema_extra={"unit": "s"}
    )
    memory_mb: int = Field(2048, ge=256, description="Most memory that the FMU's process may take, MB.")


@dataclass(frozen=True)
class Ran:
    """values: response -> deviations, (rows,), in its unit; figures: what `twin.json` says of the run."""

    values: Mapping[str, np.ndarray]
    source: str
    notes: tuple[str, ...]
    figures: dict[str, Any]


def run(
    recording: Recording, how: FmuOptions, file: Path, progress: Callable[[float, str], None] = lambda share, text: None
) -> Ran:
    """Simulate every session of the recording. Raises UsageError without FMPy, DataError for all that goes wrong."""
    _refuse_missing(Path(file))
    with tempfile.TemporaryDirectory(prefix="errpipe-fmu-") as folder, Worker(Path(file), Path(folder), how) as worker:
        plan = Plan(recording, how, worker)
        progress(0.1, f"running {plan.name}")
        start = {t.parameter: plan.start_value(t.parameter) for t in how.recalibrate}
        values = plan.simulate(start)
        told: list[dict[str, Any]] = []
        if how.recalibrate:
            values, told = recalibrated(recording, how, plan, start, values, progress)
    figures = {"fmu": plan.name, "fmi": plan.facts["version"], "step_s": plan.step, "parameters": told}
    return Ran(values, plan.name, tuple(plan.notes), figures)


def by_name(recording: Recording, file: Path) -> dict[str, Any]:
    """`inputs` and `outputs` of an FMU whose variables are called as the recording's columns and responses are.

    Units are the recording's own where the FMU declares none. Parameters that the FMU calls tunable are to be
    recalibrated: see `tunable`. Raises DataError where no output is a response.
    """
    from errpipe.simulation.external import names_of

    _refuse_missing(file)
    how = FmuOptions(outputs={"EXX": FmuOutput(variable="not asked yet")})
    with tempfile.TemporaryDirectory(prefix="errpipe-fmu-") as folder, Worker(file, Path(folder), how) as worker:
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
        told = ", ".join(recording.components())
        near = did_you_mean(recording.components()[0], given) if recording.components() else ""
        raise DataError(f"{file.name}: none of its outputs ({', '.join(given)}) is a response ({told}).{near}")
    return {"inputs": inputs, "outputs": outputs, "recalibrate": tunable(variables)}


def tunable(variables: Mapping[str, Mapping[str, Any]]) -> tuple[Tunable, ...]:
    """What an FMU leaves to be set right: its tunable parameters, within their declared bounds, or half to twice.

    One that stands at zero and declares no bounds stays there: nothing says how far it may go.
    """
    out = []
    for name, v in variables.items():
        numeric = v["type"] in ("Real", "Float64", "Float32") and v["scalar"]
        if v["causality"] != "parameter" or v["variability"] != "tunable" or not numeric or v["start"] is None:
            continue
        start = float(v["start"])
        low, high = sorted((start / REACH, start * REACH))
        low = low if v["min"] is None else float(v["min"])
        high = high if v["max"] is None else float(v["max"])
        if low < high and low <= start <= high and np.isfinite([low, high]).all():
            out.append(Tunable(parameter=name, low=low, high=high))
    return tuple(out[:MOST_TUNABLE])


def _refuse_missing(file: Path) -> None:
    if importlib.util.find_spec("fmpy") is None:
        raise UsageError("an FMU is run by FMPy, which is not installed: pip install 'errpipe[fmu]'")
    if not file.is_file():
        raise DataError(f"{file.name}: there is no such file")


# ---------------------------------------------------------------- the process


class Worker:
    """The FMU's process: one order at a time, each answered in time or the end of it."""

    def __init__(self, file: Path, folder: Path, how: FmuOptions):
        self.file, self.folder, self.how = file, folder, how

    def __enter__(self) -> Worker:
        script = Path(__file__).with_name("fmu_worker.py")
        self.told = (self.folder / "told.txt").open("wb")
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(script)],
            cwd=self.folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.told,
            start_new_session=True,
            env={k: os.environ[k] for k in KEPT if k in os.environ},
        )
        assert self.process.stdin is not None and self.process.stdout is not None
        self.orders, self.answers = self.process.stdin, self.process.stdout
        return self

    def __exit__(self, *_: object) -> None:
        try:
            os.killpg(self.process.pid, signal.SIGKILL)  # it, and whatever the FMU may have started
        except (ProcessLookupError, PermissionError, AttributeError):
            self.process.kill()
        self.process.wait()
        for stream in (self.orders, self.answers, self.told):
            with contextlib.suppress(BrokenPipeError):
                stream.close()

    def load(self) -> dict[str, Any]:
        """The FMU unpacked and described."""
        order = {"do": "load", "fmu": str(self.file.resolve()), "memory_mb": self.how.memory_mb}
        return self._asked(order, "loading")

    def simulate(self, order: dict[str, Any]) -> None:
        """One session simulated into its output file."""
        self._asked({"do": "simulate", **order}, "simulating")

    def _asked(self, order: dict[str, Any], doing: str) -> Any:
        try:
            self.orders.write((json.dumps(order) + "\n").encode())
            self.orders.flush()
        except (BrokenPipeError, ValueError):
            raise self._ended(doing) from None
        line = self._line(doing)
        if not line.endswith(b"\n"):
            raise self._ended(doing)
        answer = json.loads(line)
        if "error" in answer:
            told = " ".join(answer["error"].replace(str(self.folder), "...").split())
            raise DataError(f"{self.file.name}: {doing} it failed: {told}{self._tail()}")
        return answer["ok"]

    def _line(self, doing: str) -> bytes:
        """One line of the answer. Raises DataError when time is up."""
        pipe, line = self.answers, b""
        end = time.monotonic() + self.how.time_limit
        while not line.endswith(b"\n"):
            left = end - time.monotonic()
            if left <= 0 or not select.select([pipe], [], [], left)[0]:
                raise DataError(
                    f"{self.file.name}: {doing} it took longer than {self.how.time_limit:g} s (time_limit); it was "
                    f"ended{self._tail()}"
                )
            piece = os.read(pipe.fileno(), 65536)
            if not piece:
                break
            line += piece
        return line

    def _ended(self, doing: str) -> DataError:
        code = self.process.wait()
        how = f"exit status {code}"
        if code < 0:
            how = signal.Signals(-code).name
        return DataError(f"{self.file.name}: {doing} it, its process ended by itself ({how}){self._tail()}")

    def _tail(self) -> str:
        self.told.flush()
        text = (self.folder / "told.txt").read_text("utf-8", errors="replace").strip()
        text = text.replace(str(self.folder), "...")
        lines = [line.strip() for line in text[-TAIL:].splitlines() if line.strip()]
        return f". It said: {' | '.join(lines[-3:])}" if lines else ""


# ---------------------------------------------------------------- what is handed over


class Plan:
    """A recording cut into sessions, inputs in the FMU's units, and how to turn outputs into deviations."""

    def __init__(self, recording: Recording, how: FmuOptions, worker: Worker):
        self.recording, self.how, self.worker, self.name = recording, how, worker, worker.file.name
        self.facts = worker.load()
        self.variables: dict[str, dict[str, Any]] = self.facts["variables"]
        self.notes: list[str] = []
        if not self.facts["kinds"]:
            raise DataError(f"{self.name}: neither co-simulation nor model exchange")
        self.session = sessions(recording)
        t = recording.time()
        if not np.isfinite(t).all():
            raise DataError(f"{self.name}: {np.count_nonzero(~np.isfinite(t))} rows have no time")
        self.step = self._step(t)
        self.inputs = {name: self._input(name, given) for name, given in how.inputs.items()}
        self._unmapped()
        self.outputs = {c: (o.variable, *self._output(c, o)) for c, o in how.outputs.items()}
        for name in (*how.parameters, *(p.parameter for p in how.recalibrate)):
            self._parameter(name)
        self._write_inputs(t)

    def variable(self, name: str, allowed: tuple[str, ...] = ()) -> dict[str, Any]:
        """A scalar variable of the FMU, of one of these causalities."""
        found = self.variables.get(name)
        fitting = [n for n, v in self.variables.items() if not allowed or v["causality"] in allowed]
        if found is None:
            what = allowed[0] if allowed else "variable"
            near = did_you_mean(name, fitting)
            raise DataError(f"{self.name}: no {what} {name!r} (it has: {', '.join(fitting[:12]) or 'none'}).{near}")
        if allowed and found["causality"] not in allowed:
            raise DataError(f"{self.name}: {name} is its {found['causality']}, not an {' or '.join(allowed)}")
        if not found["scalar"]:
            raise DataError(f"{self.name}: {name} is an array; scalar variables only")
        if found["type"] == "String":
            raise DataError(f"{self.name}: {name} is a text, not a number")
        return found

    def start_value(self, name: str) -> float:
        """Where a parameter stands before it is recalibrated: as set, else the FMU's own start, within its bounds."""
        tunable = next(t for t in self.how.recalibrate if t.parameter == name)
        said = self.how.parameters.get(name, self.variables[name]["start"])
        value = float(said) if said is not None else (tunable.low + tunable.high) / 2
        return float(np.clip(value, tunable.low, tunable.high))

    def _parameter(self, name: str) -> None:
        found = self.variable(name, ("parameter",))
        if found["variability"] not in ("fixed", "tunable"):
            raise DataError(f"{self.name}: {name} is {found['variability']}: it cannot be set")

    def _step(self, t: np.ndarray) -> float:
        if self.how.step is not None:
            return self.how.step
        if self.facts["step"]:
            return float(self.facts["step"])
        forward = np.diff(t)[np.diff(self.session) == 0]
        forward = forward[forward > 0]
        if not forward.size:
            raise DataError(f"{self.name}: time stands still in every run: say the communication step (`step`)")
        return float(np.median(forward)) / INNER

    def _unit(self, name: str, said: str | None) -> str:
        declared = self.variables[name]["unit"]
        written = said if said is not None else declared
        if written is None:
            raise DataError(f"{self.name}: {name} states no unit: say the one it means (`unit`)")
        unit = SPELLINGS.get(written, written)
        if declared is not None and SPELLINGS.get(declared, declared) != unit:
            raise DataError(f"{self.name}: {name} is declared in {declared}, not in {written}")
        return unit

    def _input(self, name: str, given: FmuInput) -> np.ndarray:
        """Values of one input on all rows, in the FMU's unit."""
        found = self.variable(name, ("input",))
        column = self.recording.manifest.columns.get(given.column)
        if column is None or given.column not in self.recording.frame.columns:
            near = did_you_mean(given.column, self.recording.frame.columns)
            raise DataError(f"{self.name}: {name} is driven by {given.column}, which the recording lacks.{near}")
        if column.role in ("run", "group"):
            raise DataError(f"{self.name}: {name} is driven by {given.column}, which is a label")
        values = self._filled(name, self.recording.array(given.column))
        plain = column.unit is None or found["type"] not in ("Real", "Float64", "Float32")
        if plain and given.unit is None and found["unit"] is None:
            return values
        unit, own = self._unit(name, given.unit), column.unit or "1"
        if given.rise_from is None:
            return convert(values, own, unit, f"{self.name}: {name} ({unit}) cannot be given {given.column} ({own})")
        if column.role != "temperature":
            raise DataError(f"{self.name}: {name}: rise_from is for temperatures; {given.column} is a {column.role}")
        zero = self._first(values) if given.rise_from == "first" else given.rise_from
        why = f"{self.name}: {name} ({unit}) cannot be given a temperature rise"
        return convert(values - zero, own, unit, why, rise=True)

    def _first(self, values: np.ndarray) -> np.ndarray:
        _, first = np.unique(self.session, return_index=True)
        return values[first][np.searchsorted(np.unique(self.session), self.session)]

    def _filled(self, name: str, values: np.ndarray) -> np.ndarray:
        """Missing readings interpolated in time inside a session, held at its ends."""
        bad, out, t = ~np.isfinite(values), values.copy(), self.recording.time()
        for s in np.unique(self.session[bad]):
            rows = np.flatnonzero(self.session == s)
            good = rows[~bad[rows]]
            if good.size < max(1, rows.size / 2):
                raise DataError(
                    f"{self.name}: {self.how.inputs[name].column}, which drives {name}, misses "
                    f"{rows.size - good.size} of {rows.size} readings from row {rows[0] + 1} on"
                )
            out[rows] = np.interp(t[rows], t[good], values[good])
        if bad.any():
            told = np.count_nonzero(bad)
            self.notes.append(f"{told} missing readings of {self.how.inputs[name].column} were filled in between")
        return out

    def _unmapped(self) -> None:
        for name, found in self.variables.items():
            if found["causality"] != "input" or name in self.how.inputs:
                continue
            if found["start"] is None:
                raise DataError(f"{self.name}: its input {name} is driven by nothing and has no start value")
            self.notes.append(f"input {name} stays at its start value {found['start']}")

    def _output(self, component: str, wanted: FmuOutput) -> tuple[str, str, float]:
        """FMU unit, response unit and sign of one output."""
        from errpipe.simulation.external import error_column

        unit = self.recording.manifest.columns[error_column(self.recording, component)].unit or "um"
        self.variable(wanted.variable, ("output", "local"))
        own = self._unit(wanted.variable, wanted.unit)
        convert(0.0, own, unit, f"{self.name}: {component} ({unit}) cannot be {wanted.variable} ({own})")
        return own, unit, -1.0 if wanted.means == "correction" else 1.0

    def _write_inputs(self, t: np.ndarray) -> None:
        self.stretches: list[tuple[np.ndarray, np.ndarray, dict[str, Any]]] = []
        for k, s in enumerate(np.unique(self.session)):
            rows = np.flatnonzero(self.session == s)
            at = t[rows] - t[rows[0]]
            if at[-1] / self.step > MOST_STEPS:
                raise DataError(f"{self.name}: {at[-1]:g} s in steps of {self.step:g} s are too many (say `step`)")
            order: dict[str, Any] = {"stop": float(max(at[-1], self.step)), "inputs": "", "output": f"out{k}.npy"}
            if self.inputs:
                new = np.r_[True, np.diff(at) > 0]
                types = [("time", float), *((name, float) for name in self.inputs)]
                signals = np.zeros(int(new.sum()), dtype=types)
                signals["time"] = at[new]
                for name, values in self.inputs.items():
                    signals[name] = values[rows][new]
                order["inputs"] = f"in{k}.npy"
                np.save(self.worker.folder / order["inputs"], signals, allow_pickle=False)
            self.stretches.append((rows, at, order))

    def simulate(self, parameters: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Deviations of every response on all rows with these parameters; NaN where the FMU gave no number."""
        out = {c: np.full(len(self.recording), np.nan) for c in self.outputs}
        names = list(dict.fromkeys(v for v, *_ in self.outputs.values()))
        kind = self.facts["kinds"][0]
        start = {**self.how.parameters, **parameters}
        for rows, at, order in self.stretches:
            self.worker.simulate({**order, "outputs": names, "start_values": start, "step": self.step, "kind": kind})
            table = np.load(self.worker.folder / order["output"], allow_pickle=False)
            if table[-1, 0] < at[-1] - self.step:
                raise DataError(f"{self.name}: it stopped at {table[-1, 0]:g} s of {at[-1]:g} s")
            for component, (variable, own, unit, sign) in self.outputs.items():
                values = np.interp(at, table[:, 0], table[:, 1 + names.index(variable)])
                out[component][rows] = sign * convert(values, own, unit, self.name)
        return out
