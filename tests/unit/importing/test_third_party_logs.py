"""What logs of other machines ran into: columns of other motors, states of a program, scatter, held values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, UsageError
from errpipe.importing.columns import guess
from errpipe.importing.layout import RawColumn
from errpipe.importing.owners import drop_other_channels
from errpipe.importing.proposed import Proposal
from errpipe.importing.sheet import ReaderOptions
from errpipe.verbs import import_files
from tests.unit.importing.known_test import imported
from tests.unit.importing.known_test import prepared as prepared_files

T = np.arange(0, 12, 0.02)
X = 100 + 80 * np.sin(0.9 * T)
V = np.gradient(X, T)


def log(tmp_path: Path, **columns: np.ndarray) -> Path:
    """A file with a column for each name."""
    rows = zip(*(c.tolist() for c in columns.values()), strict=True)
    path = tmp_path / "log.csv"
    path.write_text(
        "\n".join([",".join(columns), *(",".join(f"{v:.9g}" for v in row) for row in rows)]) + "\n", "utf-8"
    )
    return path


def prepared(path: Path, sets: dict[str, dict[str, str]] | None = None, **said: Any) -> Proposal:
    """The proposal of a file; where it names no axis a person says X."""
    texts = [f"{name}.{key}={value}" for name, keys in (sets or {}).items() for key, value in keys.items()]
    return prepared_files([path], sets=texts, **said)[0]


def roles(path: Path, **options: Any) -> dict[str, dict[str, Any]]:
    return prepared(path, **options).entries


def test_a_spindle_and_states_of_a_program_are_nothing_of_an_axis(tmp_path: Path) -> None:
    """`S1_ActualVelocity` became a velocity of X, the number of the current program a current of 16 A."""
    entries = roles(
        log(
            tmp_path,
            **{"time [s]": T, "X1_ActualPosition [mm]": X + 0.01, "X1_SetPosition [mm]": X, "X1_ActualVelocity": V},
            **{"S1_ActualPosition": 7 * T, "S1_ActualVelocity": 7 + 0 * T, "X1_CurrentFeedback": V / 100},
            M1_CURRENT_PROGRAM_NUMBER=16 + 0 * T,
            M1_CURRENT_FEEDRATE=50 + 0 * T,
        )
    )
    assert entries["EXX"]["derived"] == {"minus": ["X1_ActualPosition", "X1_SetPosition"]}
    assert {entries[n]["role"] for n in ("S1_ActualPosition", "S1_ActualVelocity", "M1_CURRENT_PROGRAM_NUMBER")} == {
        "ignore"
    }
    assert entries["M1_CURRENT_FEEDRATE"]["role"] == "feed"
    assert (entries["X1_CurrentFeedback"]["role"], entries["X1_CurrentFeedback"]["axis"]) == ("current", "X")


def test_what_moves_with_a_motor_that_was_left_out_is_left_out() -> None:
    cells = [0.0, 1.0, 2.0]
    columns = [RawColumn(h, None, [*cells], np.array(cells)) for h in ("pos (1)", "speed (1)", "pos (2)", "speed (2)")]
    guesses = {c.header: guess(c) for c in columns}
    guesses["pos (2)"] = type(guesses["pos (2)"])("ignore", None, "")  # as `--set 'pos (2).role=ignore'` says
    kinds = {h: g.kind for h, g in drop_other_channels(columns, guesses).items()}
    assert kinds == {"pos (1)": "position", "speed (1)": "velocity", "pos (2)": "ignore", "speed (2)": "ignore"}


@pytest.mark.parametrize(
    "factor, role, ratio",
    [(1.0, "velocity", 1.0), (60.0, "velocity", 60.0), (1e-3, "velocity", 1e-3), (3.7, "ignore", 1.0)],
)
def test_a_velocity_without_a_unit_has_that_of_its_position(
    tmp_path: Path, factor: float, role: str, ratio: float
) -> None:
    """All were taken as mm/s."""
    path = log(tmp_path, **{"time [s]": T, "X cmd [mm]": X, "X act [mm]": X + 0.01, "X velocity": V * factor})
    proposal = prepared(path)
    assert proposal.entries["X_velocity"]["role"] == role
    if role == "velocity":
        assert proposal.data["X_velocity"] * ratio == pytest.approx(V * factor, rel=1e-6, abs=1e-6)


def test_a_log_in_metres_has_velocity_and_simulation(tmp_path: Path) -> None:
    """Of a log in m (rad) neither was made: it could not be diagnosed."""
    recording: Recording = imported(
        tmp_path, log(tmp_path, **{"time [s]": T, "X cmd [m]": X / 1e3, "X act [m]": X / 1e3 + 1e-5})
    )
    assert recording.array("v_X") == pytest.approx(V, rel=1e-3, abs=0.05)
    assert recording.array("EXX") == pytest.approx(10.0, abs=1e-3)
    assert not recording.array("EXX_sim").any()


def test_counts_by_their_resolution(tmp_path: Path) -> None:
    """Whole numbers without a unit became degrees, whatever --resolution stated."""
    path = log(tmp_path, **{"time [s]": T, "target pos": np.round(10 * X), "pos": np.round(10 * X) + 3})
    proposal = prepared(path, axis="C", resolution=0.05)
    assert proposal.data["pos"] - proposal.data["target_pos"] == pytest.approx(0.15)
    with pytest.raises(UsageError, match="--resolution would be ignored"):
        prepared(log(tmp_path, **{"time [s]": T, "X cmd [mm]": X, "X act [mm]": X + 0.01}), resolution=0.05)


@pytest.mark.parametrize("header", ["Image RMS [um]", "U(95) X [um]", "Std dev [um]", "ErrorCode", "Error ID"])
def test_no_deviation_by_its_name(tmp_path: Path, header: str) -> None:
    column = RawColumn(header.partition(" [")[0], "um" if "[" in header else None, [1.0, 2.0], np.array([1.0, 2.0]))
    assert guess(column).kind == "ignore"


def test_clocks_of_a_card_are_no_temperatures() -> None:
    t = np.arange(50) * 0.02
    assert guess(RawColumn("t_NI", None, t.tolist(), t)).kind == "time"
    warm = 20 + np.sin(t)
    assert guess(RawColumn("t_nut", None, warm.tolist(), warm)).kind == "temperature"


def test_an_input_is_not_in_inches(tmp_path: Path) -> None:
    """`u_in` was a position of the axis U in inches, and the axis of the file became U."""
    entries = roles(log(tmp_path, **{"time": T, "q_ref [mm]": X, "q_meas [mm]": X + 0.01, "u_in": V}), axis="X")
    assert entries["u_in"]["role"] == "ignore"
    assert "EXX" in entries


@pytest.mark.parametrize("name", ["torque", "Iq"])
def test_the_load_of_a_drive(tmp_path: Path, name: str) -> None:
    """A load in % of the rated torque was taken as N m, asked for the sign of a following error."""
    path = log(tmp_path, **{"time [s]": T, "X pos [mm]": X, name: V})
    with pytest.raises(DataError, match=f"--set {name}.role=error --set {name}.component=F_X"):
        prepared(path)
    load = {"role": "error", "component": "F_X"}
    with pytest.raises(DataError, match="no unit is stated for F_X"):
        prepared(path, sets={name: load})
    assert roles(path, sets={name: {**load, "unit": "N"}})[name]["unit"] == "N"


def test_a_component_that_is_none_is_a_wrong_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It was an internal error."""
    path = log(tmp_path, **{"time [s]": T, "torque": V})
    assert main(["import", str(path), "--out", str(tmp_path / "r"), "--set", "torque.component=M_C", "--yes"]) == 2
    assert "'M_C' is not an ISO 230-1 component" in capsys.readouterr().err
    with pytest.raises(UsageError, match="not of role velocity"):
        prepared(log(tmp_path, **{"time [s]": T, "X [mm]": X, "v": V}), sets={"v": {"role": "velocity", "unit": "kg"}})


def test_events_between_header_and_rows(tmp_path: Path) -> None:
    """The events were taken as the header."""
    rows = [f"{k},{t:.3f},Mount,{0.1 * k % 0.7:.3f},{0.2 * k % 0.9:.3f},,E" for k, t in enumerate(T[:60])]
    head = "Frame,Time,mount,dx,RA error [um],DEC,RADirection"
    events = ["INFO: SETTLING STATE CHANGE, Settling started", "INFO: SETTLING STATE CHANGE, Settling complete"]
    path = tmp_path / "guide.txt"
    path.write_text("\n".join(["Guiding Begins", head, *events, *rows]) + "\n", "utf-8")
    entries = roles(path, component="E_A", unit="arcsec", sets={"RA error": {"unit": "arcsec"}})
    assert entries["RA_error"]["role"] == "error"


def test_sheets_of_one_fault_are_named_once(tmp_path: Path) -> None:
    import pandas as pd

    path = tmp_path / "book.xlsx"
    with pd.ExcelWriter(path) as book:
        for name in ("Mon", "Tue"):
            pd.DataFrame({"Ambient": T[:20], "Bed temp": T[:20]}).to_excel(book, sheet_name=name, index=False)
    with pytest.raises(DataError, match="Mon, Tue: no column holds a deviation") as raised:
        prepared(path)
    assert str(raised.value).count("no column holds") == 1


def test_sensors_in_a_list_of_json(tmp_path: Path) -> None:
    """They were left out."""
    path = tmp_path / "log.jsonl"
    records = [{"ts": float(t), "E_Z": 0.1 * k, "of": [{"id": "C", "temp": 20.0 + k}]} for k, t in enumerate(T[:30])]
    path.write_text("\n".join(map(json.dumps, records)), "utf-8")
    assert roles(path, unit="um")["of_C_temp"]["role"] == "temperature"


def camonitor(tmp_path: Path) -> Path:
    """Axis and encoder of a controller, 5 us apart in each cycle of 10 ms; the axis stands still for a second."""
    lines = []
    for k in range(800):
        x = 50.0 + max(k - 100, 0) * 0.01
        stamp = f"2020-12-09 15:16:{10 + k // 100:02d}.{k % 100:02d}"
        if k == 0 or k > 100:
            lines.append(f"IOC:Axis1-PosSet {stamp}6116 {x:.4f}  ")
        lines.append(f"IOC:Axis1-PosAct {stamp}6121 {x + 0.002:.4f} MINOR HIGH")
    path = tmp_path / "axis1.log"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def test_values_of_camonitor_hold_and_cycles_are_rows(tmp_path: Path) -> None:
    recording = imported(tmp_path, camonitor(tmp_path), axis="X", sets=["IOC:Axis1-PosSet.unit=mm"])
    assert recording.frame.shape[0] == 800
    assert recording.array("EXX") == pytest.approx(2.0, abs=1e-6)


def test_two_positions_of_which_none_is_measured_are_asked_about(tmp_path: Path) -> None:
    """The encoder was taken as the command of the other one: the deviation had the wrong sign."""
    path = log(tmp_path, **{"time [s]": T, "X Enc PosAct [mm]": X, "X Axis PosAct [mm]": X + 0.01})
    with pytest.raises(DataError, match="both contain actual positions of X"):
        prepared(path)


def test_unknown_option_of_a_component_is_refused_before_the_file_is_read() -> None:
    with pytest.raises(UsageError, match="--component 'QQ'"):
        import_files.options_of(component="QQ", sets=[])


def test_joints_of_a_robot_are_no_runs(tmp_path: Path) -> None:
    """`j2` to `j6` were five runs of deviations in um over the targets `j1` in mm."""
    joints = {f"j{k}": 10 * k + 30 * np.sin(T[:40] + k) for k in range(2, 7)}
    with pytest.raises(DataError, match="no column holds a deviation"):
        prepared(log(tmp_path, j1=np.linspace(-90, 20, 40), **joints), axis="X")


def test_a_sensor_in_volts_is_no_force(tmp_path: Path) -> None:
    """The unit in a row of its own was not known, and the force taken as N."""
    head = "Timestamp,A,Timestamp,A\nChannel name,Force,Channel name,Dial\nUnit,V,Unit,um\n"
    path = tmp_path / "card.csv"
    path.write_text(head + "".join(f"{t:.3f},{0.1 * t:.4f},{t:.3f},{t % 0.7:.4f}\n" for t in T[:60]), "utf-8")
    entries = roles(path, component="E_X", sets={"Dial": {"role": "error"}})
    assert entries["Force_V"]["role"] == "ignore"


def test_a_log_without_header_keeps_its_own_times(tmp_path: Path) -> None:
    """A column named time was a second clock beside rows that were taken as 1 ms apart."""
    path = tmp_path / "run.dat"
    path.write_text("".join(f"{t:.6f} {x:.4f} {x + 0.01:.4f}\n" for t, x in zip(1.7 * T, X, strict=True)), "utf-8")
    proposal = prepared_files([path], ReaderOptions(names=("time", "x_cmd", "x_fb")))[0]
    assert proposal.data["time"] == pytest.approx(1.7 * T)


def test_columns_that_a_person_left_out_are_no_runs(tmp_path: Path) -> None:
    """`temp_1` to `temp_3`, ignored with --set, were three runs of deviations over the position."""
    sensors = {f"temp_{k}": 190 + np.round(3 * np.sin(T[:40] + k)) for k in range(1, 4)}
    path = log(tmp_path, **{"X pos [mm]": np.linspace(0, 40, 40)}, **sensors)
    with pytest.raises(DataError, match="no column holds a deviation"):
        prepared(path, sets={name: {"role": "ignore"} for name in sensors})
