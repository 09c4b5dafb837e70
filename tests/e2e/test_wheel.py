"""The wheel holds all that the command line needs, away from the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_the_installed_demonstration_is_that_of_the_checkout() -> None:
    name = "ball-screw-axis.yaml"
    assert (ROOT / "errpipe/stages/templates" / name).read_bytes() == (ROOT / "pipelines" / name).read_bytes()


@pytest.mark.slow
def test_a_wheel_runs_away_from_the_checkout(tmp_path: Path) -> None:
    pytest.importorskip("build", reason="the package `build` is not installed")
    source = tmp_path / "source"
    source.mkdir()
    for name in ("errpipe", "pyproject.toml", "README.md", "LICENSE"):
        (source / name).symlink_to(ROOT / name)
    subprocess.run([sys.executable, "-m", "build", "--wheel", "-o", str(tmp_path), str(source)], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    line = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(tmp_path / "site"), str(wheel)]
    subprocess.run(line, check=True)
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    for arguments in (["demo", "--out", "out"], ["init", "work"], ["check", "work/pipeline.yaml"], ["targets"]):
        subprocess.run([sys.executable, "-m", "errpipe", *arguments], check=True, cwd=tmp_path, env=environment)
    where = subprocess.run(
        [sys.executable, "-c", "import errpipe; print(errpipe.__file__)"],
        check=True,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert str(tmp_path) in where.stdout
