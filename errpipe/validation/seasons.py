"""Leave-one-season-out table of a thermal model, compared with no compensation and the error within the season.

    uncompensated   rms of the deviation since the start of the run
    in_season       rms with only the test run left out: other runs of its season were fitted
    out_of_season   rms with the whole group left out
    ratio           out_of_season / in_season
    bias, scatter   mean and standard deviation of the out-of-season residual
    worst           its largest magnitude
    coverage        share of rows inside the 90 % interval of the model fitted without the group
    half_width      mean half width of that interval

The optimism gap is out_of_season minus the rms suggested by randomly selected rows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.holdout import Fold
from errpipe.fitting.parallel import parallel_map
from errpipe.fitting.statistics import rms
from errpipe.models import Family
from errpipe.thermal.arithmetic import since_start_of

# Recording, component, mask of the fitted rows -> a model with `values`, and `predict` if it has an interval.
Fitter = Callable[[Recording, str, np.ndarray], Any]

VERSION = 1  # of the document's layout
RANDOM_FOLDS = 5  # folds of random rows, for the optimism gap
FIGURES = (  # of each held-out group, in the order of the tables
    "uncompensated", "in_season", "out_of_season", "ratio", "bias", "scatter", "worst", "coverage", "half_width",
)  # fmt: skip
POOLED = ("uncompensated", "out_of_season")


def table(
    recording: Recording,
    component: str,
    fit: Fitter,
    scheme: holdout.HoldOut | str = "leave-one-group-out:season",
    *,
    in_season: bool = True,
) -> dict[str, Any]:
    """The seasonal document: one row per left-out group, and the optimism gap. um.

    in_season: also refit without each run, for the ratio (costs a fit per run).
    """
    folds = holdout.groups(recording, scheme)
    y = since_start_of(recording, component)
    runs = holdout.groups(recording, "leave-one-run-out") if in_season else []
    in_season_residual = _left_out(recording, component, fit, runs, y)[0] if runs else None
    residual, covered, half = _left_out(recording, component, fit, folds, y)
    rows = [_row(f, y, residual, covered, half, in_season_residual) for f in folds]
    gap = optimism(recording, component, fit, y, residual) if in_season else None
    chosen = holdout.parse(scheme) if isinstance(scheme, str) else scheme
    return {
        "seasons": VERSION,
        "component": component,
        "unit": "um",
        "scheme": holdout.name(chosen),
        "groups": rows,
        "never_worse": all(r["out_of_season"] <= r["uncompensated"] for r in rows),
        **({"months": months} if (months := by_month(rows)) else {}),
        "optimism": gap,
    }


def by_month(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of days (2017-02-27) pooled by month; [] if the groups are not days. um."""
    if not all(re.fullmatch(r"\d{4}-\d\d-\d\d", r["left_out"]) for r in rows):
        return []
    out = []
    for month in dict.fromkeys(r["left_out"][:7] for r in rows):
        days = [r for r in rows if r["left_out"].startswith(month)]
        size = sum(r["rows"] for r in days)
        pooled = {k: float(np.sqrt(sum(r["rows"] * r[k] ** 2 for r in days) / size)) for k in POOLED}
        out.append({"month": month, "days": len(days), "rows": size, **pooled})
    return out


def optimism(
    recording: Recording, component: str, fit: Fitter, y: np.ndarray, residual: np.ndarray
) -> dict[str, float]:
    """rms suggested by random rows against rms of held-out groups, um."""
    pick = np.random.default_rng(0).integers(RANDOM_FOLDS, size=len(recording))
    folds = [Fold(str(k), pick != k, pick == k) for k in range(RANDOM_FOLDS)]
    random = _left_out(recording, component, fit, folds, y)[0]
    seen = np.isfinite(residual) & np.isfinite(random)
    promised, kept = rms(random[seen]), rms(residual[seen])
    return {"random_rows": promised, "groups_left_out": kept, "gap": kept - promised}


def _left_out(recording, component: str, fit: Fitter, folds: Sequence[Fold], y: np.ndarray):
    """Residual of each test row, whether its interval covers it, its half width (NaN if the model has none)."""
    residual, covered, half = (np.full(y.size, np.nan) for _ in range(3))

    def judged(fold: Fold) -> None:
        holdout.check(fold)
        model = fit(recording, component, fold.train)
        if hasattr(model, "predict"):
            prediction = model.predict(recording)
            value = prediction.predicted
            inside = (y >= prediction.lower) & (y <= prediction.upper)
            covered[fold.test] = inside[fold.test]
            half[fold.test] = 0.5 * (prediction.upper - prediction.lower)[fold.test]
        else:
            value = model.values(recording)
        residual[fold.test] = (y - value)[fold.test]

    parallel_map(judged, folds)
    return residual, covered, half


def _row(fold: Fold, y, residual, covered, half, own) -> dict[str, Any]:
    judged = fold.test & np.isfinite(residual)
    if not judged.any():
        raise DataError(f"seasons: no row of {fold.label} can be judged")
    judged_residual, inside = residual[judged], covered[judged]
    out = rms(judged_residual)
    in_season = rms(own[judged & np.isfinite(own)]) if own is not None else None
    return {
        "left_out": fold.label,
        "rows": int(np.count_nonzero(judged)),
        "rows_fitted": int(np.count_nonzero(fold.train)),
        "uncompensated": rms(y[judged]),
        "in_season": in_season,
        "out_of_season": out,
        "ratio": out / in_season if in_season else None,
        "bias": float(np.mean(judged_residual)),
        "scatter": float(np.std(judged_residual)),
        "worst": float(np.abs(judged_residual).max()),
        "coverage": float(np.nanmean(inside)) if np.isfinite(inside).any() else None,
        "half_width": float(np.nanmean(half[judged])) if np.isfinite(inside).any() else None,
    }


def documents(
    recording: Recording, family: Family, progress: Callable[[float, str], None] = lambda share, text: None
) -> dict[str, Any]:
    """Tables of a seasonal family by their key in `validation.json`: seasons held out, and fits on the past only."""
    (component,) = family.responses
    progress(0.3, "seasons held out, compared with runs held out")

    def train(recording: Recording, component: str, rows: np.ndarray) -> Any:
        return family.train(recording, rows)  # type: ignore[attr-defined]  # seasonal families have it

    out = {}
    if family.folds(recording, None)[0] == holdout.name(family.scheme):  # else it has fewer than two seasons
        out["seasons"] = table(recording, component, train, family.scheme)
    if any(recording.manifest.columns[n].of == "day" for n in recording.names("group")):
        progress(0.7, "trained on the past alone")
        out["forward"] = table(recording, component, train, "forward:month", in_season=False)
        out["forward_daily"] = table(recording, component, train, "forward:day", in_season=False)
    return out
