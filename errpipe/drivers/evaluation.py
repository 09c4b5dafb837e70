"""A driver evaluated causally over a recording."""

from __future__ import annotations

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import direction, position
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses


def drive(driver: d.Driver, recording: Recording) -> np.ndarray:
    """Evaluate a driver causally over a recording, shape (rows,). Missing inputs give NaN.

    States (first value, lag, switch, direction, approach) live as long as a session: see `sessions`.
    """
    match driver:
        case d.Constant():
            return np.full(len(recording), driver.value)
        case d.Input():
            return recording.array(driver.name)
        case d.Affine():
            total = np.full(len(recording), driver.offset)
            for weight, of in zip(driver.weights, driver.of, strict=True):
                total = total + weight * drive(of, recording)
            return total
        case d.First():
            return responses.first_value(sessions(recording), drive(driver.of, recording))
        case d.Lag():
            source = drive(driver.of, recording)
            return _late(driver, source, recording)
        case d.Product():
            return np.prod([drive(of, recording) for of in driver.of], axis=0)
        case d.Power():
            source = drive(driver.of, recording)
            return np.sign(source) * np.abs(source) ** driver.exponent
        case d.Clip():
            return np.clip(drive(driver.of, recording), driver.low, driver.high)
        case d.Switch():
            return responses.switch(sessions(recording), drive(driver.of, recording), driver.on, driver.off)
        case d.Direction():
            return direction(recording, driver.axis, driver.threshold, driver.start)
        case d.Approach():
            side = direction(recording, driver.axis, driver.threshold, driver.start)
            return responses.approach(sessions(recording), position(recording, driver.axis), side, driver.length)
        case d.Lookup():
            values = np.asarray(driver.values)
            return responses.lookup(drive(driver.of, recording), driver.start, driver.step, values)
    raise TypeError(f"unknown driver {driver!r}")


PAUSE = 4.0  # times the usual step between rows, from which a series of parts has paused


def _late(driver: d.Lag, source: np.ndarray, recording: Recording) -> np.ndarray:
    """A lag's answer, by what the recording says of the time between its rows."""
    session, t, at_input = sessions(recording), recording.time(), driver.start == "input"
    taus = (driver.tau_up, driver.tau_down)
    if recording.between == "inferred" and runs_on(driver.of, recording):
        return responses.lag_straight(session, t, source, *taus, at_input)
    if recording.between == "inferred" and recording.name("cut_length") is not None and len(recording) > 1:
        usual = float(np.median(np.diff(t)))
        return responses.lag_paused(session, t, source, *taus, at_input, PAUSE * usual, usual)
    return responses.lag(session, t, source, *taus, at_input)


def runs_on(driver: d.Driver, recording: Recording) -> bool:
    """Does a driver depend on nothing but temperatures and pressures, which do not jump between rows?"""
    names = d.inputs(driver)
    roles = {recording.manifest.columns[n].role for n in names}
    return bool(names) and roles <= {"temperature", "pressure"}
