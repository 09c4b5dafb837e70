"""Where the mismatch sits: rms before and after by run, direction, stretch, temperature, speed and coolant."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from errpipe.diagnosis.hypotheses import Hypothesis
from errpipe.domain.diagnosis import Regime, Where
from errpipe.domain.recording import Recording
from errpipe.terms._base import direction
from errpipe.terms._place import axes, position_name

LEAST_ROWS = 10


def where(h: Hypothesis, recording: Recording, nonlinear: tuple[float, ...]) -> Where:
    """What limits a hypothesis."""
    term = h.terms[0]
    if h.mask and h.mask[0] == "runs":
        return Where(runs=tuple(h.mask[1]))
    if h.mask:
        return Where(ranges={h.mask[1]: (float(h.mask[2]), float(h.mask[3]))})
    if h.effect == "local_wear":
        centre, width = nonlinear
        return Where(ranges={position_name(recording, term.axis): (centre - 2 * width, centre + 2 * width)})
    clock = recording.name("time")
    if h.effect == "sensor_fault" and clock is not None:
        t = recording.time()
        return Where(ranges={clock: (float(t[term.first]), float(t[term.last]))})
    return Where()


def regimes(recording: Recording, rows: np.ndarray, before: np.ndarray, after: np.ndarray) -> tuple[Regime, ...]:
    """rms of the mismatch before and after in each part of the recording."""
    out = []
    for what, inside in _parts(recording, rows):
        if inside.sum() >= LEAST_ROWS:
            b, a = (float(np.sqrt(np.mean(v[inside] ** 2))) for v in (before, after))
            out.append(Regime(what=what, rows=int(inside.sum()), rms_before_um=b, rms_after_um=a))
    return tuple(out)


def _parts(recording: Recording, rows: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    run = recording.run_codes()[rows]
    labels = recording.run_labels()
    codes = np.unique(run)
    if codes.size > 1:
        for c in codes:
            yield f"run {labels[c]}", run == c
    for axis in axes(recording):
        name = position_name(recording, axis)
        x = recording.array(name)[rows]
        try:
            side = direction(recording, axis)[rows]
        except KeyError:
            side = np.ones(rows.size)
        if np.unique(side).size > 1:
            yield f"{name} approached from below", side > 0
            yield f"{name} approached from above", side < 0
        cuts = np.quantile(x, [0.0, 1 / 3, 2 / 3, 1.0])
        for word, low, high in zip(("lower", "middle", "upper"), cuts[:-1], cuts[1:], strict=True):
            yield f"{word} third of {name}", (x >= low) & (x <= high)
    for role in ("temperature", "spindle_speed", "feed", "load"):
        for name in recording.names(role):
            u = recording.array(name)[rows]
            middle = np.median(u)
            if u.max() > u.min() and (u > middle).any():
                yield f"{name} up to {middle:.4g}", u <= middle
                yield f"{name} above {middle:.4g}", u > middle
    for name in recording.names("coolant"):
        u = recording.array(name)[rows]
        if np.unique(u).size > 1:
            yield "coolant on", u > 0.5
            yield "coolant off", u <= 0.5
