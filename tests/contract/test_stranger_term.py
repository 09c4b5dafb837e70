"""A term that nobody has heard of, with a time constant, is one file and one registry line: diagnosis then names it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import errpipe

TERM = '''"""Follows the humidity of the hall through a first-order lag."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms._base import Parameter, Term


class HumiditySwelling(Term):
    """Polymer concrete takes up water from the air and swells, weeks behind in a bed and hours in a cover.

    Equation   tau dy/dt + y = h - h(0);  deviation = gain * y          [um] = [um/%] * [%]
    Assumes    one time constant
    Typical    0.1..2 um/%, tau 500..20000 s
    Moves      positive gain: the wetter, the further
    Source     made up for a test
    """

    term: Literal["humidity_swelling"] = "humidity_swelling"
    column: str = Field(description="Column of the humidity.")
    reports_as = "humidity_swelling"
    family = "thermal"

    def linear(self) -> tuple[Parameter, ...]:
        return (Parameter("gain", "um/%", (0.1, 2.0), (-100.0, 100.0), "shift per percent"),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        return (Parameter("tau", "s", (500.0, 20000.0), (1.0, 1e6), "time constant"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.column,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[HumiditySwelling]:
        for column in recording.names("humidity") if component.startswith("E") else ():
            yield cls(column=column)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        session, rise = sessions(recording), recording.array(self.column)
        rise = rise - responses.first_value(session, rise)
        return responses.lag(session, recording.time(), rise, *nonlinear, *nonlinear, True)[:, None]
'''

MANIFEST = """recording: 1
title: a cover of polymer concrete
machine: none
tables: [rows.csv]
columns:
  t: {role: time, unit: s}
  h: {role: humidity, unit: "%"}
  T: {role: temperature, unit: degC, location: column}
  e: {role: error, component: E_X, unit: um}
  s: {role: simulated, component: E_X, unit: um}
"""
TAU = 3000.0  # s
GAIN = 0.8  # um/%


def recorded(folder: Path) -> Path:
    """Humidity that wanders over a day, a deviation that follows it late, and a simulation that knows the heat only."""
    rng = np.random.default_rng(5)
    t = 60.0 * np.arange(1400)
    h = 50 + np.cumsum(np.where(np.arange(1400) % 140 == 0, rng.normal(0, 8, 1400), 0.0))
    heat = 20 + 3 * np.sin(2 * np.pi * t / 40000.0)
    late = np.empty(t.size)
    late[0] = 0.0
    for i in range(1, t.size):
        late[i] = late[i - 1] + (h[i - 1] - h[0] - late[i - 1]) * (1 - np.exp(-60.0 / TAU))
    simulated = 2.0 * (heat - 20)
    actual = simulated + GAIN * late + rng.normal(0, 0.3, t.size)
    folder.mkdir()
    (folder / "recording.yaml").write_text(MANIFEST)
    rows = [
        "t,h,T,e,s",
        *(
            f"{a:.0f},{b:.3f},{c:.4f},{d:.4f},{e:.4f}"
            for a, b, c, d, e in zip(t, h, heat, actual, simulated, strict=True)
        ),
    ]
    (folder / "rows.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.mark.slow
def test_one_file_and_one_line_are_enough_for_a_diagnosis(tmp_path: Path) -> None:
    copy = shutil.copytree(
        Path(errpipe.__file__).parent, tmp_path / "errpipe", ignore=shutil.ignore_patterns("__pycache__")
    )
    (copy / "terms" / "humidity_swelling.py").write_text(TERM)
    registry = copy / "terms" / "__init__.py"
    text = registry.read_text()
    registry.write_text(text.replace('        "tool_wear",\n', '        "tool_wear",\n        "humidity_swelling",\n'))
    recording = recorded(tmp_path / "recording")
    command = [sys.executable, "-m", "errpipe.cli.app", "diagnose", str(recording), "--out", str(tmp_path / "out")]
    asked = subprocess.run(
        command,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert asked.returncode == 0, asked.stderr
    (response,) = json.loads((tmp_path / "out" / "diagnosis.json").read_text())["responses"]
    first = response["findings"][0]
    assert first["effect"] == "humidity_swelling" and first["confidence"] > 0.5
    values = {p["name"]: p for p in first["parameters"]}
    assert abs(values["gain"]["value"] - GAIN) < 0.1 * GAIN
    assert values["tau"]["ci95"][0] < TAU < values["tau"]["ci95"][1]
