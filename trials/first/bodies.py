"""Heat conduction by finite volumes: bars, plates and lumps, solved exactly in their modes or marched in time.

All temperatures are rises over the start in K; lengths m, powers W, conductances W/K, capacities J/K.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

Array = np.ndarray

STEEL = {"k": 45.0, "c": 3.7e6}  # W/m/K, J/m3/K
IRON = {"k": 50.0, "c": 3.6e6}


@dataclass
class Body:
    """Cells with `capacity` (n), joined by `joints` (n, n; symmetric, zero diagonal), leaking to air by `air` (n)."""

    capacity: Array
    joints: Array
    air: Array

    def matrix(self) -> Array:
        return np.diag(self.joints.sum(axis=1) + self.air) - self.joints

    def respond(self, dt: float, forcing: Array) -> Array:
        """Temperatures (time, cells) under forcing (time, cells) in W held over each step of `dt` s; starts at zero."""
        root = np.sqrt(self.capacity)
        rates, modes = np.linalg.eigh(self.matrix() / np.outer(root, root))
        rates = np.maximum(rates, 1e-12)
        drive = (forcing / root) @ modes
        out = np.empty_like(drive)
        for m, rate in enumerate(rates):
            keep = np.exp(-rate * dt)
            out[:, m] = lfilter([0.0, (1.0 - keep) / rate], [1.0, -keep], drive[:, m])
        return out @ modes.T / root

    def march(self, dt: float, forcing: Array, level: Array, air_at: dict[int, Array]) -> Array:
        """As `respond`, but the leak to air changes in time: `level` (time) names one of `air_at`; implicit Euler."""
        solve = {}
        for key, air in air_at.items():
            system = np.diag(self.capacity / dt + self.joints.sum(axis=1) + air) - self.joints
            solve[key] = np.linalg.inv(system)
        out = np.zeros_like(forcing)
        state = np.zeros(self.capacity.size)
        inertia = self.capacity / dt
        for i in range(1, forcing.shape[0]):
            state = solve[int(level[i])] @ (inertia * state + forcing[i - 1])
            out[i] = state
        return out


def bar(cells: int, length: float, area: float, perimeter: float, h: float, *, k: float, c: float) -> Body:
    """A bar cut into `cells`, cooled over its side by h W/m2/K, with insulated ends."""
    d = length / cells
    joints = np.zeros((cells, cells))
    inner = k * area / d
    for i in range(cells - 1):
        joints[i, i + 1] = joints[i + 1, i] = inner
    return Body(np.full(cells, c * area * d), joints, np.full(cells, h * perimeter * d))


def plate(cells: int, thickness: float, front: float, back: float, *, k: float, c: float) -> Body:
    """One square metre of wall through its thickness; film coefficients at the front and the back."""
    d = thickness / cells
    body = bar(cells, thickness, 1.0, 0.0, 0.0, k=k, c=c)
    body.air[0] += front / (1.0 + front * d / (2 * k))
    body.air[-1] += back / (1.0 + back * d / (2 * k))
    return body


def wall_after(dt: float, surface: Array, thickness: float, film: float, cells: int = 8) -> Array:
    """Mean temperature of a wall whose face touches `surface` (time) over a film coefficient; its back is insulated.

    Close to a first-order lag of thickness * c / film, but with the faster modes that a wall has.
    """
    body = plate(cells, thickness, film, 0.0, **IRON)
    forcing = np.zeros((surface.size, cells))
    forcing[:, 0] = body.air[0] * surface
    return body.respond(dt, forcing).mean(axis=1)


def lump(dt: float, power: Array, tau: float) -> Array:
    """One node: rise per unit of held power, with time constant tau."""
    keep = np.exp(-dt / tau)
    return lfilter([0.0, 1.0 - keep], [1.0, -keep], power)


def two_nodes(dt: float, power: Array, fast: float, slow: float, share: float) -> Array:
    """A small node on a large one: the sum of a quick and a slow rise, as bearings in housings show."""
    return (1.0 - share) * lump(dt, power, fast) + share * lump(dt, power, slow)


def room(rng: np.random.Generator, n: int, dt: float, swing: float, wander: float, start_hour: float) -> Array:
    """Room temperature rise over the start, K: a day's wave, a slow random part, a cycling air conditioner."""
    t = np.arange(n) * dt
    day = swing * np.sin(2 * np.pi * (t / 86400.0 + start_hour / 24.0))
    slow = lfilter([1.0], [1.0, -np.exp(-dt / 5400.0)], rng.normal(0, 1, n))
    slow = wander * slow / max(np.std(slow), 1e-9) if n > 2 else slow
    cycle = rng.uniform(0.0, 0.15) * np.sin(2 * np.pi * t / rng.uniform(900, 2400) + rng.uniform(0, 6))
    out = day + slow + cycle
    return out - out[0]


def weather(rng: np.random.Generator, n: int, dt: float) -> Array:
    """Air pressure in hPa: a front passes."""
    base = rng.uniform(985, 1025)
    t = np.arange(n) * dt
    front = (
        rng.choice([-1, 1])
        * rng.uniform(3, 14)
        * np.tanh((t - rng.uniform(0.2, 0.9) * t[-1]) / rng.uniform(2500, 9000))
    )
    slow = lfilter([1.0], [1.0, -np.exp(-dt / 7200.0)], rng.normal(0, 1, n))
    return base + front + rng.uniform(0.5, 2.5) * slow / max(np.std(slow), 1e-9)
