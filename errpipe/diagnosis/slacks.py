"""How reality strays from a term's textbook form: columns, and how large each may be beside the form itself.

A lead error is not quite straight, a wall has more than one time constant, the loop swings before a spike is gone.
Freedoms are standard deviations relative to the form's own size.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from errpipe.domain.driver import Input, Lag
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.motion import direction, position, share
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms import Term

WAVY = 0.07  # freedom of each smooth deformation along an axis
DEGREES = range(1, 8)
STARTS = 5  # sessions (starts of the machine) from which whole ones sit out, and each may have its datum


def unit(x: np.ndarray) -> np.ndarray:
    """Scaled to -1..1 over its own range."""
    low, high = np.nanmin(x), np.nanmax(x)
    return (2 * x - low - high) / (high - low) if high > low else np.zeros_like(x)


def wavy(column: np.ndarray, x: np.ndarray, first: int = 1) -> Iterator[tuple[np.ndarray, float]]:
    """A column bent smoothly along x."""
    turns = np.polynomial.chebyshev.chebvander(unit(x), DEGREES[-1])
    for k in DEGREES:
        if k >= first:
            yield column * turns[:, k], WAVY


def cooled_growth(flow: str, tau: float, recording: Recording) -> Iterator[np.ndarray]:
    """What coolant takes away from a spindle that has run: the warmer it is, the more."""
    on = recording.array(flow)
    for name in recording.names("spindle_speed"):
        speed = recording.array(name)
        warm = drive(Lag(of=Input(name=name), tau_up=1500.0, tau_down=1500.0, start="zero"), recording)
        if speed.max() > 0:
            yield responses.lag(sessions(recording), recording.time(), on * warm / speed.max(), tau, tau, False)


def other_shape(column: np.ndarray, base: np.ndarray) -> np.ndarray:
    """How a column differs from another of its size: what it adds leaves the size to the other."""
    return column / max(float(np.std(column)), 1e-12) - base / max(float(np.std(base)), 1e-12)


def decays(recording: Recording, tau: float, first: float, later: float) -> Iterator[tuple[np.ndarray, float]]:
    """What is left of an unknown state at the start of each session.

    Of many starts only what they have in common: a state for each would pass for whatever differs from start to start.
    """
    session, t = sessions(recording), recording.time()
    made = []
    for s in np.unique(session):
        inside = session == s
        since = np.where(inside, t - t[inside][0], 0.0)
        made.append(np.where(inside, np.exp(-np.maximum(since, 0.0) / tau), 0.0))
    if len(made) >= STARTS:
        yield np.sum(made, axis=0), 1.0
        return
    for k, column in enumerate(made):
        yield column, first if k == 0 else later


def slacks(
    term: Term, nl: tuple[float, ...], base: np.ndarray, recording: Recording
) -> Iterator[tuple[np.ndarray, float]]:
    """How reality strays from a term's textbook form: (column, freedom relative to the core)."""
    name = term.term
    radial = getattr(term, "radial", False)
    if name in ("torque_ripple", "pitch_cyclic", "interpolation") and not radial:
        bent = np.polynomial.chebyshev.chebvander(unit(position(recording, term.axis)), 2)
        for wave in base.T:  # stronger here than there, or a little longer than said
            yield wave * bent[:, 1], 0.15
            yield wave * bent[:, 2], 0.15
    if name == "friction_hysteresis":
        for factor in (0.3, 3.0):  # contacts give way one after the other
            yield term.basis(recording, nl[0] * factor)[:, 0] - base[:, 0], 0.25
    if name in ("backlash", "screw_windup") and recording.name("direction", axis=term.axis) is None:
        # no contact changes sides at once
        side, x = direction(recording, term.axis), position(recording, term.axis)
        for length in (0.005, 0.02, 0.08):
            late = responses.approach(sessions(recording), x, side, length) - side
            yield base[:, 0] * side * late, 0.6
    if name in ("backlash", "screw_windup", "friction_hysteresis") and not radial:
        yield from wavy(base[:, 0], position(recording, term.axis))
    elif name == "scale_error" and not radial:
        turns = np.polynomial.chebyshev.chebvander(unit(position(recording, term.axis)), 8)
        for k in range(2, 9):
            yield turns[:, k], 0.12
    elif name in ("scale_expansion", "feed_heating") and not radial:
        x = position(recording, term.axis)
        yield x, 0.2 if name == "feed_heating" else 0.7
        yield from wavy(base[:, 0], x)
        # the growth is counted from the fixed end, wherever that is
        reach = x - term.fixed_end if name == "feed_heating" else x
        level = base[:, 0] / np.where(np.abs(reach) > 1e-9, reach, 1e-9) * (np.nanmax(x) - np.nanmin(x))
        yield np.where(np.abs(reach) > 1e-6, level, 0.0), 0.3
        if name == "feed_heating":
            for column, freedom in decays(recording, nl[0], 0.1, 0.5):
                yield column * x, freedom
            for factor in (0.3, 3.0):
                yield term.basis(recording, nl[0] * factor)[:, 0], 0.25
        else:
            rise = recording.array(term.sensor)
            for tau in (400.0, 1500.0):
                late = responses.lag(sessions(recording), recording.time(), rise, tau, tau, True)
                yield (late - rise) * x, 0.3
    elif name == "thermal_lag":
        yield from decays(recording, nl[0], 0.4, 0.6)
    elif name == "straightness":
        turns = np.polynomial.chebyshev.chebvander(unit(position(recording, term.axis)), 8)
        across = share(recording, term.across, True) if term.across else 1.0
        yield turns[:, 1] * across, 0.4  # whichever line it is counted from
        for k in range(term.order + 1, 9):
            yield turns[:, k] * across, 0.3
    elif name == "angular_abbe":
        turns = np.polynomial.chebyshev.chebvander(unit(position(recording, term.axis)), 6)
        for k in range(term.order + 1, 7):
            yield turns[:, k] * recording.array(term.lever), 0.2
        for k in range(1, term.order + 1):
            yield turns[:, k], 0.2  # wherever the lever is counted from
    elif name == "ambient_drift":
        yield from decays(recording, nl[0], 1.0, 1.0)
        for factor in (0.3, 3.0):  # walls and beds are thick: one after the other takes the room's temperature
            yield other_shape(term.basis(recording, nl[0] * factor)[:, 0], base[:, 0]), 0.2
    elif name == "spindle_growth":
        yield from decays(recording, nl[0], 0.1, 0.7)
        for factor in (0.3, 3.0):
            yield term.basis(recording, nl[0] * factor, nl[1])[:, 0], 0.25
        if recording.name("cut_length") is not None:  # or the spindle ran on between the parts
            ran_on = dataclasses.replace(recording, between="held")
            yield term.basis(ran_on, *nl)[:, 0] - base[:, 0], 0.3
        for factor, power in itertools.product((1.0, 0.3), (1.0 / 1.5, 1.5)):  # each body has its own friction
            yield other_shape(term.basis(recording, nl[0] * factor, nl[1] * power)[:, 0], base[:, 0]), 0.15
    elif name == "thermal_interaction":
        for sensor in dict.fromkeys((term.first, term.second)):
            yield recording.array(sensor) - np.nanmean(recording.array(sensor)), 0.12
    elif name == "coolant_effect":
        yield from decays(recording, nl[0], 0.2, 0.2)
        for factor in (0.3, 3.0):
            yield term.basis(recording, nl[0] * factor)[:, 0], 0.25
        if term.sensor:
            yield term.model_copy(update={"sensor": None, "other": None}).basis(recording, *nl)[:, 0], 0.25
        yield from ((column, 0.25) for column in cooled_growth(term.flow, nl[0], recording))
    elif name == "air_refraction":
        yield position(recording, term.axis), 0.3  # counted from the weather of an unknown day
    elif name == "local_wear" and not radial:
        centre, width = nl
        for shift in (-0.6, 0.6):
            yield term.basis(recording, centre + shift * width, width)[:, 0] - base[:, 0], 0.5
    elif name == "cutting_compliance" and term.overhang:
        yield recording.array(term.force), 0.4  # what gives way besides the bar
    elif name == "viscous_friction":
        yield np.abs(base[:, 0]), 0.4  # it may differ by direction
    elif name == "inertial_deflection":
        for tau in (0.004, 0.02):  # what is bent swings a while
            late = responses.lag(sessions(recording), recording.time(), base[:, 0], tau, tau, True)
            yield late - base[:, 0], 0.25
    elif name == "reversal_spike":
        # a real spike takes a moment to rise, and the loop swings before it is gone: Laguerre's shapes
        since = np.minimum(term.since_turn(recording) / nl[0], 1e3)
        for k in (1, 2, 3):
            yield base[:, 0] * since**k, 0.4
    elif name == "thermal_drift":
        rise = recording.array(term.sensor)
        yield responses.lag(sessions(recording), recording.time(), rise, 300.0, 300.0, True) - rise, 0.2
    elif name == "sensor_fault":
        rows = np.arange(len(recording))
        inside = ((rows >= term.first) & (rows <= term.last)).astype(float)
        yield inside, 0.3
        yield inside * (rows - term.first) / max(term.last - term.first, 1), 0.3
    elif name == "tool_wear":
        yield term.basis(recording, min(nl[0] * 1.6, 3.0))[:, 0], 0.3
