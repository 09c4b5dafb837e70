"""Options of a thermal model for all seasons; light imports, because every pipeline file is validated against it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from errpipe.domain.recording import FrozenModel
from errpipe.yamlfile import quantity


class SeasonOptions(FrozenModel):
    """How a thermal model for all seasons is fitted."""

    kind: Literal["thermal_season"] = "thermal_season"
    sensors: tuple[str, ...] = Field((), description="Temperatures to use; empty: all.")
    room: str | None = Field(None, description="Sensor of the room; default: found by its location.")
    spindle: str | None = Field(
        None, description="Sensor that shows whether the spindle runs; default: all sensors near it."
    )
    bed: str | None = Field(None, description="Sensor of the bed; default: found by its location.")
    late: tuple[float, ...] = quantity("s", "Lags of heat while the spindle runs.", (900.0,))
    slow: tuple[float, ...] = quantity(
        "s", "Lags of parts without a sensor that follow the room.", (3600.0, 7200.0, 14400.0, 28800.0)
    )
    # viscosity loss per kelvin at 20 to 30 degC of a mineral oil of 32 to 68 mm2/s
    thinning: float = quantity(
        "1/K", "Loss of viscosity of the oil whose friction heats while the spindle runs.", 0.05, ge=0
    )
    penalty: float = quantity("K2", "Ridge penalty: shrinks causes with an rms below its root.", 1e-3, gt=0)
    rounds: int = Field(
        2, ge=0, le=20, description="Number of times that badly fitted runs get more weight, towards minimax."
    )
    correction: bool = Field(True, description="Whether a data-driven part may be added within its validity range.")
    fade: float = quantity(
        "K",
        "Distance of the start outside the recorded range (mean over sensors) at which the correction is zero.",
        0.4,
        gt=0,
    )
    environment: str = Field("season", description="Group whose members differ in environment, such as seasons.")
    coverage: float = quantity("1", "Coverage of the prediction interval.", 0.9, gt=0.5, lt=1)
    datum_rows: int = Field(3, ge=1, description="First rows of a run whose mean is its zero.")
