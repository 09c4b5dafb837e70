"""Single runs whose readings are wrong: named with the cause, for as long as they are kept, and no sound one."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.validation.outlying_runs import outliers_of_responses, outliers_of_sensors
from errpipe.validation.what_changed import what_changed

OLD, NEW, ROWS = 12, 8, 24
RUN = np.repeat(np.arange(OLD + NEW), ROWS)
REFERENCE = RUN < OLD
WRONG = 14  # number of the run that is read wrongly, with sound ones after it
NAMES = ("T_screw", "T_bed", "T_air")


def machine(seed: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Three temperatures, degC, and the true deviation, um, by row."""
    rng = np.random.default_rng(seed)
    air = 20.0 + 3.0 * np.sin(RUN / 4.0)
    screw = air + rng.uniform(2.0, 8.0, OLD + NEW)[RUN]
    bed = air + 0.4 * (screw - air) + rng.normal(0.0, 0.1, OLD + NEW)[RUN]
    x = np.tile(np.linspace(0.0, 500.0, ROWS), OLD + NEW)
    shown = [v + rng.normal(0.0, 0.05, RUN.size) for v in (screw, bed, air)]
    return {"x": x, **dict(zip(NAMES, shown, strict=True))}, 5.0 + 0.02 * x + 11e-3 * x * (screw - 20.0)


def recorded(columns: dict[str, np.ndarray], error: np.ndarray) -> Recording:
    kinds = {"run": Column(role="run"), "e": Column(role="error", component="EXX", unit="um")}
    kinds |= {"x": Column(role="position", axis="X", unit="mm")}
    kinds |= {n: Column(role="temperature", unit="degC") for n in NAMES}
    frame = pd.DataFrame({"run": RUN.astype(str), "e": error, **columns})
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=kinds), frame)


def test_normal_runs_are_not_outlying() -> None:
    for seed in range(20):
        columns, error = machine(seed)
        noise = np.random.default_rng(seed + 100).normal(0.0, 0.8, RUN.size)
        assert outliers_of_sensors(recorded(columns, error), REFERENCE) == []
        assert outliers_of_responses(recorded(columns, error + noise), REFERENCE, {"EXX": error}) == []


def test_two_sensors_exchanged_for_one_night_are_named_with_the_night() -> None:
    columns, error = machine(10)
    wrong = RUN == WRONG
    screw, air = columns["T_screw"], columns["T_air"]
    columns |= {"T_screw": np.where(wrong, air, screw), "T_air": np.where(wrong, screw, air)}
    (odd,) = outliers_of_sensors(recorded(columns, error), REFERENCE)
    assert (odd.run, odd.what, odd.says) == (str(WRONG), "T_screw and T_air", "read exchanged")


def test_one_sensor_in_another_unit_for_one_night_is_named_with_the_unit() -> None:
    columns, error = machine(8)
    columns["T_bed"] = np.where(RUN == WRONG, 1.8 * columns["T_bed"] + 32.0, columns["T_bed"])
    (odd,) = outliers_of_sensors(recorded(columns, error), REFERENCE)
    assert (odd.run, odd.what, odd.says) == (str(WRONG), "T_bed", "reads as if in degF instead of degC")


def test_a_sensor_that_drifts_makes_no_outlying_run() -> None:
    for seed, rate in ((9, 1.5), (11, -0.4), (12, 0.1), (13, -0.1), (14, 0.2)):
        columns, error = machine(seed)
        columns["T_bed"] = columns["T_bed"] + rate * np.maximum(0, RUN - OLD)
        assert outliers_of_sensors(recorded(columns, error), REFERENCE) == []


@pytest.mark.parametrize(
    "factor, means",
    [
        (-1.0, "sign is reversed"),
        (0.0, "switched on"),
        (1e-3, "unit, 1/1000"),
        (1e3, "unit, 1000"),
        (25.4, "unit, 25.4"),
    ],
)
def test_one_file_of_another_sign_or_unit_is_named_though_sound_ones_follow(factor: float, means: str) -> None:
    columns, error = machine(10)
    measured = error + np.random.default_rng(1).normal(0.0, 0.8, RUN.size)
    read = factor * measured if factor else measured - error  # a table that is on takes away what it predicts
    measured = np.where(RUN == WRONG, read, measured)
    (odd,) = outliers_of_responses(recorded(columns, measured), REFERENCE, {"EXX": error})
    assert odd.run == str(WRONG) and odd.wrong and means in odd.says


def test_a_run_of_another_machine_is_named_once_the_next_run_is_as_before_and_proves_nothing() -> None:
    columns, error = machine(11)
    measured = error + np.random.default_rng(2).normal(0.0, 0.8, RUN.size)
    foreign = np.where(RUN == WRONG, 40.0 * np.cos(columns["x"] / 90.0), measured)
    (odd,) = outliers_of_responses(recorded(columns, foreign), REFERENCE, {"EXX": error})
    assert odd.run == str(WRONG) and not odd.wrong and "another machine" in odd.says
    crashed = np.where(RUN >= WRONG, measured + 30.0, measured)  # it stays: no odd run, a change
    assert outliers_of_responses(recorded(columns, crashed), REFERENCE, {"EXX": error}) == []


def test_a_run_of_a_changed_machine_that_happens_to_be_small_is_not_called_compensated() -> None:
    columns, error = machine(12)
    noise = np.random.default_rng(2).normal(0.0, 0.8, RUN.size)
    changed = np.where(RUN >= OLD, -20.0, error) + noise
    changed[RUN == WRONG] = noise[RUN == WRONG]
    assert outliers_of_responses(recorded(columns, changed), REFERENCE, {"EXX": error}) == []


MODEL = {
    "error_model": 1,
    "components": [
        {
            "component": "EXX",
            "unit": "um",
            "terms": [
                {"term": {"term": "offset"}, "parameters": [{"name": "level", "value": 5.0, "unit": "um"}]},
                {
                    "term": {"term": "scale_expansion", "axis": "X", "sensor": "T_screw"},
                    "parameters": [{"name": "coefficient", "value": 11.0, "unit": "um/m/K"}],
                },
            ],
        }
    ],
}


@pytest.mark.parametrize(
    "offset, growth, says",
    [
        (12.0, 0.0, ["offset: level 5 -> 17 um"]),
        (0.0, 4.0, ["scale_expansion: coefficient 11 -> 15 um/m/K"]),
        (0.0, 0.0, []),
    ],
    ids=["collision", "bearing", "nothing"],
)
def test_what_changed_is_reported_in_the_terms_of_the_model(offset: float, growth: float, says: list[str]) -> None:
    columns, error = machine(12)
    screw = columns["T_screw"]
    residual = offset + growth * 1e-3 * columns["x"] * (screw - 20.0)
    recording = recorded(columns, error)
    model = ErrorModel.model_validate(MODEL)
    noise = np.random.default_rng(3).normal(0.0, 0.8, RUN.size)
    changes = what_changed(model, model.components[0], recording, residual + noise, 0.8)
    values = [
        c.says.replace("16.9", "17").replace("17.1", "17").replace("14.9", "15").replace("15.1", "15") for c in changes
    ]
    assert values == says


def test_of_two_terms_of_one_kind_the_changed_one_is_named_by_its_sensor() -> None:
    columns, error = machine(12)
    model = ErrorModel.model_validate(
        {
            "error_model": 1,
            "components": [
                {
                    "component": "EXX",
                    "unit": "um",
                    "terms": [
                        {
                            "term": {"term": "thermal_drift", "sensor": sensor},
                            "parameters": [{"name": "gain", "value": 2.0, "unit": "um/K"}],
                        }
                        for sensor in ("T_screw", "T_air")
                    ],
                }
            ],
        }
    )
    residual = 3.0 * (columns["T_screw"] - 20.0) + np.random.default_rng(3).normal(0.0, 0.8, RUN.size)
    (change,) = what_changed(model, model.components[0], recorded(columns, error), residual, 0.8)
    assert change.says.startswith("thermal_drift of T_screw: gain 2 -> ") and change.term == "thermal_drift"


def test_a_change_without_a_term_is_reported_to_be_one() -> None:
    columns, error = machine(13)
    model = ErrorModel.model_validate(MODEL)
    wave = 9.0 * np.sin(2 * np.pi * columns["x"] / 20.8)
    changes = what_changed(model, model.components[0], recorded(columns, error), wave, 0.5)
    assert [c.term for c in changes][-1] == "" and "no term" in changes[-1].says


def test_a_run_of_which_nothing_is_predicted_is_in_no_other_unit() -> None:
    """A silent sensor: nothing is predicted, and 1000 times nothing, with 1000 times the noise, fits any deviation."""
    columns, error = machine(6)
    noise = np.random.default_rng(7).normal(0.0, 0.5, RUN.size)
    predicted = np.where(RUN == WRONG, 0.0, error)
    found = outliers_of_responses(recorded(columns, error + noise), REFERENCE, {"EXX": predicted})
    assert not [odd for odd in found if odd.wrong]
