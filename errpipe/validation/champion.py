"""Champion against challengers on left-out groups. Doing nothing competes too, and wins ties.

A candidate wins only if it makes no left-out group worse than doing nothing; of those, the least error; within 1 %
the one listed earlier (the simpler). Learners without a compiled form may compete, but cannot win: a table
cannot express them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import thermal_causes, thermal_season
from errpipe.fitting.holdout import Fold
from errpipe.fitting.thermal_arithmetic import rms, since_start_of

TIE = 0.01  # of the least rms: within it the simpler candidate wins
LAGS = (900.0, 3600.0, 14400.0)  # s, of the lagged rises that the learners are given
SEED = 20240101  # of the learners that draw random numbers
NETWORK = {"hidden_layer_sizes": (16,), "alpha": 1.0, "early_stopping": True, "max_iter": 300, "random_state": SEED}


class Fitted(Protocol):
    """What a candidate's fit returns."""

    def values(self, recording: Recording) -> np.ndarray:
        """Deviation since the start of each run, um, shape (rows,)."""


Fitter = Callable[[Recording, str, np.ndarray], Fitted]


@dataclass(frozen=True)
class Candidate:
    """A model that competes. compiled: whether a table can express it."""

    name: str
    fit: Fitter
    compiled: bool = True


@dataclass(frozen=True)
class _Values:
    of: Callable[[Recording], np.ndarray]

    def values(self, recording: Recording) -> np.ndarray:
        return self.of(recording)


def nothing(recording: Recording, component: str, rows: np.ndarray) -> Fitted:
    """No compensation."""
    return _Values(lambda r: np.zeros(len(r)))


def season(options: thermal_season.SeasonOptions, gain: float = 1.0) -> Fitter:
    """The season model, times a gain."""

    def fit(recording: Recording, component: str, rows: np.ndarray) -> Fitted:
        model = thermal_season.fit(recording, component, options, rows)
        return model if gain == 1.0 else _Values(lambda r: gain * model.values(r))

    return fit


def rises(recording: Recording, lags: Sequence[float] = ()) -> np.ndarray:
    """Rises of all temperatures over the start of the run and the rises through lags, (rows, n), K."""
    names = recording.names("temperature")
    nodes: list[d.Driver] = [d.rise(n) for n in names]
    nodes += [d.Lag(of=d.rise(n), tau_up=t, tau_down=t, start="zero") for n in names for t in lags]
    return thermal_causes.columns(recording, nodes)


def differences(recording: Recording, component: str, rows: np.ndarray) -> Fitted:
    """Least squares on rises over the rise of one sensor; which one (room, bed) spans the same space."""

    def columns(r: Recording) -> np.ndarray:
        values = rises(r)
        return values[:, 1:] - values[:, :1]

    table, y = columns(recording), since_start_of(recording, component)
    good = rows & np.isfinite(y) & np.isfinite(table).all(axis=1)
    gains = np.linalg.lstsq(table[good], y[good], rcond=None)[0]
    return _Values(lambda r: np.nan_to_num(columns(r)) @ gains)


def learner(make: Callable[[], Any], lags: Sequence[float]) -> Fitter:
    """A scikit-learn regressor on (lagged) rises; rows with missing readings are left out of its fit."""

    def fit(recording: Recording, component: str, rows: np.ndarray) -> Fitted:
        table = rises(recording, lags)
        y = since_start_of(recording, component)
        good = rows & np.isfinite(y) & np.isfinite(table).all(axis=1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a network that stops before it has converged still competes
            model = make().fit(table[good], y[good])
        return _Values(lambda r: np.asarray(model.predict(np.nan_to_num(rises(r, lags)))))

    return fit


def candidates(options: thermal_season.SeasonOptions | None = None) -> tuple[Candidate, ...]:
    """All candidates, the simplest first."""
    from sklearn.ensemble import HistGradientBoostingRegressor
    from sklearn.linear_model import LinearRegression, Ridge
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    chosen = options or thermal_season.SeasonOptions()
    core = chosen.model_copy(update={"correction": False})
    return (
        Candidate("do nothing", nothing),
        Candidate("season physics, half gain", season(core, 0.5)),
        Candidate("season physics", season(core)),
        Candidate("season physics and correction", season(chosen)),
        Candidate("linear on rises", learner(LinearRegression, ())),
        Candidate("linear on differences of rises", differences),
        Candidate("ridge on lagged rises", learner(lambda: make_pipeline(StandardScaler(), Ridge(50.0)), LAGS)),
        Candidate(
            "gradient boosting",
            learner(lambda: HistGradientBoostingRegressor(max_iter=150, random_state=SEED), LAGS),
            compiled=False,
        ),
        Candidate(
            "neural network",
            learner(lambda: make_pipeline(StandardScaler(), MLPRegressor(**NETWORK)), LAGS),
            compiled=False,
        ),
    )


def compare(
    recording: Recording, component: str, folds: Sequence[Fold], entrants: Sequence[Candidate]
) -> dict[str, Any]:
    """rms per candidate and left-out group, the winner, and why the others lose, as JSON values.

    Raises DataError without a candidate or a group to leave out.
    """
    if not entrants or not folds:
        raise DataError("champion: no candidate or no group to leave out")
    y = since_start_of(recording, component)
    rms_by_group: dict[str, dict[str, float]] = {}
    for entrant in entrants:
        rms_by_group[entrant.name] = {}
        for fold in folds:
            judged = fold.test & np.isfinite(y)
            value = entrant.fit(recording, component, fold.train).values(recording)
            rms_by_group[entrant.name][fold.label] = rms((y - value)[judged])
    base = {f.label: rms(y[f.test & np.isfinite(y)]) for f in folds}
    return {"groups": base, "rms": rms_by_group, **decide(base, rms_by_group, entrants)}


def decide(
    base: Mapping[str, float], found: Mapping[str, Mapping[str, float]], entrants: Sequence[Candidate]
) -> dict[str, Any]:
    """The winner, and a verdict on each candidate. base: group -> rms uncompensated; found: the same by candidate."""
    pooled = {n: float(np.sqrt(np.mean([v**2 for v in g.values()]))) for n, g in found.items()}
    verdict, never_worse = {}, []
    for entrant in entrants:
        worse = [label for label, value in found[entrant.name].items() if value > base[label] * (1.0 + 1e-9)]
        if worse:
            verdict[entrant.name] = f"worse than doing nothing in {', '.join(worse)}"
        else:
            never_worse.append(entrant)
    best = min((pooled[e.name] for e in never_worse), default=float("inf"))
    tied = [e for e in never_worse if pooled[e.name] <= best * (1.0 + TIE)]
    refused = [e.name for e in tied if not e.compiled]
    for entrant in never_worse:
        verdict[entrant.name] = "never worse than doing nothing"
    for name in refused:
        verdict[name] = "would win, but has no compiled form: refused"
    compiled = [e for e in never_worse if e.compiled]
    best = min((pooled[e.name] for e in compiled), default=float("inf"))
    winner = next((e.name for e in compiled if pooled[e.name] <= best * (1.0 + TIE)), "do nothing")
    return {"pooled": pooled, "verdict": verdict, "champion": winner}
