"""Thermal families on a shop's recordings: a sensor that came late."""

from __future__ import annotations

import numpy as np

from errpipe.models.auto import Auto
from tests.unit.models.test_competition import machine
from tests.validation_document import held_out

FAMILY = Auto(component="E_Z", among=("rises", "lagged"))


def test_a_season_without_one_sensor_leaves_the_runs_of_the_other_to_be_judged() -> None:
    """Before: "hold-out winter: no judged row has everything the model needs"."""
    recording = machine(3, seasons=("winter", "spring"))
    late = np.where(recording.frame["season"] == "winter", np.nan, recording.array("T_spindle"))
    recording = recording.with_columns({"T_spindle": late}, {})
    name, folds = FAMILY.folds(recording, None)
    assert name == "leave-one-run-out"
    assert sorted(fold.label for fold in folds) == [f"spring{k}" for k in range(5)]
    (figures,) = held_out(recording, FAMILY)["components"]
    assert figures["rms_after"] < 0.3 * figures["rms_before"]
    assert "most gaps: T_spindle" in FAMILY.fit(recording).summary["E_Z"]


def test_one_run_without_a_sensor_is_named_by_the_fit() -> None:
    """Before: one run of ten took no part, and nothing said so."""
    recording = machine(3, seasons=("winter", "spring"))
    gone = np.where(recording.frame["run"] == "winter2", np.nan, recording.array("T_spindle"))
    said = FAMILY.fit(recording.with_columns({"T_spindle": gone}, {})).summary["E_Z"]
    assert "; without winter2 (most gaps: T_spindle, no reading in" in said
    assert "without" not in FAMILY.fit(recording).summary["E_Z"]


def test_runs_in_which_a_sensor_is_late_take_part_from_its_first_reading_on() -> None:
    """Before: a run took no part if a sensor had no reading at its first deviations."""
    recording = machine(3, seasons=("winter", "spring"))
    code = recording.run_codes()
    number = np.arange(code.size) - np.flatnonzero(np.diff(code, prepend=-1))[code]
    late = np.where((code % 2 == 0) & (number < 8), np.nan, recording.array("T_spindle"))
    lacking = recording.with_columns({"T_spindle": late}, {})
    fitted = FAMILY.train(lacking)
    assert fitted.report["rows"] > 0.85 * FAMILY.train(recording).report["rows"]
    (figures,) = held_out(lacking, FAMILY)["components"]
    assert figures["rows"] > 0.85 * len(recording)
    assert figures["rms_after"] < 0.3 * figures["rms_before"]


def test_signed_families_compete_where_a_sensor_is_late_in_one_run() -> None:
    """Before: an internal error, because these had no row of a run that the others fit."""
    recording = machine(3, seasons=("winter", "spring"))
    late = recording.array("T_spindle").copy()
    late[:8] = np.nan
    lacking = recording.with_columns({"T_spindle": late}, {})
    family = Auto(component="E_Z", among=("rises", "network", "season"))
    assert set(family.fit(lacking).documents["competition.json"]["rms_um"]["run"]) >= {"network", "mixture"}
