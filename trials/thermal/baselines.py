"""What anybody would try first, fitted on the same rows: nothing, least squares, ridge, lasso on lagged rises.

All work on what has changed since a day's first readings, day by day: deviation and temperatures.
"""

from __future__ import annotations

import warnings

import numpy as np

from trials.folder import Array, Sheet
from trials.rivals import first_order

DATUM_ROWS = 3  # readings at a day's start whose mean is its zero in a fit
LAGS = (0.0, 600.0, 1800.0, 3600.0, 7200.0, 14400.0)  # s


def since_start(values: Array, runs: Array, first: int = DATUM_ROWS) -> Array:
    """Less the mean of each run's first readings; shape kept."""
    out = np.array(values, dtype=float)
    for run in dict.fromkeys(runs.tolist()):
        rows = np.flatnonzero(runs == run)
        out[rows] -= out[rows[:first]].mean(axis=0)
    return out


def rises(sheet: Sheet, lags: tuple[float, ...] = (0.0,)) -> Array:
    """Rise of every sensor since the start of its run, through each lag; shape (rows, sensors x lags)."""
    runs, t = sheet.runs(), sheet.values("t")
    plain = since_start(np.column_stack([sheet.values(s) for s in sheet.names("temperature")]), runs)
    out = []
    for lag in lags:
        late = plain.copy()
        if lag:
            for run in dict.fromkeys(runs.tolist()):
                rows = np.flatnonzero(runs == run)
                for k in range(plain.shape[1]):
                    late[rows, k] = first_order(t[rows], plain[rows, k], lag)
        out.append(late)
    return np.hstack(out)


def predictions(fit: Sheet, judged: Sheet, component: str) -> dict[str, Array]:
    """Of each baseline: the deviation since each run's start on the judged rows."""
    from sklearn.linear_model import LassoCV, LinearRegression, RidgeCV
    from sklearn.model_selection import GroupKFold

    error = fit.responses()[component][0]
    y = since_start(fit.values(error), fit.runs())
    groups = np.unique(fit.runs(), return_inverse=True)[1]
    if groups.max() == 0:  # one run: five blocks of it
        groups = np.arange(y.size) * 5 // y.size
    folds = list(GroupKFold(min(5, groups.max() + 1)).split(y, groups=groups))
    x, x_judged = rises(fit), rises(judged)
    late, late_judged = rises(fit, LAGS), rises(judged, LAGS)
    size = late.std(axis=0)
    size[size == 0] = 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # lasso's path may stop short of convergence at its weakest penalties
        lasso = LassoCV(cv=folds, fit_intercept=False, max_iter=4000, alphas=40).fit(late / size, y)
    plain = LinearRegression(fit_intercept=False).fit(x, y)
    ridge = RidgeCV(np.geomspace(1e-3, 1e5, 30), fit_intercept=False, cv=folds).fit(x, y)
    return {
        "nothing": np.zeros(len(x_judged)),
        "least squares": plain.predict(x_judged),
        "ridge": ridge.predict(x_judged),
        "lasso": lasso.predict(late_judged / size),
    }
