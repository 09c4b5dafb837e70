"""Options of an FMU: columns of its inputs, outputs of its responses, parameters to recalibrate."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from errpipe.yamlfile import Options, quantity

MAX_TUNABLE = 6  # parameters recalibrated at once; each costs a simulation per step of the search


class FmuInput(Options):
    """Which column drives an input of the FMU."""

    column: str = Field(description="Column of the recording.")
    unit: str | None = Field(None, description="Unit in the FMU, if it declares none.")
    rise_from: float | Literal["first"] | None = quantity(
        "degC", "A temperature becomes a rise: over this one, or over the first reading of the session.", None
    )


class FmuOutput(Options):
    """Which variable of the FMU is the simulated value of a response."""

    variable: str = Field(description="Name in the FMU.")
    unit: str | None = Field(None, description="Unit in the FMU, if it declares none.")
    means: Literal["deviation", "correction"] = Field("deviation", description="Actual minus commanded, or minus that.")


class Tunable(Options):
    """A parameter of the FMU that is recalibrated before the diagnosis."""

    parameter: str = Field(description="Name in the FMU.")
    low: float = quantity("of the parameter", "Lowest possible value.")
    high: float = quantity("of the parameter", "Highest possible value.")

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
