"""Nuisance columns (datums, gains), and limits on gains: the evidence for gains beyond the limits is penalised.

The simulated signal is decomposed into parts, each with its own gain in addition to that of the whole. Enough rows
overrule a Gaussian prior; here the log evidence that enforcing the limits would cost is subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from errpipe.diagnosis.evidence import Scene

LIMIT = 0.2  # how far the gain of a part may be off (0..15 %, and a margin for parts that are poorly separated)
FAR_OFF = 0.5  # gain - 1 of a part, implausible unless the simulation was fitted without what is missing


@dataclass(frozen=True)
class Nuisance:
    """Meaning of one column; `label`: its name in a report; effect and `part`: the effect it belongs to, and its label.

    datum: a constant; session datum: a constant of one session; whole: the simulated signal; part: the contribution
    of one effect; departure: of that effect from its textbook form, or what may belong to another part; noise:
    that of the simulated signal.
    """

    kind: Literal["datum", "session datum", "whole", "part", "departure", "noise"]
    label: str
    effect: str = ""
    part: str = ""

    @property
    def is_datum(self) -> bool:
        """Whether it is a constant."""
        return self.kind in ("datum", "session datum")

    @property
    def is_gain(self) -> bool:
        """Whether it is a gain - 1, of the signal or of one of its parts."""
        return self.kind in ("whole", "part", "departure")


DATUM = Nuisance("datum", "datum")
WHOLE = Nuisance("whole", "simulation")
NOISE = Nuisance("noise", "noise of the simulation")


def count_distant_gains(scene: Scene, nuisances: list[Nuisance], sizes: np.ndarray) -> int:
    """Number of parts with a gain that far off, in a scene whose first active columns are the nuisances."""
    held, rows = totals(nuisances, sizes)
    return int(np.count_nonzero(np.abs(rows @ scene.coefficients()[: rows.shape[1]]) > FAR_OFF)) if held else 0


def totals(nuisances: list[Nuisance], sizes: np.ndarray) -> tuple[list[Nuisance], np.ndarray]:
    """Parts, and the matrix from the nuisances' coefficients to the parts' gain - 1, shape (parts, nuisances)."""
    parts = [j for j, n in enumerate(nuisances) if n.kind == "part"]
    rows = np.zeros((max(len(parts), 1), len(nuisances)))
    rows[:, 1] = 1.0 / sizes[1]
    for k, j in enumerate(parts):
        rows[k, j] = 1.0 / sizes[j]
    return [nuisances[j] for j in parts], rows


def penalty(scene: Scene, rows: np.ndarray, effective: float | None = None) -> tuple[float, np.ndarray]:
    """Log evidence that a scene would lose if its gains were kept within the limits, and which gains exceed them.

    The scene's first active columns are the nuisances that `rows` belong to.
    """
    b = scene.coefficients()
    A = np.zeros((rows.shape[0], b.size))
    A[:, : rows.shape[1]] = rows
    spread = A @ np.linalg.solve(scene.M, A.T)
    held = np.zeros(rows.shape[0], dtype=bool)
    aim = np.zeros(rows.shape[0])
    at, cost = A @ b, 0.0
    first = np.abs(at) > LIMIT * 1.001
    for _ in range(rows.shape[0]):
        outside = (np.abs(at) > LIMIT * 1.001) & ~held
        if not outside.any():
            break
        held |= outside
        aim[outside] = LIMIT * np.sign(at[outside])
        off = (A @ b - aim)[held]
        push = np.linalg.lstsq(spread[np.ix_(held, held)], off, rcond=None)[0]
        cost = float(off @ push)
        at = A @ b - spread[:, held] @ push
    return 0.5 * (effective or scene.n) * float(np.log1p(max(cost, 0.0) / scene.Q)), first
