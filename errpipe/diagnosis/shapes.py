"""Nonparametric shapes: smooth in a column or in time, per run, or a surface, for what no known effect explains.

They compete with named effects: a shape that explains the residual of a finding lowers its confidence.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import axes, direction, position_name
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms import resolved_times

WANDERING = ("time", "runs", "slope in time", "slope of each run")  # kinds over time or runs, not over an input
TIME_WAVES = 40  # cosines over the recording: down to a fortieth of half its length
PLACE_WAVES = 24  # cosines over an axis
SMOOTH = 8  # cosines over any other column
BY_SIDE = 4  # cosines over an input of a shape that changes sign with the direction
SLOW = ("temperature", "pressure", "humidity", "spindle_speed", "feed", "coolant", "load", "force")
ROLES = (*SLOW, "overhang", "depth_of_cut", "cut_length", "velocity", "acceleration")
LAGS = (1 / 60, 1 / 20, 1 / 6)  # of the longest session: time constants of lagged inputs
MOST_PRODUCTS = 8  # inputs whose products are tried in pairs, and with the position on an axis
DECAYS = (0.01, 0.03, 0.1, 0.3)  # of the longest session: time constants of a decay that restarts with each run
LEAST_STARTS = 3  # runs needed to distinguish that from a drifting reading


@dataclass(frozen=True)
class Shape:
    """A data-driven shape: the inputs it is smooth in, its columns (rows, k) and their freedoms."""

    kind: str
    drivers: tuple[str, ...]
    columns: np.ndarray
    freedom: np.ndarray

    @property
    def of_inputs(self) -> bool:
        """Is it a shape over inputs? Slow noise resembles a shape over time or runs only."""
        return self.kind not in WANDERING


def shapes(recording: Recording, component: str, rows: np.ndarray) -> list[Shape]:
    """All shapes for a response on its rows, columns of unit rms; responses on the same rows share them."""
    name = component == "E_R", rows.tobytes()
    kept, made = recording.derived.get("shapes", (None, []))
    out: list[Shape] = made if kept == name else []
    for kind, drivers, columns, freedom in _all_columns(recording, component, rows) if kept != name else ():
        rms = np.sqrt(np.mean(columns**2, axis=0))
        keep = rms > 1e-9
        if keep.sum() >= 1:
            out.append(Shape(kind, drivers, columns[:, keep] / rms[keep], freedom[keep]))
    recording.derived["shapes"] = name, out  # cached for the latest rows only: they take 60 MB
    return out


def _waves(u: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosines over the range of u, with a smoothness prior."""
    low, high = np.min(u), np.max(u)
    at = (u - low) / (high - low) if high > low else np.zeros_like(u)
    k = np.arange(1, count + 1)
    return np.cos(np.pi * at[:, None] * k), 1.0 / k**0.8


def _since_start(recording: Recording, rows: np.ndarray) -> Iterator[tuple]:
    """Decays that restart with each run and are equal in all: a gauge or a slide that settles."""
    run, clock = recording.name("run"), recording.name("time")
    if run is None or clock is None:
        return
    t, starts = recording.time(), recording.run_codes()
    codes, first, inside = np.unique(starts, return_index=True, return_inverse=True)
    if codes.size >= LEAST_STARTS:
        since = (t - t[first][inside])[rows]
        taus = np.array(DECAYS) * resolved_times(recording)[1]
        yield "start of each run", (run, clock), np.exp(-since[:, None] / taus), np.ones(taus.size)


def _of_columns(recording: Recording, rows: np.ndarray, slow: list[tuple[str, np.ndarray]]) -> Iterator[tuple]:
    """Smooth in an input, in a lagged input, or in the product of two; slow: filled with these inputs."""
    session, t = sessions(recording), recording.time()
    _, longest = resolved_times(recording)
    for role in ROLES:
        for name in recording.names(role):
            whole = recording.array(name)
            u = whole[rows]
            if not np.isfinite(whole).all() or u.max() <= u.min():
                continue
            yield ("column", (name,), *_waves(u, min(SMOOTH, np.unique(u).size - 1)))
            if role in SLOW and recording.name("time") is not None:
                slow.append((name, u))
                lagged = [responses.lag(session, t, whole, longest * k, longest * k, True)[rows] for k in LAGS]
                for v in lagged:
                    yield ("lagged column", (name,), *_waves(v, 3))
                slow.append((name, lagged[1]))
    slow[:] = [(name, (u - u.mean()) / (u.std() or 1.0)) for name, u in slow[:MOST_PRODUCTS]]
    for (one, u), (other, v) in itertools.combinations_with_replacement(slow, 2):
        yield "product", tuple(dict.fromkeys((one, other))), (u * v)[:, None] - np.mean(u * v), np.ones(1)


def _all_columns(recording: Recording, component: str, rows: np.ndarray) -> Iterator[tuple]:
    run = recording.run_codes()[rows]
    clock = recording.name("time") or "row"
    place = np.arange(rows.size, dtype=float)
    yield ("time", (clock,), *_waves(place, TIME_WAVES))
    codes = np.unique(run)
    if codes.size > 1:
        steps = (run[:, None] == codes).astype(float)
        yield "runs", (recording.name("run") or clock,), steps - steps.mean(axis=0), np.ones(codes.size)
    yield from _since_start(recording, rows)
    slow: list[tuple[str, np.ndarray]] = []
    yield from _of_columns(recording, rows, slow)
    letters = axes(recording)
    if component == "E_R" and len(letters) >= 2:
        x, y = (recording.array(position_name(recording, a))[rows] for a in letters[:2])
        names = tuple(position_name(recording, a) for a in letters[:2])
        angle = np.arctan2(y, x)
        k = np.arange(1, 13)
        rings = np.column_stack([np.cos(angle[:, None] * k), np.sin(angle[:, None] * k)])
        free = np.r_[1.0 / k**0.5, 1.0 / k**0.5]
        yield "angle", names, rings, free
        yield "angle and sense", names, rings * np.sign(np.gradient(np.unwrap(angle)))[:, None], free
        return
    for axis in letters:
        name = position_name(recording, axis)
        x = recording.array(name)[rows]
        if x.max() <= x.min():
            continue
        waves, free = _waves(x, PLACE_WAVES)
        yield "place", (name,), waves, free
        for other, u in slow if len(letters) == 1 else ():
            yield "place and input", (name, other), waves[:, :SMOOTH] * u[:, None], free[:SMOOTH]
        side = direction(recording, axis)[rows]
        if np.unique(side).size > 1 and len(letters) == 1:
            yield "place and direction", (name,), np.column_stack([side, waves * side[:, None]]), np.r_[1.0, free]
            for other, u in slow:
                bent, smooth = _waves(u, BY_SIDE)
                yield "direction and input", (name, other), bent * side[:, None], smooth
        if codes.size > 1 and len(letters) == 1:
            slopes = (run[:, None] == codes) * (x - x.mean())[:, None]
            yield "slope of each run", (name, recording.name("run") or clock), slopes, np.ones(codes.size)
            over_time, free_shapes = _waves(place, 20)
            yield "slope in time", (name, clock), over_time * (x - x.mean())[:, None], free_shapes
    if len(letters) >= 2:
        units = []
        for axis in letters[:3]:
            x = recording.array(position_name(recording, axis))[rows]
            units.append(np.polynomial.chebyshev.chebvander((2 * x - x.min() - x.max()) / (np.ptp(x) or 1.0), 4))
        columns, free = [], []
        for degrees in itertools.product(range(5), repeat=len(units)):
            if 0 < sum(degrees) <= 4:
                columns.append(np.prod([u[:, k] for u, k in zip(units, degrees, strict=True)], axis=0))
                free.append(1.0 / sum(degrees) ** 0.5)
        names = tuple(position_name(recording, a) for a in letters[:3])
        yield "surface", names, np.column_stack(columns), np.array(free)
