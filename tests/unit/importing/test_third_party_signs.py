"""Signs, sides and axes as people write them: understood, or asked about; never taken the other way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing import order, words
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows
from tests.unit.importing.test_first_hour import headers, long, mark, wide


def readings(header: str, sign: float = 1.0, above: str = "") -> str:
    return long(f"Run;Dir;X [mm];{header}", lambda r, x, s, d: f"{r};{mark(s)};{x};{sign * d}", above)


TURNED = ["cmd - act [um]", "CMD-ACT um", "SP - PV um", "nom. - meas. [um]", "theo - real um", "encoder - laser um"]
TURNED += ["Anzeige - Laser [µm]", "DRO minus gauge um", "Regelabweichung [µm]", "Restweg [µm]", "position lag um"]
TURNED += ["Ausgleichswert [µm]", "Verrechnungswert [µm]", "Adjustment um"]
KEPT = ["act - cmd [um]", "PV - SP um", "laser - encoder um", "meas. - nom. [um]", "Lageabweichung [µm]"]


@pytest.mark.parametrize("header", [*TURNED, *KEPT])
def test_a_difference_has_its_sign(tmp_path: Path, header: str) -> None:
    (tmp_path / "f.csv").write_text(readings(header, -1.0 if header in TURNED else 1.0), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


def test_a_line_above_that_says_the_difference_in_short(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(readings("Error um", -1.0, "# error = cmd - fbk\n"), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


ASKED = {
    "an offset": readings("Offset to enter um", -1.0),
    "a gap in front of a sensor": readings("gap um", -1.0),
    "an undershoot": readings("Undershoot [um]", -1.0),
    "too short": readings("zu kurz [µm]", -1.0),
    "names that nobody knows": readings("Xc - Xm um", -1.0),
    "names of two letters": readings("Pc-Pm um", -1.0),
    "a line on the sign": readings("Error um", -1.0, "Positive error means that the axis went short\n"),
}


@pytest.mark.parametrize("name", ASKED)
def test_a_sign_that_is_not_understood_is_asked_for(tmp_path: Path, name: str) -> None:
    (tmp_path / "f.csv").write_text(ASKED[name], encoding="utf-8")
    with pytest.raises(DataError, match="--sign"):
        imported(tmp_path, tmp_path / "f.csv")
    assert not (tmp_path / "rec").exists()
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv", sign="commanded-minus-actual"))


@pytest.mark.parametrize("header", ["Run 1 - fwd", "Achse Y - Abw.", "Lauf 2 - auf", "X-Abw.", "bi-directional error"])
def test_a_hyphen_that_is_no_difference(header: str) -> None:
    assert words.difference(header) is None


def test_lost_motion_contradicts_an_unstated_sign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A column `Delta` of the other sign went to the controller: the axis lags, so its way up ends lower."""
    rows = [
        f"{r};{s:+d};{x};{5 * np.sin(x) + 2.5 * s + 0.1 * r}" for r in (1, 2) for s in (1, -1) for x in TARGETS[::s]
    ]
    (tmp_path / "f.csv").write_text("\n".join(["Run;Dir;X [mm];Delta um", *rows]), encoding="utf-8")
    command = ["import", str(tmp_path / "f.csv"), "--out", str(tmp_path / "rec"), "--yes"]
    assert main(command) == 3 and not (tmp_path / "rec").exists()
    assert "declare it with --sign" in " ".join(capsys.readouterr().err.split())
    assert main([*command, "--sign", "commanded-minus-actual"]) == 0
    assert main([*command[:-2], str(tmp_path / "other"), "--yes", "--sign", "actual-minus-commanded"]) == 0


NAMES = ["Yerr um", "YDev um", "Yfehler [µm]", "deltaY um", "ErrorY(um)", "posErrY um", "Ey um", "EYY um", "Y誤差(um)"]


@pytest.mark.parametrize("name", NAMES)
def test_the_axis_within_the_name_of_the_readings(tmp_path: Path, name: str) -> None:
    text = long(f"Run;Dir;Target [mm];{name}", lambda r, x, s, d: f"{r};{mark(s)};{x};{d}")
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.components() == ("EYY",)
    assert recording.name("position", axis="Y") == "Target"


@pytest.mark.parametrize(
    "name", ["PosY [mm]", "TargetY [mm]", "Y軸位置[mm]", "MCS Y [mm]", "Stage Y [mm]", "posy [mm]"]
)
def test_the_axis_within_the_name_of_the_position(tmp_path: Path, name: str) -> None:
    text = long(f"Run;Dir;{name};Error [um]", lambda r, x, s, d: f"{r};{mark(s)};{x};{d}")
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    assert imported(tmp_path, tmp_path / "f.csv").components() == ("EYY",)


@pytest.mark.parametrize(
    "word", ["Achse", "Vorschub", "Wert", "Zeit", "Abweichung", "Device", "Verlagerung", "Verrechnung"]
)
def test_a_word_that_begins_like_an_axis(word: str) -> None:
    assert guessing.axis_in(word) is None


def by_target(up: str, down: str) -> str:
    """Rows in the order of the targets, both sides of each: their order says nothing of the side."""
    rows = sorted(long_rows(), key=lambda row: (row[0], row[1], -row[2]))
    return "\n".join(["Run;Direction;X [mm];Error [um]", *(f"{r};{mark(s, up, down)};{x};{d}" for r, x, s, d in rows)])


@pytest.mark.parametrize(
    ("up", "down"),
    [
        ("+X", "-X"),
        ("(+)", "(-)"),
        ("to +", "to -"),
        ("from -", "from +"),
        ("approach from minus", "approach from plus"),
    ],
)
def test_words_for_sides(tmp_path: Path, up: str, down: str) -> None:
    (tmp_path / "f.csv").write_text(by_target(up, down), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


SIDES = [("1", "0"), ("1", "2"), ("A", "B"), ("L", "R"), ("CW", "CCW"), ("Vorlauf", "Rücklauf"), ("out", "back")]


@pytest.mark.parametrize(("up", "down"), SIDES)
def test_labels_of_sides_follow_from_the_motion_or_are_queried(tmp_path: Path, up: str, down: str) -> None:
    measured = long("Run;Direction;X [mm];Error [um]", lambda r, x, s, d: f"{r};{mark(s, up, down)};{x};{d}")
    (tmp_path / "f.csv").write_text(measured, encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))
    (tmp_path / "g.csv").write_text(by_target(up, down), encoding="utf-8")
    with pytest.raises(DataError, match="does not show which of them is from below"):
        imported(tmp_path, tmp_path / "g.csv")


def test_readings_repeated_at_every_target_stay_with_their_visit() -> None:
    """Three readings a visit; the last target is turned at without a second visit, then with one."""
    up, down = np.repeat([0.0, 50.0, 100.0, 150.0], 3), np.repeat([100.0, 50.0, 0.0], 3)
    for top in (0, 3):
        x = np.r_[up, np.full(top, 150.0), down]
        assert order.motion_sides(x).tolist() == [1.0] * 12 + [-1.0] * (top + 9)
    interleaved = np.tile(np.repeat([0.0, 50.0, 100.0, 150.0], 2), 2)
    assert set(order.motion_sides(interleaved)) == {1.0}


@pytest.mark.parametrize("form", [("forward", "reverse"), ("hin", "zurück"), ("andata", "ritorno")])
def test_the_way_there_over_falling_targets_is_asked_for(tmp_path: Path, form: tuple[str, str]) -> None:
    rising = wide("Target [mm];" + headers("Run {r} {w} [um]", *form)).splitlines()
    (tmp_path / "f.csv").write_text("\n".join([rising[0], *rising[:0:-1]]), encoding="utf-8")
    with pytest.raises(DataError, match=r"the targets fall .* write \+"):
        imported(tmp_path, tmp_path / "f.csv")


def test_numbers_of_the_targets_with_a_wide_table(tmp_path: Path) -> None:
    table = wide("Target [mm];" + headers("Run {r} ({w}) [um]", "+", "-")).splitlines()
    numbered = [f"Target no.;{table[0]}", *(f"{k};{line}" for k, line in enumerate(table[1:], start=1))]
    (tmp_path / "f.csv").write_text("\n".join(numbered), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


@pytest.mark.parametrize("head", ["+{r};-{r}", "Mean up [um];Mean down [um]"])
def test_signs_before_the_run_and_a_report_of_means(tmp_path: Path, head: str) -> None:
    runs = (1, 2, 3) if "{r}" in head else (1,)
    lines = ["Target mm;" + ";".join(head.format(r=r) for r in runs)]
    for i, x in enumerate(TARGETS):
        lines.append(";".join([f"{x}", *(f"{deviation(r, s)[i]}" for r in runs for s in (1.0, -1.0))]))
    (tmp_path / "f.csv").write_text("\n".join(lines), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    x, side = recording.array("Target"), recording.array("direction")
    for r, at, s, value in zip(recording.run_labels(), x, side, recording.array("EXX"), strict=False):
        del r
        near = [abs(deviation(run, s)[int(np.argmin(np.abs(np.asarray(TARGETS) - at)))] - value) for run in runs]
        assert min(near) < 1e-9


def test_a_drift_along_no_axis_is_asked_for(tmp_path: Path) -> None:
    rows = [f"{60 * i},{20 + 0.1 * i},{0.3 * i}" for i in range(40)]
    (tmp_path / "f.csv").write_text("\n".join(["t_s,T1,Tool drift um", *rows]), encoding="utf-8")
    with pytest.raises(DataError, match="along which axis"):
        imported(tmp_path, tmp_path / "f.csv")
    assert imported(tmp_path, tmp_path / "f.csv", axis="Z").components() == ("E_Z",)


@pytest.mark.parametrize("header", ["error ppm", "error (ppm of range)", "error um/m", "Abw. [µm/m]"])
def test_readings_per_length_are_no_micrometres(tmp_path: Path, header: str) -> None:
    (tmp_path / "f.csv").write_text(readings(header), encoding="utf-8")
    with pytest.raises(DataError, match=r"per length|no known unit"):
        imported(tmp_path, tmp_path / "f.csv")


def test_a_row_of_units_between_the_ways_and_the_runs(tmp_path: Path) -> None:
    lines = ["Soll;Vorwärts;;;Rückwärts;;", "mm;µm;µm;µm;µm;µm;µm", ";1;2;3;1;2;3"]
    for i, x in enumerate(TARGETS):
        lines.append(";".join([f"{x}", *(f"{deviation(r, s)[i]}" for s in (1.0, -1.0) for r in (1, 2, 3))]))
    (tmp_path / "f.csv").write_text("\n".join(lines), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))
