"""What a recording implies before it is diagnosed: positions of targets, and a drive force as the response."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.diagnosis import derived, prepare
from errpipe.domain.recording import Manifest, Recording

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
