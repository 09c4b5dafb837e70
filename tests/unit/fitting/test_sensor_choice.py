"""The sensor that carries the error is found, its spare is found, and the one nobody can replace is named."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout, sensor_choice


@pytest.fixture(scope="module")
def recording() -> Recording:
    """4 um per K of the carrier; a spare 0.05 K beside it; a sensor that follows something else."""
    rng = np.random.default_rng(8)
    frames = []
    for k in range(6):
        t = np.arange(50) * 300.0
        carrier = 20 + k % 3 + (5 + rng.normal(0, 1)) * (1 - np.exp(-t / 4000))
        stranger = 22 + rng.normal(0, 2) * np.sin(t / 3000 + rng.uniform(0, 6))
        frames.append(
            pd.DataFrame(
                {
                    "run": f"r{k}",
                    "t": t + 86400.0 * k,
                    "T_carrier": carrier,
                    "T_spare": carrier + rng.normal(0, 0.05, 50),
                    "T_stranger": stranger,
                    "E_Z": 4.0 * (carrier - carrier[0]) + rng.normal(0, 0.2, 50),
                }
            )
        )
    columns = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    columns |= {n: Column(role="temperature", unit="degC") for n in ("T_carrier", "T_spare", "T_stranger")}
    columns["E_Z"] = Column(role="error", component="E_Z", unit="um")
    return Recording(Manifest(recording=1, tables=("x",), columns=columns), pd.concat(frames, ignore_index=True))


def test_pareto_puts_the_carrier_first_and_one_is_enough(recording):
    folds = holdout.groups(recording, "leave-one-run-out")
    choices = sensor_choice.pareto(recording, "E_Z", folds)
    assert choices[0].sensors == ("T_carrier",) and choices[0].rms < 2.0
    assert sensor_choice.enough(choices).sensors == ("T_carrier",)
    assert [len(c.sensors) for c in choices] == [1, 2, 3] and choices[0].worst >= choices[0].rms


def test_nested_choice_never_sees_the_group_it_is_judged_on(recording):
    folds = holdout.groups(recording, "leave-one-run-out")[:2]
    spoilt = recording.frame.copy()
    spoilt.loc[folds[0].test, "E_Z"] *= -7.0
    told = sensor_choice.nested(Recording(recording.manifest, spoilt), "E_Z", folds[:1], 1)
    assert told[0].sensors == ("T_carrier",) and told[0].rms > 10.0


def test_the_spare_is_replaceable_and_the_stranger_is_not(recording):
    told = sensor_choice.redundancy(recording)
    assert told["T_carrier"]["replaceable"] and told["T_spare"]["replaceable"]
    assert not told["T_stranger"]["replaceable"]


def test_stability_prefers_what_carries(recording):
    told = sensor_choice.stability(recording, "E_Z", rounds=8)
    assert told["T_carrier"] == 1.0 and told["T_stranger"] < 0.8
    with pytest.raises(DataError):
        sensor_choice.stability(recording.take(recording.run_codes() < 2), "E_Z")
