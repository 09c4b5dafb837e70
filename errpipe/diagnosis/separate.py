"""Model discrimination: the next measurement in which the predictions of two rivals differ most."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.diagnosis.hypotheses import Hypothesis
from errpipe.domain.recording import Recording

STEPS = 240  # points of a proposed experiment at which rivals are compared
REVERSALS = (0.002, 0.005, 0.01, 0.03, 0.1, 0.3, 1.0)  # mm
SURE = 3.0  # standard errors by which the predictions of two rivals must differ
MOST_READINGS = 20000  # about one shift at one reading per second; a longer measurement is not proposed


def would_separate(
    recording: Recording,
    first: tuple[Hypothesis, np.ndarray],
    second: tuple[Hypothesis, np.ndarray],
    noise: float,
    unit: str,
) -> str:
    """A sentence: the additional measurement in which two fitted hypotheses differ most, and by how much.

    first, second: each a hypothesis and the coefficients of its core columns.
    """
    best = (0.0, "")
    for what, trial in _hypothetical_recordings(recording, (*first[0].drivers, *second[0].drivers)):
        try:
            gap = _predict(first, trial) - _predict(second, trial)
        except (KeyError, ValueError, IndexError):
            continue
        if np.isfinite(gap).all() and np.std(gap) > best[0]:
            best = (float(np.std(gap)), what)
    if not best[1]:
        return ""
    readings = int(np.ceil((SURE * noise / best[0]) ** 2))
    if readings > MOST_READINGS:
        return f"{best[1]}; but on this machine their predictions agree within the noise even then"
    enough = "a few readings" if readings < 10 else f"about {float(f'{readings:.1g}'):.0f} readings"
    return f"{best[1]}; the two then differ by {2 * best[0]:.2g} {unit} ({enough} at a noise of {noise:.2g} {unit})"


def _predict(fitted: tuple[Hypothesis, np.ndarray], trial: Recording) -> np.ndarray:
    h, b = fitted
    columns = np.column_stack([t.basis(trial, *nl) for t, nl in zip(h.terms, h.nonlinear, strict=True)])
    return columns @ b


def _hypothetical_recordings(recording: Recording, drivers: tuple[str, ...]):
    """Hypothetical recordings: one driver changes, the others are constant."""
    names = dict.fromkeys(drivers)
    columns = recording.manifest.columns
    constant = _rest(recording)
    t = recording.time()
    duration = float(np.nanmax(t) - np.nanmin(t)) or 3600.0
    clock = recording.name("time")
    constant[clock or "t"] = np.linspace(0.0, duration, STEPS)
    for name in names:
        kind = columns.get(name)
        if kind is None or name not in recording.frame.columns or kind.role in ("time", "run", "direction"):
            continue
        values = recording.array(name)
        low, high = np.nanquantile(values, [0.02, 0.98])
        if kind.role == "position":
            moved = Recording(recording.manifest, constant.assign(**{name: np.linspace(low, high, STEPS)}))
            yield f"move {name} from {low:.4g} to {high:.4g} with everything else at rest", moved
            continue
        frame = constant.assign(**{name: np.where((np.arange(STEPS) // (STEPS // 4)) % 2 == 0, low, high)})
        for position in recording.names("position"):
            x = recording.array(position)
            frame[position] = np.tile(np.linspace(np.nanmin(x), np.nanmax(x), 8), STEPS // 8)
        trial = Recording(recording.manifest, frame)
        yield f"step {name} between {low:.4g} and {high:.4g} and hold every other input still", trial
    for axis in {columns[n].axis for n in names if n in columns and columns[n].role in ("direction", "position")}:
        short = _short_reversals(recording, constant, axis)
        if short is not None:
            yield "approach the same target after reversals of 0.002, 0.01, 0.1 and 1 mm", short


def _rest(recording: Recording) -> pd.DataFrame:
    """Every input constant at its median."""
    frame = pd.DataFrame(index=range(STEPS))
    for name in recording.frame.columns:
        if recording.manifest.columns[name].role in ("run", "group"):
            frame[name] = "1"
        else:
            frame[name] = float(np.nanmedian(recording.array(name)))
    return frame


def _short_reversals(recording: Recording, rest: pd.DataFrame, axis: str | None) -> Recording | None:
    place, side = recording.name("position", axis=axis), recording.name("direction", axis=axis)
    if place is None or side is None:
        return None
    d = np.where(np.arange(STEPS) % 2, 1.0, -1.0)  # direction of the move that ends at each row
    d[0] = 1.0
    x = np.cumsum(d * np.r_[0.0, np.resize(REVERSALS, STEPS - 1)])
    return Recording(recording.manifest, rest.assign(**{place: rest[place] + x, side: d}))
