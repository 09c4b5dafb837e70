"""Fields that many terms have, described once."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from errpipe.yamlfile import quantity

Axis = Annotated[str, Field(description="Letter of the axis, such as X.")]
TEMPERATURE = "temperature"  # mark of a field that names a column of a temperature
Sensor = Annotated[str, TEMPERATURE, Field(description="Column of the temperature.")]
Reference = Annotated[
    float | None, quantity("degC", "Temperature at which the effect is nothing; none: the first one of each run.")
]
Radial = Annotated[
    bool, Field(description="The response is the radius of a circular test: the deviation enters by its share of it.")
]
