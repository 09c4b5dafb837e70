"""Options of a thermal model for all seasons; light imports, because every pipeline file is checked against it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from errpipe.domain.recording import Frozen


class SeasonOptions(Frozen):
    """How a thermal model for all seasons is fitted."""

    kind: Literal["thermal_season"] = "thermal_season"
    sensors: tuple[str, ...] = Field((), description="Temperatures to use; all of them where empty.")
    room: str | None = Field(None, description="Sensor of the room; found by its location where not given.")
    spindle: str | None = Field(None, description="Tells whether the spindle runs; all sensors near it if not given.")
    bed: str | None = Field(None, description="Sensor of the bed; found by its location where not given.")
    late: tuple[float, ...] = Field(
        (900.0,), description="Lags of heat while the spindle runs.", json_schema_extra={"unit": "s"}
    )
    slow: tuple[float, ...] = Field(
        (3600.0, 7200.0, 14400.0, 28800.0),
        description="Lags of parts without a sensor that follow the room.",
        json_schema_extra={"unit": "s"},
    )
    mixes: tuple[float, ...] = Field(
        (0.0, 0.25, 0.5),
        description="How far towards the room these parts may begin, from the machine's own temperature.",
        json_schema_extra={"unit": "1"},
    )
    thinning: float = Field(
        0.05,
        ge=0,
        description="Loss of viscosity of the oil whose friction heats while the spindle runs.",
        json_schema_extra={"unit": "1/K"},
    )
    penalty: float = Field(
        1e-3, gt=0, description="Shrinks causes that moved less than its root.", json_schema_extra={"unit": "K2"}
    )
    rounds: int = Field(
        2, ge=0, le=20, description="How often runs that fitted badly are given more weight: towards the worst day."
    )
    correction: bool = Field(True, description="Whether a data-driven part may be added where it was learnt.")
    correction_lags: tuple[float, ...] = Field(
        (900.0, 3600.0, 14400.0), description="Lags of its temperatures.", json_schema_extra={"unit": "s"}
    )
    correction_penalty: float = Field(
        3e-3, gt=0, description="Ridge strength on columns of unit root mean square.", json_schema_extra={"unit": "1"}
    )
    correction_width: float = Field(
        0.8,
        gt=0,
        description="Runs whose starts differ by more teach each other little.",
        json_schema_extra={"unit": "K"},
    )
    fade: float = Field(
        0.4,
        gt=0,
        description="Start this much outside what was seen (mean over sensors): the correction is gone.",
        json_schema_extra={"unit": "K"},
    )
    environment: str = Field("season", description="Group whose members stand for different surroundings.")
    coverage: float = Field(
        0.9, gt=0.5, lt=1, description="Coverage of the prediction interval.", json_schema_extra={"unit": "1"}
    )
    datum_rows: int = Field(3, ge=1, description="First rows of a run whose mean is its zero.")
