"""Drift of a spindle in the words of those who log it: temperatures by bare names, displacements, labels of groups."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.formats import manifest_folder
from tests.unit.importing import known_test

HOURS = np.arange(0.0, 4.0, 0.25)


def drift(header: str, mark: str = ",", factor: float = 1.0) -> str:
    """Two runs of a spindle that warms by 10 K and grows by 2 um/K."""
    lines = [header.replace(";", mark)]
    for run, season in (("r01", "winter"), ("r02", "summer")):
        for h in HOURS:
            rise = 10.0 * (1.0 - np.exp(-h))
            cells = (run, f"{3600 * h:g}", f"{21.5:g}", f"{22 + rise:.3f}", f"{21 + 0.4 * rise:.3f}")
            lines.append(mark.join([*cells, f"{factor * 2.0 * rise:.6f}", season]))
    return "\n".join(lines)


def imported(tmp_path: Path, text: str, **said: str) -> Recording:
    (tmp_path / "log.csv").write_text(text)
    return known_test.imported(tmp_path, tmp_path / "log.csv", **said)


@pytest.mark.parametrize("response", ["drift [um]", "Z displacement [um]", "Verlagerung Z [um]", "E_Z"])
@pytest.mark.parametrize("group", ["season", "Saison", "Jahreszeit"])
def test_temperatures_a_displacement_and_groups_are_understood(tmp_path: Path, response: str, group: str) -> None:
    recording = imported(tmp_path, drift(f"run;time_s;ambient;T1;T02;{response};{group}"), component="E_Z")
    columns = recording.manifest.columns
    assert {n: columns[n].role for n in ("ambient", "T1", "T02")} == dict.fromkeys(
        ("ambient", "T1", "T02"), "temperature"
    )
    (label,) = recording.names("group")
    assert columns[label].of == "season" and set(recording.frame[label]) == {"winter", "summer"}
    assert recording.run_labels() == ("r01", "r02"), "`r01` names a run, not a way back"
    assert recording.name("direction") is None
    (error,) = recording.names("error")
    assert columns[error].component == "E_Z"
    largest = 20.0 * (1.0 - np.exp(-HOURS[-1]))
    assert recording.array(error).max() == pytest.approx(largest, abs=0.01)  # um too far: positive


def test_a_displacement_in_mm_is_a_deviation_and_one_as_long_as_a_travel_is_a_position(tmp_path: Path) -> None:
    small = imported(tmp_path, drift("run;t;room;T1;T2;Z displacement [mm];month", factor=1e-3), component="E_Z")
    assert small.array(small.names("error")[0]).max() == pytest.approx(19.5, abs=0.5)
    targets = "\n".join(["target [mm],displacement [mm]", *(f"{x},{x + 1e-5 * x:.5f}" for x in range(0, 500, 50))])
    (tmp_path / "log").mkdir()
    log = imported(tmp_path / "log", targets, axis="X")
    assert log.array(log.names("error")[0])[-1] == pytest.approx(4.5, abs=0.01)  # actual less commanded, um


def test_numbers_that_are_no_degrees_are_not_taken_for_a_temperature(tmp_path: Path) -> None:
    text = drift("run;t;room;T1;T2;drift [um];month").replace(",21.5,", ",1850,")
    recording = imported(tmp_path, text, component="E_Z")
    assert set(recording.names("temperature")) == {"T1", "T2"}


def test_a_temperature_without_a_unit_with_fahrenheit_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no unit is stated for 'ambient', and 'T1' is in degF"):
        imported(tmp_path, drift("run;t;ambient;T1 [degF];T2 [degF];drift [um];month"), component="E_Z")


def test_a_file_that_lacks_a_temperature_has_empty_cells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Before: refused ("its columns are not those of"); another name for a sensor still is."""
    whole = drift("run;t;room;T1;T2;drift [um];month").splitlines()
    day, other = [line.split(",") for line in whole], tmp_path / "day2.csv"
    (tmp_path / "day1.csv").write_text("\n".join(whole))
    for lacking in ([[*row[:4], *row[5:]] for row in day], [day[0], *([*r[:4], "", *r[5:]] for r in day[1:])]):
        other.write_text("\n".join(",".join(row) for row in lacking))
        files = [str(tmp_path / "day1.csv"), str(other)]
        assert main(["import", *files, "--out", str(tmp_path / "rec"), "--yes", "--component", "E_Z"]) == 0
        assert "day2: no reading of T2: missing" in " ".join(capsys.readouterr().out.split())
        recording = manifest_folder.read(tmp_path / "rec")
        own = np.char.startswith(np.array(recording.run_labels())[recording.run_codes()], "day2")
        assert np.array_equal(np.isnan(recording.array("T2")), own)
    other.write_text("\n".join(whole).replace("T2", "T9"))
    assert main(["import", *files, "--out", str(tmp_path / "rec"), "--yes", "--component", "E_Z"]) == 3
    assert "give a quantity one header in all files" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("clock", ["2025-07-0{day}T{h:02d}:{m:02d}:00", "2025-07-0{day};{h:02d}:{m:02d}:00"])
def test_a_log_of_a_failed_sensor_is_left_out_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], clock: str
) -> None:
    """Before: refused for a lack of a header."""
    zeit = "Datum;Uhrzeit" if ";" in clock else "Zeit"

    def written(name: str, head: str, day: int, cell: str) -> str:
        rows = [clock.format(day=day, h=6 + q // 4, m=q % 4 * 15) + ";" + cell.format(q) for q in range(16)]
        (tmp_path / name).write_text("\n".join([f"{zeit};{head}", *rows]))
        return str(tmp_path / name)

    files = [written(f"probe_{d}.csv", "E_Z Ist - Soll [um]", d, "{}.5") for d in (1, 2)]
    files += [written(f"spindle_{d}.csv", "Lager [°C]", d, "2{}.1") for d in (1, 2)]
    files += [written("room_1.csv", "Raum [°C]", 1, "21.{}"), written("room_2.csv", "Raum [°C]", 2, "")]
    assert main(["import", *files, "--out", str(tmp_path / "rec"), "--yes"]) == 0
    assert "room_2.csv: " in (said := " ".join(capsys.readouterr().out.split())) and "this file is left out" in said
    recording = manifest_folder.read(tmp_path / "rec")
    day = np.char.startswith(np.array(recording.run_labels())[recording.run_codes()], "probe_2")
    assert [np.isfinite(recording.array("Raum"))[d].sum() for d in (day, ~day)] == [0, 16]
    assert [np.isfinite(recording.array("Lager"))[d].sum() for d in (day, ~day)] == [16, 16]
    assert main(["import", files[-1], "--out", str(tmp_path / "alone"), "--yes"]) == 3


@pytest.mark.parametrize(("hour", "said"), [(6, False), (5, True), pytest.param(7, True, marks=pytest.mark.slow)])
def test_a_log_of_winter_time_in_summer_is_hinted_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], hour: int, said: bool
) -> None:
    """Both ends an hour off; a log that is stopped late, or goes on over night, is none."""

    def written(name: str, head: str, begin: str, minutes: int) -> str:
        clock = np.datetime64(f"2025-{begin}:00") + np.arange(minutes).astype("timedelta64[m]")
        (tmp_path / name).write_text("\n".join([f"Zeit;{head}", *(f"{t};2{q % 9}.1" for q, t in enumerate(clock))]))
        return str(tmp_path / name)

    probes = [written(f"probe_{d}.csv", "E_Z Ist - Soll [um]", f"{d}T06:01", 240) for d in ("01-14", "07-08")]
    files = [written("spindle_1.csv", "Lager [°C]", "01-14T06:00", 300)]
    files.append(written("spindle_2.csv", "Lager [°C]", f"07-08T0{hour}:00", 241))
    files.append(written("room.csv", "Raum [°C]", "07-08T00:00", 1440))
    assert main(["import", *probes, *files, "--out", str(tmp_path / "rec"), "--yes"]) == 0
    notes = " ".join(capsys.readouterr().out.split())
    way = "later" if hour > 6 else "earlier"
    assert notes.count("its rows begin and end") == said
    assert (f"spindle_1: its rows begin and end 1 h {way} than the deviations of probe_07-08: day" in notes) == said


@pytest.mark.parametrize("name", ["Tamb", "TRoom", "Troom", "Tbed", "room"])
def test_a_sensor_by_t_and_its_place_is_a_temperature(tmp_path: Path, name: str) -> None:
    """Before: `Tamb` was ignored."""
    recording = imported(tmp_path, drift(f"run;t;{name};T1;T2;drift [um];month"), component="E_Z")
    assert len(recording.names("temperature")) == 3
