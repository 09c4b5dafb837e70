"""CMM readings of a machined part cut along the paths of a true machine: circles and planes fitted to paths.

Features alternate: a drilled bore (centre), a face (offset and normal), a milled bore (centre and diameter), a face.
Paths are sampled densely by full transforms and fitted by least squares.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SIZES = (20.0, 40.0, 40.0, 30.0)  # mm: diameter of a bore, side of a face, by turn
TURN_NOISE = 1e3  # urad um-1 mm: of a normal, divided by the side of its face
ANGLES = np.arange(36) * np.pi / 18  # rad: 36 points of each bore

Cut = Callable[[np.ndarray, np.ndarray], np.ndarray]


def read(count: int, cut: Cut, rng: np.random.Generator, noise: float, cutter: float) -> dict[str, np.ndarray]:
    """Columns of `count` features: size (mm), readings (um, urad), and u_ columns of their standard uncertainties.

    cut: rows (m,) and steps (m, 3) mm from their middles -> deviation of the surface there (m, 3), um. noise: standard
    uncertainty of an ordinary centre, um; features differ by a factor of 1 to 4. cutter: excess of the
    cutter's diameter over its nominal value, um.
    """
    turn = np.arange(count) % 4
    out = {n: np.full(count, np.nan) for n in ("E_X", "E_Y", "E_Z", "E_A", "E_B", "E_D")}
    size = np.array(SIZES)[turn]
    rough = noise * 2.0 ** rng.integers(0, 3, count)
    uncertain = {n: rough.copy() for n in out}
    for name in ("E_A", "E_B"):
        uncertain[name] = rough * TURN_NOISE * np.sqrt(12.0) / size
    uncertain["E_D"] = 2.0 * rough
    drilled = np.flatnonzero(turn == 0)
    out["E_X"][drilled], out["E_Y"][drilled] = cut(drilled, np.zeros((len(drilled), 3)))[:, :2].T
    for feature in np.flatnonzero(turn == 2):
        rays = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
        steps = 0.5 * size[feature] * np.column_stack([rays, np.zeros(len(rays))])
        radial = np.sum(cut(np.full(len(rays), feature), steps)[:, :2] * rays, axis=1)
        radius, x, y = np.linalg.lstsq(np.column_stack([np.ones(len(rays)), rays]), radial, rcond=None)[0]
        out["E_X"][feature], out["E_Y"][feature], out["E_D"][feature] = x, y, 2.0 * radius + cutter
    for feature in np.flatnonzero(turn % 2 == 1):
        line = np.linspace(-0.5, 0.5, 9) * size[feature]
        x, y = (g.ravel() for g in np.meshgrid(line, line))
        height = cut(np.full(len(x), feature), np.column_stack([x, y, np.zeros(len(x))]))[:, 2]
        design = np.column_stack([np.ones(len(x)), y * 1e-3, -x * 1e-3])  # turns about X and Y lift a face so
        out["E_Z"][feature], out["E_A"][feature], out["E_B"][feature] = np.linalg.lstsq(design, height, rcond=None)[0]
    for name, value in out.items():
        value += uncertain[name] * rng.normal(size=count)
    return {"size": size} | out | {f"u_{n[-1]}": np.where(np.isfinite(out[n]), u, np.nan) for n, u in uncertain.items()}
