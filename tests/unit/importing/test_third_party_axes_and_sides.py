"""Axes, components and sides as other programs write them: a direction, a name of a file, a display beside a laser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing.words import axis_above
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows


def table(path: Path, head: str, *, above: str = "", swap: bool = False, encoding: str = "utf-8") -> Path:
    """The known test as run, side, target and deviation."""
    signs = {1.0: "-" if swap else "+", -1.0: "+" if swap else "-"}
    rows = [f"{run};{signs[side]};{x:g};{d}" for run, x, side, d in long_rows()]
    path.write_text("\n".join([*([above] if above else []), head, *rows]), encoding=encoding)
    return path


@pytest.mark.parametrize(
    ("line", "axis"),
    [
        ("X direction", "X"),
        ("Messung in Y-Richtung", "Y"),
        ("Direction of travel: Z", "Z"),
        ("Positioning error along X", "X"),
        ("Axel X", "X"),
        ("Tengely: X", "X"),
        ("As: X", "X"),
        ("Straightness in Y direction", None),  # of an axis that is not named
        ("Y error in X direction", None),
        ("as X", None),
    ],
)
def test_an_axis_named_by_a_direction(line: str, axis: str | None) -> None:
    assert axis_above([line]) == axis


@pytest.mark.parametrize(
    ("name", "component"), [("EXX_1.csv", "EXX"), ("EYX.csv", "EYX"), ("laser EYX run.csv", "EYX")]
)
def test_the_name_of_a_file_is_a_component(tmp_path: Path, name: str, component: str) -> None:
    """Asked for the axis; with --axis X a straightness EYX became the positioning EXX."""
    recording = imported(tmp_path, table(tmp_path / name, "Run;Dir;Pos [mm];Deviation [um]"))
    assert recording.names("error", component=component)
    assert np.ptp(recording.array(recording.name("position", axis="X") or "")) == 600.0


def test_a_word_that_looks_like_a_component_of_another_axis_is_none(tmp_path: Path) -> None:
    file = table(tmp_path / "a.csv", "Run;Dir;Pos [mm];Deviation [um]", above="Device EAC 12\nAxis X")
    holds_the_truth(imported(tmp_path, file))


def test_several_components_above_are_asked_about(tmp_path: Path) -> None:
    """They were taken as positioning."""
    file = table(tmp_path / "a.csv", "Run;Dir;Pos [mm];Deviation [um]", above="X axis: EXX / EYX / EZX")
    with pytest.raises(DataError, match="name EXX, EYX, EZX: what was measured"):
        imported(tmp_path, file)


@pytest.mark.parametrize("header", ["Approach from", "Approach side", "Anfahrt von"])
def test_a_sign_below_from_is_the_side_it_came_from(tmp_path: Path, header: str) -> None:
    """Lost motion had the other sign."""
    file = table(tmp_path / "a.csv", f"Run;{header};Pos [mm];Deviation [um]", above="Axis X", swap=True)
    holds_the_truth(imported(tmp_path, file))


@pytest.mark.parametrize(
    ("own", "measured"), [("Display X", "Measured X"), ("Readout", "Laser"), ("Encoder", "Laser"), ("Machine", "Laser")]
)
def test_the_own_reading_of_a_machine_stands_for_the_command(tmp_path: Path, own: str, measured: str) -> None:
    """`Encoder` was left out beside a laser and `Display` not understood; `Machine [mm]` was a list of machines."""
    rows = [f"{run};{'+' if s > 0 else '-'};{x:g};{x + d / 1000:.4f}" for run, x, s, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join(["Axis X", f"Run;Dir;{own} [mm];{measured} [mm]", *rows]), "utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


@pytest.mark.parametrize(
    ("headers", "encoding"),
    [
        ("Pomiar;Kierunek;Zadana [mm];Zmierzona [mm]", "utf-8"),
        ("Pomiar;Kierunek;Wartość zadana [mm];Wartość zmierzona [mm]", "cp1250"),
        ("Mätning;Riktning;Börvärde [mm];Ärvärde [mm]", "utf-8"),
        ("Meting;Richting;Gewenst [mm];Gemeten [mm]", "utf-8"),
        ("Měření;Směr;Žádaná [mm];Skutečná [mm]", "utf-8"),
        ("Ölçüm;Yön;Hedef [mm];Ölçülen [mm]", "utf-8"),
        ("Проход;Направление;Заданная [мм];Измеренная [мм]", "cp1251"),
        ("Mérés;Irány;Célpozíció [mm];Mért [mm]", "cp1250"),
        ("회차;방향;목표위치 [mm];측정위치 [mm]", "cp949"),
    ],
)
def test_commanded_and_measured_in_more_languages(tmp_path: Path, headers: str, encoding: str) -> None:
    rows = [f"{run};{'+' if s > 0 else '-'};{x:g};{x + d / 1000:.4f}" for run, x, s, d in long_rows()]
    (tmp_path / "f.csv").write_text("\n".join([headers, *rows]), encoding)
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


def test_polish_of_windows(tmp_path: Path) -> None:
    """`Odchy³ka` was asked for its sign."""
    head = "Przejazd;Kierunek;Pozycja zadana [mm];Odchyłka [um]"
    holds_the_truth(imported(tmp_path, table(tmp_path / "f.csv", head, above="Oś: X", encoding="cp1250")))


def test_names_behind_a_mark_of_comments(tmp_path: Path) -> None:
    rows = [f"{x:10.4f} {x + d / 1000:10.4f} {'+' if s > 0 else '-'} {run}" for run, x, s, d in long_rows()]
    head = ["; Laser log", "; Axis=X", "; target_mm laser_mm approach run"]
    (tmp_path / "f.log").write_text("\n".join([*head, *rows]), "utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.log"))


@pytest.mark.parametrize("runs", [True, False])
def test_lines_among_the_rows_state_the_side(tmp_path: Path, runs: bool) -> None:
    """Targets that rise in both sections: the side was lost, and lost motion was scatter between runs."""
    lines, last = ["Axis X", "Target [mm];Error [um]"], ""
    for run, x, side, d in sorted(long_rows(), key=lambda r: (r[0] if runs else "", -r[2], r[0], r[1])):
        title = (f"Run {run} " if runs else "") + ("forward" if side > 0 else "reverse")
        lines += [*([title] if title != last else []), f"{x:g};{d}"]
        last = title
    (tmp_path / "f.csv").write_text("\n".join(lines), "utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    side_of = {(x, d) for x, d in zip(recording.array("Target"), recording.array("direction"), strict=True)}
    assert len(side_of) == 26
    got = sorted(zip(recording.array("Target"), recording.array("direction"), recording.array("Error"), strict=True))
    assert got == pytest.approx(sorted((x, s, d) for _, x, s, d in long_rows()))
    if runs:
        holds_the_truth(recording)


def test_a_side_that_is_stated_for_the_last_rows_alone_is_asked_about(tmp_path: Path) -> None:
    lines = ["Axis X", "Target [mm];Error [um]", "0;1", "50;2", "100;3", "reverse", "0;5", "50;6", "100;7"]
    (tmp_path / "f.csv").write_text("\n".join(lines), "utf-8")
    with pytest.raises(DataError, match="'reverse', but none states from which side the rows above"):
        imported(tmp_path, tmp_path / "f.csv")


def by_target(path: Path, head: str, ways: tuple[str, str], encoding: str = "utf-8", above: str = "Axis X") -> Path:
    """The known test, each target's readings together: the order of the rows states no side."""
    rows = sorted(long_rows(), key=lambda r: (r[1], r[0], -r[2]))
    lines = [f"{run};{ways[0] if s > 0 else ways[1]};{x:g};{d}" for run, x, s, d in rows]
    path.write_text("\n".join([above, head, *lines]), encoding)
    return path


@pytest.mark.parametrize(
    ("head", "ways", "above", "encoding"),
    [
        ("Passada;Direção;Posição alvo [mm];Desvio [um]", ("ida", "volta"), "Eixo X", "cp1252"),
        ("Ensayo;Dirección;Posición nominal [mm];Error [um]", ("subida", "bajada"), "Eje X", "cp1252"),
        ("Prova;Verso;Quota [mm];Deviazione [um]", ("salita", "discesa"), "Asse X", "utf-8"),
        ("Seria;Kierunek;Zadana [mm];Błąd [um]", ("dodatni", "ujemny"), "Oś X", "cp1250"),
        ("回数;方向;指令値 [mm];偏差 [um]", ("正", "負"), "軸名 X", "cp932"),
    ],
)
def test_sides_in_more_languages(tmp_path: Path, head: str, ways: tuple[str, str], above: str, encoding: str) -> None:
    """`Direção` in Windows-1252 was read as Chinese; its two words, and the Polish ones, were left out in silence."""
    holds_the_truth(imported(tmp_path, by_target(tmp_path / "f.csv", head, ways, encoding, above)))


def test_two_unknown_words_at_every_target_are_asked_about(tmp_path: Path) -> None:
    """They were left out, and lost motion was scatter between runs."""
    file = by_target(tmp_path / "f.csv", "Run;Kulku;Pos [mm];Deviation [um]", ("meno", "paluu"))
    with pytest.raises(DataError, match="'Kulku' has 'meno' and 'paluu'"):
        imported(tmp_path, file)
    assert imported(tmp_path, file, sets=["Kulku.role=ignore"]).name("direction") is None


@pytest.mark.parametrize(
    "head", ["Проход;Направление;Заданная [mm];Измеренное - Заданное [um]", "x;Dir;Zadana [mm];Zmierzona - Zadana [um]"]
)
def test_differences_in_more_languages(tmp_path: Path, head: str) -> None:
    """They were asked for their sign, or a second command."""
    holds_the_truth(imported(tmp_path, by_target(tmp_path / "f.csv", head.replace("x;", "Run;"), ("+", "-"))))
