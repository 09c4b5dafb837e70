"""What the hostile tests share: the command line in this process or in one of its own, and small sound inputs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.cli.app import main

MANIFEST = """recording: 1
tables: [rows.csv]
columns:
  t: {role: time, unit: s}
  x: {role: position, axis: X, unit: mm}
  T_nut: {role: temperature, unit: degC}
  dev: {role: error, component: EXX, unit: um}
"""
PIPELINE = """pipeline: 1
stages:
  - {kind: ingest, recording: rec}
  - {kind: clean}
"""


def recording_folder(folder: Path, rows: int = 40, **columns: np.ndarray) -> Path:
    """A sound recording of an axis 10 um too long at X = 500; `columns` replace its own."""
    folder.mkdir(parents=True, exist_ok=True)
    at = np.arange(rows, dtype=float)
    table = {"t": at, "x": 500 * (at % 10) / 9, "T_nut": 20 + np.sin(at), "dev": 10 * (at % 10) / 9} | columns
    lines = [",".join(table)] + [
        ",".join(f"{v:.6g}" if v == v else "" for v in row) for row in zip(*table.values(), strict=True)
    ]
    (folder / "rows.csv").write_text("\n".join(lines) + "\n")
    (folder / "recording.yaml").write_text(MANIFEST)
    return folder


def command(*words: str | Path, capsys: Any) -> tuple[int, str]:
    """Exit code and standard error of one command line, which may not end in a traceback or an internal error."""
    capsys.readouterr()
    code = main([str(word) for word in words])
    text = capsys.readouterr().err
    assert code != 1 and "internal error" not in text and "Traceback" not in text, text
    return code, text


def process(
    words: Sequence[str | Path],
    *,
    limits: dict[int, int] | None = None,
    timeout: float = 60.0,
    stdout: Any = subprocess.PIPE,
) -> Any:
    """The command line in a process of its own, with resource limits (resource.RLIMIT_...: value)."""
    import resource

    def set_limits() -> None:
        for which, value in (limits or {}).items():
            resource.setrlimit(which, (value, value))

    return subprocess.run(
        [sys.executable, "-m", "errpipe.cli.app", *map(str, words)],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=timeout,
        preexec_fn=set_limits,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
    )
