"""A shop's logs of several days: a controller's temperatures, a file a day, and a probe at its own times."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import imported, prepared

DAYS = ("2025-01-14", "2025-01-15", "2025-04-08")
SENSORS = ("Lager", "KSS-Tank")
WARM = {"Lager": 24.0, "KSS-Tank": 4.0}  # K above the room at the end of a shift


def shift(day: str) -> datetime:
    return datetime.fromisoformat(f"{day}T06:00:00")


def log(folder: Path, day: str, sensors: tuple[str, ...] = SENSORS, unit: str = "°C", scale: str = "degC") -> Path:
    """Temperatures every 30 s over a shift of 200 rows."""
    folder.mkdir(exist_ok=True)
    lines = ["Zeit;" + ";".join(f"{s} [{unit}]" for s in sensors)]
    for k in range(200):
        values = [15.0 + WARM[s] * k / 200 for s in sensors]
        values = [1.8 * v + 32.0 for v in values] if scale == "degF" else values
        cells = [f"{v:.1f}".replace(".", ",") for v in values]
        lines.append(";".join([f"{shift(day) + timedelta(seconds=30 * k):%d.%m.%Y %H:%M:%S}", *cells]))
    (folder / f"SPS_{day}.csv").write_text("\n".join([*lines, ""]), "utf-8")
    return folder / f"SPS_{day}.csv"


def probe(folder: Path, day: str) -> Path:
    """Deviations every 500 s, from 100 s after the first row of the log on."""
    folder.mkdir(exist_ok=True)
    times = [shift(day) + timedelta(seconds=100 + 500 * k) for k in range(12)]
    rows = [f"{t:%d.%m.%Y %H:%M:%S};" + f"{3.1 * k:.1f}".replace(".", ",") for k, t in enumerate(times)]
    text = "\n".join(["Zeit;Abweichung Z (Ist - Soll) [µm]", *rows, ""])
    (folder / f"Taster_{day}.csv").write_text(text, "utf-8")
    return folder / f"Taster_{day}.csv"


def days(tmp_path: Path) -> list[Path]:
    return [f(tmp_path, day) for day in DAYS for f in (log, probe)]


def test_rows_of_the_log_between_two_days_are_two_runs(tmp_path: Path) -> None:
    """The end of one shift and the start of the next were one run of days, or of months."""
    recording = imported(tmp_path, days(tmp_path))
    spans = recording.frame.groupby(recording.name("run"))[recording.name("time")].agg(np.ptp)
    assert spans.max() < 200 * 30 and len(spans) == 3 + 2 * 3


def test_files_of_one_name_are_separate_runs(tmp_path: Path) -> None:
    other = probe(tmp_path / "b", DAYS[1]).rename(tmp_path / "b" / f"Taster_{DAYS[0]}.csv")
    files = [log(tmp_path, day) for day in DAYS[:2]] + [probe(tmp_path, DAYS[0]), other]
    recording = imported(tmp_path, files)
    runs = recording.frame[np.isfinite(recording.array("Abweichung_Z_Ist_Soll"))][recording.name("run")]
    assert runs.value_counts().to_dict() == {f"{tmp_path.name}_Taster_{DAYS[0]}": 12, f"b_Taster_{DAYS[0]}": 12}


def test_a_file_of_a_log_may_lack_a_sensor(tmp_path: Path) -> None:
    """It became a second log, with a second column for each sensor."""
    files = days(tmp_path)
    files[4] = log(tmp_path, DAYS[2], ("Lager",))
    proposal, _ = prepared(files)
    assert [n for n, e in proposal.entries.items() if e["role"] == "temperature"] == ["Lager", "KSS_Tank"]
    assert f"SPS_{DAYS[2]}: no reading of KSS_Tank: missing" in proposal.notes


def test_two_logs_of_one_time_stay_two(tmp_path: Path) -> None:
    log(tmp_path / "b", DAYS[0], ("Lager",)).rename(tmp_path / "b" / "room.csv")
    proposal, _ = prepared([log(tmp_path, DAYS[0]), probe(tmp_path, DAYS[0]), tmp_path / "b" / "room.csv"])
    assert sum(e["role"] == "temperature" for e in proposal.entries.values()) == 3


@pytest.mark.parametrize("end", [b"", b"\0" * 4096])
def test_a_file_copied_in_part_is_reported_and_its_torn_row_is_no_reading(tmp_path: Path, end: bytes) -> None:
    """`...;2` of `...;27,5;15,9` was a reading of 2 degC."""
    files = days(tmp_path)
    text = files[2].read_bytes()
    lines = text.split(b"\n")
    files[2].write_bytes(b"\n".join(lines[:101]) + b"\n" + lines[101][:-8] + end)
    assert lines[101][:-8].count(b";") == 1
    proposal, _ = prepared(files)
    assert np.nanmin(proposal.data["Lager"]) == 15.0
    said = [note for note in proposal.notes if note.startswith(f"SPS_{DAYS[1]}: ")]
    assert any("line 102 has 2 of 3 cells and no end of line" in note for note in said)
    assert any("4096 bytes of zeros" in note for note in said) == bool(end)


def test_a_last_line_of_text_is_no_torn_row(tmp_path: Path) -> None:
    files = days(tmp_path)
    files[0].write_text(files[0].read_text("utf-8") + "Ende der Messung", "utf-8")
    assert not any("no end of line" in note for note in prepared(files)[0].notes)


@pytest.mark.parametrize("which", [2, 3], ids=["log", "probe"])
def test_notes_on_later_files_are_shown_with_their_name(tmp_path: Path, which: int) -> None:
    files = days(tmp_path)
    lines = files[which].read_text("utf-8").split("\n")
    lines[5] = ";".join([*lines[5].split(";")[:-1], "defekt"])
    files[which].write_text("\n".join(lines), "utf-8")
    notes = prepared(files)[0].notes
    assert any(note.startswith(f"{files[which].stem}: 1 rows") for note in notes)
    assert not any("no axis is named" in note for note in notes)


@pytest.mark.parametrize(("unit", "scale", "right"), [("°C", "degF", "degF"), ("°F", "degC", "degC")])
def test_a_day_on_another_scale_than_its_header_says_is_refused(
    tmp_path: Path, unit: str, scale: str, right: str
) -> None:
    files = days(tmp_path)
    rest = "degF" if right == "degC" else "degC"
    for n, day in enumerate(DAYS):
        log(tmp_path, day, unit=unit, scale=scale if n == 2 else rest)
    with pytest.raises(DataError, match=rf"SPS_{DAYS[2]}: all temperatures lie .* agree with them in {right}.*--set"):
        prepared(files)
    stated = [f"{name}.unit={rest}" for name in ("Lager", "KSS_Tank")]
    assert prepared(files, sets=stated)[0].rows


def test_a_day_in_another_unit_by_its_header_is_converted(tmp_path: Path) -> None:
    files = days(tmp_path)
    log(tmp_path, DAYS[2], unit="°F", scale="degF")
    proposal, _ = prepared(files)
    assert np.nanmax(proposal.data["Lager"]) == pytest.approx(38.9, abs=0.1)


def test_two_capitals_of_s_in_a_name_are_no_sharp_s(tmp_path: Path) -> None:
    assert "KSS_Tank" in prepared(days(tmp_path))[0].entries
