"""A correction by start temperature: one ridge regression per knot, interpolated between knots.

Runs are weighted by the distance of their start temperature from the knot (Gaussian); between two knots, both are
used in proportion. Beyond the ends the last knot is held: there is no extrapolation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain import driver as d
from errpipe.thermal import network
from errpipe.thermal.arithmetic import ridge_gains

MOST_KNOTS = 24  # start temperatures between which gains are interpolated


@dataclass(frozen=True)
class LocalGains:
    """knots: equidistant start temperatures, degC, (k,), k >= 2; gains: (k, columns)."""

    knots: np.ndarray
    gains: np.ndarray

    def values(self, warmth: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Correction per row, um: warmth (n,), columns (n, p)."""
        each = columns @ self.gains.T
        share = np.column_stack([np.interp(warmth, self.knots, unit) for unit in np.eye(self.knots.size)])
        return np.sum(share * each, axis=1)

    def driver(self, warmth: d.Driver, nodes: Sequence[d.Driver]) -> d.Driver:
        """The same as a driver expression."""
        step = float(self.knots[1] - self.knots[0])
        parts = []
        for unit, gains in zip(np.eye(self.knots.size), self.gains, strict=True):
            hat = d.Lookup(of=warmth, start=float(self.knots[0]), step=step, values=tuple(map(float, unit)))
            parts.append(d.Product(of=(hat, d.Affine(weights=tuple(map(float, gains)), of=tuple(nodes)))))
        return d.Affine(weights=(1.0,) * len(parts), of=tuple(parts))


def fit(
    parts: Mapping[int, np.ndarray],
    rows: Mapping[int, int],
    warmth: Mapping[int, float],
    core: np.ndarray,
    width: float,
    strength: float,
) -> LocalGains:
    """Ridge on the columns behind the core's, per knot.

    parts: group -> triangle of [core columns, further columns, response]; rows: group -> number of rows it
    represents; warmth: group -> mean start temperature, degC; core: gains of the core's columns; width: K, standard
    deviation of the weights and distance of the knots; strength: of the ridge.
    """
    groups = sorted(parts)
    temperatures = np.array([warmth[g] for g in groups])
    count = int(np.clip(np.ceil((temperatures.max() - temperatures.min()) / width) + 1, 2, MOST_KNOTS))
    knots = np.linspace(temperatures.min(), max(temperatures.max(), temperatures.min() + 1e-3), count)
    left = {g: _left_by(core, parts[g]) for g in groups}
    gains = []
    for knot in knots:
        weight = np.exp(-0.5 * ((temperatures - knot) / max(width, knots[1] - knots[0])) ** 2)
        near = {g: np.sqrt(w) * left[g] for g, w in zip(groups, weight, strict=True) if w > 1e-9}
        if not near:  # no run with a similar start temperature: gains stay zero
            gains.append(np.zeros(next(iter(left.values())).shape[1] - 1))
            continue
        triangle = network.stack(near, sorted(near))
        effective = sum(float(w) * rows[g] for g, w in zip(groups, weight, strict=True))
        gains.append(ridge_gains(triangle[:, :-1], triangle[:, -1], effective, strength))
    return LocalGains(knots, np.array(gains))


def _left_by(core: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Triangle of the further columns and of the residual of the core."""
    residual = part[:, -1] - part[:, : core.size] @ core
    return network.stack({0: np.column_stack([part[:, core.size : -1], residual])}, [0])
