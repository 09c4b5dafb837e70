"""Contacts that slip: LuGre friction, Bouc-Wen hysteresis and a gap with play, along a prescribed motion."""

from __future__ import annotations

import math

import numpy as np

Array = np.ndarray


def lugre(t: Array, v: Array, coulomb: float, static: float, knee: float, bristle: float) -> Array:
    """Friction force in N for speed v (mm/s); `knee` is the Stribeck speed, `bristle` the pre-sliding travel in mm.

    The bristle state is exact for a speed held between samples; the force is the bristle's part alone.
    """
    z = 0.0
    out = np.empty(t.size)
    times, speeds = t.tolist(), v.tolist()
    last = times[0]
    for i, speed in enumerate(speeds):
        level = coulomb + (static - coulomb) * math.exp(-((speed / knee) ** 2))
        dt = times[i] - last
        last = times[i]
        if speed != 0.0 and dt > 0:
            goal = math.copysign(level, speed)
            z = goal + (z - goal) * math.exp(-abs(speed) * dt * coulomb / (bristle * level))
        out[i] = z
    return out


def bouc_wen(travel: Array, length: float, power: float = 1.4, start: float = 0.0) -> Array:
    """Hysteretic state in -1..1 along a path of positions (mm); saturates after a few `length` of travel."""
    z = start
    out = np.empty(travel.size)
    last = float(travel[0])
    for i, x in enumerate(travel.tolist()):
        step = x - last
        last = x
        if abs(step) > 8 * length or (z * step > 0 and abs(z) > 0.9999):
            z = math.copysign(1.0, step)
        else:
            pieces = int(abs(step) / (0.1 * length)) + 1
            d = step / pieces / length
            for _ in range(pieces):
                z += d * (1.0 - math.copysign(abs(z) ** power, d * z))
                z = -1.0 if z < -1.0 else min(z, 1.0)
        out[i] = z
    return out


def play(travel: Array, gap: float, start: float = 0.0) -> Array:
    """Side of the gap (-1..1, with the sign of the motion): the driven part follows only once the gap is closed."""
    out = np.empty(travel.size)
    slack = -start * gap / 2
    last = float(travel[0])
    for i, x in enumerate(travel.tolist()):
        slack = max(-gap / 2, min(gap / 2, slack - (x - last)))
        last = x
        out[i] = -2 * slack / gap if gap > 0 else 0.0
    return out
