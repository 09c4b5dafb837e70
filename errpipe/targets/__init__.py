"""Controller formats. A new one is one file here and one entry in TARGETS.

A target gets a `CompensationTable`, never a recording or a model: it can export only what a table expresses.
"""

from __future__ import annotations

from errpipe.targets._base import Target
from errpipe.targets.aerotech_cal import AerotechCal
from errpipe.targets.beckhoff_crosscomp import BeckhoffCrosscomp
from errpipe.targets.beckhoff_ssfk import BeckhoffSsfk
from errpipe.targets.beckhoff_temperature import BeckhoffTemperature
from errpipe.targets.beckhoff_volumetric import BeckhoffVolumetric
from errpipe.targets.c_runtime import CRuntime
from errpipe.targets.codesys_backlash import CodesysBacklash
from errpipe.targets.ecmc_lut import EcmcLut
from errpipe.targets.fagor_lscrw import FagorLscrw
from errpipe.targets.fanuc_pitch import FanucPitch
from errpipe.targets.feedback_inject import FeedbackInject
from errpipe.targets.grblhal_backlash import GrblhalBacklash
from errpipe.targets.haas_pitch import HaasPitch
from errpipe.targets.heidenhain_com import HeidenhainCom
from errpipe.targets.iec_st import IecSt
from errpipe.targets.klipper_sections import KlipperSections
from errpipe.targets.linuxcnc_hal import LinuxcncHal
from errpipe.targets.linuxcnc_screw import LinuxcncScrew
from errpipe.targets.mach4_screw_map import Mach4ScrewMap
from errpipe.targets.marlin_gcode import MarlinGcode
from errpipe.targets.mitsubishi_pitch import MitsubishiPitch
from errpipe.targets.pmac_comp import PmacComp
from errpipe.targets.reprap_heightmap import ReprapHeightmap
from errpipe.targets.sinumerik_cec import SinumerikCec
from errpipe.targets.sinumerik_lec import SinumerikLec
from errpipe.targets.sinumerik_temperature import SinumerikTemperature
from errpipe.targets.smoothie_pitch import SmoothiePitch
from errpipe.targets.twincat_nc_table import TwincatNcTable
from errpipe.targets.weihong_axeserr import WeihongAxeserr

TARGETS: tuple[type[Target], ...] = (
    AerotechCal,
    BeckhoffCrosscomp,
    BeckhoffSsfk,
    BeckhoffTemperature,
    BeckhoffVolumetric,
    CRuntime,
    CodesysBacklash,
    EcmcLut,
    FagorLscrw,
    FanucPitch,
    FeedbackInject,
    GrblhalBacklash,
    HaasPitch,
    HeidenhainCom,
    IecSt,
    KlipperSections,
    LinuxcncHal,
    LinuxcncScrew,
    Mach4ScrewMap,
    MarlinGcode,
    MitsubishiPitch,
    PmacComp,
    ReprapHeightmap,
    SinumerikCec,
    SinumerikLec,
    SinumerikTemperature,
    SmoothiePitch,
    TwincatNcTable,
    WeihongAxeserr,
)
