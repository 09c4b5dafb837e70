"""LinuxCNC's own halcmd and the line that keeps a machine in inches from screw files in mm."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from errpipe.targets.linuxcnc_screw import GUARD, ONLY_IN_MM
from tests.e2e.linuxcnc import session


@pytest.mark.parametrize(("unit", "starts"), [("mm", True), ("metric", True), ("inch", False), ("in", False)])
def test_a_machine_in_inches_does_not_start(tmp_path: Path, unit: str, starts: bool) -> None:
    halcmd = shutil.which("halcmd")
    if halcmd is None or session.missing():
        pytest.skip(session.missing() or "no halcmd")
    (tmp_path / "machine.ini").write_text(f"[TRAJ]\nLINEAR_UNITS = {unit}\n")
    (tmp_path / GUARD).write_text(ONLY_IN_MM)
    run = subprocess.run(
        [halcmd, "-i", "machine.ini", "-f", GUARD], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert (run.returncode == 0) is starts, run.stderr
    assert starts or "program 'expr' failed" in run.stderr
