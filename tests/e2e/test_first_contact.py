"""A new user with an unprepared file, in an empty folder: few commands to a verified file on the controller."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from errpipe import jsonfile
from errpipe.cli.app import main


def commands(*lines: str) -> None:
    """Command lines that must all succeed."""
    for line in lines:
        assert main(line.split()[1:]) == 0, line


def deviation(x: np.ndarray, side: float, rng: np.random.Generator) -> np.ndarray:
    """um: 10 um too long at X = 600, a wave that is nothing there, 6 um of lost motion, noise."""
    return x / 60 + 4 * np.sin(np.pi * x / 150) - 3 * side + 0.3 * rng.normal(size=x.size)


def wide_export(path: Path) -> None:
    """A spreadsheet export as a German Excel writes it: cp1252, semicolons, decimal commas, a preamble, sums below."""
    rng, x = np.random.default_rng(1), np.linspace(0, 600, 13)
    runs = [deviation(x, s, rng) for _ in range(5) for s in (1.0, -1.0)]

    def number(value: float) -> str:
        return f"{value:.2f}".replace(".", ",")

    lines = [
        "Messprotokoll Positionierabweichung",
        "Maschine;VMC Müller",
        "Achse;X",
        "",
        ";" + ";;".join(f"Lauf {r}" for r in range(1, 6)),
    ]
    lines.append("Soll [mm];" + ";".join(["auf [µm]", "ab [µm]"] * 5))
    lines += [";".join([number(x[i]), *(number(run[i]) for run in runs)]) for i in range(13)]
    lines.append("Mittelwert;" + ";".join(number(run.mean()) for run in runs))
    path.write_bytes("\r\n".join(lines).encode("cp1252"))


def test_a_wide_export_to_three_controllers_in_four_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    wide_export(tmp_path / "positionen.csv")
    commands(
        "errpipe import positionen.csv --out recording --yes",
        "errpipe init --template laser-iso230 work --recording recording",
        "errpipe run work/pipeline.yaml --out out",
        "errpipe verify out/export",
    )
    folders = {p.name for p in (tmp_path / "out" / "export").iterdir() if p.is_dir()}
    assert folders == {"sinumerik_lec", "linuxcnc_screw", "heidenhain_com"}
    for name in folders:
        says = re.findall(r"^- (at X = .*)\.$", (tmp_path / "out/export" / name / "CHECKLIST.md").read_text(), re.M)
        assert len(says) == 1 and "too far and will be commanded" in says[0]
    steps = np.loadtxt(tmp_path / "out/export/linuxcnc_screw/x.comp")
    end = steps[np.argmin(np.abs(steps[:, 0] - 600))]
    assert end[1:].mean() == pytest.approx(-0.010, abs=1.5e-3) or end[1:].mean() == pytest.approx(600.010, abs=1.5e-3)


def test_a_dial_gauge_to_a_screw_file_in_three_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rng, up = np.random.default_rng(2), np.linspace(0, 250, 11)
    lines = ["commanded,dial"]
    for _ in range(3):
        for side, x in ((1.0, up), (-1.0, up[::-1])):
            error = 0.0003 * x - 0.02 * side + 0.002 * rng.normal(size=x.size)
            lines += [f"{a:.1f},{a + e:.2f}" for a, e in zip(x, error, strict=True)]
    (tmp_path / "dial.csv").write_text("\n".join(lines))
    commands(
        "errpipe import dial.csv --axis X --out recording --yes",
        "errpipe init --template dial-gauge work --recording recording",
        "errpipe run work/pipeline.yaml --out out",
    )
    assert (tmp_path / "out/export/linuxcnc_screw/x.comp").is_file()


@pytest.mark.slow
def test_a_fast_log_to_a_diagnosis_in_two_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rng, t = np.random.default_rng(3), np.arange(8000) / 1000
    x = 100 + 80 * np.sin(1.3 * t) + 10 * np.sin(4.7 * t)
    v = np.gradient(x, t)
    actual = x - 0.002 * v - 0.004 * np.sign(v) + 0.0003 * rng.normal(size=t.size)
    lines = ["time [s];x_cmd [mm];x_act [mm];motor current [A];T motor [°C]"]
    lines += [
        f"{a:.3f};{b:.5f};{c:.5f};{0.3 * np.sign(d) + 0.001 * d:.3f};{30 + a / 100:.2f}"
        for a, b, c, d in zip(t, x, actual, v, strict=True)
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="utf-8")
    commands("errpipe import log.csv --out recording --yes", "errpipe diagnose recording --out diagnosis")
    assert "following error" in capsys.readouterr().out


@pytest.mark.slow
def test_a_spindle_log_to_a_model_in_three_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six hours of a spindle that is switched on and off; the growth is 3 um/K of its bearing."""
    monkeypatch.chdir(tmp_path)
    rng, t = np.random.default_rng(4), np.arange(0.0, 6 * 3600, 60.0)
    speed = np.where((t // 3600) % 2 == 0, 8000, 0)
    bearing = np.full(t.size, 22.0)
    for k in range(1, t.size):
        bearing[k] = bearing[k - 1] + 60 / 1500 * (22 + 15 * speed[k] / 8000 - bearing[k - 1])
    z = 3.0 * (bearing - 22) + 0.3 * rng.normal(size=t.size)
    lines = ["Uhrzeit;Drehzahl [1/min];T Spindellager [°C];T Raum [°C];Z Abw. [µm]"]
    for a, n, b, c in zip(t.astype(int), speed, bearing, z, strict=True):
        clock = f"{8 + a // 3600:02d}:{a // 60 % 60:02d}:00"
        lines.append(f"{clock};{n};{b:.2f};{22 + 0.3 * np.sin(a / 8000):.2f};{c:.2f}".replace(".", ","))
    (tmp_path / "spindel.csv").write_text("\n".join(lines), encoding="utf-8")
    commands(
        "errpipe import spindel.csv --out recording --yes",
        "errpipe init --template spindle-drift work --recording recording",
        "errpipe run work/pipeline.yaml --out out",
    )
    (judged,) = jsonfile.read(tmp_path / "out/validate/validation.json")["components"]
    assert judged["rms_after"] < 0.1 * judged["rms_before"]


def test_absolute_readings_called_errors_are_not_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hobbyist who declares a reading of 300 mm at 300 mm as the error gets no correction of -300 mm."""
    monkeypatch.chdir(tmp_path)
    rows = [f"{r},{s},{x},{x + 0.01 * s}" for r in range(4) for s in (1, -1) for x in range(0, 301, 25)]
    (tmp_path / "t.csv").write_text("\n".join(["run,dir,x,EXX", *rows]))
    columns = ["run: {role: run}", "dir: {role: direction, axis: X}", "x: {role: position, axis: X, unit: mm}"]
    columns.append("EXX: {role: error, component: EXX, unit: mm}")
    text = "recording: 1\ntables: [t.csv]\ncolumns:\n" + "".join(f"  {c}\n" for c in columns)
    (tmp_path / "recording.yaml").write_text(text)
    (tmp_path / "p.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: ingest, recording: .}\n  - {kind: fit, components: [{component: EXX, terms: "
        "[{term: offset}, {term: chebyshev, axis: X, degree: 2}]}]}\n  - {kind: validate}\n  - {kind: export}\n"
    )
    assert main(["run", "p.yaml", "--out", "../out"]) == 4
    heard = capsys.readouterr().err
    assert "absolute readings" in heard and "[absolute-readings]" in heard and "beyond-limit" in heard
    assert not list((tmp_path.parent / "out").glob("export/*"))


def test_a_sensor_that_stands_still_says_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A room at 22 degC all day: no library's warning reaches the terminal."""
    monkeypatch.chdir(tmp_path)
    rng, t = np.random.default_rng(5), np.arange(0.0, 4 * 3600, 60.0)
    bearing = 22 + 12 * (1 - np.exp(-t / 2500))
    rows = zip(t, bearing, 3 * (bearing - 22) + 0.3 * rng.normal(size=t.size), strict=True)
    lines = ["t [s],T_bearing [degC],T_room [degC],E_Z [um]", *(f"{a},{b:.2f},22.0,{z:.2f}" for a, b, z in rows)]
    (tmp_path / "day.csv").write_text("\n".join(lines))
    (tmp_path / "p.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: ingest, recording: day}\n  - {kind: clean}\n  - kind: fit\n    components:\n"
        "      - {component: E_Z, terms: [{term: offset}, {term: thermal_drift, sensor: T_bearing}]}\n"
        "    holdout: {scheme: blocks, blocks: 5}\n  - {kind: validate}\n  - {kind: report}\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        commands("errpipe import day.csv --out day --yes", "errpipe run p.yaml --out out")
    assert "Warning" not in capfd.readouterr().err
