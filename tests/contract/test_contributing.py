"""The recipes of CONTRIBUTING.md, followed word for word on a copy of the project: what a newcomer does must work.

A term with a time constant, a format, a target, a stage, a cleaning rule, a rule of the sensor guard and a model
family are added, each one file,
one registry entry and a sample.
The commands of the text are run on the copy; then each new thing is used as the old ones are.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
# a comment that names the step (file, registry or run), then a fenced block
STEP = re.compile(r"<!-- (file|registry|run)(?:: ([^ ]+))? -->\n```[a-z]*\n(.*?)\n?```", re.S)
GAIN, TAU = 1.2, 6000.0  # um/%, s: of the new term, in the recording that is diagnosed
COPIED = ("errpipe", "tests", "schemas", "docs", "pipelines", "pyproject.toml", "trials", "bench", "examples")


def steps() -> list[tuple[str, str, str]]:
    return STEP.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))


def register(path: Path, lines: str) -> None:
    """Put the import (if there is one) above the registry and the entry at its start."""
    imports = [line for line in lines.splitlines() if line.startswith("from ")]
    (entry,) = (line.strip() for line in lines.splitlines() if not line.startswith("from "))
    text = path.read_text(encoding="utf-8")
    start = re.search(r"^    \(|^[A-Z_]+(: [^=]+)? = \(", text, re.M)
    assert start is not None, f"{path.name} holds no registry"
    path.write_text(
        text[: start.start()] + "\n".join(imports) + "\n\n" + start.group() + f"{entry} " + text[start.end() :],
        encoding="utf-8",
    )


def run(project: Path, command: str) -> str:
    words = shlex.split(command)
    module = {"errpipe": ["-m", "errpipe.cli.app"], "pytest": ["-m", "pytest", "-q"]}[words[0]]
    environment = os.environ | {"PYTHONPATH": str(project), "OMP_NUM_THREADS": "1", "NO_COLOR": "1"}
    done = subprocess.run(
        [sys.executable, *module, *words[1:]],
        cwd=project,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project after the recipes' files and registry entries, before their commands."""
    copy = tmp_path_factory.mktemp("newcomer") / "errpipe"
    copy.mkdir()
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, copy / name)
    for kind, where, text in steps():
        if kind == "file":
            assert not (copy / where).exists(), f"{where} exists already"
            (copy / where).write_text(text + "\n", encoding="utf-8")
        elif kind == "registry":
            register(copy / where, text)
    return copy


def test_the_text_has_seven_recipes_of_one_file_and_one_registry_entry_each() -> None:
    files = [where for kind, where, _ in steps() if kind == "file"]
    registries = [where for kind, where, _ in steps() if kind == "registry"]
    assert [where.split("/")[1] for where in files if where.startswith("errpipe/")] == [
        "terms",
        "formats",
        "targets",
        "stages",
        "cleaning",
        "guard",
        "models",
    ]
    assert len(registries) == 7


@pytest.mark.slow
@pytest.mark.xdist_group("recipes")
def test_every_command_of_the_text_runs_on_a_copy(project: Path) -> None:
    commands = [line for kind, _, text in steps() if kind == "run" for line in text.splitlines()]
    generated = [c for c in commands if "--write" in c]
    for command in [*generated, *(c for c in commands if c not in generated)]:
        run(project, command)
    fitted = json.loads((project / "out/resampled/fit/error_model.json").read_text(encoding="utf-8"))
    resampled = pd.read_parquet(project / "out/resampled/resample/recording.parquet")
    whole = pd.read_parquet(project / "out/resampled/ingest/recording.parquet")
    assert len(resampled) == (len(whole) + 3) // 4
    assert {c["component"] for c in fitted["components"]} == {"EXX"}
    blanked = json.loads((project / "out/mean-rise/clean/cleaning.json").read_text(encoding="utf-8"))
    assert [rule["rule"] for rule in blanked["rules"]] == ["zero_readings"]
    gain = json.loads((project / "out/mean-rise/validate/validation.json").read_text(encoding="utf-8"))["components"][0]
    assert gain["rms_after"] < 0.5 * gain["rms_before"], gain
    assert all(c["rows"] <= len(resampled) for c in fitted["components"]), "fit read the rows that were left out"


@pytest.mark.slow
@pytest.mark.xdist_group("recipes")
def test_the_new_term_is_a_finding_of_the_diagnosis(project: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 86400.0, 240.0)
    humidity = 50.0 + 15.0 * np.sin(2 * np.pi * t / 43200.0) + 6.0 * (t > 30000.0)
    slow = np.empty_like(t)
    slow[0] = humidity[0] - 50.0
    for i in range(1, t.size):
        keep = np.exp(-240.0 / TAU)
        slow[i] = keep * slow[i - 1] + (1 - keep) * (humidity[i - 1] - 50.0)
    error = GAIN * slow + rng.normal(0.0, 0.5, t.size)
    rows = {"run": "1", "t": t, "H": humidity, "E_Z": error, "E_Z_sim": 0.0}
    pd.DataFrame(rows).to_csv(tmp_path / "recording.csv", index=False)
    (tmp_path / "recording.yaml").write_text(
        "recording: 1\ntables: [recording.csv]\ncolumns:\n  run: {role: run}\n  t: {role: time, unit: s}\n"
        "  H: {role: humidity, unit: '%'}\n  E_Z: {role: error, component: E_Z, unit: um}\n"
        "  E_Z_sim: {role: simulated, component: E_Z, unit: um}\n",
        encoding="utf-8",
    )
    run(project, f"errpipe diagnose {tmp_path} --out {tmp_path / 'out'}")
    (response,) = json.loads((tmp_path / "out/diagnosis.json").read_text(encoding="utf-8"))["responses"]
    finding = response["findings"][0]
    assert finding["effect"] == "humidity_swelling" and finding["confidence"] > 0.5, response
    parameters = {p["name"]: p for p in finding["parameters"]}
    assert abs(parameters["gain"]["value"] - GAIN) < 0.1 * GAIN
    assert parameters["tau"]["ci95"][0] < TAU < parameters["tau"]["ci95"][1]
