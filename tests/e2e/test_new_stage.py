"""A stage added in one file and one registry line: its rows reach the fit, the validation and the table."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd

import errpipe
from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.formats import manifest_folder

RESAMPLE = '''"""Every so many rows of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts


class Resample(Stage):
    """Keep one row of so many."""

    kind: Literal["resample"]
    every: int = Field(4, ge=1, description="One row of so many is kept.")
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording")}
    gives: ClassVar[tuple[str, ...]] = ("recording",)

    def outputs(self) -> tuple[str, ...]:
        return ("recording.yaml", "recording.parquet")

    def run(self, context: Context) -> Mapping[str, Any]:
        import numpy as np

        from errpipe.formats import manifest_folder

        recording = _artefacts.recording_in(context.needed("recording"))
        kept = recording.take(np.arange(0, len(recording), self.every))
        return {"rows": manifest_folder.write(kept, context.folder)}
'''

PIPELINE = """pipeline: 1
stages:
  - {kind: ingest, recording: recording}
  - {kind: clean}
  - {kind: resample}
  - kind: fit
    components: [{component: EXX, terms: [{term: offset}, {term: scale_error, axis: X}]}]
  - {kind: validate}
  - {kind: export}
"""


def recorded(folder: Path, rows: int = 480) -> None:
    """An axis that is 20 um/m too long, measured in six runs."""
    rng = np.random.default_rng(1)
    x = rng.uniform(0.0, 500.0, rows)
    frame = {"run": np.repeat(np.arange(6), rows // 6).astype(str), "t": 10.0 * np.arange(rows), "x": x}
    kinds = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    constants = {"X": Constant(role="axis", kind="linear", travel=(0, 500), unit="mm")}
    manifest = Manifest(recording=1, tables=("a.parquet",), columns=kinds, constants=constants)
    values = pd.DataFrame(frame | {"EXX": 20e-3 * x + rng.normal(0.0, 0.2, rows)})
    manifest_folder.write(Recording(manifest, values), folder)


def test_a_stage_between_clean_and_fit_feeds_the_fit(tmp_path: Path) -> None:
    package = tmp_path / "copy" / "errpipe"
    shutil.copytree(Path(errpipe.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "stages" / "resample.py").write_text(RESAMPLE)
    registry = package / "stages" / "__init__.py"
    registry.write_text(registry.read_text().replace('        "report",\n', '        "report",\n        "resample",\n'))
    recorded(tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(PIPELINE)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "errpipe.cli.app", *arguments]
        environment = os.environ | {"PYTHONPATH": str(tmp_path / "copy")}
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    done = run("run", "p.yaml", "--out", "out")
    assert done.returncode == 0, done.stderr
    for file in ("fit/error_model.json", "validate/validation.json"):
        (component,) = json.loads((tmp_path / "out" / file).read_text())["components"]
        assert component["rows"] == 120, file
    (proof,) = json.loads((tmp_path / "out" / "export" / "export.json").read_text())["proof"]
    assert proof["rows"] == 120

    (tmp_path / "p.yaml").write_text(
        PIPELINE.replace("kind: fit\n", "kind: fit\n    from: {recording: clean}\n")
        .replace("{kind: validate}", "{kind: validate, from: {recording: clean}}")
        .replace("{kind: export}", "{kind: export, from: {recording: clean}}")
    )
    done = run("run", "p.yaml", "--out", "out")
    assert done.returncode == 2
    assert "stages[2]: its recording is not read, although a later stage takes one" in done.stderr
