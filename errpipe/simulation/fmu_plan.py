"""A recording split into sessions for an FMU: its inputs in the FMU's units, its outputs converted to deviations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError, did_you_mean
from errpipe.simulation.fmu_process import FmuProcess
from errpipe.simulation.responses import error_column
from errpipe.simulation.twin_options import FmuInput, FmuOptions, FmuOutput
from errpipe.yamlfile import UNITS

# dimension -> {unit: (zero, factor)}: base = (value - zero) * factor; in an FMU all speeds of rotation are one
TABLE = {name: {u: (float(zero), float(factor)) for u, (zero, factor) in of.items()} for name, of in UNITS.items()}
ROTATION = {"rad/s": 1, "rpm": math.pi / 30, "1/s": 2 * math.pi, "deg/s": math.pi / 180, "deg/min": math.pi / 10800}
TABLE["angular speed"] = {unit: (0.0, factor) for unit, factor in ROTATION.items()}
RISE = "temperature rise"
TABLE[RISE] = {"K": (0.0, 1.0), "degC": (0.0, 1.0), "degF": (0.0, 5 / 9)}
for name in ("rotational speed", "temperature difference"):
    del TABLE[name]
WRITTEN_AS = {
    "degC": ("C", "Cel", "celsius", "deg_C"),
    "degF": ("F",),
    "um": ("µm", "μm"),
    "inch": ("in",),
    "rpm": ("rev/min", "1/min", "r/min"),
    "1/s": ("Hz",),
    "m/s": ("m.s-1",),
    "m/s2": ("m/s^2", "m.s-2"),
    "mm/s2": ("mm/s^2",),
    "rad/s": ("rad.s-1",),
    "1": ("-", ""),
}
SPELLINGS = {spelling: unit for unit, spellings in WRITTEN_AS.items() for spelling in spellings}

MAX_STEPS = 5_000_000  # communication steps of one session: about ten minutes of a light FMU
STEPS_PER_ROW = 4  # communication steps between two rows if the FMU states none: an input is held during a step


class Plan:
    """A recording split into sessions, inputs in the FMU's units, and the conversion of outputs to deviations."""

    def __init__(self, recording: Recording, how: FmuOptions, worker: FmuProcess):
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
        variable = self.variables.get(name)
        fitting = [n for n, v in self.variables.items() if not allowed or v["causality"] in allowed]
        if variable is None:
            what = allowed[0] if allowed else "variable"
            near = did_you_mean(name, fitting)
            raise DataError(f"{self.name}: no {what} {name!r} (it has: {', '.join(fitting[:12]) or 'none'}).{near}")
        if allowed and variable["causality"] not in allowed:
            raise DataError(f"{self.name}: {name} is its {variable['causality']}, not an {' or '.join(allowed)}")
        if not variable["scalar"]:
            raise DataError(f"{self.name}: {name} is an array; scalar variables only")
        if variable["type"] == "String":
            raise DataError(f"{self.name}: {name} is a text, not a number")
        return variable

    def start_value(self, name: str) -> float:
        """Start value of a parameter before recalibration: as set, else the FMU's own, within its bounds."""
        tunable = next(t for t in self.how.recalibrate if t.parameter == name)
        stated = self.how.parameters.get(name, self.variables[name]["start"])
        value = float(stated) if stated is not None else (tunable.low + tunable.high) / 2
        return float(np.clip(value, tunable.low, tunable.high))

    def _parameter(self, name: str) -> None:
        variable = self.variable(name, ("parameter",))
        if variable["variability"] not in ("fixed", "tunable"):
            raise DataError(f"{self.name}: {name} is {variable['variability']}: it cannot be set")

    def _step(self, t: np.ndarray) -> float:
        if self.how.step is not None:
            return self.how.step
        if self.facts["step"]:
            return float(self.facts["step"])
        forward = np.diff(t)[np.diff(self.session) == 0]
        forward = forward[forward > 0]
        if not forward.size:
            raise DataError(f"{self.name}: time does not advance in any run: state the communication step (`step`)")
        return float(np.median(forward)) / STEPS_PER_ROW

    def _unit(self, name: str, stated: str | None) -> str:
        declared = self.variables[name]["unit"]
        written = stated if stated is not None else declared
        if written is None:
            raise DataError(f"{self.name}: {name} has no declared unit: set it with `unit`")
        unit = SPELLINGS.get(written, written)
        if declared is not None and SPELLINGS.get(declared, declared) != unit:
            raise DataError(f"{self.name}: {name} is declared in {declared}, not in {written}")
        return unit

    def _input(self, name: str, given: FmuInput) -> np.ndarray:
        """Values of one input on all rows, in the FMU's unit."""
        variable = self.variable(name, ("input",))
        column = self.recording.manifest.columns.get(given.column)
        if column is None or given.column not in self.recording.frame.columns:
            near = did_you_mean(given.column, self.recording.frame.columns)
            raise DataError(f"{self.name}: {name} is driven by {given.column}, which the recording lacks.{near}")
        if column.role in ("run", "group"):
            raise DataError(f"{self.name}: {name} is driven by {given.column}, which is a label")
        values = self._filled(name, self.recording.array(given.column))
        plain = column.unit is None or variable["type"] not in ("Real", "Float64", "Float32")
        if plain and given.unit is None and variable["unit"] is None:
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
            filled = np.count_nonzero(bad)
            self.notes.append(f"{filled} missing readings of {self.how.inputs[name].column} were interpolated")
        return out

    def _unmapped(self) -> None:
        for name, variable in self.variables.items():
            if variable["causality"] != "input" or name in self.how.inputs:
                continue
            if variable["start"] is None:
                raise DataError(f"{self.name}: its input {name} has neither a column nor a start value")
            self.notes.append(f"input {name} keeps its start value {variable['start']}")

    def _output(self, component: str, wanted: FmuOutput) -> tuple[str, str, float]:
        """FMU unit, response unit and sign of one output."""
        unit = self.recording.manifest.columns[error_column(self.recording, component)].unit or "um"
        self.variable(wanted.variable, ("output", "local"))
        own = self._unit(wanted.variable, wanted.unit)
        convert(0.0, own, unit, f"{self.name}: {component} ({unit}) cannot be {wanted.variable} ({own})")
        return own, unit, -1.0 if wanted.means == "correction" else 1.0

    def _write_inputs(self, t: np.ndarray) -> None:
        self.stretches: list[tuple[np.ndarray, np.ndarray, float, np.ndarray | None]] = []
        for s in np.unique(self.session):
            rows = np.flatnonzero(self.session == s)
            at = t[rows] - t[rows[0]]
            if at[-1] / self.step > MAX_STEPS:
                raise DataError(f"{self.name}: {at[-1]:g} s in steps of {self.step:g} s are too many (set `step`)")
            stop, signals = float(max(at[-1], self.step)), None
            if self.inputs:
                new = np.r_[True, np.diff(at) > 0]
                types = [("time", float), *((name, float) for name in self.inputs)]
                signals = np.zeros(int(new.sum()), dtype=types)
                signals["time"] = at[new]
                for name, values in self.inputs.items():
                    signals[name] = values[rows][new]
            self.stretches.append((rows, at, stop, signals))

    def simulate(self, parameters: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Deviations of every response on all rows with these parameters; NaN where the FMU returned no number."""
        out = {c: np.full(len(self.recording), np.nan) for c in self.outputs}
        names = list(dict.fromkeys(v for v, *_ in self.outputs.values()))
        kind = self.facts["kinds"][0]
        start = {**self.how.parameters, **parameters}
        order = {"outputs": names, "start_values": start, "step": self.step, "kind": kind}
        for rows, at, stop, signals in self.stretches:
            table = self.worker.simulate(order | {"stop": stop}, signals)
            if table[-1, 0] < at[-1] - self.step:
                raise DataError(f"{self.name}: it stopped at {table[-1, 0]:g} s of {at[-1]:g} s")
            for component, (variable, own, unit, sign) in self.outputs.items():
                values = np.interp(at, table[:, 0], table[:, 1 + names.index(variable)])
                out[component][rows] = sign * convert(values, own, unit, self.name)
        return out


def convert(values: Any, own: str, unit: str, why: str, rise: bool = False) -> Any:
    """Convert values from one unit to another. Raises DataError starting with `why` for different quantities."""
    kinds = [k for k, units in TABLE.items() if own in units and unit in units]
    kinds = [k for k in kinds if (k == RISE) == rise] if own in ("K", "degC", "degF") else kinds
    if not kinds:
        of = {u: next((k for k, known in TABLE.items() if u in known), "not a known unit") for u in (own, unit)}
        raise DataError(f"{why}: {own} is {of[own]}, {unit} is {of[unit]}")
    (zero, factor), (to_zero, to_factor) = TABLE[kinds[0]][own], TABLE[kinds[0]][unit]
    if own == unit:
        return values
    return (values - zero) * factor / to_factor + to_zero
