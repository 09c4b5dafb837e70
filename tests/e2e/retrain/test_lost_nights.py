"""Nights that bring nothing: a sensor that is silent, a file that is torn."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from errpipe.cli.app import main
from tests.e2e.retrain.test_retrain import failed, made, record, retrain, site  # noqa: F401  # fixtures


def without_the_nut(site: Path, first: int, last: int) -> None:  # noqa: F811
    """Days of a recording in which the sensor of the nut reads nothing."""
    file = site / "recording/recording.csv"
    frame = pd.read_csv(file)
    silent = frame["run"].str.split().str[1].astype(int).between(first, last)
    frame.assign(T_nut=np.where(silent, np.nan, frame["T_nut"])).to_csv(file, index=False)


def test_a_sensor_that_is_silent_is_named_and_its_nights_are_no_evidence(site: Path) -> None:  # noqa: F811
    """It stopped the whole look (exit 3), and days of which nothing is predicted passed for another machine."""
    record(site / "recording", 20)
    without_the_nut(site, 15, 19)
    code, document = retrain(site)
    assert code == 4 and "readings of T_nut" in failed(document)
    (says,) = (g["says"] for g in document["gates"] if g["name"] == "readings of T_nut")
    assert "day 19: no evidence, and none in the last run" in says
    assert {run["run"] for run in document["runs"]} == {"day 12", "day 13", "day 14"}
    assert not any(document["drift"].values())


def test_a_sensor_that_came_back_stops_nothing(site: Path) -> None:  # noqa: F811
    record(site / "recording", 20)
    without_the_nut(site, 15, 16)
    _, document = retrain(site)
    assert "readings of T_nut" not in failed(document) and not any(document["drift"].values())
    assert {"day 15", "day 16"}.isdisjoint(run["run"] for run in document["runs"])


def test_a_torn_file_is_on_the_pages_of_its_night(site: Path) -> None:  # noqa: F811
    record(site / "recording", 16)
    retrain(site)
    file = site / "recording/recording.csv"
    file.write_bytes(file.read_bytes()[:-40] + b"\x00\xff\x13")
    arguments = ["--champion", str(site / "champion"), "--out", str(site / "out")]
    assert main(["retrain", str(site / "axis.yaml"), *arguments]) == 3
    suite = ElementTree.fromstring((site / "out/retrain.junit.xml").read_text(encoding="utf-8"))
    assert suite.attrib["errors"] == "1" and "recording.csv:" in str(suite[0][0].get("message"))
    assert "not judged" in (site / "out/retrain.md").read_text(encoding="utf-8")
