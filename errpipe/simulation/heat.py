"""Heat in a ball-screw axis by finite differences: a screw divided into cells, its nut, its bearing, bed and room.

Independent of the terms fitted to it: no lag, no profile, only conduction, convection and friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PIECES = 40  # cells along the screw
HALF_NUT = 30.0  # mm
STEP = 2.0  # s; the explicit scheme is stable below 24 s for these pieces


@dataclass(frozen=True)
class Screw:
    """A steel screw of `length` mm, held at x = 0; sizes of a common 40 mm screw. W, J, K, mm."""

    length: float = 900.0
    diameter: float = 40.0
    conductivity: float = 50.0  # W/m/K
    heat_capacity: float = 3.9e6  # J/m3/K
    still_air: float = 14.0  # W/m2/K
    moving_air: float = 22.0  # W/m2/K more at 300 mm/s
    expansion: float = 11.5  # um/m/K


@dataclass(frozen=True)
class Temperatures:
    """Along time: screw pieces (steps, PIECES), nut, bearing, bed, air, each (steps,), degC."""

    time: np.ndarray
    screw: np.ndarray
    nut: np.ndarray
    bearing: np.ndarray
    bed: np.ndarray
    air: np.ndarray


def simulate_temperatures(
    screw: Screw, speed: np.ndarray, low: np.ndarray, high: np.ndarray, air: np.ndarray, start: float
) -> Temperatures:
    """Temperatures of a moving axis.

    speed: mean speed in mm/s at each step of STEP seconds; low, high: stretch of the nut's motion in that step, mm;
    air: room in degC; start: initial temperature, degC.
    """
    piece = screw.length / PIECES * 1e-3
    area = np.pi * (screw.diameter * 1e-3) ** 2 / 4
    capacity = screw.heat_capacity * area * piece
    along = screw.conductivity * area / piece
    surface = np.pi * screw.diameter * 1e-3 * piece
    middle = (np.arange(PIECES) + 0.5) * piece * 1e3
    steps = speed.size
    theta = np.full(PIECES, start)
    nut = bearing = bed = start
    out = np.empty((steps, PIECES + 3))
    for k in range(steps):
        out[k, :PIECES], out[k, PIECES:] = theta, (nut, bearing, bed)
        first, last = low[k] - HALF_NUT, high[k] + HALF_NUT
        nut_share = np.clip(np.minimum(middle + 500 * piece, last) - np.maximum(middle - 500 * piece, first), 0.0, None)
        nut_share /= nut_share.sum()
        friction = 0.085 * speed[k] * (1 + 0.1 * speed[k] / 300)  # W at the nut, from its drag of about 85 N
        turning = 0.027 * speed[k]  # W at the fixed bearing
        contact = 9.0 * nut_share * (nut - theta)  # W
        loss = (screw.still_air + screw.moving_air * speed[k] / 300) * surface * (theta - air[k])
        flow = along * np.diff(theta)
        seat = 1.5 * (bearing - theta[0])
        gain = contact + 0.5 * friction * nut_share - loss
        gain[:-1] += flow
        gain[1:] -= flow
        gain[0] += seat
        nut += STEP / 2600.0 * (0.5 * friction - contact.sum() - 2.2 * (nut - bed) - 0.8 * (nut - air[k]))
        bearing += STEP / 5200.0 * (turning - seat - 2.0 * (bearing - bed) - 1.2 * (bearing - air[k]))
        bed += STEP / 9.0e4 * (2.2 * (nut - bed) + 2.0 * (bearing - bed) - 12.0 * (bed - air[k]))
        theta = theta + STEP / capacity * gain
    return Temperatures(
        np.arange(steps) * STEP, out[:, :PIECES], out[:, PIECES], out[:, PIECES + 1], out[:, PIECES + 2], air
    )


def growth(screw: Screw, theta: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Displacement of the nut by the screw's expansion between 0 and x, um.

    theta: (n, PIECES) degC; x: (n,) mm. The integral of expansion over length, exact for pieces of one temperature.
    """
    piece = screw.length / PIECES
    part = np.clip(np.asarray(x)[:, None] / piece - np.arange(PIECES), 0.0, 1.0)
    return screw.expansion * 1e-3 * piece * np.sum(part * (theta - 20.0), axis=1)
