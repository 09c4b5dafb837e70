"""The terms: one file per piece of physics, listed here by its file; a term is imported on first use."""

from __future__ import annotations

from errpipe.terms._base import NEVER, Example, Parameter, Term, fitted_term, plain
from errpipe.terms._example import example_of
from errpipe.terms._fields import TEMPERATURE
from errpipe.terms._profiles import Curve, Line
from errpipe.terms._search import Signals, resolved_times, search_of
from errpipe.terms._slack import MANY_STARTS
from errpipe.yamlfile import Choice

__all__ = [
    "MANY_STARTS",
    "NEVER",
    "TEMPERATURE",
    "TERMS",
    "Curve",
    "Example",
    "Line",
    "Parameter",
    "Signals",
    "Term",
    "example_of",
    "fitted_term",
    "plain",
    "resolved_times",
    "search_of",
]

TERMS: Choice[type[Term]] = Choice.of_files(
    "errpipe.terms",
    "term",
    (
        "scale_error",
        "pitch_cyclic",
        "interpolation",
        "local_wear",
        "straightness",
        "squareness",
        "angular_abbe",
        "gravity_sag",
        "workpiece_load",
        "backlash",
        "screw_windup",
        "friction_hysteresis",
        "reversal_spike",
        "following_error",
        "inertial_deflection",
        "servo_mismatch",
        "coulomb_friction",
        "viscous_friction",
        "stribeck_friction",
        "torque_ripple",
        "scale_expansion",
        "thermal_drift",
        "thermal_lag",
        "thermal_interaction",
        "gradient_bending",
        "spindle_growth",
        "feed_heating",
        "ambient_drift",
        "coolant_effect",
        "centrifugal_growth",
        "cutting_compliance",
        "tool_wear",
        "air_refraction",
        "sensor_drift",
        "clock_offset",
        "sensor_fault",
        "chebyshev",
        "measured_points",
        "harmonics",
        "offset",
        "profile_driver",
        "run_offset",
        "run_pose",
        "smooth_curve",
        "moving_mass",
        "friction_gradient",
        "saturation",
        "dead_zone",
        "flexible_mode",
        "dead_time",
    ),
)
