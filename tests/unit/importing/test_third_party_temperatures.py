"""Temperatures without a unit, in the words of those who name the sensor or its place; and what is called alike."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from errpipe.domain.recording import Recording
from errpipe.importing.columns import UNKNOWN, ColumnGuess, guess
from errpipe.importing.layout import RawColumn
from errpipe.importing.temperatures import with_temperatures
from errpipe.importing.units import split_header
from tests.unit.importing import known_test

ROWS = 120
WARM = np.round(22.0 + 9.0 * (1.0 - np.exp(-3.0 * np.linspace(0.0, 1.0, ROWS))), 2)
STEPS = np.repeat([24.0, 60.0, 31.0, 24.0], ROWS // 4)
NOISE = np.random.default_rng(5).normal(0.0, 0.06, ROWS)


def seen(header: str, values: np.ndarray) -> tuple[ColumnGuess, list[str]]:
    """What is made of one column, and the notes."""
    name, unit = split_header(header)
    column = RawColumn(name, unit, [f"{v:g}" for v in values], values)
    guesses, notes = with_temperatures([column], {name: guess(column)})
    return guesses[name], notes


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize(
    "header",
    [
        *("TC1 spindle", "TC6 coolant", "TC_room", "T03 column", "T-Spindle", "RTD2 bed", "NTC nut X", "Pt100 head"),
        *(
            "Spindle brg front",
            "spindle nose",
            "column front",
            "ballscrew nut Y",
            "coolant in",
            "hydraulic oil",
            "bed 2",
        ),
        *(
            "Spindel vorn",
            "Spindellager hinten",
            "Ständer links",
            "Kühlmittel",
            "Hallenluft",
            "Mutter X",
            "Glasmaßstab",
        ),
        *(
            "broche",
            "palier broche avant",
            "bâti",
            "mandrino",
            "cuscinetto anteriore",
            "husillo",
            "主轴",
            "主軸",
            "室温",
        ),
    ],
)
def test_a_sensor_or_a_place_that_warms_slowly_is_a_temperature(header: str, noise: float) -> None:
    found, notes = seen(header, np.round(WARM + noise * NOISE, 2))
    assert found.kind == "temperature", header
    assert not notes


@pytest.mark.parametrize(
    ("header", "values"),
    [
        *((name, 200.0 * STEPS) for name in ("spindle", "Spindel", "broche", "TC1 status")),
        *((name, WARM) for name in ("spindle load", "Spindellast", "charge broche", "spindle power", "oil level")),
        *((name, WARM) for name in ("spindle vibration", "coolant flow", "Spindle override", "TC1 status")),
        *((name, WARM) for name in ("Spindle X", "spindle probe Z", "Sensor 1 Z", "spindle growth", "TCP Z", "S1")),
        *((name, STEPS) for name in ("spindle", "broche", "TC1 spindle", "table")),
        ("spindle", STEPS + 20.0 * NOISE),
        ("table", np.linspace(20.0, 80.0, ROWS)),
        ("column", np.arange(20.0, 20.0 + ROWS)),
        ("spindle front", WARM - 22.0),
        ("Spindle brg front", 1.8 * WARM + 32.0),
    ],
)
def test_what_is_only_called_alike_is_none(header: str, values: np.ndarray) -> None:
    assert seen(header, values)[0].kind != "temperature", header


@pytest.mark.parametrize(
    ("header", "kind"), [("coolant flow [l/min]", "coolant"), ("Kuehlmittel (l/min)", "coolant"), ("coolant", "ignore")]
)
def test_a_flow_of_coolant_is_known_by_its_unit(header: str, kind: str) -> None:
    """Without one, values other than 0 and 1 are neither on nor off."""
    assert seen(header, 12.0 * (STEPS > 30.0))[0].kind == kind


@pytest.mark.parametrize(
    ("header", "values"),
    [("Kanal 7", WARM), ("Spindle brg front", 1.8 * WARM + 32.0), ("TC1 spindle", WARM + 273.15), ("spindle", STEPS)],
)
def test_a_column_that_may_be_one_is_named(header: str, values: np.ndarray) -> None:
    found, notes = seen(header, values)
    assert found.kind == "ignore"
    assert len(notes) == 1 and f"--set '{header}.role=temperature'" in notes[0]


def test_a_person_who_says_that_it_is_not_used_is_not_asked() -> None:
    column = RawColumn("Kanal 7", None, [str(v) for v in WARM], WARM)
    assert with_temperatures([column], {"Kanal 7": ColumnGuess("ignore", None, "")})[1] == []
    assert with_temperatures([column], {"Kanal 7": ColumnGuess("ignore", None, UNKNOWN)})[1] != []


def drift(names: str, rows: int = 12) -> str:
    """Two runs, in winter and in summer, one reading every 20 min; a spindle speed in steps."""
    lines = [f"run;time;{names};n;drift [um]"]
    for run, room in (("1", 17.0), ("2", 26.0)):
        rise = 10.0 * (1.0 - np.exp(-np.arange(rows) / 3.0))
        for k, warm in enumerate(rise):
            lines.append(f"{run};{1200 * k};{room + warm:.2f};{room + 0.3 * warm:.2f};{4000 * (k > 0)};{2 * warm:.3f}")
    return "\n".join(lines)


@pytest.mark.parametrize("names", ["TC1 spindle;TC6 column", "Spindel vorn;Ständer", "broche;bâti"])
def test_runs_of_two_seasons_keep_their_temperatures(tmp_path: Path, names: str) -> None:
    (tmp_path / "log.csv").write_text(drift(names))
    recording: Recording = known_test.imported(tmp_path, tmp_path / "log.csv", axis="Z")
    assert len(recording.names("temperature")) == 2
    assert recording.array(recording.names("temperature")[0])[12] == pytest.approx(26.0)


def test_a_header_without_end_is_answered_at_once() -> None:
    began = time.perf_counter()
    assert seen("spindles" * 500 + "q", WARM)[0].kind == "ignore"
    assert time.perf_counter() - began < 1.0
