"""Surrogate test: the whole search is repeated on surrogate signals without any effect.

A surrogate is the residual of the other findings and the recalibration, resampled so that no input can explain it
while neighbouring rows stay together: half of the surrogates by random signs (of whole runs if
there are enough, else of blocks), half by blocks resampled from anywhere (moving-block bootstrap). Each is searched
with every hypothesis at every point of its grid of non-linear parameters, and the best gain is recorded: the p value
is thereby corrected for multiple comparisons. Only products with the surrogates are new; those among the columns are
reused from the search.

The p value is reported with the confidence and does not enter it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from errpipe.diagnosis.case import Case
from errpipe.diagnosis.coloured import correlation_time
from errpipe.diagnosis.evidence import Scene, averaged, with_known_size

SURROGATES = 99  # surrogates; the smallest resolvable probability is 0.01
ENOUGH_RUNS = 10  # fewer runs give too few combinations of signs
LEAST_BLOCK = 8  # rows: correlation length of the noise
FEWEST_BLOCKS = 12  # blocks that are permuted: fewer give too few permutations


@dataclass(frozen=True)
class SurrogateTest:
    """p of the search's best gain, (1 + surrogates as good) / (1 + surrogates); the gains; how surrogates were made.

    limit: 95th percentile of the surrogates' gains; rows: effective number of rows; best: each surrogate's gain.
    """

    p: float
    gain: float
    limit: float
    scheme: str
    rows: float
    best: np.ndarray


def surrogate_test(
    case: Case, k: int | None = None, surrogates: int = SURROGATES, whole: SurrogateTest | None = None
) -> SurrogateTest:
    """Significance of finding k given the others; without k, of the best gain of the whole search.

    whole: the latter, if known: with no other findings its surrogates are also those of finding k.
    """
    accepted = case.explanation.accepted
    others = [(f.index, f.size) for j, f in enumerate(accepted) if j != k] if k is not None else []
    if whole is not None and k is not None and not others:
        return replace(whole, gain=accepted[k].gain, p=_p(whole.best, accepted[k].gain))
    scene = case.search.scene(others)
    rows = float(case.run.size / correlation_time(case.search.scene(case.chosen()).residual(), case.run))
    block = int(np.clip(2 * case.run.size / rows, LEAST_BLOCK, max(case.run.size // FEWEST_BLOCKS, 1)))
    turned, scheme = surrogate_signals(scene.residual(), case.run, block, surrogates)
    best = best_gains(case, scene, turned)
    gain = float(best_gains(case, scene, scene.data.y[:, None])[0]) if k is None else accepted[k].gain
    return SurrogateTest(_p(best, gain), gain, float(np.quantile(best, 0.95)), scheme, rows, best)


def _p(best: np.ndarray, gain: float) -> float:
    return (1 + int(np.sum(best >= gain))) / (1 + best.size)


def surrogate_signals(left: np.ndarray, run: np.ndarray, block: int, count: int) -> tuple[np.ndarray, str]:
    """Signals (rows, count) that preserve only the short-range correlation of `left`, and how they were made."""
    rng = np.random.default_rng(0)
    n = left.size
    codes, inside = np.unique(run, return_inverse=True)
    by_run = codes.size >= ENOUGH_RUNS
    out = np.empty((n, count))
    for k in range(count):
        if k % 2:
            starts = rng.integers(0, n - block + 1, -(-n // block))
            drawn = left[(starts[:, None] + np.arange(block)).ravel()[:n]]
            out[:, k] = drawn * np.repeat(rng.choice([-1.0, 1.0], starts.size), block)[:n]
        else:
            group = inside if by_run else (np.arange(n) + rng.integers(0, block)) // block
            out[:, k] = left * rng.choice([-1.0, 1.0], int(group.max()) + 1)[group]
    turned = "signs of runs turned" if by_run else f"signs of blocks of {block} rows turned"
    return out, f"{count} surrogates: {turned}, or blocks of {block} rows drawn again"


def best_gains(case: Case, scene: Scene, signals: np.ndarray) -> np.ndarray:
    """The best gain of the whole library on each whitened signal (rows, count), given the scene's active columns."""
    library, table, active = case.library, scene.table, scene.active.index
    products = table.whitened.T @ signals
    half = np.linalg.solve(scene.chol, products[active])
    total = np.einsum("nc,nc->c", signals, signals)
    spare = np.maximum(total - np.einsum("ac,ac->c", half, half), 1e-12 * total + 1e-300)
    sizes: dict[int, list[int]] = {}
    for i, h in enumerate(library.hypotheses):
        if case.search.prior[i] > -1e5:
            sizes.setdefault(0 if h.terms[0].gain_sd else library.places[i].size, []).append(i)
    best = np.full(signals.shape[1], -np.inf if sizes else 0.0)
    for width, members in sizes.items():
        columns = np.stack([library.places[i][: width or 1] for i in members])
        cross = np.linalg.solve(scene.chol, scene.with_active(columns.ravel()))
        cross = cross.reshape(active.size, *columns.shape).transpose(1, 2, 0)  # (members, width, active)
        S = np.stack([table.products_among(c, scene.data.without) for c in columns]) - cross @ cross.transpose(0, 2, 1)
        s = products[columns] - cross @ half
        prior = case.search.prior[members][:, None]
        if width == 0:
            unit = np.array([library.scales[i][0] for i in members])[:, None]
            sd = library.gain_sd[members][:, None] * unit / scene.sigma
            gain = with_known_size(S[:, 0], s[:, 0], unit, sd, spare, case.search.rows or scene.n)
        else:
            freedom = np.stack([library.freedoms[i] for i in members])
            S = S * freedom[:, :, None] * freedom[:, None, :]
            gain = averaged(S, s * freedom[:, :, None], spare, case.search.rows or scene.n)
        best = np.maximum(best, (gain + prior).max(axis=0))
    return best
