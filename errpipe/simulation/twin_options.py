"""Origin of a recording's simulated values, as stated in a pipeline (`source:` of the stage that adds them)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from errpipe.yamlfile import Options, quantity

MAX_TUNABLE = 6  # parameters recalibrated at once; each costs a simulation per step of the search


class TwinOptions(Options):
    """Options common to all sources."""

    datum: Literal["absolute", "run_start"] | None = Field(
        None,
        description="Datum: as simulated, or each run's first readings; default: absolute, and for an error "
        "model the one of the model.",
    )
    most_missing: float = quantity(
        "1", "Reject a simulation that has no values for more than this share of the recorded rows.", 0.1, ge=0, lt=1
    )


class FromRecorded(TwinOptions):
    """The recording already contains its simulated columns."""

    kind: Literal["recorded"]


class CsvColumn(Options):
    """One column of a CSV file of simulated values."""

    column: str = Field(description="Name in the file's header.")
    unit: str = Field(description="Unit of the file's values: um, mm, nm, urad, mrad, arcsec or N.")
    means: Literal["deviation", "correction"] = Field(
        "deviation", description="Actual minus commanded, or its negative."
    )


class FromCsv(TwinOptions):
    """A CSV file (a header row, then numbers) of simulated values over time."""

    kind: Literal["csv"]
    columns: dict[str, CsvColumn] = Field(min_length=1, description="Response of the recording -> column of the file.")
    time: str = Field("t", description="Column of the file with the time, on the recording's clock.")
    time_unit: Literal["s", "ms", "min", "h", "d"] = Field("s", description="Its unit.")
    run: str | None = Field(
        None, description="Column with the run's label; needed where the recording's runs overlap in time."
    )
    separator: Literal[",", ";", "\t"] = Field(",", description="Separator between cells.")
    longest_gap: float | None = quantity(
        "s", "Nothing is interpolated over a longer step; default: ten usual steps.", None, gt=0
    )


class FromModel(TwinOptions):
    """errpipe's own error model: the one in `file`, or that of the preceding fit stage."""

    kind: Literal["error_model"]


class FmuInput(Options):
    """Which column drives an input of the FMU."""

    column: str = Field(description="Column of the recording.")
    unit: str | None = Field(None, description="Unit that the FMU means, where it states none.")
    rise_from: float | Literal["first"] | None = quantity(
        "degC", "A temperature becomes a rise: over this one, or over the first reading of the session.", None
    )


class FmuOutput(Options):
    """Which variable of the FMU is the simulated value of a response."""

    variable: str = Field(description="Name in the FMU.")
    unit: str | None = Field(None, description="Unit that the FMU means, where it states none.")
    means: Literal["deviation", "correction"] = Field("deviation", description="Actual minus commanded, or minus that.")


class Tunable(Options):
    """A parameter of the FMU that is set right before anything is called missing."""

    parameter: str = Field(description="Name in the FMU.")
    low: float = quantity("of the parameter", "Lowest value that can be.")
    high: float = quantity("of the parameter", "Highest value that can be.")

    @model_validator(mode="after")
    def _ordered(self) -> Tunable:
        if not self.low < self.high:
            raise ValueError(f"low {self.low:g} is not below high {self.high:g}")
        return self


class FmuOptions(Options):
    """How an FMU is run over a recording."""

    inputs: dict[str, FmuInput] = Field({}, description="Input of the FMU -> column that drives it.")
    outputs: dict[str, FmuOutput] = Field(min_length=1, description="Response of the recording -> variable of the FMU.")
    parameters: dict[str, float] = quantity("of each", "Values to set before the start, in the FMU's units.", {})
    recalibrate: tuple[Tunable, ...] = Field(
        (), max_length=MAX_TUNABLE, description="Parameters to fit to the recording."
    )
    step: float | None = quantity(
        "s", "Communication step; default: the FMU's own, else a quarter of the rows' step.", None, gt=0
    )
    time_limit: float = quantity("s", "Longest time that a session may take to simulate.", 60.0, gt=0)
    disk_mb: int = Field(512, ge=1, description="Most disk that the FMU, unpacked, and its files may take, MB.")
    memory_mb: int = Field(2048, ge=256, description="Most memory that the FMU's process may take, MB.")


class FromFmu(TwinOptions, FmuOptions):
    """A Functional Mock-up Unit in `file`, run in a separate process."""

    kind: Literal["fmu"]


AnySource = Annotated[FromRecorded | FromCsv | FromModel | FromFmu, Field(discriminator="kind")]
