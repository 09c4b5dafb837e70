"""Model discrimination: the next measurement in which the predictions of two rivals differ most."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.diagnosis.hypotheses import Hypothesis
from errpipe.diagnosis.units import rounded
from errpipe.domain.recording import Recording

STEPS = 240  # points of a proposed experiment at which rivals are compared
REVERSALS = (0.002, 0.005, 0.01, 0.03, 0.1, 0.3, 1.0)  # mm (deg)
SPEEDS = (0.01, 0.03, 0.1, 0.3, 1.0)  # shares of the highest speed: friction differs most near standstill
MOTION = ("position", "command", "velocity", "acceleration")  # roles that one move of an axis changes together
ROWS_PER_PERIOD = 4096  # rows of a sine: straight between them is within 3e-7 of its amplitude, far below a dead time
SURE = 3.0  # standard errors by which the predictions of two rivals must differ
MOST_READINGS = 20000  # about one shift at one reading per second; a longer measurement is not proposed
Fitted = tuple[Hypothesis, np.ndarray]  # a hypothesis and the coefficients of its core columns


def would_separate(recording: Recording, first: Fitted, second: Fitted, noise: float, unit: str) -> str:
    """A sentence: the additional measurement in which two fitted hypotheses differ most, and by how much."""
    best = (0.0, "")
    for what, trial in _hypothetical_recordings(recording, (*first[0].drivers, *second[0].drivers)):
        try:
            apart = _predict(first, trial) - _predict(second, trial)
        except (KeyError, ValueError, IndexError):
            continue
        if np.isfinite(apart).all() and np.std(apart) > best[0]:
            best = (float(np.std(apart)), what)
    if not best[1]:
        return ""
    readings = int(np.ceil((SURE * noise / best[0]) ** 2))
    if readings > MOST_READINGS:
        return f"{best[1]}; but on this machine their predictions agree within the noise even then"
    enough = "a few readings" if readings < 10 else f"about {float(f'{readings:.1g}'):.0f} readings"
    gap, scatter = rounded(2 * best[0], 2), rounded(noise, 2)
    return f"{best[1]}; the two then differ by {gap} {unit} ({enough} at a noise of {scatter} {unit})"


def _predict(fitted: Fitted, trial: Recording) -> np.ndarray:
    h, b = fitted
    return np.column_stack([t.basis(trial, *nl) for t, nl in zip(h.terms, h.nonlinear, strict=True)]) @ b


def _hypothetical_recordings(recording: Recording, drivers: tuple[str, ...]):
    """Hypothetical recordings: one driver or one axis changes, the others are constant."""
    columns, constant = recording.manifest.columns, _at_rest(recording)
    names = [n for n in dict.fromkeys(drivers) if n in columns and n in recording]
    for name in (n for n in names if columns[n].role not in (*MOTION, "time", "run", "direction")):
        low, high = np.nanquantile(recording.array(name), [0.02, 0.98])
        moved = {name: np.where((np.arange(STEPS) // (STEPS // 4)) % 2 == 0, low, high)}
        for position in recording.names("position"):
            x = recording.array(position)
            moved[position] = np.tile(np.linspace(np.nanmin(x), np.nanmax(x), 8), STEPS // 8)
        shown = f"{name} = {rounded(low)} and {rounded(high)} {columns[name].unit or ''}".strip()
        yield (
            f"measure at {shown} with all other inputs as constant as can be",
            Recording(recording.manifest, constant.assign(**moved)),
        )
    for axis in dict.fromkeys(columns[n].axis for n in names if columns[n].role in (*MOTION, "direction")):
        place = recording.name("position", axis=axis)
        for what, moved in _axis_moves(recording, axis, place, constant) if place else ():
            rows = np.linspace(0, STEPS - 1, moved[place].size).astype(int)
            yield what, Recording(recording.manifest, constant.iloc[rows].reset_index(drop=True).assign(**moved))


def _axis_moves(recording: Recording, axis: str | None, place: str, constant: pd.DataFrame):
    """Moves of one axis that it can make, all its columns in agreement: slow, at several speeds, a sine, reversals."""
    (low, high), unit = np.nanquantile(recording.array(place), [0.02, 0.98]), recording.manifest.columns[place].unit
    position, side = (place, *recording.names("command", axis=axis)), recording.names("direction", axis=axis)
    speed, clock = recording.name("velocity", axis=axis) or "", recording.name("time") or ""
    top = float(np.nanquantile(np.abs(recording.array(speed)), 0.98)) if speed and clock and high > low else 0.0

    def made(x: np.ndarray, v: np.ndarray, t: np.ndarray, **more: np.ndarray) -> dict[str, np.ndarray]:
        known = {speed: v, clock: t} if top > 0 else {}
        return {**dict.fromkeys(position, x), **dict.fromkeys(side, np.where(v < 0, -1.0, 1.0)), **known, **more}

    v, t = np.full(STEPS, SPEEDS[0] * top or 1.0), np.linspace(0.0, (high - low) / (SPEEDS[0] * top or 1.0), STEPS)
    what = f"move {place} from {rounded(low)} to {rounded(high)} {unit} slowly, with everything else at rest"
    yield what, made(np.linspace(low, high, STEPS), v, t)
    if side:
        listed = f"{', '.join(f'{r:g}' for r in REVERSALS[:-1])} and {REVERSALS[-1]:g} {unit}"
        yield f"approach the same target after reversals of {listed}", _short_reversals(place, side[0], constant)
    if top > 0:
        v, t = np.resize(np.outer(SPEEDS, (top, -top)), STEPS), 0.5 * (high - low) / top * np.arange(STEPS)
        what = f"move {place} at 1, 3, 10, 30 and 100 % of {rounded(top)} {unit}/s, in both directions"
        yield what, made(0.5 * (low + high) + np.cumsum(v) * t[1], v, t)
    for name in recording.names("acceleration", axis=axis) if top > 0 else ():
        most = max(float(np.nanquantile(np.abs(recording.array(name)), 0.98)), 2 * top**2 / (high - low))
        rate, phase = most / top, np.linspace(0.0, 2 * np.pi, ROWS_PER_PERIOD)  # rad/s, rad
        x, v, a = top / rate * np.sin(phase), top * np.cos(phase), -most * np.sin(phase)
        middle, ends = 0.5 * (low + high), top / rate
        between = f"between {rounded(middle - ends)} and {rounded(middle + ends)} {unit}"
        what = f"move {place} {between} as a sine of {rounded(rate / (2 * np.pi))} Hz"
        yield what, made(middle + x, v, phase / rate, **{name: a})


def _at_rest(recording: Recording) -> pd.DataFrame:
    """Every input constant at its median, the time over that of the recording."""
    labels, t = {*recording.names("run"), *recording.names("group")}, recording.time()
    rest = {n: "1" if n in labels else float(np.nanmedian(recording.array(n))) for n in recording.frame.columns}
    time = np.linspace(0.0, float(np.nanmax(t) - np.nanmin(t)) or 3600.0, STEPS)
    return pd.DataFrame(rest, index=range(STEPS)).assign(**{recording.name("time") or "t": time})


def _short_reversals(place: str, side: str, rest: pd.DataFrame) -> dict[str, np.ndarray]:
    d = np.where(np.arange(STEPS) % 2, 1.0, -1.0)  # direction of the move that ends at each row
    d[0] = 1.0
    return {place: rest[place] + np.cumsum(d * np.r_[0.0, np.resize(REVERSALS, STEPS - 1)]), side: d}
