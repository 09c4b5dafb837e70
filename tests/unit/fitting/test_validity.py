"""The validity box of a model that takes over where an earlier one held, and what a table makes of readings outside."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import MissingColumn
from errpipe.fitting.validity import as_in_a_table, box, distance, extended

KINDS = {"x": Column(role="position", axis="X", unit="mm"), "T": Column(role="temperature", unit="degC")}


def readings(temperatures: list[float]) -> Recording:
    frame = pd.DataFrame({"x": np.linspace(0.0, 100.0, len(temperatures)), "T": temperatures})
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=KINDS), frame)


def test_a_box_goes_out_to_where_an_earlier_model_held_and_distances_count_from_what_was_seen() -> None:
    few = readings(np.linspace(20.0, 24.0, 200).tolist())
    own = box(few, ["x", "T"], np.full(200, True))
    wide = extended(own, {"T": (10.0, 22.0)}, few)
    assert wide.ranges["T"] == (10.0, 24.0) and wide.margins["T"] == 7.0 and wide.seen == {"T": (20.0, 24.0)}
    assert wide.ranges["x"] == own.ranges["x"]
    assert distance(wide, readings([16.0])) == distance(wide.model_copy(update={"seen": {}}), readings([16.0])) + 4 / 7
    assert extended(own, {"T": (21.0, 23.0)}, few) == own
    with pytest.raises(MissingColumn, match=r"also_valid: the recording has no column T_bed. Did you mean T_bad\?"):
        extended(own, {"T_bed": (10.0, 22.0)}, few.with_columns({"T_bad": few.array("T")}, {"T_bad": KINDS["T"]}))


def test_readings_outside_are_held_at_the_end_and_fade_as_a_table_does() -> None:
    validity = box(readings([20.0, 24.0]), ["x", "T"], np.full(2, True))
    held, left = as_in_a_table(readings([22.0, 25.0, 15.0, np.nan]), validity)
    assert np.array_equal(held.array("T"), [22.0, 24.0, 20.0, np.nan], equal_nan=True)
    assert left.tolist() == [1.0, 0.5, 0.0, 1.0]
    far = readings([22.0]).with_columns({"x": np.array([500.0])}, {})
    assert as_in_a_table(far, validity)[1].tolist() == [1.0]  # a position's end holds its profile
    assert as_in_a_table(readings([40.0]), validity.model_copy(update={"fades": False}))[1].tolist() == [1.0]
