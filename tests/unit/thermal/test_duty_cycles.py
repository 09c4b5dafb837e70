"""What a duty cycle will teach is known before it is measured, and comes as it was expected."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.thermal.duty_cycles import DutyCycles

ROWS = 60
GAINS = np.array([4.0, -3.0])  # um/K of head and table
OWN, NOISE = 0.6, 0.3  # um/K, of a day's own gains; um


def days(kinds: str, seed: int = 0) -> Recording:
    """One day a letter: h warms the head, t the table, b both; the room stands still."""
    rng = np.random.default_rng(seed)
    parts = []
    for k, kind in enumerate(kinds):
        warm = 1.0 - np.exp(-np.arange(ROWS) / 15.0)
        rises = np.outer(warm, [rng.uniform(3, 5) * (kind in "hb"), rng.uniform(3, 5) * (kind in "tb")])
        y = rises @ (GAINS + rng.normal(0, OWN, 2)) + rng.normal(0, NOISE, ROWS)
        parts.append(
            pd.DataFrame(
                {"run": f"{kind}{k}", "cycle": kind, "t": k * 86400 + np.arange(ROWS) * 300.0, "E": y}
                | {"T_head": 20.0 + rises[:, 0], "T_table": 20.0 + rises[:, 1]}
            )
        )
    columns = {
        "run": Column(role="run"),
        "cycle": Column(role="group", of="duty_cycle"),
        "t": Column(role="time", unit="s"),
        "E": Column(role="error", component="E_Z", unit="um"),
        "T_head": Column(role="temperature", unit="degC", location="column"),
        "T_table": Column(role="temperature", unit="degC", location="table"),
    }
    manifest = Manifest(recording=1, columns=columns, tables=("r.csv",))
    return Recording(manifest, pd.concat(parts, ignore_index=True))


def without_errors(recording: Recording, kinds: str) -> Recording:
    hidden = recording.frame["cycle"].isin(list(kinds))
    return recording.with_columns({"E": recording.frame["E"].mask(hidden).to_numpy()}, {})


def test_the_cycle_that_was_never_measured_teaches_most_and_then_nothing_does():
    recording = days("hhhht")
    cycles = DutyCycles.of(without_errors(recording, "t"), "E_Z")
    assert cycles.measured == [0, 1, 2, 3]
    known = cycles.fit(cycles.measured)
    before, head, table = cycles.expected(known), cycles.expected(known, [0]), cycles.expected(known, [4])
    assert table < 0.4 * before
    assert head > 0.9 * before
    whole = DutyCycles.of(days("hhtthhtthhtt" * 2), "E_Z")
    known = whole.fit(whole.measured)
    assert whole.expected(known) ** 2 - whole.expected(known, [2]) ** 2 < NOISE**2


def test_what_is_expected_does_not_depend_on_the_deviation_of_the_candidate():
    recording = days("hhtb")
    measured = DutyCycles.of(recording, "E_Z")
    logged = DutyCycles.of(without_errors(recording, "t"), "E_Z")
    known = measured.fit([0, 1])
    assert logged.information_of(2, known) == pytest.approx(measured.information_of(2, known))


def test_the_expected_error_is_the_one_that_comes():
    """The promised rms, and what fits of many machines leave of held-out days."""
    promised, came = [], []
    for seed in range(12):
        cycles = DutyCycles.of(days("htb" * 8, seed), "E_Z")
        known = cycles.fit(range(8))
        promised.append(cycles.expected(known) ** 2 + cycles.irreducible(known) ** 2)
        came.append(np.mean([cycles.left(r, known.mean) ** 2 for r in range(8, 24)]))
    assert np.sqrt(np.mean(came) / np.mean(promised)) == pytest.approx(1.0, abs=0.2)


def test_scales_come_from_the_readings():
    cycles = DutyCycles.of(days("htb" * 8), "E_Z")
    known = cycles.fit(cycles.measured)
    assert known.noise == pytest.approx(NOISE, rel=0.2)
    assert known.own == pytest.approx(OWN * 2.5, rel=0.6)  # per kelvin, of rises of about 2.5 K rms


def test_still_temperatures_are_refused():
    recording = days("h")
    still = recording.with_columns({n: np.full(ROWS, 20.0) for n in ("T_head", "T_table")}, {})
    with pytest.raises(DataError, match="no temperature changes"):
        DutyCycles.of(still, "E_Z")
