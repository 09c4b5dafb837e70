"""What all responses share is computed once, and columns are the bits that numpy and the plain loops give."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

from errpipe.diagnosis import shapes
from errpipe.diagnosis.hypotheses import rms_and_spread, scaled
from errpipe.drivers.sessions import sessions
from errpipe.terms import MANY_STARTS, sensor_fault
from errpipe.terms._slack import start_states

from .long import linear_axis


def test_shapes_are_made_once_for_responses_on_the_same_rows() -> None:
    made = linear_axis(16, 0.02, ("EXX", "EYX"))
    rows = np.arange(0, len(made), 50)
    first = shapes.shapes(made, "EXX", rows)
    assert shapes.shapes(made, "EYX", rows) is first
    fewer = shapes.shapes(made, "EYX", rows[1:])
    assert fewer is not first and fewer[0].columns.shape[0] == rows.size - 1
    assert shapes.shapes(made, "EXX", rows)[0].columns.tobytes() == first[0].columns.tobytes()


def test_how_sensors_go_together_is_solved_once_for_every_axis_and_response() -> None:
    made = linear_axis(3, 5.0, ("EXX",))
    with mock.patch.object(sensor_fault.np.linalg, "lstsq", side_effect=np.linalg.lstsq) as solved:
        once, again, elsewhere = (
            sensor_fault.reconstructed(made, "T_0", *rows) for rows in ((5, 40), (5, 40), (5, 90))
        )
    assert solved.call_count == 2 and once.tobytes() == again.tobytes() != elsewhere.tobytes()


@pytest.mark.parametrize("runs", [1, 3, MANY_STARTS])
def test_a_state_at_the_start_decays_in_its_own_session(runs: int) -> None:
    made = linear_axis(runs, 0.7, ("EXX",))
    t, session = made.time(), sessions(made)
    every = []
    for code in np.unique(session):
        inside = session == code
        every.append(np.where(inside, np.exp(-np.where(inside, t - t[inside][0], 0.0) / 700.0), 0.0))
    expected = [np.sum(every, axis=0)] if len(every) >= MANY_STARTS else every
    states = list(start_states(made, 700.0, 0.3, 0.7))
    assert [s.tobytes() for s, _ in states] == [e.tobytes() for e in expected]
    assert [f for _, f in states] == ([1.0] if len(every) >= MANY_STARTS else [0.3, *[0.7] * (len(every) - 1)])


@pytest.mark.parametrize("for_table", [False, True])
@pytest.mark.parametrize("cores", [1, 2])
def test_scaled_columns_are_numpys_to_the_last_bit(for_table: bool, cores: int) -> None:
    rng = np.random.default_rng(cores)
    for rows in rng.integers(30, 20_000, 10):
        core, slack = rng.normal(3.0, 2.0, (rows, cores)), rng.normal(size=(rows, 3)) * [1.0, 0.0, 1e-3]
        if cores == 1:
            assert rms_and_spread(core)[0] == np.sqrt(np.mean(core**2)) and rms_and_spread(core)[1] == core.std()
        block, freedom, scale = scaled(core, slack, np.array([0.1, 0.2, 0.3]), for_table)
        assert freedom.tolist() == [*[1.0] * cores, 0.1, 0.3] and block.shape == (rows, cores + 2)
        assert (block == np.column_stack([core, slack[:, [0, 2]]]) / scale).all()
