"""Two or three tests with probes that are zeroed at the start of each, as ISO 230-3 asks: a datum for each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from errpipe.diagnosis import diagnose
from errpipe.diagnosis.left_out import zeroed_at_starts
from errpipe.domain.recording import Recording

from .machines import recording, spindle


def zeroed(hidden: Callable[[pd.DataFrame], pd.Series], seeds: tuple[int, ...]) -> Recording:
    """A spindle test for each seed, in rooms of other temperatures; all values count from its first row."""
    parts = []
    for k, seed in enumerate(seeds):
        one = spindle(seed)
        frame = one.frame.assign(run=f"test {k + 1}")
        room, bed = np.random.default_rng(seed).uniform(-2.5, 2.5, 2)
        frame["T_room"] += room
        frame["T_bed"] += bed
        frame["E_Z"] += hidden(frame)
        for name in ("E_Z", "E_Z_sim"):
            frame[name] -= frame[name].iloc[0]
        parts.append(frame)
    kinds = {name: column.model_dump(exclude_none=True) for name, column in one.manifest.columns.items()}
    frame = pd.concat(parts, ignore_index=True)
    return recording({n: frame[n].to_numpy() for n in frame}, {"run": {"role": "run"}, **kinds})


def named(made: Recording) -> list[str]:
    (response,) = diagnose(made)[0].responses
    return [f.effect for f in response.findings if f.effect != "recalibration"]


@pytest.mark.parametrize("seeds", [(1, 2, 3), (4, 5, 6)])
def test_levels_of_whole_tests_are_no_second_finding(seeds):
    assert named(zeroed(lambda c: 9.0 * (c["rpm"] / 12000) ** 2, seeds)) == ["centrifugal_growth"]


def test_readings_that_begin_at_zero_in_each_of_two_sessions_or_more():
    session, rise = np.repeat([0, 1, 2], 50), np.tile(np.linspace(0, 10, 50), 3)
    assert zeroed_at_starts(rise, session)
    assert not zeroed_at_starts(rise + 6.0 * session, session)  # one zero for all
    assert not zeroed_at_starts(rise[:50], session[:50])
    assert not zeroed_at_starts(np.tile(np.linspace(0, 10, 20), 3), np.repeat([0, 1, 2], 20))  # too few rows to show it


def test_readings_that_swing_about_zero_begin_near_it_by_chance():
    swing = np.tile(10.0 * np.sin(np.linspace(-0.5, 30, 50)), 2)
    assert not zeroed_at_starts(swing, np.repeat([0, 1], 50))
