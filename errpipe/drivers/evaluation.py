"""A driver evaluated causally over a recording."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import CarriedState, Recording
from errpipe.drivers.motion import direction, motion_sessions, position
from errpipe.drivers.sessions import MAX_PAUSE, sessions
from errpipe.kernels import responses

Respond = Callable[["np.ndarray", "np.ndarray", "np.ndarray", bool], "np.ndarray"]


def drive(driver: d.Driver, recording: Recording) -> np.ndarray:
    """Evaluate a driver causally over a recording, shape (rows,). Missing inputs give NaN.

    States (first value, lag, switch, direction, approach) live as long as a session: see `sessions`; an approach
    where motion is recorded without a break: see `motion_sessions`.
    """
    match driver:
        case d.Constant():
            return np.full(len(recording), driver.value)
        case d.Input():
            return recording.array(driver.name)
        case d.Affine():
            total: np.ndarray | float = driver.offset
            for weight, of in zip(driver.weights, driver.of, strict=True):
                part = drive(of, recording)
                total = total + (part if weight == 1.0 else weight * part)
            return total if isinstance(total, np.ndarray) else np.full(len(recording), total)
        case d.First():
            source = drive(driver.of, recording)
            return _state(driver, source, recording, lambda s, t, u, start: responses.first_value(s, u))
        case d.Lag():
            return _late(driver, _at_input(driver, recording), recording)
        case d.Product():
            return reduce(np.multiply, [drive(of, recording) for of in driver.of])
        case d.Power():
            source = drive(driver.of, recording)
            return np.sign(source) * np.abs(source) ** driver.exponent
        case d.Clip():
            return np.clip(drive(driver.of, recording), driver.low, driver.high)
        case d.Switch():
            on, off = driver.on, driver.off
            source = drive(driver.of, recording)
            return _state(driver, source, recording, lambda s, t, u, start: responses.switch(s, u, on, off))
        case d.Direction():
            return direction(recording, driver.axis, driver.threshold, driver.start)
        case d.Approach():
            side = direction(recording, driver.axis, driver.threshold, driver.start)
            return responses.approach(motion_sessions(recording), position(recording, driver.axis), side, driver.length)
        case d.Lookup():
            values = np.asarray(driver.values)
            return responses.lookup(drive(driver.of, recording), driver.start, driver.step, values)
    raise TypeError(f"unknown driver {driver!r}")


PAUSE = 4.0  # times the usual step between rows, from which a series of parts has paused


def _at_input(driver: d.Lag, recording: Recording) -> np.ndarray:
    """What a lag is of: kept with the rows, for a search asks for it at every time constant that it tries."""
    if recording.past is not None:  # states continue from batch to batch
        return drive(driver.of, recording)
    if driver.of not in recording.derived:
        recording.derived[driver.of] = drive(driver.of, recording)
    return recording.derived[driver.of]


def _late(driver: d.Lag, source: np.ndarray, recording: Recording) -> np.ndarray:
    """Response of a lag, from the time between the rows of a recording."""
    session, t, at_input = sessions(recording), recording.time(), driver.start == "input"
    taus = (driver.tau_up, driver.tau_down)
    if recording.between == "inferred" and runs_on(driver.of, recording):
        return responses.lag_straight(session, t, source, *taus, at_input)
    if recording.between == "inferred" and recording.name("cut_length") is not None and len(recording) > 1:
        usual = float(np.median(np.diff(t)))
        return responses.lag_paused(session, t, source, *taus, at_input, PAUSE * usual, usual)
    return _state(driver, source, recording, lambda s, t, u, start: responses.lag(s, t, u, *taus, at_input or start))


def carried(driver: d.Driver, recording: Recording) -> bool:
    """Whether a driver's states are carried over from one batch of rows to the next."""
    if isinstance(driver, d.Direction):
        return recording.name("direction", axis=driver.axis) is not None
    of = getattr(driver, "of", ())
    return not isinstance(driver, d.Approach) and all(
        carried(o, recording) for o in (of if isinstance(of, tuple) else (of,))
    )


def _state(
    driver: d.First | d.Lag | d.Switch, source: np.ndarray, recording: Recording, respond: Respond
) -> np.ndarray:
    """A response with a state, shape (rows,), which in a batch continues from where the batch before left it.

    Rows before the batch that bring the response to its state, at the time of the last one, stand for all of them.
    respond: (session, time, source, whether it starts at its input) -> response.
    """
    session, t, past = sessions(recording), recording.time(), recording.past
    if past is None or not len(recording):
        return respond(session, t, source, False)
    before = past.states.get(driver, ()) if _goes_on(recording, past) else ()
    first = int(np.searchsorted(session, session[0], side="right")) if before else 0
    head = respond(
        np.zeros(len(before) + first, dtype=np.int64),
        np.r_[np.full(len(before), past.time), t[:first]],
        np.r_[before, source[:first]],
        True,
    )[len(before) :]
    out = np.r_[head, respond(session[first:], t[first:], source[first:], False)]
    seen = source[session == session[-1]]
    if first == len(recording):
        seen = np.r_[before, seen]
    past.later[driver] = _rows_before(driver, float(out[-1]), seen[np.isfinite(seen)])
    return out


def _goes_on(recording: Recording, past: CarriedState) -> bool:
    same_run = recording.run_labels()[recording.run_codes()[0]] == past.run
    return same_run or (recording.name("time") is not None and 0.0 <= recording.time()[0] - past.time <= MAX_PAUSE)


def _rows_before(driver: d.First | d.Lag | d.Switch, last: float, seen: np.ndarray) -> tuple[float, ...]:
    """Inputs that bring a fresh response to its value `last`; () where it has not begun."""
    if isinstance(driver, d.Switch):
        return (driver.on if last > 0.5 else driver.off,)
    if not seen.size:
        return ()
    return (last,) if isinstance(driver, d.First) else (last, float(seen[-1]))


def runs_on(driver: d.Driver, recording: Recording) -> bool:
    """Does a driver depend only on temperatures and pressures, which do not jump between rows?"""
    names = d.inputs(driver)
    roles = {recording.manifest.columns[n].role for n in names}
    return bool(names) and roles <= {"temperature", "pressure"}
