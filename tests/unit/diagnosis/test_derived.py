"""What a recording implies before it is diagnosed: positions of targets, and a drive force as the response."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.diagnosis import derived, prepare
from errpipe.domain.recording import Manifest, Recording
from errpipe.drivers import motion

X = np.tile(np.r_[np.linspace(0.0, 500.0, 13), np.linspace(500.0, 0.0, 13)], 4)
ERROR = 8.0 * np.sin(X / 80.0) + np.random.default_rng(1).normal(0.0, 2.0, X.size)  # um


def recording(columns: dict[str, dict[str, str]], values: dict[str, np.ndarray]) -> Recording:
    manifest = Manifest.model_validate({"recording": 1, "tables": ["r.csv"], "columns": columns})
    return Recording(manifest, pd.DataFrame(values))


def test_the_actual_position_of_a_target_does_not_tell_its_deviation() -> None:
    """A wave of a quarter of the step read the deviation off the actual position: 13 -> 0.0003 um, below all noise."""
    columns = {
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "cmd": {"role": "command", "axis": "X", "unit": "mm"},
        "EXX": {"role": "error", "component": "EXX", "unit": "um"},
    }
    test = recording(columns, {"x": X + ERROR / 1000.0, "cmd": X, "EXX": ERROR})
    assert np.array_equal(derived.with_motion(test)[0].array("x"), X)
    log = recording(columns, {"x": 1.0 + np.arange(X.size) / 7.0, "cmd": np.arange(X.size) / 7.0, "EXX": ERROR})
    assert np.array_equal(derived.at_targets(log).array("x"), log.array("x"))


@pytest.mark.parametrize(
    ("targets", "sided"),
    [
        (np.tile([0.0, 90.0, 160.0, 250.0, 330.0, 400.0], 5), False),  # every pass starts at 0, from the same side
        (np.tile([0.0, 90.0, 160.0, 250.0, 330.0, 400.0][::-1], 5), False),
        (np.tile([0.0, 200.0, 400.0, 400.0, 200.0, 0.0], 5), True),
    ],
)
def test_a_return_to_the_start_of_another_pass_is_no_approach_from_the_other_side(targets, sided) -> None:
    columns = {
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "t": {"role": "time", "unit": "s"},
        "EXX": {"role": "error", "component": "EXX", "unit": "um"},
    }
    values = {"x": targets, "t": 9.0 * np.arange(targets.size), "EXX": targets / 80.0}
    moved, _ = derived.with_motion(recording(columns, values))
    assert bool(moved.names("direction")) is sided


@pytest.mark.parametrize("readings", [1, 3])
def test_the_last_target_read_twice_is_approached_from_either_side(readings) -> None:
    """A bidirectional test without a column of directions: one reading in eleven was taken for the other side's."""
    columns = {
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "t": {"role": "time", "unit": "s"},
        "EXX": {"role": "error", "component": "EXX", "unit": "um"},
    }
    targets = np.repeat(np.tile([0.0, 90.0, 160.0, 250.0, 250.0, 160.0, 90.0, 0.0], 3), readings)
    values = {"x": targets, "t": 9.0 * np.arange(targets.size), "EXX": targets / 80.0}
    moved, _ = derived.with_motion(recording(columns, values))
    side = np.repeat(np.tile(np.repeat([1.0, -1.0], 4), 3), readings)
    assert np.array_equal(moved.array("direction of X"), side)
    assert np.array_equal(motion.direction(recording(columns, values), "X"), side)


def test_a_log_with_speed_but_without_acceleration_gets_it_from_the_speed() -> None:
    """Drives log position and speed: what follows the acceleration had no candidate there."""
    t = 0.02 * np.arange(400)
    names = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
        "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
    }
    every = {"t": t, "x": 20.0 * np.sin(t), "v": 20.0 * np.cos(t), "a": -20.0 * np.sin(t)}
    without = recording({n: c for n, c in names.items() if n != "a"}, {n: v for n, v in every.items() if n != "a"})
    log, source = derived.with_motion(without)
    assert source == {"acceleration of X": "v"} and log.names("velocity") == ("v",) and not log.names("direction")
    assert np.allclose(log.array("acceleration of X"), every["a"], atol=0.5)
    assert derived.with_motion(recording(names, every))[1] == {}


def test_a_drive_force_that_names_its_component_is_a_response() -> None:
    columns = {
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "F": {"role": "force", "axis": "X", "unit": "N", "component": "F_X"},
        "cutting": {"role": "force", "axis": "X", "unit": "N"},
        "sim": {"role": "simulated", "component": "F_X", "unit": "N"},
    }
    values = {"x": X, "F": 10.0 + ERROR, "cutting": ERROR**2, "sim": 0.1 * ERROR}
    accepted, refused = prepare.pairs(derived.with_responses(recording(columns, values)))
    assert [pair.error for pair in accepted] == ["F"] and not refused


@pytest.mark.filterwarnings("error")
def test_a_pass_at_one_speed_is_conditioned_without_a_warning():
    t = 0.01 * np.arange(400)
    columns = {"t": t, "x": 3.0 * t, "v": np.full(t.size, 3.0)}
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
    }
    assert np.array_equal(prepare.condition(recording(kinds, columns)).array("v"), columns["v"])
