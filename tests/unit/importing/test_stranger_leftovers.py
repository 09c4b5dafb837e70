"""What a stranger's first hour still ran into: constant sensors, units nobody wrote, devices by name, axes in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main

TARGETS = np.linspace(0, 600, 11)


def laser_export(runs: int, air: str = "20.0") -> str:
    """A laser's table with its weather station, which shows one value in every row."""
    lines = ["Run;X [mm];Direction;Error [um];Air temp [°C];Humidity [%];Pressure [hPa];Material temp [°C]"]
    for run in range(1, runs + 1):
        for side in (1, -1):
            for x in TARGETS[::side]:
                error = x / 60 + 3 * np.sin(x / 80) - 2 * side + 0.1 * run
                lines.append(f"{run};{x:g};{'+' if side > 0 else '-'};{error:.1f};{air};50;1013;20.1")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("runs", [1, 4])
def test_a_weather_station_that_shows_one_value_stops_no_test(
    tmp_path: Path, runs: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """`clean` refused it (exit code 3): four of four sensors would have been set aside."""
    (tmp_path / "laser.csv").write_text(laser_export(runs), encoding="utf-8")
    work, recording = tmp_path / "work", tmp_path / "recording"
    assert main(["import", str(tmp_path / "laser.csv"), "--out", str(recording), "--yes"]) == 0
    assert main(["init", "--template", "laser-iso230", str(work), "--recording", str(recording)]) == 0
    pipeline = work / "pipeline.yaml"
    capsys.readouterr()
    if runs == 1:  # nothing can be held out; but it is not the sensors that stop it
        assert main(["run", str(pipeline), "--out", str(work / "out"), "--to", "fit"]) == 0
        return
    assert main(["run", str(pipeline), "--out", str(work / "out")]) == 0
    assert "Air_temp set column aside: shows 20 in every row" in capsys.readouterr().out
    text = pipeline.read_text("utf-8")
    term = "          - {term: scale_expansion, axis: X, sensor: Air_temp}\n"
    pipeline.write_text(text.replace("          - {term: backlash", term + "          - {term: backlash"), "utf-8")
    assert main(["run", str(pipeline), "--out", str(work / "out")]) == 3
    assert "Air_temp: cleaning set it aside: shows 20 in every row" in capsys.readouterr().err
