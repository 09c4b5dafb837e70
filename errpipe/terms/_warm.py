"""Temperature rises as drivers: over the value at the start, or over a fixed reference."""

from __future__ import annotations

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording

REFERENCE = 20.0  # degC, ISO 1: the temperature at which lengths are stated


def rise_driver(sensor: str, reference: float | None) -> d.Affine:
    """Rise of a sensor in K: over `reference` degC, or over its first value of the session where that is None."""
    return d.rise(sensor) if reference is None else d.above(sensor, reference)


def scaled(driver: d.Driver, gain: float) -> d.Affine:
    """gain * driver."""
    return d.Affine(weights=(gain,), of=(driver,))


def location(recording: Recording, sensor: str) -> str:
    """Location of a sensor from the manifest, lower case; its column name if none is stated."""
    return (recording.manifest.columns[sensor].location or sensor).lower()


def sensors(recording: Recording) -> tuple[str, ...]:
    """Temperature columns that hold at least two different finite values, in manifest order."""
    alive = []
    for name in recording.names("temperature"):
        values = recording.array(name)
        finite = values[np.isfinite(values)]
        if finite.size > 2 and finite.max() > finite.min():
            alive.append(name)
    return tuple(alive)


ROOM_WORDS = ("room", "ambient", "hall", "shop", "environment")
AIR_WORDS = ("air", *ROOM_WORDS)
COOLANT_WORDS = ("coolant", "cutting fluid", "emulsion", "lubricant tank")


def mentions(recording: Recording, sensor: str, words: tuple[str, ...]) -> bool:
    """Does the sensor's place hold one of the words?"""
    place = location(recording, sensor)
    return any(word in place for word in words)
