"""The proposed measurement can be carried out: one axis moves, and all its columns describe the same motion."""

from __future__ import annotations

import numpy as np

from errpipe.diagnosis.separate import _hypothetical_recordings
from tests.unit.diagnosis.machines import recording

KINDS = {
    "t": {"role": "time", "unit": "s"},
    "x": {"role": "position", "axis": "X", "unit": "mm"},
    "cmd": {"role": "command", "axis": "X", "unit": "mm"},
    "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
    "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
    "EXX": {"role": "error", "component": "EXX", "unit": "um"},
}


def servo_log():
    t = np.arange(3000) * 0.004
    x = 150 + 100 * np.sin(1.5 * t)
    v, a = 150 * np.cos(1.5 * t), -225 * np.sin(1.5 * t)
    return recording({"t": t, "x": x, "cmd": x, "v": v, "a": a, "EXX": np.zeros(t.size)}, KINDS)


def test_position_command_velocity_and_acceleration_of_a_proposed_move_agree() -> None:
    """A command that jumped at constant velocity was proposed: following error and dead time differed by 1.3 mm."""
    moves = dict(_hypothetical_recordings(servo_log(), ("v", "cmd")))
    assert len(moves) == 3
    for what, made in moves.items():
        t, x, v = made.time(), made.array("x"), made.array("v")
        assert (np.diff(t) > 0).all() and np.array_equal(x, made.array("cmd"))
        if "100 %" in what:  # each row is the end of a stroke at its speed
            assert np.allclose(np.diff(x) / np.diff(t), v[1:])
        else:
            assert np.allclose(np.gradient(x, t)[1:-1], v[1:-1], atol=1e-3 * np.abs(v).max())
        if "sine" in what:
            assert np.allclose(np.gradient(v, t)[1:-1], made.array("a")[1:-1], atol=0.3)
        assert x.min() > 49 and x.max() < 251, "within the travel that was recorded"


def test_a_sine_keeps_to_the_speed_and_the_acceleration_that_were_recorded() -> None:
    (made,) = [m for what, m in _hypothetical_recordings(servo_log(), ("v",)) if "sine" in what]
    assert 140 < np.abs(made.array("v")).max() < 151
    assert 210 < np.abs(made.array("a")).max() < 226


def test_the_ends_of_a_sine_are_stated_as_places() -> None:
    """`+-75.7 mm` read like the uncertainty of the move."""
    ((what, made),) = [(w, m) for w, m in _hypothetical_recordings(servo_log(), ("v",)) if "sine" in w]
    assert f"between {made.array('x').min():.3g} and {made.array('x').max():.3g} mm as a sine" in what
    assert "+-" not in what
