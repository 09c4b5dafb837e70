"""Model discrimination: the next measurement in which the predictions of two rivals differ most."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.diagnosis.hypotheses import Hypothesis
from errpipe.diagnosis.units import said
from errpipe.domain.recording import Recording

STEPS = 240  # points of a proposed experiment at which rivals are compared
REVERSALS = (0.002, 0.005, 0.01, 0.03, 0.1, 0.3, 1.0)  # mm (deg)
SPEEDS = (0.01, 0.03, 0.1, 0.3, 1.0)  # shares of the highest speed: friction differs most near standstill
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
    gap, scatter = said(2 * best[0], 2), said(noise, 2)
    return f"{best[1]}; the two then differ by {gap} {unit} ({enough} at a noise of {scatter} {unit})"


def _predict(fitted: Fitted, trial: Recording) -> np.ndarray:
    h, b = fitted
    columns = np.column_stack([t.basis(trial, *nl) for t, nl in zip(h.terms, h.nonlinear, strict=True)])
    return columns @ b


def _hypothetical_recordings(recording: Recording, drivers: tuple[str, ...]):
    """Hypothetical recordings: one driver changes, the others are constant."""
    names, columns, t = dict.fromkeys(drivers), recording.manifest.columns, recording.time()
    labels = {*recording.names("run"), *recording.names("group")}
    rest = {n: "1" if n in labels else float(np.nanmedian(recording.array(n))) for n in recording.frame.columns}
    constant = pd.DataFrame(rest, index=range(STEPS))
    constant[recording.name("time") or "t"] = np.linspace(0.0, float(np.nanmax(t) - np.nanmin(t)) or 3600.0, STEPS)
    for name in names:
        kind = columns.get(name)
        if kind is None or name not in recording.frame.columns or kind.role in ("time", "run", "direction"):
            continue
        low, high = np.nanquantile(recording.array(name), [0.02, 0.98])
        frame, unit = constant.copy(), f" {kind.unit}" if kind.unit else ""
        if kind.role == "position":
            frame[name] = np.linspace(low, high, STEPS)
            what = f"move {name} from {said(low)} to {said(high)}{unit} with everything else at rest"
        elif kind.role == "velocity":
            top = max(abs(low), abs(high))
            frame[name] = np.resize(np.outer(SPEEDS, (top, -top)), STEPS)
            what = f"move with {name} at 1, 3, 10, 30 and 100 % of {said(top)}{unit}, in both directions"
        else:
            frame[name] = np.where((np.arange(STEPS) // (STEPS // 4)) % 2 == 0, low, high)
            what = f"measure at {name} = {said(low)} and {said(high)}{unit} with all other inputs as constant as can be"
        for position in recording.names("position") if kind.role != "position" else ():
            x = recording.array(position)
            frame[position] = np.tile(np.linspace(np.nanmin(x), np.nanmax(x), 8), STEPS // 8)
        yield what, Recording(recording.manifest, frame)
    for axis in {columns[n].axis for n in names if n in columns and columns[n].role in ("direction", "position")}:
        place, side = recording.name("position", axis=axis), recording.name("direction", axis=axis)
        if place is not None and side is not None:
            listed = f"{', '.join(f'{r:g}' for r in REVERSALS[:-1])} and {REVERSALS[-1]:g} {columns[place].unit}"
            short = constant.assign(**_short_reversals(place, side, constant))
            yield f"approach the same target after reversals of {listed}", Recording(recording.manifest, short)


def _short_reversals(place: str, side: str, rest: pd.DataFrame) -> dict[str, np.ndarray]:
    d = np.where(np.arange(STEPS) % 2, 1.0, -1.0)  # direction of the move that ends at each row
    d[0] = 1.0
    return {place: rest[place] + np.cumsum(d * np.r_[0.0, np.resize(REVERSALS, STEPS - 1)]), side: d}
