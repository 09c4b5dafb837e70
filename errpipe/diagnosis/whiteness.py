"""Whiteness tests of the residual: against every input, by run, by direction, and in its order.

Each test adds columns to the explanation and compares the variance they explain with noise (a score test: the columns
are orthogonalised to everything fitted before; F distribution). The noise is white plus a slowly varying share, as in
public recordings; the share is estimated from the residual, so that ordinary noise raises no alarm. The smallest p is
multiplied by the number of tests (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import chdtrc, fdtrc

from errpipe.diagnosis import coloured
from errpipe.diagnosis.case import Case, residual
from errpipe.diagnosis.shapes import ROLES
from errpipe.domain.diagnosis import Whiteness, WhitenessTest
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import axes, direction

BINS = 6  # levels of an input between which the residual's mean may differ
LAGS = 20  # rows up to which the autocorrelation is tested (Ljung-Box)
SHARES = np.linspace(0.0, 0.15, 16)  # slow shares of the noise tried (public blind trials: 0 to 0.12)
ALARM = 0.01  # false-alarm rate: share of perfect explanations reported as structured (measured: see the tests)
LEAST_IN_RUN = 12  # rows of a run whose order is tested
ORDER = "order of the rows"


def whiteness(case: Case) -> Whiteness:
    """All tests of a response's residual, and the sentence that summarises them."""
    share = slow_share(residual(case), case.run)
    used = _whiten(case.judged().columns([i for i, _ in case.chosen()]), case.run, share)
    frame = Frame(_whiten(case.y, case.run, share), used, case.run, share)
    made = [frame.test(name, how, columns) for name, how, columns in _tests(case.recording, case.pair.rows)]
    tests = [t for t in made if t is not None]
    tests.append(frame.in_order())
    p = min(1.0, len(tests) * min(t.p for t in tests))
    return Whiteness(p=p, slow_share=float(share), tests=tuple(tests), says=_sentence(tests, p))


def _whiten(columns: np.ndarray, run: np.ndarray, share: float) -> np.ndarray:
    return coloured.whiten(columns, run, coloured.Colour(coloured.USUAL.memory, share))


def slow_share(left: np.ndarray, run: np.ndarray) -> float:
    """Maximum-likelihood slow share of the noise in the residual."""
    gains = [coloured.Colour(coloured.USUAL.memory, float(s)).filter()[2] for s in SHARES]  # whitening divides by them
    rms = [np.sqrt(np.mean(_whiten(left, run, float(s)) ** 2)) * gain for s, gain in zip(SHARES, gains, strict=True)]
    return float(SHARES[np.argmin(rms)])


class Frame:
    """A whitened response with all fitted columns projected out: score tests and autocorrelation test."""

    def __init__(self, y: np.ndarray, used: np.ndarray, run: np.ndarray, share: float):
        self.run, self.share = run, share
        size = np.linalg.norm(used, axis=0)
        u, s, _ = np.linalg.svd(used[:, size > 0] / size[size > 0], full_matrices=False)
        self.basis = u[:, s > 1e-6 * s[0]]
        left = self._freed(y)
        # clipped: outliers would dominate the sums of squares
        spread = 1.4826 * np.median(np.abs(left)) + 1e-300
        self.left = self._freed(np.clip(left, -4 * spread, 4 * spread))
        self.free = y.size - self.basis.shape[1]

    def _freed(self, columns: np.ndarray) -> np.ndarray:
        return columns - self.basis @ (self.basis.T @ columns)

    def test(self, against: str, how: str, columns: np.ndarray) -> WhitenessTest | None:
        """Score test of columns (rows, k); None if the explanation spans them all."""
        made = _whiten(columns, self.run, self.share)
        before = np.linalg.norm(made, axis=0)
        made = self._freed(made)
        after = np.linalg.norm(made, axis=0)
        keep = after > 1e-3 * np.maximum(before, 1e-300)
        if not keep.any():
            return None
        u, s, _ = np.linalg.svd(made[:, keep] / after[keep], full_matrices=False)
        u = u[:, s > 1e-3 * s[0]]
        if self.free <= (count := u.shape[1]) + 5:
            return None
        explained = float(np.sum((u.T @ self.left) ** 2))
        unexplained = float(self.left @ self.left) - explained
        f = (explained / count) / (max(unexplained, 1e-300) / (self.free - count))  # the residual may be exactly zero
        p = float(fdtrc(count, self.free - count, f))
        return WhitenessTest(against=against, how=how, statistic=f, dof=count, p=p)

    def in_order(self) -> WhitenessTest:
        """Ljung-Box test of autocorrelation within runs."""
        left, n = self.left - self.left.mean(), self.left.size
        most = int(min(LAGS, max(n // 5, 1)))
        power = float(left @ left) or 1.0
        q = 0.0
        for lag in range(1, most + 1):
            same = self.run[lag:] == self.run[:-lag]
            rho = float(left[lag:][same] @ left[:-lag][same]) / power
            q += rho**2 * n * (n + 2) / max(int(same.sum()), 1)
        p = float(chdtrc(max(most - 1, 1), q))
        return WhitenessTest(against=ORDER, how="Ljung-Box", statistic=q, dof=most - 1, p=p)


def _tests(recording: Recording, rows: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """The tests of the residual: (input, how, columns (rows, k))."""
    run = recording.run_codes()[rows]
    sides = both_ways(recording, rows)
    names = [n for role in ("position", *ROLES) for n in recording.names(role) if n in recording.frame.columns]
    inputs = {n: recording.array(n)[rows] for n in names}
    inputs[ORDER] = np.arange(rows.size, dtype=float)
    runs = [r for r in np.unique(run) if (run == r).sum() >= LEAST_IN_RUN]
    runs = runs if 2 <= len(runs) <= 40 else []
    if runs:
        yield "run", "level", np.column_stack([run == r for r in runs]).astype(float)
    for axis, side in sides.items():
        yield f"direction of {axis}", "level", side[:, None]
        if runs:
            yield f"direction of {axis}", "by run", np.column_stack([(run == r) * side for r in runs])
    for name, u in inputs.items():
        if not np.isfinite(u).all() or u.max() <= u.min():
            continue
        bins = levels(u)
        yield name, "level", bins
        if runs:
            slope = (u - u.mean()) / u.std()
            yield name, "by run", np.column_stack([(run == r) * (slope - slope[run == r].mean()) for r in runs])
        for axis, side in sides.items():
            yield name, "by direction" if len(sides) == 1 else f"by direction of {axis}", bins * side[:, None]


def both_ways(recording: Recording, rows: np.ndarray) -> dict[str, np.ndarray]:
    """The direction of each axis that moves both ways."""
    every = {axis: direction(recording, axis)[rows] for axis in axes(recording)}
    return {axis: side for axis, side in every.items() if (side > 0).any() and (side < 0).any()}


def levels(u: np.ndarray) -> np.ndarray:
    """Membership of each row in up to BINS equally populated levels, shape (rows, levels)."""
    own = np.unique(u)
    if own.size <= BINS:
        return (u[:, None] == own).astype(float)
    edges = np.unique(np.quantile(u, np.linspace(0, 1, BINS + 1)[1:-1]))
    return (np.searchsorted(edges, u, side="right")[:, None] == np.arange(edges.size + 1)).astype(float)


def structured(tests: Sequence[WhitenessTest]) -> list[WhitenessTest]:
    """Tests that would raise the alarm on their own, the strongest first; inputs before the order of the rows."""
    alarming = [t for t in tests if t.p * len(tests) < ALARM]
    # collinear inputs have the same p up to rounding: the first one is then named
    return sorted(alarming, key=lambda t: (t.against == ORDER, float(f"{t.p:.9g}")))


def _sentence(tests: list[WhitenessTest], p: float) -> str:
    alarming = structured(tests)
    t = alarming[0] if alarming else min(tests, key=lambda t: t.p)
    where = t.against if t.how == "level" else f"{t.against}, {t.how}"
    if not alarming:
        return f"The residual is noise: the strongest of {len(tests)} tests ({where}) has an adjusted p = {p:.2g}."
    where += f" (and {len(alarming) - 1} more)" if len(alarming) > 1 else ""
    small = f"= {p:.1g}" if p > 1e-16 else "< 1e-16"
    return f"The residual is not only noise: it correlates with {where}; adjusted p {small} of {len(tests)} tests."
