"""Value of a duty cycle for a thermal model, from temperatures and the deviations measured so far.

The deviation since the start of run r, um, is a regression with random coefficients (Swamy 1970, Econometrica 38:311):

    y = X (b + d_r) + e,    b ~ N(0, gain^2 I),  d_r ~ N(0, own^2 I),  e ~ N(0, noise^2 I)

X: principal components of the thermal states (causes of `thermal.causes`, else rises) over every run, of unit rms.
b is common to all runs, d_r is one run's departure from it, which no other run can show. The information on b
depends on a run's temperatures alone, so it is known for a run that was logged without a measured deviation: the
posterior covariance of b after it, and the expected square of a prediction's error over all logged states,
are computed before it is measured (Bayesian I-optimal design; Chaloner and Verdinelli 1995,
Statistical Science 10:273).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting.solve import one_thread
from errpipe.fitting.statistics import rms
from errpipe.thermal import causes as thermal_causes
from errpipe.thermal.arithmetic import centred, held_readings, since_start_of
from errpipe.thermal.season_options import SeasonOptions

# Least variance of a principal component over that of the first. Chosen on simulated machines (trials.duty_cycles, seed
# 7, 9 machines): geometric mean of the residual in a third season after three chosen runs 3.9 um, 5.0 with 1e-2, 9.6
# with 3e-2. Judged on the turning centre: leave-one-run-out 7.7 um, 8.2 expected; 10.9 with 1e-3, 46 with 3e-4.
LEAST_VARIANCE = 3e-3
DATUM_ROWS = 3  # of a run, whose mean is its zero; as in the thermal families
# Prior of gain, own and noise: shares of the rms deviation, and standard deviation of their logarithms (judgement: a
# machine's gains explain most of its drift, and each within a factor of e of that).
SHARES, CERTAINTY = (1.0, 0.25, 0.1), 1.0
TYPICAL = 30.0  # um: drift of a machine without measurements


@dataclass(frozen=True)
class _Run:
    """One run: information of its rows on X (triangle, rotated deviation, rest), rows, mean of X'X."""

    triangle: np.ndarray
    rotated: np.ndarray
    rest: float
    rows: int
    square: np.ndarray


@dataclass(frozen=True)
class Posterior:
    """Posterior after some runs. gain, own, noise: um; precision (p, p), mean (p,): of b."""

    gain: float
    own: float
    noise: float
    precision: np.ndarray
    mean: np.ndarray


@dataclass(frozen=True)
class DutyCycles:
    """All runs of a recording. states (rows, p); deviation (rows,), um, NaN where not measured; run (rows,)."""

    states: np.ndarray
    deviation: np.ndarray
    run: np.ndarray
    runs: dict[int, _Run]

    @classmethod
    def of(cls, recording: Recording, component: str) -> DutyCycles:
        """The runs of a recording. Raises DataError without a temperature, its component, or a row with all of them."""
        recording = held_readings(recording)
        run = recording.run_codes()
        deviation = since_start_of(recording, component, DATUM_ROWS)
        with one_thread():
            states = _components(centred(_thermal_states(recording), run, DATUM_ROWS, np.isfinite(deviation), 1.0))
        seen = np.isfinite(states).all(axis=1)
        runs = {}
        for code in np.unique(run[seen]).tolist():
            own = seen & (run == code)
            rows = own & np.isfinite(deviation) if np.isfinite(deviation[own]).any() else own
            y = np.nan_to_num(deviation[rows])
            q, triangle = np.linalg.qr(states[rows])
            rotated = q.T @ y
            rest = max(float(y @ y - rotated @ rotated), 0.0)
            runs[code] = _Run(triangle, rotated, rest, y.size, states[own].T @ states[own] / np.count_nonzero(own))
        return cls(states, np.where(seen, deviation, np.nan), run, runs)

    @property
    def measured(self) -> list[int]:
        """Runs with a measured deviation."""
        return [r for r in self.runs if np.isfinite(self.deviation[self.run == r]).any()]

    def fit(self, runs: Sequence[int]) -> Posterior:
        """Scales by marginal likelihood, then the posterior of b. Without a run: the prior."""
        size = TYPICAL
        if runs:
            size = float(np.sqrt(np.mean([self.left(r, np.zeros(self.states.shape[1])) ** 2 for r in runs]))) or TYPICAL
        centre = np.log(size * np.array(SHARES))
        if not runs:
            return self._posterior(np.exp(centre), runs)

        def cost(logarithms: np.ndarray) -> float:
            return self._cost(np.exp(logarithms), runs) + 0.5 * float(np.sum(((logarithms - centre) / CERTAINTY) ** 2))

        optimum = minimize(cost, centre, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02, "maxiter": 300})
        return self._posterior(np.exp(optimum.x), runs)

    def information_of(self, run: int, known: Posterior) -> np.ndarray:
        """Information on b of one run, measured or only logged, (p, p), 1/um2."""
        half = solve_triangular(self._factor(run, known.own, known.noise), self.runs[run].triangle, lower=True)
        return half.T @ half

    def expected(self, known: Posterior, candidate: Iterable[int] = ()) -> float:
        """Expected rms due to the uncertainty of b, over the states of all runs, um, after a run like the candidate's.

        Each run counts once regardless of its length; a candidate of several runs is their mean.
        """
        weight = np.mean([r.square for r in self.runs.values()], axis=0)
        after = [known.precision + self.information_of(r, known) for r in candidate] or [known.precision]
        return float(np.sqrt(np.mean([np.trace(np.linalg.solve(p, weight)) for p in after])))

    def irreducible(self, known: Posterior) -> float:
        """Expected rms that no further run can reduce, over the states of all runs, um."""
        weight = np.mean([np.trace(r.square) for r in self.runs.values()])
        return float(np.hypot(known.own * np.sqrt(weight), known.noise))

    def left(self, run: int, mean: np.ndarray) -> float:
        """rms of the measured deviation of a run minus its prediction, um."""
        rows = (self.run == run) & np.isfinite(self.deviation)
        return rms(self.deviation[rows] - self.states[rows] @ mean)

    def _factor(self, run: int, own: float, noise: float) -> np.ndarray:
        """Cholesky factor of the covariance of a run's rotated deviation, given b."""
        triangle = self.runs[run].triangle
        return np.linalg.cholesky(noise**2 * np.eye(len(triangle)) + own**2 * triangle @ triangle.T)

    def _cost(self, scales: np.ndarray, runs: Sequence[int]) -> float:
        """Minus the log marginal likelihood of the runs, b and d_r integrated out."""
        _, own, noise = scales
        known = self._posterior(scales, runs)
        total = len(known.mean) * 2.0 * np.log(scales[0]) + np.linalg.slogdet(known.precision)[1]
        total -= known.mean @ known.precision @ known.mean
        for r in runs:
            one, factor = self.runs[r], self._factor(r, own, noise)
            rotated = solve_triangular(factor, one.rotated, lower=True)
            total += 2.0 * np.log(np.diag(factor)).sum() + rotated @ rotated + one.rest / noise**2
            total += (one.rows - len(one.rotated)) * 2.0 * np.log(noise)
        return 0.5 * float(total)

    def _posterior(self, scales: np.ndarray, runs: Sequence[int]) -> Posterior:
        gain, own, noise = map(float, scales)
        precision, right = np.eye(self.states.shape[1]) / gain**2, np.zeros(self.states.shape[1])
        for r in runs:
            one, factor = self.runs[r], self._factor(r, own, noise)
            whitened = cho_solve((factor, True), np.column_stack([one.triangle, one.rotated]))
            precision += one.triangle.T @ whitened[:, :-1]
            right += one.triangle.T @ whitened[:, -1]
        return Posterior(gain, own, noise, precision, np.linalg.solve(precision, right))


def _thermal_states(recording: Recording) -> np.ndarray:
    """Causes of a thermal deviation, (rows, causes), K; rises if no sensor is on the machine itself."""
    names = recording.names("temperature")
    if not names:
        raise DataError("plan-day: the recording has no temperature")
    options = SeasonOptions()
    try:
        sensors = thermal_causes.sensors(recording)
    except DataError:
        return thermal_causes.columns(recording, [d.rise(n) for n in names])
    causes = thermal_causes.causes(recording, sensors, options.late, options.slow, options.thinning)
    return thermal_causes.columns(recording, [c.driver for c in causes])


def _components(columns: np.ndarray) -> np.ndarray:
    """Principal components of unit rms, (rows, components), of columns scaled to unit rms. Raises DataError if none."""
    rows = np.isfinite(columns).all(axis=1)
    if not columns[rows].any():
        raise DataError(
            "plan-day: no temperature changes over the rows that have all of them (needed: rows of a warm-up)"
        )
    size = np.sqrt(np.mean(columns[rows] ** 2, axis=0))
    scaled = columns / np.where(size > 0, size, 1.0)
    variance, axes = np.linalg.eigh(scaled[rows].T @ scaled[rows] / np.count_nonzero(rows))
    kept = variance > LEAST_VARIANCE * variance[-1]
    return scaled @ (axes[:, kept] / np.sqrt(variance[kept]))
