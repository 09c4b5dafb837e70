"""A recording: what every column of a measurement *is* (the manifest), and its rows.

The manifest is version 1 of the recording manifest; nothing is guessed from a column's name. A
`Recording` is always in canonical units (mm, deg, s, mm/s, mm/min, rpm, degC, hPa, N, kg, um, urad, N):
readers convert when they read.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from errpipe.errors import MissingColumn, did_you_mean
from errpipe.yamlfile import quantity

Role = Literal[
    "run",
    "time",
    "group",
    "position",
    "command",
    "actual",
    "direction",
    "velocity",
    "acceleration",
    "feed",
    "spindle_speed",
    "temperature",
    "pressure",
    "humidity",
    "coolant",
    "force",
    "current",
    "torque",
    "load",
    "depth_of_cut",
    "overhang",
    "cut_length",
    "size",
    "uncertainty",
    "error",
    "simulated",
    "ignore",
]

# Allowed units of each role, the canonical one first; () means the role has none.
ROLE_UNITS: dict[str, tuple[str, ...]] = {
    "run": (),
    "group": (),
    "ignore": (),
    "direction": (),
    "coolant": ("l/min",),  # or none: 1 while it flows, else 0
    "time": ("s", "ms", "min", "h", "d"),
    "position": ("mm", "deg", "m", "um", "inch", "rad"),
    "command": ("mm", "deg", "m", "um", "inch", "rad"),
    "actual": ("mm", "deg", "m", "um", "inch", "rad"),
    "velocity": ("mm/s", "deg/s", "m/s", "mm/min", "m/min"),
    "acceleration": ("mm/s2", "deg/s2", "m/s2"),
    "feed": ("mm/min", "m/min", "mm/s", "deg/min"),
    "spindle_speed": ("rpm", "1/s"),
    "temperature": ("degC", "degF", "K"),
    "pressure": ("hPa", "Pa", "kPa", "bar", "mbar"),
    "humidity": ("%",),
    "force": ("N", "kN"),
    "current": ("A", "mA"),
    "torque": ("N m", "N mm", "N cm", "kN m"),
    "load": ("kg", "g", "t"),
    "depth_of_cut": ("mm", "um"),
    "overhang": ("mm", "m"),
    "cut_length": ("m", "mm", "km"),
    "size": ("mm", "m", "inch"),
    "uncertainty": ("um", "urad", "mm", "nm", "arcsec", "mrad"),
    "error": ("um", "urad", "N", "kN", "mm", "nm", "arcsec", "mrad", "N m", "N mm", "N cm", "kN m"),
    "simulated": ("um", "urad", "N", "kN", "mm", "nm", "arcsec", "mrad", "N m", "N mm", "N cm", "kN m"),
}

# Roles whose canonical unit is optional to state (the contract writes them without one).
UNITLESS_BY_DEFAULT = {"pressure": "hPa", "humidity": "%", "spindle_speed": "rpm", "time": "s", "feed": "mm/min"}

# How people write units -> how they are written here.
_SPELLINGS = {
    "c": "degC",
    "celsius": "degC",
    "deg c": "degC",
    "f": "degF",
    "fahrenheit": "degF",
    "kelvin": "K",
    "in": "inch",
    "inches": "inch",
    '"': "inch",
    "micron": "um",
    "microns": "um",
    "sec": "s",
    "seconds": "s",
    "minutes": "min",
    "hours": "h",
    "hr": "h",
    "days": "d",
    "1/min": "rpm",
    "u/min": "rpm",
    "rev/min": "rpm",
    "hz": "1/s",
    "m/s^2": "m/s2",
    "mm/s^2": "mm/s2",
    "m/s²": "m/s2",
    "mm/s²": "mm/s2",
    "percent": "%",
    "lpm": "l/min",
    "liters/min": "l/min",
    "litres/min": "l/min",
    "newton": "N",
    "n·m": "N m",
    "n*m": "N m",
    "newton metre": "N m",
    "degrees": "deg",
    "": "deg",
    "radians": "rad",
}


class FrozenModel(BaseModel):
    """Immutable, and a key it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


class Derived(FrozenModel):
    """How a column that is in no table comes about: one of a difference, a multiple of a column, a constant."""

    minus: tuple[str, str] | None = Field(
        None, description="First column less the second one; of positions in mm the result is in um, in deg in urad."
    )
    of: str | None = Field(None, description="Column of the table whose number, as written, is multiplied.")
    factor: float = quantity(
        "the column's unit per unit of `of`",
        "What it is multiplied by, such as the resolution of an encoder or a torque constant.",
        1.0,
    )
    offset: float = quantity("of the column", "What is added then.", 0.0)
    constant: float | None = quantity("of the column", "The same value in every row.", None)

    @model_validator(mode="after")
    def _one_way(self) -> Derived:
        ways = [n for n in ("minus", "of", "constant") if getattr(self, n) is not None]
        if len(ways) != 1:
            raise ValueError(f"one of minus, of and constant is needed (found: {', '.join(ways) or 'none'})")
        return self


class ActsOn(FrozenModel):
    """The axis that corrects a component that belongs to no axis."""

    axis: str = Field(description="Letter of the axis, such as X.", pattern="^[A-Z][A-Z0-9]{0,6}$")
    factor: float | None = quantity(
        "1",
        "Deviation along the axis per deviation of the component. A diameter on X: 0.5 (the default) where "
        "the axis counts in radius, as joints of a control do in diameter programming too, 1 where its compensation "
        "counts in diameter; negative where the tool is on the minus side of the spindle. Others: 1.",
        None,
        ge=-10,
        le=10,
    )


class Column(FrozenModel):
    """What one column of the tables is."""

    role: Role = Field(description="What the column holds.")
    unit: str | None = Field(None, description="Unit of the values in the table.")
    axis: str | None = Field(None, description="Letter of the axis by ISO 841, such as X.")
    component: str | None = Field(None, description="Component by ISO 230-1, such as EXX, E_Z or F_X.")
    acts_on: ActsOn | None = Field(
        None, description="The axis that corrects an error component which names none itself, such as E_D."
    )
    location: str | None = Field(None, description="Position of the sensor on the machine.")
    of: str | None = Field(None, description="What a group is of: season, day, duty_cycle, machine.")
    derived: Derived | None = Field(None, description="How the column is computed, where no table holds it.")
    epoch: str | None = Field(None, description="When the time was 0, by ISO 8601.")

    @field_validator("unit")
    @classmethod
    def _unit_of_the_role(cls, unit: str | None, info: ValidationInfo) -> str | None:
        role = info.data.get("role")
        allowed = ROLE_UNITS.get(str(role), ())
        if role in (None, "ignore") or unit is None or unit in allowed:
            return unit
        if not allowed:
            raise ValueError(f"a column of role {role} has no unit (found {unit!r})")
        plain = unit.lower().replace("µ", "u").replace("μ", "u").replace("°", "")
        near = _SPELLINGS.get(plain, plain)
        hint = f" Did you mean {near}?" if near in allowed else did_you_mean(unit, allowed)
        raise ValueError(f"{unit!r} is not a unit of role {role} (allowed: {', '.join(allowed)}).{hint}")

    @model_validator(mode="after")
    def _complete(self) -> Column:
        if self.role in ("error", "simulated", "uncertainty") and self.component is None:
            raise ValueError(f"a column of role {self.role} needs a component, such as EXX or E_Z")
        if self.acts_on is not None and self.role != "error":
            raise ValueError(f"acts_on belongs to a column of role error (found {self.role})")
        if (
            self.role in ("position", "command", "actual", "direction", "velocity", "acceleration")
            and self.axis is None
        ):
            raise ValueError(f"a column of role {self.role} needs an axis, such as X")
        return self


class Constant(FrozenModel):
    """A fact about the set-up: an axis (role: axis) or a plain value with its unit."""

    role: Literal["axis"] | None = Field(None, description="`axis` for the facts of an axis.")
    kind: Literal["linear", "rotary"] | None = Field(None, description="How the axis moves.")
    travel: tuple[float, float] | None = quantity("of `unit`", "Lowest and highest position.", None)
    screw_lead: float | None = quantity("of `unit`", "Travel in one turn of the screw.", None)
    encoder_period: float | None = quantity("of `unit`", "Signal period of the encoder.", None)
    tooth_pitch: float | None = quantity("of `unit`", "Length of a tooth of belt or rack.", None, gt=0)
    teeth: int | None = Field(None, gt=0, description="Teeth of pulley or pinion; of a rotary axis, of its wheel.")
    gear_ratio: float | None = quantity(
        "1", "Turns of the motor in one turn of screw, pulley, pinion or wheel.", None, gt=0
    )
    pole_pairs: int | None = Field(None, gt=0, description="Pole pairs in one turn of the motor.")
    magnet_period: float | None = quantity("of `unit`", "Length of a pole pair of a linear motor.", None, gt=0)
    drive_end: float | None = quantity("of `unit`", "Position of the end where the motor is.", None)
    value: float | str | None = quantity("of `unit`", "Value of a constant that is not of an axis.", None)
    unit: str | None = Field(None, description="Unit of the numbers beside it.")


class Manifest(FrozenModel):
    """Recording manifest, version 1."""

    recording: Literal[1]
    title: str = Field("", description="What was measured, for people.")
    machine: str = Field("", description="Free text, or the name of a machine file.")
    tables: tuple[str, ...] = Field(min_length=1, description="Files of the rows, read in this order.")
    constants: dict[str, Constant] = Field({}, description="Facts about the set-up, by axis letter or name.")
    columns: dict[str, Column] = Field(description="What each column of the tables is.")

    def names(self, role: str, *, axis: str | None = None, component: str | None = None) -> tuple[str, ...]:
        """Column names of a role, in manifest order."""
        return tuple(
            name
            for name, c in self.columns.items()
            if c.role == role and (axis is None or c.axis == axis) and (component is None or c.component == component)
        )

    def axis(self, letter: str) -> Constant | None:
        column = self.constants.get(letter)
        return column if column is not None and column.role == "axis" else None


@dataclass
class CarriedState:
    """State after the rows before a batch. run, time: of the last one; states, later: driver -> its state at the
    end of the rows before and of this batch.
    """

    run: str = ""
    time: float = float("nan")
    states: dict[Any, tuple[float, ...]] = field(default_factory=dict)
    later: dict[Any, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Recording:
    """A manifest and its rows in canonical units.

    frame: one pandas column per manifest column that is not `ignore`; numbers are float64 (missing = NaN),
    labels (run, group) are strings.
    between: what drives a slow effect from one row to the next. `held`: the row's value, as a control that reads it at
    a fixed rate has it. `inferred`: temperatures and pressures run straight to the next row, and in the pauses of a
    series of parts the rest (spindle, coolant) is at 0.
    past: for a batch of a longer recording, the state after the rows before it.
    separate_runs: whether slow effects restart with every run; else they continue through runs that follow in time.
    """

    manifest: Manifest
    frame: pd.DataFrame
    between: Literal["held", "inferred"] = "held"
    past: CarriedState | None = None
    separate_runs: bool = False

    def __len__(self) -> int:
        return len(self.frame)

    def __contains__(self, name: str) -> bool:
        return name in self.frame.columns

    def names(self, role: str, *, axis: str | None = None, component: str | None = None) -> tuple[str, ...]:
        """Column names of a role that are present in the rows, in manifest order."""
        return tuple(n for n in self.manifest.names(role, axis=axis, component=component) if n in self)

    def name(self, role: str, *, axis: str | None = None, component: str | None = None) -> str | None:
        """The first column of a role, or None."""
        names = self.names(role, axis=axis, component=component)
        return names[0] if names else None

    def array(self, name: str) -> np.ndarray:
        """One column as float64, shape (rows,). Raises DataError if the rows have none of that name."""
        if name not in self._arrays:
            self._arrays[name] = self._array(name)
        return self._arrays[name]

    @cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        """Cache of requested columns: fits request them ten thousand times, and pandas is slow."""
        return {}

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """What follows from the rows (most: an array of a value per row), cached; read-only."""
        return {}

    def _array(self, name: str) -> np.ndarray:
        if name not in self:
            near = did_you_mean(name, self.frame.columns)
            raise MissingColumn(
                f"{name}: the recording has no such column (it has: {', '.join(self.frame.columns)}).{near} A column"
                " of role ignore is not read; cleaning sets sensors aside that say nothing (cleaning.json says why)."
            )
        return self.frame[name].to_numpy(dtype=float)

    @cached_property
    def _codes(self) -> tuple[np.ndarray, tuple[str, ...]]:
        column = self.name("run")
        if column is None:
            return np.zeros(len(self.frame), dtype=np.int64), ("1",)
        codes, labels = pd.factorize(self.frame[column], sort=False)
        return codes.astype(np.int64), tuple(map(str, labels))

    def run_codes(self) -> np.ndarray:
        """Run number of each row, 0-based in order of appearance, shape (rows,)."""
        return self._codes[0]

    def run_labels(self) -> tuple[str, ...]:
        """Labels of the runs, in order of appearance."""
        return self._codes[1]

    @cached_property
    def run_stretches(self) -> tuple[list[str], np.ndarray]:
        """Run of each stretch of rows of one run, and the first row of each, (stretches,)."""
        codes, labels = self._codes
        starts = np.flatnonzero(np.diff(codes, prepend=-1))
        return [labels[k] for k in codes[starts]], starts

    def time(self) -> np.ndarray:
        """Time in s, shape (rows,); the row number where the recording has no time column."""
        column = self.name("time")
        return np.arange(len(self), dtype=float) if column is None else self.array(column)

    def components(self) -> tuple[str, ...]:
        """Components with an error column, in manifest order."""
        return tuple(str(self.manifest.columns[n].component) for n in self.names("error"))

    def take(self, rows: Any) -> Recording:
        """The recording with only the rows of a boolean mask, an index array or a slice (which copies nothing)."""
        frame = self.frame[rows] if getattr(rows, "dtype", None) == "bool" else self.frame.iloc[rows]
        return Recording(self.manifest, frame.reset_index(drop=True), self.between, separate_runs=self.separate_runs)

    def each_run_alone(self) -> Recording:
        """The same rows, with slow effects that restart in every run."""
        return self if self.separate_runs else replace(self, separate_runs=True)

    def with_values(self, columns: dict[str, Any]) -> Recording:
        """The rows with other values (arrays) in some columns, each of them held until the next row."""
        return Recording(self.manifest, self.frame.assign(**columns))

    def with_columns(self, columns: dict[str, Any], kinds: dict[str, Column]) -> Recording:
        """The recording with further columns (arrays) of the given kinds."""
        manifest = self.manifest.model_copy(update={"columns": {**self.manifest.columns, **kinds}})
        return Recording(manifest, self.frame.assign(**columns), self.between, self.past, self.separate_runs)
