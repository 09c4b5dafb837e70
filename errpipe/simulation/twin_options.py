"""Origin of a recording's simulated values, as stated in a pipeline (`source:` of the stage that adds them)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from errpipe.simulation.fmu_options import FmuOptions
from errpipe.yamlfile import Options, quantity


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


class FromFmu(TwinOptions, FmuOptions):
    """A Functional Mock-up Unit in `file`, run in a separate process."""

    kind: Literal["fmu"]


AnySource = Annotated[FromRecorded | FromCsv | FromModel | FromFmu, Field(discriminator="kind")]
