"""Position loops: what a disturbing friction and a finite bandwidth leave between command and axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import bilinear, lfilter

from .friction import lugre

Array = np.ndarray


@dataclass
class Loop:
    """A loop with integral action: compliance s*Ti / ((1 + s*Ti)(1 + 2*d*s/w + s^2/w^2)), um per N at mid band."""

    integral: float  # s
    corner: float  # rad/s
    damping: float
    softness: float  # um/N

    def deflect(self, dt: float, force: Array) -> Array:
        """um under a force (N) sampled every dt s, settled at the start."""
        quick = [1 / self.corner**2, 2 * self.damping / self.corner, 1.0]
        b, a = bilinear([self.integral, 0.0], np.polymul([self.integral, 1.0], quick), 1.0 / dt)
        return self.softness * lfilter(b, a, force - force[0])


def any_loop(rng: np.random.Generator) -> Loop:
    return Loop(rng.uniform(0.02, 0.08), 2 * np.pi * rng.uniform(15, 45), rng.uniform(0.3, 0.8), 1.0)


def spike(loop: Loop, dt: float, v: Array, knee: float, bristle: float) -> Array:
    """What a reversal of v (mm/s, sampled every dt) leaves: LuGre friction pushes, the loop gives way and recovers."""
    t = np.arange(v.size) * dt
    return -loop.deflect(dt, lugre(t, v, 1.0, 1.25, knee, bristle))


def follow(dt: float, x: Array, lag: float, corner: float) -> Array:
    """Actual minus commanded (same unit as x) of an axis with a small lag and a mechanical corner, rad/s."""
    b, a = bilinear([1.0], np.polymul([lag, 1.0], [1 / corner**2, 1.2 / corner, 1.0]), 1.0 / dt)
    ideal_b, ideal_a = bilinear([1.0], [1 / corner**2, 1.2 / corner, 1.0], 1.0 / dt)
    base = x - x[0]
    return lfilter(b, a, base) - lfilter(ideal_b, ideal_a, base)
