"""Target by target: the values are ISO 230-2's means, the files keep the targets, every number by hand is printed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe import jsonfile
from errpipe.cli.app import main
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.terms.measured_points import MeasuredPoints

LOST = 6.0  # um


def deviation(x: np.ndarray, side: np.ndarray) -> np.ndarray:
    """um: 10 too long at X = 600; a wave that no polynomial of few degrees follows; lost motion."""
    return x / 60 + 4 * np.sin(x / 24) - LOST / 2 * side


def recording(targets: np.ndarray, runs: int = 3, noise: float = 0.0, both: bool = True) -> Recording:
    rng = np.random.default_rng(5)
    passes = [(r, s) for r in range(1, runs + 1) for s in ((1.0, -1.0) if both else (1.0,))]
    parts = [(str(r), s, x) for r, s in passes for x in (targets if s > 0 else targets[::-1])]
    f = pd.DataFrame(parts, columns=["run", "d", "x"])
    f["e"] = deviation(f.x, f.d) + noise * rng.normal(size=len(f))
    columns = {
        "run": Column(role="run"),
        "d": Column(role="direction", axis="X"),
        "x": Column(role="position", axis="X", unit="mm"),
        "e": Column(role="error", component="EXX", unit="um"),
    }
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), f)


def test_the_values_are_the_means_of_each_target_and_direction() -> None:
    data = recording(np.linspace(0, 600, 13), runs=5, noise=0.5)
    term = MeasuredPoints(axis="X").settled(data)
    gains, *_ = np.linalg.lstsq(term.basis(data), data.array("e"), rcond=None)
    means = data.frame.groupby(["x", "d"])["e"].mean()
    for k, target in enumerate(term.targets):
        assert gains[k] + gains[13 + k] == pytest.approx(means[target, 1.0], abs=1e-9)
        assert gains[k] - gains[13 + k] == pytest.approx(means[target, -1.0], abs=1e-9)


def test_readings_near_a_target_are_readings_of_it() -> None:
    data = recording(np.array([0.0, 7.5, 130.0, 300.0]))
    scattered = Recording(data.manifest, data.frame.assign(x=data.frame.x + np.linspace(-0.01, 0.01, len(data))))
    assert MeasuredPoints(axis="X").settled(scattered).targets == pytest.approx((0.0, 7.5, 130.0, 300.0), abs=0.01)


def test_targets_too_near_each_other_are_refused_not_averaged() -> None:
    """Each within a thousandth of the span of the next, all became one target: a constant was exported."""
    for targets in (np.linspace(0.0, 600.0, 2001), np.r_[0.0, 100.0 + 0.5 * np.arange(20), 600.0]):
        with pytest.raises(DataError, match=r"follow each other within 0.6 \(a thousandth of the span\): no list"):
            MeasuredPoints(axis="X").settled(recording(targets))


def test_a_target_measured_in_one_direction_takes_its_lost_motion_from_the_neighbours() -> None:
    data = recording(np.linspace(0, 600, 7))
    data = data.take(~((data.array("x") == 600) & (data.array("d") < 0)))
    term = MeasuredPoints(axis="X").settled(data)
    assert len(term.targets) == 7 and len(term.both) == 6
    gains, _, rank, _ = np.linalg.lstsq(term.basis(data), data.array("e"), rcond=None)
    assert rank == 13 and gains[7:] == pytest.approx(-LOST / 2)
    one_way = MeasuredPoints(axis="X").settled(recording(np.linspace(0, 600, 7), both=False))
    assert one_way.both == () and len(one_way.linear()) == 7


def test_a_log_and_a_standing_axis_are_refused() -> None:
    with pytest.raises(DataError, match="no list of targets"):
        MeasuredPoints(axis="X").settled(recording(np.linspace(0, 600, 999), runs=1))
    with pytest.raises(DataError, match="are at one position"):
        MeasuredPoints(axis="X").settled(recording(np.zeros(9)))


def exported(folder: Path, targets: np.ndarray, *names: str) -> Path:
    from errpipe.formats import manifest_folder

    manifest_folder.write(recording(targets, noise=0.1), folder / "rec")
    (folder / "p.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: ingest, recording: rec}\n  - kind: fit\n    components:\n"
        "      - {component: EXX, terms: [{term: measured_points, axis: X}]}\n"
        "    holdout: {scheme: leave-one-run-out}\n  - {kind: validate}\n"
        f"  - {{kind: export, targets: [{', '.join(names)}]}}\n"
    )
    assert main(["run", str(folder / "p.yaml"), "--out", str(folder / "out")]) == 0
    assert main(["verify", str(folder / "out/export")]) == 0
    return folder / "out" / "export"


def test_vendor_files_keep_the_targets(tmp_path: Path) -> None:
    """10 um too long at X = 600: the correction there is -10 um, and lost motion stands in both columns."""
    x = np.linspace(0, 600, 25)
    out = exported(tmp_path, x, "linuxcnc_screw", "sinumerik_lec")
    rows = np.loadtxt(out / "linuxcnc_screw/x.comp")
    assert rows[:, 0] == pytest.approx(x)
    for column, side in ((1, 1.0), (2, -1.0)):
        assert 1e3 * rows[:, column] == pytest.approx(-deviation(x, np.full(25, side)), abs=0.4)
    lec = (out / "sinumerik_lec/AX1_X_EEC.INI").read_text()
    assert "STEP[0,AX1]=25\n" in lec and "MAX[0,AX1]=600\n" in lec and lec.count("AA_ENC_COMP[0,") == 25
    (proof,) = jsonfile.read(out / "export.json")["proof"]
    assert proof["largest_difference_um"] < 0.01


def test_numbers_by_hand_and_the_sibling_are_printed(tmp_path: Path) -> None:
    out = exported(tmp_path, np.linspace(0, 600, 13), "sinumerik_lec", "haas_pitch")
    text = (out / "sinumerik_lec/CHECKLIST.md").read_text()
    (value,) = re.findall(r"MD32450 BACKLASH = (\S+) mm; above 0: the encoder runs ahead", text)
    assert float(value) == pytest.approx(1e-3 * LOST, abs=2e-4)
    assert "MD38000 MM_ENC_COMP_MAX_POINTS = 13 or more" in text
    (rms,) = re.findall(r"with the numbers entered by hand: X (\S+) um rms", text)
    assert float(rms) < 0.3
    assert "sinumerik_cec can express what sinumerik_lec cannot" in text
    haas = (out / "haas_pitch/CHECKLIST.md").read_text()
    (value,) = re.findall(r"backlash value = (\S+) mm", haas)
    assert float(value) == pytest.approx(1e-3 * LOST, abs=2e-4) and "the datum of X keeps the constant" in haas


def test_two_files_of_one_control_ask_for_no_backlash_value(tmp_path: Path) -> None:
    out = exported(tmp_path, np.linspace(0, 600, 13), "sinumerik_lec", "sinumerik_cec")
    text = (out / "sinumerik_lec/CHECKLIST.md").read_text()
    assert "MD32450 BACKLASH = 0.0000 mm" in text and "cannot; with both" not in text
    assert "they lack X 0" in text


def test_targets_at_uneven_places_are_met_within_the_error_of_the_format(tmp_path: Path) -> None:
    x = np.array([3.7, 41.2, 90.9, 151.3, 198.4, 260.6, 300.1, 377.7, 431.0, 500.5, 549.9, 600.0])
    out = exported(tmp_path, x, "linuxcnc_screw")
    rows = np.loadtxt(out / "linuxcnc_screw/x.comp")
    up = np.interp(x, rows[:, 0], rows[:, 1])
    assert 1e3 * up == pytest.approx(-deviation(x, np.ones(12)), abs=0.4)
