"""The competition of thermal models: which entrants held-out runs and environments admit, and with what weight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.thermal import competition


def entrant(family: str, values: np.ndarray) -> competition.Entrant:
    return competition.Entrant(family, family, lambda groups: values, lambda groups: ())


def test_a_setting_that_fails_in_the_other_season_loses_to_one_nearly_as_good_on_runs() -> None:
    """Held-out runs: 1.0 and 1.1 um; held-out seasons: 3.9 and 2 um, both admitted."""
    run = np.repeat(np.arange(6), 20)
    wave = np.sqrt(2.0) * np.sin(np.arange(120) * np.pi / 5)  # zero in each first row
    response = 10.0 * wave

    def entrant(name: str, of_runs: float, of_seasons: float) -> competition.Entrant:
        def predict(groups: competition.Groups) -> np.ndarray:
            return response + (of_runs if len(groups) == 5 else of_seasons) * np.roll(wave, 5)

        return competition.Entrant("one", name, predict, lambda groups: ())

    ways = [
        competition.Grouping(competition.RUN, tuple((g,) for g in range(6)), (), False),
        competition.Grouping("season", ((0, 1, 2), (3, 4, 5))),
    ]
    entrants = [entrant("fragile", 1.0, 3.9), entrant("sound", 1.1, 2.0)]
    for known, best in ((None, "fragile"), (run, "sound")):
        outcome = competition.compete(entrants, ways, response, run >= 0, run, run=known)
        assert [e.name for e, _ in outcome.weights] == [best]


def test_residuals_from_the_first_reading_carry_its_error() -> None:
    run = np.repeat([0, 1], 4)
    response, predicted = np.arange(8.0), np.arange(8.0)
    predicted[[0, 4]] += [1.0, -2.0]
    predicted[1] = np.nan
    held_out_rows = competition._HeldOutPredictions(predicted[None], response, run >= 0, run)
    moved = held_out_rows.from_first_reading(run)
    assert_allclose((moved.response - moved.mixture({0: 1.0}))[moved.seen], [0.0, 1.0, 1.0, 0.0, -2.0, -2.0, -2.0])


@pytest.mark.parametrize(("behind", "expected"), [(1.2, "signed"), (2.0, "free")])
def test_of_one_season_gains_with_a_sign_are_used_unless_they_are_behind_already_there(behind, expected) -> None:
    rng = np.random.default_rng(5)
    group = np.repeat(np.arange(8), 50)
    truth = np.tile(np.linspace(0, 20, 50), 8)
    runs = competition.Grouping("run", tuple((g,) for g in range(8)))
    signed = replace(entrant("signed", truth + rng.normal(0, behind, 400)), physical=True)
    both = [signed, entrant("free", truth + rng.normal(0, 1.0, 400))]

    def mixture(one_environment: bool) -> set[str]:
        arguments = (both, (runs,), truth, np.ones(400, bool), group, False, one_environment)
        return {e.family for e, _ in competition.compete(*arguments).weights}

    assert expected in mixture(True) and (behind > 1.5 or mixture(True) == {"signed"})
    assert "free" in mixture(False)


def test_an_entrant_that_does_not_carry_over_to_another_season_is_out() -> None:
    """Both know runs left out; one of them leaves three times as much without the season."""
    rng = np.random.default_rng(5)
    group = np.repeat(np.arange(8), 50)
    truth = np.tile(np.linspace(0, 20, 50), 8) + rng.normal(0, 0.3, 400)
    runs = competition.Grouping("run", tuple((g,) for g in range(8)))
    seasons = competition.Grouping("season", ((0, 1, 2, 3), (4, 5, 6, 7)))
    good = truth + rng.normal(0, 1.0, 400)

    def fickle(groups):
        return truth + rng.normal(0, 0.5 if len(groups) == 7 else 3.0, 400)

    def mixture(predict, ways):
        rival = competition.Entrant("fickle", "fickle", predict, lambda groups: ())
        outcome = competition.compete([rival, entrant("good", good)], ways, truth, np.ones(400, bool), group)
        return {e.family for e, _ in outcome.weights}

    assert "fickle" in mixture(fickle, (runs,))
    assert mixture(fickle, (runs, seasons)) == {"good"}


def test_surroundings_that_contradict_each_other_leave_the_least_regretted() -> None:
    """Each entrant is three times worse than another one in one of two groupings; none is worse than nothing."""
    rng = np.random.default_rng(8)
    group = np.repeat(np.arange(8), 50)
    truth = np.tile(np.linspace(0, 20, 50), 8)
    noise = rng.normal(0, 1.0, 400)
    runs = competition.Grouping("run", tuple((g,) for g in range(8)))
    seasons = competition.Grouping("season", ((0, 1, 2, 3), (4, 5, 6, 7)))
    warmth = competition.Grouping("warmth", ((0, 2, 4, 6), (1, 3, 5, 7)))

    def by(in_season: float, in_warmth: float):
        def predict(groups):
            size = 1.0 if len(groups) == 7 else in_season if set(groups) in ({0, 1, 2, 3}, {4, 5, 6, 7}) else in_warmth
            return truth + size * noise

        return competition.Entrant(f"{in_season}", f"{in_season}", predict, lambda groups: ())

    rivals = [by(1.0, 4.0), by(2.5, 1.0)]
    outcome = competition.compete(rivals, (runs, seasons, warmth), truth, np.ones(400, bool), group)
    assert [e.family for e, _ in outcome.weights] == ["2.5"]


def test_an_entrant_that_helps_by_chance_does_not_join() -> None:
    """Six families of pure noise, the best of five settings each: what they get all together."""
    rng = np.random.default_rng(6)
    group = np.repeat(np.arange(8), 50)
    truth = rng.normal(0, 5.0, 400)
    runs = competition.Grouping("run", tuple((g,) for g in range(8)))
    noise = [entrant(str(k % 6), rng.normal(0, 5.0, 400)) for k in range(30)]
    outcome = competition.compete(noise, (runs,), truth, np.ones(400, bool), group)
    assert sum(w for _, w in outcome.weights) < 0.3
