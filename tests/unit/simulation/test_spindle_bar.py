"""The heated bar against closed forms, and where a sensor belongs on it (Ni 1997, Fig. 8)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.errors import DataError
from errpipe.fitting import placement
from errpipe.simulation import spindle_bar
from errpipe.simulation.spindle_bar import Bar
from examples.placement import nonlinearity
from examples.placement.column import Column

INSULATED = {0.25: (0.294, 0.280), 0.5: (0.369, 0.339), 1.0: (0.402, 0.362), 2.0: (0.414, 0.378), 5.0: (0.420, 0.386)}


def warm_up(bar: Bar, until: float, steps: int = 400) -> tuple[np.ndarray, np.ndarray]:
    times = np.linspace(0.0, until, steps + 1)[1:]
    theta = bar.respond(times, np.ones(steps))
    return theta, spindle_bar.growth(theta)


def test_steady_state_of_a_fin():
    # theta = cosh(m (1 - x)) / (m sinh m) for unit flux at x = 0 and an insulated end (Incropera, fin case B)
    theta, grown = warm_up(Bar(loss=2.0), 40.0, 4)
    m = np.sqrt(2.0)
    assert_allclose(theta[-1], np.cosh(m * (1 - Bar().places)) / (m * np.sinh(m)), atol=2e-4)
    assert_allclose(grown[-1], 1 / 2.0, rtol=1e-9)


def test_heat_is_kept_where_nothing_is_lost():
    _, grown = warm_up(Bar(loss=0.0), 0.7, 10)
    assert_allclose(grown, np.linspace(0.07, 0.7, 10), rtol=1e-9)


def test_steady_state_with_a_cold_and_a_losing_end():
    cold, _ = warm_up(Bar(loss=0.0, end=np.inf), 20.0, 3)
    assert_allclose(cold[-1], 1 - Bar().places, atol=1e-6)
    losing, _ = warm_up(Bar(loss=0.0, end=2.0), 40.0, 3)
    assert_allclose(losing[-1], 1 - Bar().places + 0.5, atol=1e-6)


def test_steps_do_not_matter():
    coarse = Bar(1.5).respond(np.array([0.1, 0.5]), np.array([1.0, 1.0]))
    fine = Bar(1.5).respond(np.linspace(0.005, 0.5, 100), np.ones(100))
    assert_allclose(coarse[-1], fine[-1], rtol=1e-9)


@pytest.mark.parametrize("until", INSULATED)
def test_the_strategic_place_of_the_paper(until):
    theta, grown = warm_up(Bar(loss=0.0), until)
    by_rms, by_max = INSULATED[until]
    assert_allclose(nonlinearity.finest(Bar().places, nonlinearity.linearity(theta, grown).residual), by_rms, atol=2e-3)
    largest = nonlinearity.linearity(theta, grown, "max").residual
    assert_allclose(nonlinearity.finest(Bar().places, largest), by_max, atol=3e-3)


@pytest.mark.parametrize(("loss", "place"), [(0.0, 1 - 1 / np.sqrt(3)), (1.0, 0.4096), (4.0, 0.369)])
def test_the_lag_free_place_in_closed_form(loss, place):
    assert_allclose(placement.lag_free_place(loss), place, atol=1e-4)
    # what it means: long after a slow ramp starts, reading and growth lag by the same time
    bar = Bar(loss)
    times = np.linspace(0.0, 8.0, 401)[1:]
    theta = bar.respond(times, times - (times[1] - times[0]) / 2)
    k = int(np.argmin(np.abs(bar.places - place)))
    if loss:
        steady = np.cosh(np.sqrt(loss) * (1 - bar.places[k])) / (np.sqrt(loss) * np.sinh(np.sqrt(loss)))
        lag = times[-1] - theta[-1, k] / steady
        assert_allclose(lag, times[-1] - spindle_bar.growth(theta)[-1] * loss, atol=5e-3)


def test_linear_at_the_strategic_place_extrapolates_where_a_polynomial_elsewhere_does_not():
    bar = Bar(1.5)
    theta, grown = warm_up(bar, 0.5, 200)
    times, flux = spindle_bar.random_duty(30, 20, seed=1)
    duty = bar.respond(times, flux)
    later = spindle_bar.growth(duty)

    def error(x: float, degree: int) -> float:
        k = int(np.argmin(np.abs(bar.places - x)))
        return nonlinearity.extrapolation(theta[:, k], grown, duty[:, k], later, degree)

    assert error(0.35, 1) < 0.05 and error(0.40, 1) < 0.02
    assert error(0.02, 1) > 0.15 and error(0.98, 1) > 0.25
    assert error(0.98, 2) > 1.5 and error(0.02, 2) > 0.4
    assert error(0.35, 1) == pytest.approx(0.034, abs=0.01)  # 3.4 % of the range against 215 %
    assert error(0.98, 2) == pytest.approx(2.15, abs=0.1)


def test_column_leans_away_from_the_heat_and_a_pair_of_sensors_tells_how_far():
    column = Column()
    times = np.arange(1, 181) * 120.0
    field = column.respond(times, np.ones(180))
    lean = column.lean(field)
    assert (lean > 0).all() and (field >= 0).all() and field[:, 0].max() < 0.1 * field.max()
    pair = field[:, :, 0] - field[:, :, -1]
    linearity = nonlinearity.linearity(pair, lean)
    height = column.places()[0][linearity.best, 0]
    assert 0.8 < height < 0.95 and linearity.residual[linearity.best] < 0.02 < 0.05 < np.median(linearity.residual)


def test_column_conserves_heat_without_losses():
    column = Column(loss=0.0)
    step = column.respond(np.array([1.0]), np.array([1.0]))[0]
    patch = sum((np.arange(36) + 0.5) / 36 >= 0.65) - sum((np.arange(36) + 0.5) / 36 > 0.8)
    assert_allclose(step.sum() * column.spacing**2, column.diffusivity * column.spacing * patch, rtol=1e-3)


def test_placement_refuses_what_has_no_answer():
    with pytest.raises(DataError):
        nonlinearity.linearity(np.ones((5, 2)), np.zeros(5))
    with pytest.raises(DataError):
        placement.lag_free_place(-1.0)
    assert nonlinearity.finest(np.arange(3.0), np.array([0.1, 0.5, 0.9])) == 0.0
