"""The terms: one file per piece of physics, listed here."""

from __future__ import annotations

from errpipe.terms.backlash import Backlash
from errpipe.terms.chebyshev import Chebyshev
from errpipe.terms.harmonics import Harmonics
from errpipe.terms.offset import Offset
from errpipe.terms.pitch_cyclic import PitchCyclic
from errpipe.terms.profile_driver import ProfileDriver
from errpipe.terms.run_offset import RunOffset
from errpipe.terms.run_pose import RunPose
from errpipe.terms.scale_error import ScaleError
from errpipe.terms.scale_expansion import ScaleExpansion
from errpipe.terms.screw_windup import ScrewWindup
from errpipe.terms.smooth_curve import SmoothCurve
from errpipe.terms.straightness import Straightness
from errpipe.terms.thermal_drift import ThermalDrift
from errpipe.terms.thermal_lag import ThermalLag

TERMS = (
    ScaleError,
    PitchCyclic,
    Straightness,
    Backlash,
    ScrewWindup,
    ScaleExpansion,
    ThermalDrift,
    ThermalLag,
    Chebyshev,
    Harmonics,
    Offset,
    ProfileDriver,
    RunOffset,
    RunPose,
    SmoothCurve,
)
