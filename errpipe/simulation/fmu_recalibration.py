"""Recalibration of a few parameters of a simulation on a recording, before the diagnosis.

Bounded least squares on recorded minus simulated, robust against outliers. The datum is a nuisance parameter:
a constant between recording and simulation does not change a parameter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.simulation.fmu_plan import Plan
from errpipe.simulation.twin_options import FmuOptions

MAX_EVALUATIONS = 15  # of the residual, without gradients; chosen for at most two minutes with one parameter
MIN_GAIN = 0.01  # share of the mismatch that a recalibration must remove to be used (chosen, not measured)


def recalibrated(
    recording: Recording, how: FmuOptions, plan: Plan, start: dict[str, float], begin: dict[str, np.ndarray], progress
) -> tuple[dict[str, np.ndarray], list[dict[str, Any]]]:
    """The simulation with its tunable parameters fitted within their bounds, and the result for each."""
    from scipy.optimize import least_squares

    low, high = (np.array([getattr(t, end) for t in how.recalibrate]) for end in ("low", "high"))
    names = [t.parameter for t in how.recalibrate]
    mismatch = _Mismatch(recording, begin)
    cache: dict[bytes, np.ndarray] = {}

    def residual(share: np.ndarray) -> np.ndarray:
        key = share.tobytes()
        if key not in cache:
            progress(min(0.2 + 0.7 * len(cache) / (MAX_EVALUATIONS * (len(names) + 1)), 0.9), "recalibrating")
            cache[key] = mismatch(plan.simulate(dict(zip(names, low + share * (high - low), strict=True))))
        return cache[key]

    inside = np.clip((np.array([start[n] for n in names]) - low) / (high - low), 1e-3, 1 - 1e-3)
    robust = {"loss": "soft_l1", "f_scale": 3.0, "max_nfev": MAX_EVALUATIONS, "xtol": 1e-5, "ftol": 1e-6}
    optimum = least_squares(residual, inside, bounds=(0.0, 1.0), diff_step=1e-3, **robust)
    tuned = dict(zip(names, map(float, low + optimum.x * (high - low)), strict=True))
    values = plan.simulate(tuned)
    improved = mismatch.rms(values) < (1 - MIN_GAIN) * mismatch.rms(begin)
    if not improved:
        plan.notes.append("recalibration did not reduce the mismatch: the parameters are unchanged")
    sensitive = [
        mismatch.is_sensitive(values, plan.simulate(tuned | {n: _other_value(tuned[n], a, b)}))
        for n, a, b in zip(names, low, high, strict=True)
    ]
    parameters = [
        {
            "parameter": n,
            "start": start[n],
            "value": tuned[n] if improved else start[n],
            "low": float(a),
            "high": float(b),
            "at_a_bound": bool(improved and not 1e-3 < x < 1 - 1e-3),
            "shows": s,
        }
        for n, a, b, x, s in zip(names, low, high, optimum.x, sensitive, strict=True)
    ]
    plan.notes += [
        f"{t['parameter']} changes only the datum: it is not determined" for t in parameters if not t["shows"]
    ]
    plan.notes += [f"{t['parameter']} ends at one of its bounds" for t in parameters if t["at_a_bound"]]
    return (values if improved else begin), parameters


def _other_value(value: float, low: float, high: float) -> float:
    """A value a tenth of the range away, inside it."""
    step = 0.1 * (high - low)
    return float(value + step if value + step <= high else value - step)


class _Mismatch:
    """Recorded minus simulated, without the datum, over each response's spread."""

    def __init__(self, recording: Recording, begin: Mapping[str, np.ndarray]):
        self.recorded = {c: recording.array(str(recording.name("error", component=c))) for c in begin}
        self.rows = {c: np.flatnonzero(np.isfinite(v) & np.isfinite(begin[c])) for c, v in self.recorded.items()}
        for component, rows in self.rows.items():
            if rows.size < 10:
                raise DataError(f"twin: {component}: only {rows.size} rows to recalibrate on (at least 10)")
        self.scale = {c: self._spread(c, begin[c]) for c in begin}

    def _spread(self, component: str, begin: np.ndarray) -> float:
        residual = (self.recorded[component] - begin)[self.rows[component]]
        step = 1.4826 * np.median(np.abs(np.diff(residual))) / math.sqrt(2)
        return float(max(step, 0.01 * np.std(residual), 1e-9))

    def __call__(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        parts = []
        for component, rows in self.rows.items():
            residual = (self.recorded[component] - values[component])[rows]
            rejected = 1e6 * self.scale[component]  # so large that the search rejects the step
            residual = np.where(np.isfinite(residual), residual, rejected)
            parts.append((residual - np.median(residual)) / self.scale[component])
        return np.concatenate(parts)

    def is_sensitive(self, values: Mapping[str, np.ndarray], moved: Mapping[str, np.ndarray]) -> bool:
        """Whether a change of a parameter changes some response by more than a constant and the noise."""
        for component, rows in self.rows.items():
            change = (moved[component] - values[component])[rows]
            change = change[np.isfinite(change)]
            shape = float(np.quantile(np.abs(change - np.median(change)), 0.95)) if change.size else 0.0
            if shape > 0.02 * self.scale[component] and shape > 0.02 * abs(float(np.median(change))):
                return True
        return False

    def rms(self, values: Mapping[str, np.ndarray]) -> float:
        """Root mean square without the widest tenth (outliers), over all responses."""
        residual = np.sort(np.abs(self(values)))
        return float(np.sqrt(np.mean(residual[: int(0.9 * residual.size)] ** 2)))
