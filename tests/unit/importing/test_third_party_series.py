"""Logs that were started again, prints of serial devices, series of historians, references beside encoders."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe.errors import DataError
from errpipe.importing import columns
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows, prepared

START = datetime(2026, 3, 1, 8, tzinfo=UTC).timestamp()


def test_a_logger_that_was_started_again_with_other_channels(tmp_path: Path) -> None:
    """The rows below a second header were left out where its columns stood in another order."""
    rows = long_rows()
    first = [f"{run},{x},{d}" for run, x, _, d in rows if run == "1"]
    more = [f"{d},{x},21.5,{run}" for run, x, _, d in rows if run != "1"]
    lines = ["Run,X target [mm],Error [um]", *first, "Error [um],X target [mm],T_nut [C],Run", *more]
    (tmp_path / "f.csv").write_text("\n".join(lines))
    recording = imported(tmp_path, tmp_path / "f.csv")
    holds_the_truth(recording)
    assert np.isnan(recording.array("T_nut")[: len(first)]).all() and recording.array("T_nut")[-1] == 21.5


def test_blocks_below_a_header_with_blanks_in_its_names(tmp_path: Path) -> None:
    """All blocks but the first were left out: 16 rows of 96."""
    lines, last = ["AXIS: X"], ("", 0.0)
    for run, x, side, d in long_rows():
        if (run, side) != last:
            lines += [f"RUN {run} {'FORWARD' if side > 0 else 'REVERSE'}", "POSITION (MM)   ERROR (MICRONS)"]
        lines.append(f"{x:12.3f}   {d:8.2f}")
        last = run, side
    (tmp_path / "f.txt").write_text("\n".join(lines))
    holds_the_truth(imported(tmp_path, tmp_path / "f.txt"))


@pytest.mark.parametrize(
    "line",
    [
        "[08:00:{s:02d}.5] Xcmd={x}mm Xact={a:.4f}mm T1=20.5C",
        "08:00:{s:02d} -> Xcmd: {x}, Xact: {a:.4f}, T1: 20.5",
        "Xcmd {x}, Xact {a:.4f}",
    ],
)
def test_prints_of_serial_devices(tmp_path: Path, line: str) -> None:
    said = [line.format(s=i % 60, x=x, a=x + d / 1000) for i, (_, x, _, d) in enumerate(long_rows()[:26])]
    (tmp_path / "f.txt").write_text("\n".join(said))
    proposal, _ = prepared([tmp_path / "f.txt"])
    assert proposal.entries["EXX"]["derived"] == {"minus": ["Xact", "Xcmd"]}
    assert proposal.rows == 26 and proposal.first("time") == ("t" if ":0" in line or ":{s" in line else None)


def test_a_block_of_a_program_is_no_print(tmp_path: Path) -> None:
    (tmp_path / "f.nc").write_text("\n".join(f"G1 X{x} Y{x + 1} F500" for x in range(40)))
    with pytest.raises(DataError):
        prepared([tmp_path / "f.nc"])


def test_variables_without_names_are_columns(tmp_path: Path) -> None:
    rows = long_rows()
    said = [f"VC[{i}] = {x}  VC[{i + 200}] = {x + d / 1000:.4f}" for i, (_, x, _, d) in enumerate(rows)]
    (tmp_path / "f.txt").write_text("\n".join(said))
    holds_the_truth(imported(tmp_path, tmp_path / "f.txt", sets=["VC_1.role=command", "VC_2.role=actual"]))


@pytest.mark.parametrize("ms", [False, True])
def test_series_of_pairs(tmp_path: Path, ms: bool) -> None:
    """As Prometheus (s, text) and Graphite (value, ms) answer."""
    rows = long_rows()

    def pair(i: int, value: float) -> list[object]:
        return [value, int(1000 * (START + i))] if ms else [START + i, f"{value}"]

    values = {"cmd_mm": [x for _, x, _, _ in rows], "act_mm": [x + d / 1000 for _, x, _, d in rows]}
    series = [
        {"metric": {"__name__": name, "axis": "X"}, "values": [pair(i, v) for i, v in enumerate(of)]}
        for name, of in values.items()
    ]
    (tmp_path / "f.json").write_text(json.dumps({"data": {"result": series}}))
    recording = imported(tmp_path, tmp_path / "f.json")
    holds_the_truth(recording)
    assert recording.manifest.columns["t"].epoch == "2026-03-01T08:00:00+00:00"


def test_feather_is_read_and_a_pickle_is_not_opened(tmp_path: Path) -> None:
    frame = pd.DataFrame([(run, x, d) for run, x, _, d in long_rows()], columns=["run", "X [mm]", "Error [um]"])
    frame.to_feather(tmp_path / "f.feather")
    holds_the_truth(imported(tmp_path, tmp_path / "f.feather"))
    frame.to_pickle(tmp_path / "f.pkl")
    with pytest.raises(DataError, match="a pickle, which can execute code"):
        prepared([tmp_path / "f.pkl"])


def test_a_reference_with_an_encoder_is_asked_about(tmp_path: Path) -> None:
    """It was taken as the command: with an interferometer as the reference every deviation had the other sign."""
    rows = [f"{x + d / 1000},{x + 0.001 * i:.4f}" for i, (_, x, _, d) in enumerate(long_rows())]
    (tmp_path / "f.csv").write_text("\n".join(["Reference X [mm],Encoder X [mm]", *rows]))
    with pytest.raises(DataError, match="the commanded position, or an instrument"):
        prepared([tmp_path / "f.csv"])


@pytest.mark.parametrize(
    ("header", "match"),
    [
        ("display minus reference [um]", "the set point, or an instrument"),
        ("enc-ref [um]", "the set point, or an instrument"),
        ("Scale error [um]", "does it rise"),
        ("Anzeigefehler [um]", "does it rise"),
    ],
)
def test_errors_of_what_a_machine_shows_are_asked_about(tmp_path: Path, header: str, match: str) -> None:
    """Display minus true is minus the deviation of the axis."""
    rows = [f"{run},{x},{d}" for run, x, _, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join([f"Run,X [mm],{header}", *rows]))
    with pytest.raises(DataError, match=match):
        prepared([tmp_path / "f.csv"])


def test_lost_motion_against_an_assumed_sign_is_asked_about(tmp_path: Path) -> None:
    """From 5 um on it was asked about; a smaller one was exported with the sign as it stood."""
    rows = [f"{run},{x},{-d / 2}" for run, x, _, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join(["Run,X [mm],Deviation [um]", *rows]))
    with pytest.raises(DataError, match="does not state its sign: declare it with --sign"):
        prepared([tmp_path / "f.csv"])


@pytest.mark.parametrize(("header", "assumed"), [("Deviation [um]", True), ("Actual - target [um]", False)])
def test_a_recording_says_that_its_sign_was_assumed(tmp_path: Path, header: str, assumed: bool) -> None:
    rows = [f"{run},{x},{d}" for run, x, _, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join([f"Run,X [mm],{header}", *rows]))
    constants = imported(tmp_path, tmp_path / "f.csv").manifest.constants
    assert ("sign" in constants) is assumed
    assert not assumed or constants["sign"].value == "assumed"


def test_angles_of_an_axis_that_may_be_rotary(tmp_path: Path) -> None:
    """`sec` without a known axis ended in an internal error; arcsec were taken for a pitch of X."""
    for header in ("Winkel,Abw. in sec", "Tischwinkel [Grad],Abweichung [arcsec]"):
        (tmp_path / "f.csv").write_text("\n".join([header, *(f"{30 * i},{np.sin(i):.2f}" for i in range(13))]))
        with pytest.raises(DataError, match="--axis C"):
            prepared([tmp_path / "f.csv"])
        proposal, _ = prepared([tmp_path / "f.csv"], axis="C")
        error = next(e for e in proposal.entries.values() if e["role"] == "error")
        assert error["component"] == "ECC" and error["unit"] == "arcsec"


def test_a_definition_below_the_table_is_no_title_of_rows(tmp_path: Path) -> None:
    """`Soll minus Ist` below the last row was taken for the side of the rows below it."""
    rows = [f"{run},{x},{-d}" for run, x, _, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join(["Run,X [mm],Deviation [um]", *rows, "Fehler: Soll minus Ist"]))
    proposal, _ = prepared([tmp_path / "f.csv"])
    assert proposal.entries["Deviation"]["derived"]["factor"] == -1.0


@pytest.mark.parametrize("header", ["X [mrad],Deviation [um]", "X [mm],Abw. [hPa]"])
def test_a_unit_of_another_quantity_is_refused_with_its_column(tmp_path: Path, header: str) -> None:
    """Each ended in an internal error."""
    rows = [f"{x},{d}" for _, x, _, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join([header, *rows]))
    with pytest.raises(DataError, match=r"column '.*': '.*' is no unit of role"):
        prepared([tmp_path / "f.csv"], axis="X")


def test_a_straightness_is_along_a_linear_axis():
    """`Straightness/V` is vertical: no axis has that letter, and one of rotation would make it a roll."""
    for header in ("Straightness/V", "Straightness A"):
        with pytest.raises(DataError, match="a straightness in which direction"):
            columns.other_component(header, "C")
    assert columns.other_component("Straightness Y", "X") == "EYX"
