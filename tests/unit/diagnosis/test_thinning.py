"""Long logs: the choice of rows does not depend on the mismatch and hides no wave; rare events are reported."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.diagnosis import thinning
from errpipe.drivers.motion import direction
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses

from .long import STEP, log


@pytest.fixture(scope="module")
def whole():
    return log()


def test_a_short_recording_is_judged_as_it_is() -> None:
    short = log(5000)
    assert thinning.thinned(short).recording is short


def test_which_rows_are_judged_does_not_hang_on_the_mismatch(whole) -> None:
    other = log(hidden=lambda c: 50.0 * (c["x"] > 200))
    one, two = thinning.thinned(whole), thinning.thinned(other)
    assert np.array_equal(one.rows, two.rows) and one.notes[0] == two.notes[0]
    judged = np.isfinite(one.recording.array("EXX"))
    assert 15_000 < judged.sum() <= 20_000 and len(one.recording) < 40_000
    assert "20" in one.notes[0] and "waves down to two rows are seen" in one.notes[0]


def test_judged_rows_hold_what_the_log_holds(whole) -> None:
    short = thinning.thinned(whole)
    judged = np.isfinite(short.recording.array("EXX"))
    for name in ("t", "x", "F", "rpm", "EXX", "EXX_sim"):
        assert_allclose(short.recording.array(name)[judged], whole.array(name)[short.rows][judged], rtol=0, atol=0)
    assert_allclose(short.recording.array("v"), whole.array("v")[short.rows], atol=0.02 * np.std(whole.array("v")))


def test_sides_and_lags_are_those_of_the_whole_log(whole) -> None:
    """A lag of 20 s of a speed, and the side from positions alone, at every judged row."""
    short = thinning.thinned(whole)
    part, rows = short.recording, short.rows
    wanted = responses.lag(sessions(whole), whole.time(), whole.array("rpm"), 20.0, 20.0, True)[rows]
    got = responses.lag(sessions(part), part.time(), part.array("rpm"), 20.0, 20.0, True)
    assert np.abs(got - wanted).max() < 0.01 * np.ptp(wanted)
    from_positions = whole.with_columns({}, {})
    from_positions = type(whole)(from_positions.manifest, from_positions.frame.drop(columns=["v", "a"]))
    side = direction(from_positions, "X")[rows]
    assert (direction(thinning.thinned(from_positions).recording, "X") == side).mean() > 0.999


@pytest.mark.parametrize("period", [0.05, 0.2, 0.25, 2.5, 5.0, 7.3])
def test_no_period_is_seen_at_one_phase_only(whole, period: float) -> None:
    """Mean direction of the phases of all judged rows (Rayleigh): a regular choice would give up to 1."""
    short = thinning.thinned(whole).recording
    t = short.time()[np.isfinite(short.array("EXX"))]
    assert np.abs(np.exp(2j * np.pi * t / period).mean()) < 0.35


def test_spikes_of_one_row_every_few_seconds_are_reported(whole) -> None:
    at = np.arange(1500, 200_000, 3000)

    def spikes(c):
        out = np.zeros(200_000)
        out[at] = 8.0
        return out

    notes = " ".join(thinning.thinned(log(hidden=spikes)).notes)
    assert "single rows standing out by" in notes and "every 3 s" in notes and "the first at 1.5 s" in notes
    assert "standing out" not in " ".join(thinning.thinned(whole).notes)


@pytest.mark.parametrize("width", [1, 12, 40, 300])
def test_events_of_every_width_are_found(width: int) -> None:
    rng = np.random.default_rng(width)
    values = rng.standard_normal(1_200_000)
    places = np.arange(20_000, 1_190_000, 230_011)
    for a in places:
        values[a : a + width] += 12.0
    events = thinning.events(values)
    assert events is not None and events.height > 4.0
    near = [np.abs(events.rows - a).min() < 2 * max(width, events.width) + 1 for a in places]
    assert np.mean(near) >= 0.8


def test_steps_and_noise_are_no_events() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        wander = np.convolve(rng.standard_normal(200_000), 0.97 ** np.arange(200), mode="same")
        assert thinning.events(wander) is None
        assert thinning.events(rng.standard_normal(200_000) + 9.0 * (np.arange(200_000) // 50_000 % 2)) is None
        assert thinning.lines(wander, STEP) == [] and thinning.lines(rng.standard_t(3, 200_000), STEP) == []


@pytest.mark.parametrize("period", [0.02, 0.25, 0.2, 2.5])
def test_waves_in_time_alone_are_reported(period: float) -> None:
    """No effect of the vocabulary: a line in the spectrum of all rows, also at the length of stretch and block."""
    notes = " ".join(thinning.thinned(log(hidden=lambda c: 0.6 * np.sin(2 * np.pi * c["t"] / period))).notes)
    assert f"{1 / period:.3g}" in notes and ("(0.5" in notes or "(0.6" in notes)
    moved = thinning.thinned(log(hidden=lambda c: -4.0 * c["d"] + 0.02 * c["v"])).notes
    assert "lines" not in " ".join(moved)  # lost motion and following error go with motion


def test_a_spike_that_outlasts_the_time_between_turns_is_not_offered(whole) -> None:
    """It would be lost motion under another name: the axis turns every 3.65 s."""
    from errpipe.terms import search_of
    from errpipe.terms.reversal_spike import ReversalSpike

    (term,) = ReversalSpike.bind(whole, "EXX")
    tau = next(p for p in term.nonlinear() if p.unit == "s")
    assert max(search_of(tau).values(term, tau.name, whole, None)) < 3.65 / 3 * 1.1


@pytest.mark.slow
def test_lost_motion_of_a_long_log_is_named() -> None:
    from errpipe.diagnosis import diagnose

    diagnosis, _ = diagnose(log(150_000, lambda c: -1.5 * c["d"]))
    assert [f.effect for f in diagnosis.responses[0].findings] == ["backlash"]
