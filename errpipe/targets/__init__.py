"""Controller formats. A new one is one file here and one entry in TARGETS.

A target gets a `CompensationTable`, never a recording or a model: it can export only what a table expresses.
"""

from __future__ import annotations

from errpipe.targets._base import Target
from errpipe.yamlfile import Choice

TARGETS: Choice[type[Target]] = Choice.of_files(
    "errpipe.targets",
    "name",
    (
        "aerotech_cal",
        "beckhoff_crosscomp",
        "beckhoff_ssfk",
        "beckhoff_temperature",
        "beckhoff_volumetric",
        "c_runtime",
        "codesys_backlash",
        "ecmc_lut",
        "fagor_lscrw",
        "fanuc_pitch",
        "feedback_inject",
        "grblhal_backlash",
        "haas_pitch",
        "heidenhain_com",
        "iec_st",
        "klipper_sections",
        "linuxcnc_hal",
        "linuxcnc_screw",
        "mach4_screw_map",
        "marlin_gcode",
        "mitsubishi_pitch",
        "pmac_comp",
        "reprap_heightmap",
        "sinumerik_cec",
        "sinumerik_lec",
        "sinumerik_temperature",
        "smoothie_pitch",
        "twincat_nc_table",
        "weihong_axeserr",
    ),
)
