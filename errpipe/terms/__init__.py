"""The terms: one file per piece of physics, listed here."""

from __future__ import annotations

from errpipe.terms._base import NEVER, Example, Parameter, Term, plain
from errpipe.terms._profiles import Curve, Line
from errpipe.terms._search import Signals, resolved_times, search_of
from errpipe.terms._slack import MANY_STARTS
from errpipe.terms.air_refraction import AirRefraction
from errpipe.terms.ambient_drift import AmbientDrift
from errpipe.terms.angular_abbe import AngularAbbe
from errpipe.terms.backlash import Backlash
from errpipe.terms.centrifugal_growth import CentrifugalGrowth
from errpipe.terms.chebyshev import Chebyshev
from errpipe.terms.clock_offset import ClockOffset
from errpipe.terms.coolant_effect import CoolantEffect
from errpipe.terms.coulomb_friction import CoulombFriction
from errpipe.terms.cutting_compliance import CuttingCompliance
from errpipe.terms.feed_heating import FeedHeating
from errpipe.terms.following_error import FollowingError
from errpipe.terms.friction_hysteresis import FrictionHysteresis
from errpipe.terms.gradient_bending import GradientBending
from errpipe.terms.gravity_sag import GravitySag
from errpipe.terms.harmonics import Harmonics
from errpipe.terms.inertial_deflection import InertialDeflection
from errpipe.terms.interpolation import Interpolation
from errpipe.terms.local_wear import LocalWear
from errpipe.terms.moving_mass import MovingMass
from errpipe.terms.offset import Offset
from errpipe.terms.pitch_cyclic import PitchCyclic
from errpipe.terms.profile_driver import ProfileDriver
from errpipe.terms.reversal_spike import ReversalSpike
from errpipe.terms.run_offset import RunOffset
from errpipe.terms.run_pose import RunPose
from errpipe.terms.scale_error import ScaleError
from errpipe.terms.scale_expansion import ScaleExpansion
from errpipe.terms.screw_windup import ScrewWindup
from errpipe.terms.sensor_drift import SensorDrift
from errpipe.terms.sensor_fault import SensorFault
from errpipe.terms.servo_mismatch import ServoMismatch
from errpipe.terms.smooth_curve import SmoothCurve
from errpipe.terms.spindle_growth import SpindleGrowth
from errpipe.terms.squareness import Squareness
from errpipe.terms.straightness import Straightness
from errpipe.terms.stribeck_friction import StribeckFriction
from errpipe.terms.thermal_drift import ThermalDrift
from errpipe.terms.thermal_interaction import ThermalInteraction
from errpipe.terms.thermal_lag import ThermalLag
from errpipe.terms.tool_wear import ToolWear
from errpipe.terms.torque_ripple import TorqueRipple
from errpipe.terms.viscous_friction import ViscousFriction
from errpipe.terms.workpiece_load import WorkpieceLoad

__all__ = [
    "MANY_STARTS",
    "NEVER",
    "TERMS",
    "Curve",
    "Example",
    "Line",
    "Parameter",
    "Signals",
    "Term",
    "plain",
    "resolved_times",
    "search_of",
]

TERMS = (
    ScaleError,
    PitchCyclic,
    Interpolation,
    LocalWear,
    Straightness,
    Squareness,
    AngularAbbe,
    GravitySag,
    WorkpieceLoad,
    Backlash,
    ScrewWindup,
    FrictionHysteresis,
    ReversalSpike,
    FollowingError,
    InertialDeflection,
    ServoMismatch,
    CoulombFriction,
    ViscousFriction,
    StribeckFriction,
    TorqueRipple,
    ScaleExpansion,
    ThermalDrift,
    ThermalLag,
    ThermalInteraction,
    GradientBending,
    SpindleGrowth,
    FeedHeating,
    AmbientDrift,
    CoolantEffect,
    CentrifugalGrowth,
    CuttingCompliance,
    ToolWear,
    AirRefraction,
    SensorDrift,
    ClockOffset,
    SensorFault,
    Chebyshev,
    Harmonics,
    Offset,
    ProfileDriver,
    RunOffset,
    RunPose,
    SmoothCurve,
    MovingMass,
)
