"""What is left after the best explanation, tested; and whether chance could have brought the search as far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from errpipe.diagnosis import judge, locate, prepare, significance, whiteness
from errpipe.diagnosis.evidence import Data
from errpipe.diagnosis.search import Explanation

from .machines import axis, spindle


def judged(recording) -> judge.Case:
    (pair,), _ = prepare.pairs(recording)
    return judge.diagnose(recording, prepare.condition(recording), pair)


def with_mismatch(case: judge.Case, y: np.ndarray) -> judge.Case:
    """The same response and library, another mismatch, and nothing named."""
    search = case.search
    search.data, search.rows = Data(case.library.table, y), None
    return replace(case, y=y, search=search, explanation=Explanation((), np.zeros(0)))


def noise(rng, run: np.ndarray, share: float, memory: float) -> np.ndarray:
    """White noise with a slow share of its variance, as public recordings have it."""
    phi = np.exp(-1 / memory)
    slow = np.zeros(run.size)
    fresh = rng.standard_normal(run.size)
    for i in range(run.size):
        again = i == 0 or run[i] != run[i - 1]
        slow[i] = fresh[i] if again else phi * slow[i - 1] + np.sqrt(1 - phi**2) * fresh[i]
    return np.sqrt(1 - share) * rng.standard_normal(run.size) + np.sqrt(share) * slow


@pytest.fixture(scope="module")
def quiet() -> judge.Case:
    return judged(axis(1))


@pytest.mark.parametrize(
    "share, memory",
    [(0.0, 8.0), (0.12, 12.0), *(pytest.param(*p, marks=pytest.mark.slow) for p in ((0.06, 8.0), (0.12, 5.0)))],
)
def test_noise_with_a_memory_is_called_structured_no_oftener_than_stated(quiet, share, memory):
    """At the stated rate of 1 % for all tests together: at most 4 of 80 (chance of more: 0.1 %)."""
    rng = np.random.default_rng(7)
    alarms = sum(
        whiteness.whiteness(with_mismatch(quiet, 0.5 * noise(rng, quiet.run, share, memory))).p < whiteness.ALARM
        for _ in range(80)
    )
    assert alarms <= 4


@pytest.mark.parametrize("what", ["a kink in one temperature", "one run", "the other direction in one place", "order"])
def test_planted_structure_is_detected_and_located(quiet, what):
    rng = np.random.default_rng(8)
    recording, rows = quiet.recording, quiet.pair.rows
    x, side = recording.array("x")[rows], recording.array("dir")[rows]
    nut = recording.array("T_nut")[rows]
    planted = {
        "a kink in one temperature": np.abs(nut - np.median(nut)),
        "one run": 0.6 * (quiet.run == 2),
        "the other direction in one place": 0.8 * side * (np.abs(x - 450) < 60),
        "order": np.sin(np.arange(x.size) / 4.0),
    }[what]
    statistic = whiteness.whiteness(with_mismatch(quiet, planted + 0.5 * rng.standard_normal(x.size)))
    assert statistic.p < whiteness.ALARM
    alarming = whiteness.structured(statistic.tests)
    expected = {
        "a kink in one temperature": ("T_nut", "level"),
        "one run": ("run", "level"),
        "the other direction in one place": ("x", "by direction"),
        "order": ("order of the rows", "Ljung-Box"),
    }[what]
    assert expected in [(t.against, t.how) for t in alarming]
    assert alarming[0].against in statistic.says and "not only noise" in statistic.says


@pytest.mark.slow
def test_on_nulls_every_p_of_the_search_is_as_likely_as_any(quiet):
    """200 nulls: of p <= 0.05, 0.2 and 0.5 about as many as that."""
    rng = np.random.default_rng(9)
    p = np.array(
        [
            significance.surrogate_test(with_mismatch(quiet, 0.5 * noise(rng, quiet.run, 0.06, 8.0))).p
            for _ in range(200)
        ]
    )
    for level in (0.05, 0.2, 0.5):
        assert np.mean(p <= level) < level + 2.6 * np.sqrt(level * (1 - level) / p.size)
    assert np.mean(p <= 0.5) > 0.35


def test_a_planted_effect_is_beyond_chance():
    case = judged(axis(3, hidden=lambda c: -2.0 * c["dir"]))
    probability = significance.surrogate_test(case, 0)
    assert case.explanation.accepted[0].hypothesis.effect in ("backlash", "friction_hysteresis")  # no short reversals
    assert probability.p == 0.01 and probability.gain > 5 * max(probability.limit, 1.0)
    assert probability.rows == pytest.approx(case.run.size, rel=0.3)  # what is left is noise: rows count
    assert len(case.explanation.accepted) == 1  # its surrogates are those of the whole search, which are known then
    again = significance.surrogate_test(case, 0, whole=significance.surrogate_test(case))
    assert (again.p, again.gain, again.limit) == (probability.p, probability.gain, probability.limit)


def test_rows_that_repeat_their_neighbours_count_for_less():
    case = judged(spindle(2))
    rng = np.random.default_rng(10)
    slow = np.repeat(rng.standard_normal(case.y.size // 12 + 1), 12)[: case.y.size]
    assert significance.surrogate_test(with_mismatch(case, slow), surrogates=1).rows < case.y.size / 6


def test_a_permanent_step_is_a_change_point_and_noise_has_none(quiet):
    rng = np.random.default_rng(11)
    recording, rows = quiet.recording, quiet.pair.rows
    t = recording.time()[rows]
    flat = 0.5 * rng.standard_normal(rows.size)
    assert locate.changes(recording, rows, flat) == ()
    (changes,) = locate.changes(recording, rows, flat + 2.0 * (t > 3000))
    assert changes.what == "level" and changes.column == "t"
    assert abs(changes.at - 3000) < 0.05 * (t[-1] - t[0])
    assert changes.after_um - changes.before_um == pytest.approx(2.0, abs=0.3)
    assert "size" in [c.what for c in locate.changes(recording, rows, flat * np.where(t > 3000, 4.0, 1.0))]


def test_the_share_of_the_mismatch_in_each_part_says_where_it_is(quiet):
    rng = np.random.default_rng(12)
    recording, rows = quiet.recording, quiet.pair.rows
    x = recording.array("x")[rows]
    y = np.where(x > 420, 4.0, 0.0) + 0.5 * rng.standard_normal(rows.size)
    parts = {r.what: r.share for r in locate.regimes(recording, rows, y, y, y, 0.5)}
    assert parts["upper third of x"] > 0.85 and parts["lower third of x"] < 0.05
    still = {r.what: r.share for r in locate.regimes(recording, rows, y, y, rng.standard_normal(rows.size) / 2, 0.5)}
    assert set(still.values()) == {None}  # nothing stands out of the noise


def test_an_offset_of_each_run_is_distinguished_from_changes_within_runs(quiet):
    rng = np.random.default_rng(13)
    fresh = 0.5 * rng.standard_normal(quiet.run.size)
    offsets = np.array([3.0, -2.0, 1.0, -3.0, 2.0, -1.0])[quiet.run]
    assert locate.between_runs(quiet.run, offsets + fresh, 0.5) > 0.97
    assert locate.between_runs(quiet.run, 3 * np.sin(np.arange(quiet.run.size)) + fresh, 0.5) < 0.03
    assert locate.between_runs(quiet.run, fresh, 1.0001 * float(np.std(fresh))) is None  # nothing but noise
