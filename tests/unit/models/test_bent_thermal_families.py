"""Thermal families that are not linear in the readings: what competes is what a table is given."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.shared import drive_all
from errpipe.models._perceptron import Start, _trained
from errpipe.models.bilinear import MOST_SENSORS, Bilinear
from errpipe.models.lagged import Lagged
from errpipe.models.neural import Neural
from errpipe.thermal import linear
from errpipe.thermal.arithmetic import since_start

STEP, ROWS = 300.0, 72  # s, six hours a day


def bent_machine(seed: int, runs: int, sensors: int = 2) -> Recording:
    """A body warms from the first row on; a part without a sensor is heated as fast as the body is, times its rise."""
    rng, frames = np.random.default_rng(seed), []
    for k in range(runs):
        speed = np.repeat(rng.choice([0.3, 0.6, 1.0, 0.0], 6), ROWS // 6)
        speed[:6] = 1.0
        body, hidden = np.zeros(ROWS), np.zeros(ROWS)
        for i in range(1, ROWS):
            body[i] = body[i - 1] + STEP * (12.0 * speed[i] - body[i - 1]) / 2000.0
            heat = body[i] * (body[i] - body[i - 1]) / STEP * 600.0
            hidden[i] = hidden[i - 1] + STEP * (heat - hidden[i - 1]) / 1500.0
        values = {f"T_{n}": 20 + body / (1 + n) + rng.normal(0, 0.01, ROWS) for n in range(sensors)}
        growth = hidden + 3 * body + rng.normal(0, 0.1, ROWS)
        frames.append(pd.DataFrame({"run": f"day{k}", "t": STEP * np.arange(ROWS), **values, "E_Z": growth}))
    frame = pd.concat(frames, ignore_index=True)
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    kinds |= {n: Column(role="temperature", unit="degC") for n in frame if n.startswith("T_")}
    kinds["E_Z"] = Column(role="error", component="E_Z", unit="um")
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), frame)


def left(family, fitted: Recording, judged: Recording) -> float:
    run = judged.run_codes()
    y = since_start(judged.array("E_Z"), run, 3)[0]
    predicted = since_start(family.train(fitted).values(judged), run, 3)[0]
    return float(np.sqrt(np.mean((y - predicted) ** 2)))


def test_products_of_rate_and_rise_are_learnt() -> None:
    fitted, judged = bent_machine(1, 10), bent_machine(2, 5)
    assert left(Bilinear(component="E_Z"), fitted, judged) < 0.5 * left(Lagged(component="E_Z"), fitted, judged)


@pytest.mark.parametrize(("family", "within"), [(Bilinear(component="E_Z"), 1e-6), (Neural(component="E_Z"), 0.05)])
def test_what_competes_is_what_a_table_is_given(family, within: float) -> None:
    """The machine warms while its zero is read; a table of tanh is within 0.0015 of it."""
    recording = bent_machine(3, 6)
    problem = linear.problem(recording, "E_Z", None, 3)
    groups = tuple(problem.groups)
    for entrant in family.entrants(problem):
        parts = entrant.parts(groups)
        compiled = drive_all([node for _, _, node in parts], recording) @ [gain for _, gain, _ in parts]
        compiled = since_start(compiled, recording.run_codes(), 3)[0]
        assert np.ptp(compiled) > 10.0
        assert_allclose(entrant.predict(groups), compiled, atol=within * np.ptp(compiled) / 10.0)


def test_products_of_many_sensors_or_of_one_run_do_not_compete() -> None:
    for recording in (bent_machine(1, 3, MOST_SENSORS + 1), bent_machine(1, 1)):
        problem = linear.problem(recording, "E_Z", None, 3)
        assert not Bilinear(component="E_Z").entrants(problem)


def test_a_net_learns_a_bent_function_from_its_zero() -> None:
    """Counted from the mean of first rows that already move; constant inputs give nothing."""
    rng = np.random.default_rng(0)
    x, start = rng.normal(size=(120, 3)), Start.of(np.repeat([0, 1, 2], 40), 3, np.ones(120, dtype=bool))
    y = 5.0 * start.centred(np.tanh(2.0 * x[:, 0]))
    inner, bias, outer = _trained(x, start, np.arange(120), y, 4, 1e-3)
    assert_allclose(start.centred(np.tanh(x @ inner + bias) @ outer), y, atol=0.2)
    inner, bias, outer = _trained(0.0 * x, start, np.arange(120), 0.0 * y, 4, 1e-3)
    assert np.isfinite(inner).all()
    assert_allclose(start.centred(np.tanh(0.0 * x @ inner + bias) @ outer), 0.0, atol=1e-9)
