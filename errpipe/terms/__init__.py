"""The terms: one file per piece of physics, listed here."""

from __future__ import annotations

from errpipe.terms.backlash import Backlash
from errpipe.terms.pitch_cyclic import PitchCyclic
from errpipe.terms.scale_error import ScaleError
from errpipe.terms.scale_expansion import ScaleExpansion
from errpipe.terms.screw_windup import ScrewWindup
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
)
