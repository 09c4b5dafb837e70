"""One LinuxCNC at a time, never for ever, and gone afterwards.

HAL's shared memory exists once per host, so sessions take turns (flock); everything runs under `timeout`; `halrun -U`
ends what is left. As root, LinuxCNC runs its realtime program under another user's id.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

MODULES = Path("/usr/lib/linuxcnc/modules")
UID_NOBODY = 65534
MARK = "ERRPIPE_LINUXCNC_SESSION"
LOCK = Path(tempfile.gettempdir()) / "errpipe-linuxcnc.lock"
NEEDED = ("linuxcnc", "halrun", "halcmd", "halcompile", "halstreamer", "halsampler")


def missing() -> str:
    """Why LinuxCNC cannot be used here; empty where it can."""
    lacking = [name for name in NEEDED if shutil.which(name) is None]
    if lacking:
        return f"LinuxCNC is not installed ({', '.join(lacking)})"
    if not os.access(MODULES, os.W_OK):
        return f"{MODULES} is not writable: a HAL component can only be installed by root"
    return ""


MARKS = [
    pytest.mark.toolchain,
    pytest.mark.skipif(bool(missing()), reason=missing() or "LinuxCNC"),
    pytest.mark.xdist_group("linuxcnc"),  # one worker takes them all: another one would only wait for the lock
]


@contextlib.contextmanager
def alone() -> Iterator[Path]:
    """A folder that another user's id can reach too; nobody else's HAL runs meanwhile, and none is left behind.

    Not pytest's folder: every pytest that starts closes that to others again.
    """
    with LOCK.open("a") as lock, tempfile.TemporaryDirectory(prefix="errpipe-linuxcnc-") as name:
        fcntl.flock(lock, fcntl.LOCK_EX)
        folder = Path(name)
        folder.chmod(0o755)
        try:
            yield folder
        finally:
            end(environment(folder), folder)


def environment(folder: Path) -> dict[str, str]:
    """For LinuxCNC's programs: Debian's Python (its hal and linuxcnc modules), no display, files they may write."""
    env = {
        "PATH": "/usr/bin:/bin:/usr/sbin:/sbin",
        "HOME": str(folder),
        "LANG": "C.UTF-8",
        "RTAPI_FIFO_PATH": str(folder / ".fifo"),
        MARK: str(folder),
    }
    if os.geteuid() == 0:
        env["RTAPI_UID"] = str(UID_NOBODY)
        for path in (folder, *folder.rglob("*")):
            os.chown(path, UID_NOBODY, UID_NOBODY)
    return env


def end(env: dict[str, str], folder: Path) -> None:
    """Unload whatever HAL runs, and end what of this session is still there."""
    quiet(["halrun", "-U"], env, folder, 30)
    for process in left(folder):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)


def left(folder: Path) -> list[int]:
    """Numbers of the processes that a session in a folder started (its mark stands in their environment)."""
    mark, pair = f"{MARK}={folder}".encode(), []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if mark in path.read_bytes().split(b"\0"):
                pair.append(int(path.parent.name))
    return pair


def quiet(command: list[str], env: dict[str, str], folder: Path, seconds: float) -> int:
    """Run a command that may leave a daemon behind: no pipes, which the daemon would hold open for ever."""
    with (folder / "talk.txt").open("ab") as talk:
        process = subprocess.run(
            ["timeout", "-k", "5", str(seconds), *command],
            cwd=folder,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=talk,
            stderr=talk,
            check=False,
        )
    return process.returncode


def said(folder: Path) -> str:
    """What the session printed so far (its last lines)."""
    path = folder / "talk.txt"
    return path.read_text(errors="replace")[-4000:] if path.is_file() else ""


def values(folder: Path) -> list[str]:
    """What `getp` printed, one value a line, among the messages of other programs."""
    return re.findall(r"^(TRUE|FALSE|0x[0-9A-Fa-f]+|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)$", said(folder), re.M)


def install(component: Path) -> Path:
    """Compile a component and put it where LinuxCNC looks; returns the module, to be removed by the caller."""
    env = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "HOME": str(component.parent), "LANG": "C.UTF-8"}
    subprocess.run(
        ["halcompile", "--install", component.name],
        cwd=component.parent,
        env=env,
        check=True,
        capture_output=True,
        timeout=120,
    )
    return MODULES / f"{component.stem}.so"


@contextlib.contextmanager
def installed(component: Path) -> Iterator[None]:
    """The component installed for the time of a `with`."""
    module = install(component)
    try:
        yield
    finally:
        module.unlink(missing_ok=True)


# What every core.hal says of the hand and the tools.
IO = """net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""


def ini(axes: str, exported: str, traj: str, base_ns: int = 0, display: str = "") -> str:
    """The controller's own file up to its axes. exported: the HAL file that errpipe wrote; traj: largest speeds."""
    return f"""[EMC]
VERSION = 1.1
MACHINE = simulated
DEBUG = 0
[DISPLAY]
DISPLAY = ./ui.py
{display}[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = sim.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 4.0
BASE_PERIOD = {base_ns}
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = sim.tbl
[HAL]
HALFILE = core.hal
HALFILE = {exported}
HALFILE = connect.hal
[TRAJ]
COORDINATES = {" ".join(axes)}
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
NO_FORCE_HOMING = 1
{traj}[KINS]
KINEMATICS = trivkins coordinates={axes}
JOINTS = {len(axes)}
"""


def write(folder: Path, files: Mapping[str, str], **plan: Any) -> None:
    """All files of a session; plan: what `ui.py` does otherwise than it usually does."""
    usual = {"settle_s": 0.5, "least_s": 0.0, "read": [], "heat": {}, "cool": {}}
    for name, text in {"sim.tbl": "", **files, "plan.json": json.dumps(usual | plan)}.items():
        (folder / name).write_text(text)
    shutil.copy(Path(__file__).with_name("ui.py"), folder / "ui.py")
    (folder / "ui.py").chmod(0o755)


def run(folder: Path, seconds: float) -> tuple[dict, np.ndarray]:
    """Run the session whose files stand in a folder: its facts, and what the sampler recorded, a row a cycle.

    Raises AssertionError with LinuxCNC's words where it does not come to its end.
    """
    (folder / "facts.json").unlink(missing_ok=True)
    env = environment(folder)
    end(env, folder)
    try:
        quiet(["linuxcnc", "-r", "sim.ini"], env, folder, seconds)
    finally:
        end(env, folder)
    assert (folder / "facts.json").is_file(), said(folder)
    return json.loads((folder / "facts.json").read_text()), np.loadtxt(folder / "record.txt", comments="overrun")


def clocks(count: int) -> str:
    """A `.tmax` in words: HAL counts in clocks of the processor's time-stamp counter."""
    match = re.search(r"cpu MHz\s*:\s*([\d.]+)", Path("/proc/cpuinfo").read_text())
    return f"{count} clocks" + (f" = {1e3 * count / float(match[1]):.0f} ns" if match else "")
