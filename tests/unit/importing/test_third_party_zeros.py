"""Targets in coordinates of a part (G54) beside those of the machine: a table acts over the machine's own positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import TARGETS, deviation, imported, long_rows

ZERO = 312.5  # mm: of the part, in the machine's coordinates


def long_file(tmp_path: Path, place: str, other: str, unit: str = "mm", shift: float = ZERO) -> Path:
    size = {"mm": 1.0, "inch": 25.4}[unit]
    fine = 1000.0 if "(um)" in other else 1.0
    rows = [f"{run},{side:+.0f},{x / size:.6f},{(x + shift) * fine:.4f},{d}" for run, x, side, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join([f"Run,Direction,{place},{other},Error X (um)", *rows]))
    return tmp_path / "f.csv"


@pytest.mark.parametrize(
    ("place", "other", "unit"),
    [
        ("Target X (mm)", "Machine X (mm)", "mm"),
        ("G54 X (mm)", "X machine (mm)", "mm"),
        ("WCS X (mm)", "MCS X (mm)", "mm"),
        ("Sollposition X (mm)", "Maschinenposition X (mm)", "mm"),
        ("Target X (inch)", "G53 X (mm)", "inch"),
        ("Target X (mm)", "Machine X (um)", "mm"),
        ("Target X (mm)", "X machine coordinate (um)", "mm"),
    ],
)
def test_a_curve_is_given_over_the_machine_positions(tmp_path: Path, place: str, other: str, unit: str) -> None:
    recording = imported(tmp_path, long_file(tmp_path, place, other, unit))
    position, error = recording.array(str(recording.name("position"))), recording.array("Error_X")
    up = recording.array(str(recording.name("direction"))) > 0
    first = up & (recording.run_codes() == 0)
    assert position[first] == pytest.approx(TARGETS + ZERO)
    assert error[first] == pytest.approx(deviation(1, 1.0))


def test_a_curve_of_runs_side_by_side_does_too(tmp_path: Path) -> None:
    head = ["Target X (mm)", "Machine X (mm)", *(f"Run {r} {w} (um)" for r in (1, 2) for w in "+-")]
    columns = [TARGETS, TARGETS + ZERO, *(deviation(r, s) for r in (1, 2) for s in (1.0, -1.0))]
    rows = [",".join(f"{v:.3f}" for v in row) for row in np.column_stack(columns)]
    (tmp_path / "f.csv").write_text("\n".join([",".join(head), *rows]))
    recording = imported(tmp_path, tmp_path / "f.csv")
    at = recording.array(str(recording.name("position")))
    assert at.min() == pytest.approx(ZERO) and at.max() == pytest.approx(TARGETS[-1] + ZERO)


def test_where_neither_names_the_machine_it_is_asked_and_the_answer_taken(tmp_path: Path) -> None:
    file = long_file(tmp_path, "Target X (mm)", "Position (mm)")
    with pytest.raises(
        DataError, match=r"'Position' is 'Target X' \+312.5 in every row: which counts from the machine"
    ):
        imported(tmp_path, file)
    recording = imported(tmp_path, file, sets=["Position.role=command", "Target X.role=ignore"])
    assert recording.array(str(recording.name("position"))).min() == pytest.approx(ZERO)


def test_a_laser_that_was_zeroed_at_the_first_target_is_no_zero_of_a_part(tmp_path: Path) -> None:
    rows = [f"{run},{side:+.0f},{x + ZERO:.4f},{x + d / 1000:.5f}" for run, x, side, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join(["Run,Direction,Target X (mm),Laser (mm)", *rows]))
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array(str(recording.name("command"))).min() == pytest.approx(ZERO)


def test_the_role_of_another_column_leaves_the_machine_s_positions(tmp_path: Path) -> None:
    file = long_file(tmp_path, "Target X (mm)", "Machine X (mm)")
    for said in ("Run.role=run", "Direction.role=direction"):
        recording = imported(tmp_path, file, sets=[said])
        assert recording.array(str(recording.name("position"))).min() == pytest.approx(ZERO)
    recording = imported(tmp_path, file, sets=["Target X.role=position", "Machine X.role=ignore"])
    assert recording.array(str(recording.name("position"))).min() == pytest.approx(0.0)


def test_the_machine_s_angle_starts_again_at_a_whole_turn(tmp_path: Path) -> None:
    rows = [f"{a},{(a + 90) % 360},{np.sin(a / 60):.3f}" for a in range(0, 361, 10)]
    (tmp_path / "c.csv").write_text("\n".join(["C [deg],Machine C [deg],Deviation [arcsec]", *rows]))
    recording = imported(tmp_path, tmp_path / "c.csv")
    assert recording.array(str(recording.name("position")))[:3] == pytest.approx([90.0, 100.0, 110.0])
