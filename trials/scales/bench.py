"""The noun of the sweep: a machine of some scale, what was logged, and the effects that could act on one response."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from trials.folder import Array, Sheet

Rng = np.random.Generator


@dataclass
class Effect:
    """One effect at a natural size. sizes: name -> (value, unit, whether it grows with the contribution)."""

    values: Array
    drivers: tuple[str, ...]
    sizes: dict[str, tuple[float, str, bool]]
    also: tuple[str, ...] = ()  # names that the contract says cannot be told from it here


@dataclass
class Bench:
    """A machine on test. `sheet` holds every column but the response; base: contributions the simulation holds."""

    scale: str
    sheet: Sheet
    component: str
    unit: str
    effects: dict[str, Effect]
    base: list[Array] = field(default_factory=list)


def log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def unit_rms(values: Array) -> Array:
    """Without its mean, of rms 1."""
    free = values - values.mean()
    return free / max(float(np.sqrt(np.mean(free**2))), 1e-300)
