"""Exports of historians and databases: a row per value becomes a column per signal."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from tests.unit.importing.known_test import imported

START = datetime(2026, 3, 31, 8)
COUNT = 60
WARM = np.round(20.0 + 5.0 * (1.0 - np.exp(-np.arange(COUNT) / 20.0)), 3)
DRIFT = np.round(3.0 * (WARM - 20.0) + 0.4 * np.sin(np.arange(COUNT)), 2)


def clock(k: int, form: str) -> str:
    return (START + timedelta(seconds=30 * k)).strftime(form)


FORMS = {
    "a database, drifts less often": (
        "_time,_measurement,_field,_value",
        "%Y-%m-%dT%H:%M:%SZ",
        lambda when, k: [
            f"{when},vmc,T_front,{WARM[k]}",
            *([f"{when},vmc,drift_Z_um,{DRIFT[k]}"] if k % 5 == 0 else []),
        ],
    ),
    "a historian in German, with units": (
        "Zeitstempel;Messstelle;Wert;Einheit",
        "%d.%m.%Y %H:%M:%S",
        lambda when, k: [
            f"{when};Lager vorn;{WARM[k]}".replace(".", ",", 0) + ";°C",
            f"{when};Z Verlagerung;{DRIFT[k]};µm",
        ],
    ),
    "no header, a quality": (
        "",
        "%Y-%m-%dT%H:%M:%SZ",
        lambda when, k: [f"Temp.Front,{when},{WARM[k]},Good", f"Z drift um,{when},{DRIFT[k]},Good"],
    ),
}


@pytest.mark.parametrize("one_after_the_other", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_signals_become_columns(tmp_path: Path, form: str, one_after_the_other: bool) -> None:
    header, dates, rows = FORMS[form]
    lines = [line for k in range(COUNT) for line in rows(clock(k, dates), k)]
    if one_after_the_other:  # the drift first: its times alone come before all others
        lines.sort(key=lambda line: "drift" not in line and "Verlagerung" not in line)
    (tmp_path / "f.csv").write_text("\n".join([*([header] if header else []), *lines, ""]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    drift = recording.array(recording.names("error")[0])
    known = np.isfinite(drift)
    assert recording.array(recording.name("temperature")) == pytest.approx(WARM)
    assert drift[known] == pytest.approx(DRIFT[:: 5 if "less often" in form else 1])
    assert recording.time() == pytest.approx(30.0 * np.arange(COUNT))


def test_a_table_of_labelled_rows_is_no_log_of_signals(tmp_path: Path) -> None:
    """Runs by name, targets and deviations: two columns of numbers beside one of words."""
    rows = [f"run {r},{x},{0.01 * x + r:.2f}" for r in (1, 2, 3) for x in range(0, 500, 50)]
    (tmp_path / "f.csv").write_text("\n".join(["Name,Target X [mm],Deviation [um]", *rows, ""]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert len(recording) == len(rows)
