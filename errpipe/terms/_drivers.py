"""Drivers that several terms are made of: temperature rises, sign and magnitude, a curve of one input."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording

REFERENCE = 20.0  # degC, ISO 1: the temperature at which lengths are stated
STEEP = 1e9  # slope at which a clipped line is a sign: inputs are never as small as 1e-9 of their unit, unless 0
CURVE_POINTS = 1200  # the interpolation error is then below 1e-4 of a tanh or a bell over its range
MAX_INPUT = 1e12  # no input is larger


def rise_driver(sensor: str, reference: float | None) -> d.Affine:
    """Rise of a sensor in K: over `reference` degC, or over its first value of the session where that is None."""
    return d.rise(sensor) if reference is None else d.above(sensor, reference)


def scaled(driver: d.Driver, gain: float) -> d.Affine:
    """gain * driver."""
    return d.Affine(weights=(gain,), of=(driver,))


def sign(name: str) -> d.Clip:
    """Sign of an input: -1, 0 or 1."""
    return d.Clip(low=-1.0, high=1.0, of=scaled(d.Input(name=name), STEEP))


def magnitude(name: str) -> d.Lookup:
    """Absolute value of an input."""
    return d.Lookup(start=-MAX_INPUT, step=MAX_INPUT, values=(MAX_INPUT, 0.0, MAX_INPUT), of=d.Input(name=name))


def curve(name: str, shape: Callable[[np.ndarray], np.ndarray], reach: float) -> d.Lookup:
    """`shape` of an input between -reach and reach, beyond held at its ends."""
    at = np.linspace(-reach, reach, CURVE_POINTS + 1)
    return d.Lookup(
        start=-reach, step=2 * reach / CURVE_POINTS, values=tuple(shape(at).tolist()), of=d.Input(name=name)
    )


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
# Words that hold one of ROOM_WORDS, and are no room.
NO_ROOM = re.compile(r"hall[ _-]?(sensor|effect|probe|element)|shallow|challeng|headroom")
COOLANT_WORDS = ("coolant", "cutting fluid", "emulsion", "lubricant tank")


def mentions(recording: Recording, sensor: str, words: tuple[str, ...]) -> bool:
    """Does the sensor's place hold one of the words?"""
    place = NO_ROOM.sub("", location(recording, sensor))
    return any(word in place for word in words)
