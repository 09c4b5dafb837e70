"""Slipping contacts: LuGre bristles, Maxwell slip elements, play, and what follows a reversal."""

from __future__ import annotations

import numpy as np


def play(u: np.ndarray, width: float) -> np.ndarray:
    """Play (gap) operator: the output stands still until the input has crossed the gap `width`."""
    y, out, half = float(u[0]), np.empty(len(u)), 0.5 * width
    for i, v in enumerate(u.tolist()):
        y = min(max(y, v - half), v + half)
        out[i] = y
    return out


def maxwell_slip(x: np.ndarray, breaks: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Force of slip elements that yield after `breaks` [mm]; 1 when all slip, for stiffness*breaks summing to 1."""
    force = np.zeros(len(x))
    for b, k in zip(breaks, stiffness, strict=True):
        force += k * (x - play(x, 2 * b))
    return force


def dahl(x: np.ndarray, length: float, shape: float = 1.0, start: float = 0.0) -> np.ndarray:
    """Dahl's pre-sliding state in -1..1 along the path x [mm]: dz/dx = (1 - sgn(dx) z)^shape / length."""
    z, out = start, np.empty(len(x))
    steps = np.diff(x, prepend=x[0]).tolist()
    for i, d in enumerate(steps):
        if d:
            s = 1.0 if d > 0 else -1.0
            gap = max(1.0 - s * z, 0.0)
            if shape == 1.0:
                gap *= np.exp(-abs(d) / length)
            else:
                gap = (gap ** (1 - shape) + (shape - 1) * abs(d) / length) ** (1 / (1 - shape)) if gap > 1e-9 else 0.0
            z = s * (1.0 - gap)
        out[i] = z
    return out


def lugre(v: np.ndarray, dt: float, coulomb: float, static: float, stribeck: float, bristle: float) -> np.ndarray:
    """LuGre friction force without its viscous part, bristles of length `bristle` [mm], held velocity over a step."""
    g = coulomb + (static - coulomb) * np.exp(-((v / stribeck) ** 2))
    z, out = 0.0, np.empty(len(v))
    rate = np.abs(v) / bristle
    keep = np.exp(-rate * dt).tolist()
    end = (np.sign(v) * g).tolist()
    for i in range(len(v)):
        z = end[i] + (z - end[i]) * keep[i]
        out[i] = z
    return out


def since_reversal(sign: np.ndarray, path: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """Distance on `path` (time, angle or travel) since the sign last changed inside its run; inf before the first."""
    out, last, previous, run = np.empty(len(sign)), -np.inf, 0.0, None
    for i in range(len(sign)):
        if runs[i] != run:
            run, previous, last = runs[i], 0.0, -np.inf
        if sign[i] and previous and sign[i] != previous:
            last = path[i]
        previous = sign[i] or previous
        out[i] = path[i] - last
    return out
