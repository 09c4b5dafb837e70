"""The workflow files in examples/ci: their own commands, in order, in a clean folder, with and without a promotion."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from tests.e2e.retrain.test_retrain import PIPELINE, record

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples" / "ci"


def commands(name: str) -> list[str]:
    """The shell steps of a workflow file, without the one that installs the published package."""
    document: Any = YAML(typ="safe", pure=True).load((EXAMPLES / name).read_text(encoding="utf-8"))
    steps = document["retrain"]["script"] if "retrain" in document else _runs(document["jobs"]["retrain"]["steps"])
    return [step for step in steps if "pip install errpipe" not in step]


def _runs(steps: list[dict[str, Any]]) -> list[str]:
    return [step["run"] for step in steps if "run" in step]


def shell(command: str, folder: Path) -> None:
    """One step, as a runner gives it to bash; `errpipe` is this checkout's."""
    bin_folder = folder.parent / "bin"
    bin_folder.mkdir(exist_ok=True)
    program = bin_folder / "errpipe"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m errpipe.cli.app "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    path = f"{bin_folder}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", command], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["github-retrain.yml", "gitlab-retrain.yml"])
@pytest.mark.parametrize("changed", [True, False], ids=["the machine changed", "it did not"])
def test_the_steps_of_a_workflow_promote_when_they_should_and_only_then(
    name: str, changed: bool, tmp_path: Path
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    (site / "axis.yaml").write_text(PIPELINE, encoding="utf-8")
    record(site / "recording", 12)
    shell("errpipe run axis.yaml --out champion", site)
    before = (site / "champion/fit/error_model.json").read_bytes()
    record(site / "recording", 44, first=12, changed_from=12 if changed else None)
    for command in commands(name):
        shell(command, site)
    document = json.loads((site / "retrain/retrain.json").read_text(encoding="utf-8"))
    assert (document["decision"] == "promote") is changed
    assert ((site / "champion/fit/error_model.json").read_bytes() != before) is changed
