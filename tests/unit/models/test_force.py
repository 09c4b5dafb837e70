"""The force family: milling without an axis, separate structure and bodies, and what is refused."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting.components import evaluate
from errpipe.kinematics import beam
from errpipe.models.force import Force

PUSHED = {"sections": [{"length": 80.0, "diameter": 32.0}]}
SLENDER = {"sections": [{"length": 60.0, "diameter": 32.0}, {"length": 70.0, "diameter": 12.0}]}
STRUCTURE = 0.02  # um/N


def pushes(sign: float = 1.0) -> Recording:
    """A stiff test bar in a milling spindle, pushed with 0 to 400 N in three runs."""
    rng = np.random.default_rng(2)
    force = np.tile(np.linspace(0.0, 400.0, 9), 3)
    bar = float(beam.compliance([beam.Section(80.0, diameter=32.0)], np.array([80.0]))[0])
    columns = {
        "run": Column(role="run"),
        "F": Column(role="force", unit="N"),
        "E_Y": Column(role="error", component="E_Y", unit="um"),
    }
    value = sign * force * (STRUCTURE + bar) + np.repeat([0.0, 5.0, -3.0], 9) + rng.normal(0, 0.1, force.size)
    frame = pd.DataFrame({"run": np.repeat(["1", "2", "3"], 9), "F": force, "E_Y": value})
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)


def milling(**more) -> Force:
    return Force(configuration="milling", component="E_Y", force="F", pushed_tool=PUSHED, tool=SLENDER, **more)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_slender_milling_tool_takes_the_place_of_the_bar_that_was_pushed(sign):
    recording = pushes(sign)
    fitted = milling(sign=sign).fit(recording)
    tool = [beam.Section(60.0, diameter=32.0), beam.Section(70.0, diameter=12.0)]
    gives = STRUCTURE + float(beam.compliance(tool, np.array([130.0]))[0])
    said = evaluate(fitted.model, recording)["E_Y"]
    np.testing.assert_allclose(said, sign * recording.array("F") * gives, atol=0.3)


def test_a_force_column_that_is_not_there_is_named():
    with pytest.raises(DataError, match=r"no column .thrust. of role force .there are: F."):
        milling().model_copy(update={"force": "thrust"}).fit(pushes())


def test_turning_needs_the_axis_of_the_cut():
    with pytest.raises(ValidationError, match="turning needs the axis"):
        Force(force="F")


POST, SPINDLE, TILT, CLAMP = 0.012, 0.008, 0.9, 0.003  # um/N; TILT um/N per m2 of lever
MANDREL = {"sections": [{"length": 220.0, "diameter": 70.0}]}


def gauged(sign: float = 1.0, bed: bool = False, drop: tuple[str, ...] = ()) -> Recording:
    """A lathe pushed at five places, a gauge at the tool post, one at the spindle, one at the workpiece."""
    rng = np.random.default_rng(3)
    places = np.repeat([20.0, 70.0, 120.0, 170.0, 210.0], 11)
    force = np.tile(np.r_[0:501:100, 400:-1:-100].astype(float), 5)
    shaft = beam.compliance([beam.Section(220.0, diameter=70.0)], places)
    gives = {"tool_post": POST, "spindle": SPINDLE + TILT * (places * 1e-3) ** 2, "workpiece": CLAMP + shaft}
    if bed:
        gives["workpiece"] = gives["workpiece"] + gives["spindle"]
    run = np.array([f"Z{z:g}" for z in places])
    frame = {"run": run, "Z": places, "F": force}
    columns = {
        "run": Column(role="run"),
        "Z": Column(role="position", axis="Z", unit="mm"),
        "F": Column(role="force", unit="N"),
    }
    for name in (n for n in gives if n not in drop):
        frame[name] = sign * force * gives[name] + rng.normal(0, 3) + rng.normal(0, 0.1, force.size)
        columns[name] = Column(role="error", component="E_X", unit="um", location=name)
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), pd.DataFrame(frame))


def turning(**more) -> Force:
    return Force(force="F", axis="Z", pushed_workpiece=MANDREL, workpiece=MANDREL, **more)


@pytest.mark.parametrize("bed", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
def test_gauges_at_three_places_give_each_its_compliance_and_the_table_their_sum(sign, bed):
    """Pushed apart at +X by a positive force (sign 1): the reported deviation is positive and complete."""
    recording = gauged(sign, bed)
    fitted = turning(sign=sign, gauge_datum="bed" if bed else "neighbour").fit(recording)
    value = fitted.documents["compliance.json"]
    assert value["not_gauged"] == []
    levels = {name: part["structure_um_per_N"] for name, part in value["parts"].items()}
    assert levels["tool_post"]["level"] == pytest.approx(POST, abs=2e-4)
    assert levels["workpiece"]["level"] == pytest.approx(CLAMP, abs=4e-4)
    at = np.array(value["curve"]["position"])
    spindle = SPINDLE + TILT * (at * 1e-3) ** 2
    np.testing.assert_allclose(value["curve"]["spindle_gauged_um_per_N"], spindle, atol=6e-4)
    said = evaluate(fitted.model, recording)["E_X"]
    z = recording.array("Z")
    shaft = beam.compliance([beam.Section(220.0, diameter=70.0)], z)
    true = recording.array("F") * (POST + SPINDLE + TILT * (z * 1e-3) ** 2 + CLAMP + shaft)
    np.testing.assert_allclose(said, sign * true, atol=0.3)
    assert said[5] * sign > 10  # 500 N


def test_a_lathe_whose_axis_counts_towards_the_chuck_has_the_same_compliance():
    ahead = gauged()
    back = Recording(ahead.manifest, ahead.frame.assign(Z=300.0 - ahead.array("Z")))
    said = evaluate(turning().fit(ahead).model, ahead)["E_X"]
    turned = evaluate(turning(outwards=-1, chuck_face=300.0).fit(back).model, back)["E_X"]
    np.testing.assert_allclose(turned, said, atol=1e-6)
    with pytest.raises(DataError, match="give `chuck_face`"):
        turning(chuck_face=300.0).fit(back)


def test_gauges_that_sat_out_are_predicted_at_their_noise():
    recording = gauged()
    options = turning()
    _, folds = options.folds(recording, None)
    left = [options.validate_fold(recording, fold)["E_X"] for fold in folds]
    assert len(left) > 2 and max(f.rms(f.after) for f in left) < 2 * 0.1 * np.sqrt(3) < 5 < left[0].rms(left[0].before)


def test_a_gauge_that_was_not_there_is_named():
    fitted = turning().fit(gauged(drop=("spindle",)))
    value = fitted.documents["compliance.json"]
    assert value["not_gauged"] == ["spindle"] and "spindle" not in value["parts"]
    (table,) = turning().tables(fitted.documents, {})
    assert "No gauge at spindle" in table.caption and "tool post gauged, um/kN" in table.columns


def test_a_gauge_of_the_wrong_sign_is_refused_and_named():
    recording = gauged()
    turned = recording.with_columns({"tool_post": -recording.array("tool_post")}, {})
    with pytest.raises(DataError, match=r"compliance of the tool_post would be -0\.01"):
        turning().fit(turned)


@pytest.mark.parametrize("place", [None, "chuck", "spindle"])
def test_columns_of_one_component_need_a_place_each(place):
    recording = gauged()
    column = Column(role="error", component="E_X", unit="um", location=place)
    wrong = recording.with_columns({}, {"tool_post": column})
    with pytest.raises(DataError, match=r"is not a gauge|the same location"):
        turning().fit(wrong)
    with pytest.raises(DataError, match="omit pushed_tool"):
        turning(pushed_tool=PUSHED).fit(recording)
