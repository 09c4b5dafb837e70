"""A machined part measured on a CMM, feature by feature, as observations of the machine that cut it.

A bore was drilled at one place if it has only a centre, and milled along its circle if it also has a diameter E_D
(um) too: centre and diameter are then those of the least-squares circle of the path. A face has its offset (E_X, E_Y or
E_Z alone) and, if given, the rotation of its normal about the two other directions (urad): both of the least-squares
plane over a square of its size. A rotation enters as um over the size of its face, so that all readings are in um.

Set-up: pose of the part on the CMM, its temperature, and the cutter's diameter. Noise of a row: its standard
uncertainty in um if stated, else relative sizes for such fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from errpipe.errors import DataError
from errpipe.kinematics import observations as o
from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain

CIRCLE = np.arange(12) * np.pi / 6  # places of a milled bore, rad
SIDE = np.sqrt(1 / 8)  # share of the size: three places at 0 and +- SIDE scatter as a line of that length does
CENTRE, DIAMETER, TURN = 1.0, 2.0, np.sqrt(12.0)  # noise of a fit relative to that of a centre
TURNS = {"E_A": 0, "E_B": 1, "E_C": 2}  # component of the normal's turn that each column holds


def features(
    chain: Chain,
    q: np.ndarray,
    tip: np.ndarray,
    value: Mapping[str, np.ndarray],
    uncertainty: Mapping[str, np.ndarray],
    size: np.ndarray,
    label: str,
    cutter: float = 0.0,
    seconds: float = 0.0,
) -> o.Observations:
    """Every reading of every feature; rows are ordered by component, q of a row is its feature's centre.

    value, uncertainty: component -> (n,) um, of turns urad, NaN where a feature has none; size (n,): diameter of a
    bore, side of a face, mm; cutter: diameter of the tool that milled the bores, mm. Raises DataError for a turn or a
    diameter without a size, and for a rotation of a feature that is not a face.
    """
    read = [d for d in "XYZ" if f"E_{d}" in value]
    if not read:
        raise DataError("the recording has no error column of component E_X, E_Y or E_Z")
    n = len(q)
    milled = np.isfinite(value["E_D"]) if "E_D" in value else np.zeros(n, dtype=bool)
    turned = np.any([np.isfinite(value[t]) for t in TURNS if t in value] or [np.zeros(n, dtype=bool)], axis=0)
    if (~(size[milled | turned] > 0)).any():
        raise DataError(f"run {label}: a diameter or a normal needs its feature's size (a column of role size, mm)")
    columns = np.column_stack([value[f"E_{d}"] for d in read])
    points = o.points(chain, q, tip, columns, "".join(read), label, seconds=seconds, scale=True)
    parts = []
    for i, d in enumerate(read):
        rows = points.take(np.arange(i * n, (i + 1) * n))
        path, weights = _fitted_points(chain, rows, d, milled, size - cutter)
        noise = _noise(uncertainty.get(f"E_{d}"), n, CENTRE)
        parts.append(replace(rows, noise=noise, path=path, path_weights=weights))
    for name in (t for t in TURNS if t in value):
        parts.append(_normals(chain, q, tip, value, name, uncertainty.get(name), size, label))
    if milled.any():
        parts.append(_diameters(chain, q, tip, value["E_D"], uncertainty.get("E_D"), size, label, cutter))
    return o.concatenate(parts, shared=True)


def _noise(stated: np.ndarray | None, n: int, relative: float) -> np.ndarray:
    """Standard uncertainty of each row, or the relative one for rows without; (n,)."""
    if stated is None:
        return np.full(n, relative)
    if (stated[np.isfinite(stated)] <= 0).any():
        raise DataError("an uncertainty of a feature is not above 0")
    known = np.isfinite(stated)
    return np.where(known, stated, np.nanmedian(stated) if known.any() else relative)


def _moved(chain: Chain, q: np.ndarray, tip: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Poses whose tool point is `steps` (n, k, 3) mm away from that at q (n, axes); shape (n, k, axes)."""
    ways = synthesis.linear_motion(chain, q, tip)
    path = np.repeat(q[:, None, :], steps.shape[1], axis=1)
    path[:, :, chain.linear] += np.einsum("nij,nkj->nki", np.linalg.pinv(ways), steps)
    return path


def _fitted_points(
    chain: Chain, rows: o.Observations, direction: str, milled: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Path and weights of centres: the circle of a milled bore (across: its diameter, mm), else the middle alone."""
    along = "XYZ".index(direction)
    rays = np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE), np.zeros(len(CIRCLE))])
    steps = 0.5 * np.where(milled, across, 0.0)[:, None, None] * rays
    weights = np.zeros((len(rows), len(CIRCLE), 6))
    weights[:, 0] = rows.weights
    weights[milled, :, :3] = 2.0 / len(CIRCLE) * rays[:, along, None] * rays
    if along == 2:
        weights[milled, :, :3] = np.array([0.0, 0.0, 1.0]) / len(CIRCLE)
    return _moved(chain, rows.q, rows.tip, steps), weights


def _normals(chain, q, tip, value, name: str, stated, size, label: str) -> o.Observations:
    """Turns of faces about one direction, as um over their size."""
    about = TURNS[name]
    rows = np.isfinite(value[name])
    faces = np.full((len(q), 3), False)
    for i, d in enumerate("XYZ"):
        if f"E_{d}" in value:
            faces[:, i] = np.isfinite(value[f"E_{d}"])
    if (faces[rows].sum(axis=1) != 1).any() or faces[rows, about].any():
        raise DataError(
            f"run {label}: {name} is the turn of a face: its row needs one of E_X, E_Y, E_Z, not the one it turns about"
        )
    normal = np.eye(3)[np.argmax(faces, axis=1)]
    turn = np.eye(3)[about]
    lever = np.cross(normal, turn)  # a place this way (mm) is moved along the normal by the turn: (turn x arm) . normal
    other = np.broadcast_to(turn, lever.shape)
    grid = np.array([(a, b) for a in (-SIDE, 0.0, SIDE) for b in (-SIDE, 0.0, SIDE)])
    side = np.where(rows, size, 0.0)
    steps = side[:, None, None] * (grid[:, 0, None] * lever[:, None] + grid[:, 1, None] * other[:, None])
    weights = np.zeros((len(q), len(grid), 6))
    weights[:, :, :3] = (grid[:, 0] / np.sum(grid[:, 0] ** 2))[None, :, None] * normal[:, None]
    scaled = np.where(rows, size * 1e-3, np.nan)
    noise = _noise(None if stated is None else stated * size * 1e-3, len(q), TURN)
    angle = o.angle(chain, q, tip, turn, value[name] * scaled, label)
    return replace(
        angle,
        weights=np.hstack([normal, np.zeros_like(normal)]),
        nuisance=np.where(rows, scaled, 0.0)[:, None],
        nuisance_names=(f"{label}: turn {'ABC'[about]}",),
        nuisance_spread=np.array([o.TURN]),
        noise=noise,
        path=_moved(chain, q, angle.tip, steps),
        path_weights=weights,
    )


def _diameters(chain, q, tip, value, stated, size, label: str, cutter: float) -> o.Observations:
    """Diameters of milled bores, um: twice the mean of the radial deviation; cutter and warmth are set-up."""
    rows = np.isfinite(value)
    rays = np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE), np.zeros(len(CIRCLE))])
    steps = 0.5 * np.where(rows, size - cutter, 0.0)[:, None, None] * rays
    weights = np.zeros((len(q), len(CIRCLE), 6))
    weights[:, :, :3] = 2.0 / len(CIRCLE) * rays
    angle = o.angle(chain, q, tip, (0.0, 0.0, 1.0), value, label)
    both = np.tile([1.0, 1.0, 0.0, 0.0, 0.0, 0.0], (len(q), 1))
    return replace(
        angle,
        weights=both,
        nuisance=np.column_stack([np.ones(len(q)), np.where(rows, size * 1e-3, 0.0)]),
        nuisance_names=(f"{label}: cutter", f"{label}: scale"),
        nuisance_spread=np.array([o.LENGTH, o.SCALE]),
        noise=_noise(stated, len(q), DIAMETER),
        path=_moved(chain, q, angle.tip, steps),
        path_weights=weights,
    )
