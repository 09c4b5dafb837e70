"""Drivers that several terms' equations are made of: sign, magnitude, a curve of one input."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from errpipe.domain.driver import Affine, Clip, Driver, Input, Lookup

STEEP = 1e9  # slope at which a clipped line is a sign: inputs are never as small as 1e-9 of their unit, unless 0
CURVE_POINTS = 1200  # linear interpolation then leaves less than 1e-4 of a tanh or a bell over its range
MAX_INPUT = 1e12  # no input is larger


def times(driver: Driver, weight: float) -> Affine:
    """weight * driver."""
    return Affine(weights=(weight,), of=(driver,))


def sign(name: str) -> Clip:
    """Sign of an input: -1, 0 or 1."""
    return Clip(low=-1.0, high=1.0, of=times(Input(name=name), STEEP))


def magnitude(name: str) -> Lookup:
    """Absolute value of an input."""
    return Lookup(start=-MAX_INPUT, step=MAX_INPUT, values=(MAX_INPUT, 0.0, MAX_INPUT), of=Input(name=name))


def curve(name: str, shape: Callable[[np.ndarray], np.ndarray], reach: float) -> Lookup:
    """`shape` of an input between -reach and reach, beyond held at its ends."""
    at = np.linspace(-reach, reach, CURVE_POINTS + 1)
    return Lookup(start=-reach, step=2 * reach / CURVE_POINTS, values=tuple(shape(at).tolist()), of=Input(name=name))
