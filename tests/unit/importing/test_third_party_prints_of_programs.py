"""Values behind their names (prints of NC programs, line protocols, DMIS), and rows that a logger wrote in no order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows, prepared

SIDE = {1.0: "PLUS", -1.0: "MINUS"}
NS = 1764144000000000000


def lines_of(form: str, comma: bool = False) -> str:
    """`form` for each reading: r run, x target, y actual, d deviation in um, s side, i row, t ns since 1970."""
    lines = []
    for i, (r, x, s, d) in enumerate(long_rows()):
        facts = {"r": r, "x": x, "y": x + d / 1000, "d": d, "s": SIDE[s], "i": i, "t": NS + i * 30 * 10**9}
        lines.append(form.format(**facts))
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


PRINTS = {
    "WRITE of a SINUMERIK": ("log.mpf", "LAUF={r} DIR={s} X_SOLL={x:.3f} X_IST={y:.4f}", False),
    "DPRNT of a FANUC": ("log.txt", "RUN*{r} NOM*{x:9.3f} ACT*{y:9.4f}", False),
    "FN 16, a block per point": (
        "log.txt",
        "PUNKT : {i}\nLAUF : {r}\nSOLLWERT X : {x:.3f} MM\nISTWERT X : {y:.4f} MM\n",
        True,
    ),
    "line protocol": ("log.lp", "axis,axis=X cmd={x:.3f},act={y:.4f},run={r} {t}", False),
    "names and commas": ("log.csv", "run: {r}, dir: {s}, target: {x} mm, deviation: {d} um", False),
}


@pytest.mark.parametrize("name", PRINTS)
def test_values_behind_their_names_are_columns(tmp_path: Path, name: str) -> None:
    file, form, comma = PRINTS[name]
    (tmp_path / file).write_text("X AXIS\n" * (comma is False and file != "log.lp") + lines_of(form, comma))
    holds_the_truth(imported(tmp_path, tmp_path / file))


def test_lines_without_names_stay_what_they_are(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("A=1 B=2 and more\n" * 20)
    with pytest.raises(DataError, match="needed: a table of measurements"):
        prepared([tmp_path / "log.txt"])


def at(x: float, y: float) -> str:
    """Place, direction and diameter of a circle, in two lines."""
    return f"{x:.7f},{y:.7f},0.0,0.0,$\n 0.0,1.0,0.5"


@pytest.mark.parametrize("tolerances", [False, True], ids=["places", "CORTOL"])
@pytest.mark.parametrize(("unit", "size"), [("MM", 1.0), ("INCH", 25.4)])
def test_dmis_is_a_print_of_features(tmp_path: Path, tolerances: bool, unit: str, size: float) -> None:
    lines = [f"UNITS/{unit},ANGDEC"]
    for i, (x, y) in enumerate((x, y) for x in (0.0, 100.0, 200.0) for y in (0.0, 100.0)):
        dx, dy = x / 20000, -y / 50000  # mm: 10 um too far at X = 200, 2 um too short at Y = 100
        lines.append(f"F(C{i})=FEAT/CIRCLE,INNER,CART,{at(x / size, y / size)}")
        if tolerances:
            lines += [
                f"TA(X{i})=TOL/CORTOL,XAXIS,{dx / size:.7f},INTOL",
                f"TA(Y{i})=TOL/CORTOL,YAXIS,{dy / size:.7f},INTOL",
            ]
        else:
            lines.append(f"FA(C{i})=FEAT/CIRCLE,INNER,CART,{at((x + dx) / size, (y + dy) / size)}")
        lines.append(f"OUTPUT/FA(C{i})" + f",TA(X{i}),TA(Y{i})" * tolerances)
    (tmp_path / "part.dmo").write_text("\n".join(lines))
    recording = imported(tmp_path, tmp_path / "part.dmo", sign="actual-minus-commanded")
    for axis, largest in (("X", 10.0), ("Y", -2.0)):
        error = recording.array(recording.names("error", component=f"E_{axis}")[0])  # um
        place = recording.array(recording.name("position", axis=axis))
        assert error[place == place.max()] == pytest.approx(largest, abs=0.01)


HEAD = "Timestamp;X target [mm];X actual [mm];T_nut"
ROWS = [
    f"2026-11-26 08:{i // 60:02d}:{i % 60:02d};{x};{x + d / 1000:.4f};{20 + 0.1 * i:.1f}"
    for i, (_, x, _, d) in enumerate(long_rows())
]


def test_rows_in_no_order_are_put_in_the_order_of_their_dates(tmp_path: Path) -> None:
    shuffled = [ROWS[i] for i in np.random.default_rng(3).permutation(len(ROWS))]
    (tmp_path / "log.csv").write_text("\n".join([HEAD, *shuffled]))
    holds_the_truth(imported(tmp_path, tmp_path / "log.csv"))


def test_a_clock_that_was_set_back_is_no_order_of_the_rows(tmp_path: Path) -> None:
    back = [row.replace("08:00:", "07:59:") if i >= 40 else row for i, row in enumerate(ROWS)]
    (tmp_path / "log.csv").write_text("\n".join([HEAD, *back]))
    proposal, _ = prepared([tmp_path / "log.csv"])
    assert not any("sorted by date" in note for note in proposal.notes)


def test_a_row_that_is_written_twice_is_one_reading(tmp_path: Path) -> None:
    twice = [row for i, row in enumerate(ROWS) for _ in range(1 + (i in (5, 30, 60)))]
    (tmp_path / "log.csv").write_text("\n".join([HEAD, *twice]))
    recording = imported(tmp_path, tmp_path / "log.csv")
    holds_the_truth(recording)
    assert len(recording) == len(ROWS) and len(recording.run_labels()) == 3


@pytest.mark.parametrize("bits", [16, 24, 32])
def test_a_time_stamp_that_overflows_is_counted_on(tmp_path: Path, bits: int) -> None:
    step = 2**bits // 97
    rows = [f"{(2**bits - 20 * step + i * step) % 2**bits};{row.split(';', 1)[1]}" for i, row in enumerate(ROWS)]
    (tmp_path / "log.csv").write_text("\n".join(["t_ms;X target [mm];X actual [mm];T_nut", *rows]))
    recording = imported(tmp_path, tmp_path / "log.csv")
    holds_the_truth(recording)
    assert np.diff(recording.time()) == pytest.approx(step / 1000)


def test_a_sensor_that_rises_evenly_next_to_a_clock_is_none(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("\n".join([HEAD, *ROWS]))
    assert imported(tmp_path, tmp_path / "log.csv").names("temperature") == ("T_nut",)


def test_a_column_of_units_states_that_of_the_numbers_left_of_it(tmp_path: Path) -> None:
    rows = [f"{r};{x};mm;{d / 25.4:.9f};thou" for r, x, _, d in long_rows()]
    (tmp_path / "x.csv").write_text("\n".join(["Run;X target;Unit;Deviation;Unit", *rows]))
    holds_the_truth(imported(tmp_path, tmp_path / "x.csv"))


def test_a_row_of_comments_names_the_channels(tmp_path: Path) -> None:
    head = ['"Comment";"X target";"X deviation"', '"Scaling";"ON";"ON"', '"Time";"U1-1[mm]";"U1-2[um]"']
    rows = [f"{row.split(';')[0]};{x:+.5E};{d:+.5E}" for row, (_, x, _, d) in zip(ROWS, long_rows(), strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([*head, *rows]))
    holds_the_truth(imported(tmp_path, tmp_path / "log.csv"))


def test_a_stated_axis_is_used_or_refused(tmp_path: Path) -> None:
    rows = [f"{r};{x};{d}" for r, x, _, d in long_rows()]
    (tmp_path / "log.csv").write_text("\n".join(["Run;X target [mm];X deviation [um]", *rows]))
    with pytest.raises(DataError, match=r"--axis Y: column 'X target' names the axis X.*--set 'X dev"):
        prepared([tmp_path / "log.csv"], axis="Y")
    sets = ["X target.axis=Y", "X deviation.axis=Y"]
    assert imported(tmp_path, tmp_path / "log.csv", axis="Y", sets=sets).names("error", component="EYY")
    (tmp_path / "log.csv").write_text("\n".join(["Axis: X", "Run;U1 target [mm];U1 deviation [um]", *rows]))
    holds_the_truth(imported(tmp_path, tmp_path / "log.csv", axis="X"))  # a channel, as the question says


@pytest.mark.parametrize(
    "line",
    [
        "Dial gauge mounted against the axis",
        "Messuhr gegen die Achsrichtung montiert",
        "Laser direction sense: negative",
    ],
)
def test_an_instrument_that_looks_the_other_way_is_asked_about(tmp_path: Path, line: str) -> None:
    rows = [f"{r};{x};{-d}" for r, x, _, d in long_rows()]
    (tmp_path / "log.csv").write_text("\n".join(["Axis: X", line, "", "Run;Target [mm];Deviation [um]", *rows]))
    with pytest.raises(DataError, match="a line states the sign as"):
        prepared([tmp_path / "log.csv"])


def test_the_only_angle_of_a_joint_is_its_position(tmp_path: Path) -> None:
    q = np.sin(np.arange(600) / 100)
    rows = [f"{i / 100};{a:.6f};{8 * np.sign(np.cos(i / 100)) + 30 * a:.3f};{30 * a:.3f}" for i, a in enumerate(q)]
    (tmp_path / "log.csv").write_text("\n".join(["time [s];q1 [rad];tau1 [Nm];tau1_model [Nm]", *rows]))
    recording = imported(tmp_path, tmp_path / "log.csv", axis="C")
    assert np.degrees(q) == pytest.approx(recording.array(recording.name("position", axis="C")), abs=1e-3)
