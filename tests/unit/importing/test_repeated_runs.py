"""Runs that are numbered anew each day."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.importing.known_test import imported, long_rows

DAYS = ("2026-03-04", "2026-03-05")


def numbered_anew(tmp_path: Path, dated: bool) -> Path:
    """The known test made on two days, runs 1 to 3 on either."""
    head = "Date,Run,Target X [mm],Side,Deviation [um]" if dated else "Run,Target X [mm],Side,Deviation [um]"
    rows = [
        (f"{day}," if dated else "") + f"{run},{x:g},{'+' if side > 0 else '-'},{d + 20 * k:.1f}"
        for k, day in enumerate(DAYS)
        for run, x, side, d in long_rows()
    ]
    (tmp_path / "f.csv").write_text("\n".join([head, *rows]), encoding="utf-8")
    return tmp_path / "f.csv"


@pytest.mark.parametrize("dated", [True, False])
def test_runs_that_are_numbered_anew_are_other_runs(tmp_path: Path, dated: bool) -> None:
    """As one run, 20 um between the days would be its noise, and no run left out would be of another day."""
    recording = imported(tmp_path, numbered_anew(tmp_path, dated))
    runs = [f"{day} {n}" for day in DAYS for n in (1, 2, 3)] if dated else ["1", "2", "3", "1 (2)", "2 (2)", "3 (2)"]
    assert recording.run_labels() == tuple(runs)


def test_rows_sorted_by_target_are_the_runs_they_say(tmp_path: Path) -> None:
    """Each run comes back at every target, and measures none of them again."""
    rows = sorted(long_rows(), key=lambda row: (row[1], -row[2], row[0]))
    lines = [f"{run},{x:g},{'+' if side > 0 else '-'},{d:.1f}" for run, x, side, d in rows]
    (tmp_path / "f.csv").write_text("\n".join(["Run,Target X [mm],Side,Deviation [um]", *lines]), encoding="utf-8")
    assert imported(tmp_path, tmp_path / "f.csv").run_labels() == ("1", "2", "3")
