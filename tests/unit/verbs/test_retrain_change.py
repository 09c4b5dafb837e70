"""The change of a correction per kelvin, which `--max-change-um-per-k` limits."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.models.terms import Terms
from errpipe.verbs.retrain import _change


def spindle(gain: float, runs: int = 4) -> Recording:
    """Runs that warm up, with a deviation of `gain` um per kelvin since the start of each."""
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "T": Column(role="temperature", unit="degC", location="bearing"),
        "E": Column(role="error", component="E_Z", unit="um"),
    }
    t = np.arange(0.0, 3600.0, 60.0)
    rng = np.random.default_rng(1)
    rises = [8.0 * (1 - np.exp(-t / (900.0 + 200 * k))) for k in range(runs)]
    rows = [
        pd.DataFrame({"run": f"{k}", "t": t, "T": 20.0 + k + rise, "E": gain * rise + rng.normal(0, 0.01, t.size)})
        for k, rise in enumerate(rises)
    ]
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=columns), pd.concat(rows, ignore_index=True))


def fitted(gain: float, datum: str) -> ErrorModel:
    terms = [{"term": "thermal_drift", "sensor": "T"}, *([{"term": "offset"}] if datum == "absolute" else [])]
    family = Terms(datum=datum, components=[{"component": "E_Z", "terms": terms}])
    return family.fit(spindle(gain)).model


@pytest.mark.parametrize("datum", ["absolute", "run_start"])
def test_the_change_per_kelvin_is_that_of_the_gains_whatever_zero_means(datum: str) -> None:
    """From the start of a run, a rise of the whole run is none: it would be no change at all."""
    change = _change(fitted(2.0, datum), fitted(3.0, datum), spindle(2.0))
    expected = 1.0 if datum == "run_start" else fitted_gain(3.0) - fitted_gain(2.0)
    assert change["E_Z"]["largest_um_per_k"] == pytest.approx(expected, rel=0.02)


def fitted_gain(gain: float) -> float:
    (part,) = fitted(gain, "absolute").components
    return next(p.value for term in part.terms for p in term.parameters if p.name == "gain")
