"""Set-up of a laser, as stated in a pipeline, corrected by an identification and simulated."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat

from errpipe.yamlfile import Options, quantity


class Laser(Options):
    """Set-up of the laser for one component: a positioning, or the offset alone of a straightness."""

    dead_path: float = quantity("mm", "From the interferometer to the reflector where the laser was reset.", 0.0, ge=0)
    misalignment: float = quantity(
        "urad", "Angle between the beam and the axis: the laser reads short by its cosine.", 0.0, ge=0, lt=50_000
    )
    offset: tuple[float, float, float] = quantity(
        "mm", "From the beam to the point the component is defined at (Abbe), X, Y, Z.", (0.0, 0.0, 0.0)
    )
    read_on: Literal["carriage", "guideway"] = Field(
        "carriage",
        description="Straightness: whether the point at which it is read travels with the carriage (reflector or gauge "
        "on it), or stands (a gauge in the spindle against a straightedge on the moving table: guideway). The point is "
        "where the offset says when the axis is at 0.",
    )
    wavelength_corrected: bool = Field(
        True, description="Whether the laser's own weather station corrected the displacement."
    )
    display_air: tuple[float, float, float] | None = quantity(
        "degC, hPa, %",
        "Temperature (degC), pressure (hPa) and humidity (%) of the air whose refractive index a display "
        "without weather station was fixed at, often 20, 1013.25, 50. Left out: that of the record's first reading.",
        None,
    )
    zero_each_run: bool = Field(False, description="Whether the display was zeroed at the start of each run.")
    # half of the 0.2 K, 1 hPa and 6 % (k = 2) of Renishaw's XC-80 data sheet
    air_uncertainty: tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat] = quantity(
        "K, hPa, %",
        "Standard uncertainty of the sensors of the air: temperature (K), pressure (hPa), humidity (%). A "
        "humidity that was not recorded counts as 50 % with 14 %.",
        (0.1, 0.5, 3.0),
    )
