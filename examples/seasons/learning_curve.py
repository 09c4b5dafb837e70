"""How much characterisation is enough: out-of-season error against hours of data and number of duty cycles.

The judging group is held out of every fit. Runs come in the order they were taken (what a workshop would have had by
then), or in several random orders, whose spread shows how much of an improvement is chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.holdout import Fold
from errpipe.fitting.statistics import rms
from errpipe.thermal.arithmetic import since_start_of
from errpipe.validation.seasons import Fitter


def curve(
    recording: Recording,
    component: str,
    fit: Fitter,
    scheme: holdout.HoldOut | str = "leave-one-group-out:season",
    *,
    sizes: Sequence[int] = (1, 2, 3, 5, 8, 12, 16),
    orders: int = 0,
    seed: int = 0,
) -> list[dict[str, Any]]:
    """One entry per fold, order and number of runs: left_out, order, runs, hours, rms, rms_before (um).

    orders: random orders beside the recorded one. Sizes beyond a fold's runs are left out.
    """
    if not sizes or min(sizes) < 1:
        raise DataError("learning curve: sizes are numbers of runs, at least 1")
    y = since_start_of(recording, component)
    out = []
    for fold in holdout.groups(recording, scheme):
        for number, order in enumerate(_orders(recording, fold, orders, seed)):
            for size in sorted({s for s in sizes if s <= len(order)} | {len(order)}):
                rows = np.isin(recording.run_codes(), order[:size])
                part = Fold(fold.label, fold.train & rows, fold.test)
                value = fit(recording, component, part.train).values(recording)
                judged = fold.test & np.isfinite(y)
                out.append(
                    {
                        "left_out": fold.label,
                        "order": number,
                        "runs": int(size),
                        "hours": hours(recording, part.train),
                        "rms": rms((y - value)[judged]),
                        "rms_before": rms(y[judged]),
                    }
                )
    return out


def hours(recording: Recording, rows: np.ndarray) -> float:
    """Measured time of the rows of a mask, h: the sum of the runs' lengths."""
    run, t = recording.run_codes(), recording.time()
    return float(sum(np.ptp(t[rows & (run == r)]) for r in np.unique(run[rows]))) / 3600.0


def _orders(recording: Recording, fold: Fold, orders: int, seed: int) -> list[np.ndarray]:
    run = recording.run_codes()
    recorded_order = np.array(list(dict.fromkeys(run[fold.train])))
    rng = np.random.default_rng(seed)
    return [recorded_order, *(rng.permutation(recorded_order) for _ in range(orders))]
