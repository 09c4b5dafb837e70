"""One LinuxCNC at a time, never for ever, and gone afterwards.

HAL's shared memory exists once per host, so sessions take turns (flock); everything runs under `timeout`; `halrun -U`
ends what is left. As root, LinuxCNC runs its realtime program under another user's id.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

MODULES = Path("/usr/lib/linuxcnc/modules")
NOBODY = 65534
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
        env["RTAPI_UID"] = str(NOBODY)
        for path in (folder, *folder.rglob("*")):
            os.chown(path, NOBODY, NOBODY)
    return env


def end(env: dict[str, str], folder: Path) -> None:
    """Unload whatever HAL runs, and end what of this session is still there."""
    quiet(["halrun", "-U"], env, folder, 30)
    for process in left(folder):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)


def left(folder: Path) -> list[int]:
    """Numbers of the processes that a session in a folder started (its mark stands in their environment)."""
    mark, found = f"{MARK}={folder}".encode(), []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if mark in path.read_bytes().split(b"\0"):
                found.append(int(path.parent.name))
    return found


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


def clocks(count: int) -> str:
    """A `.tmax` in words: HAL counts in clocks of the processor's time-stamp counter."""
    found = re.search(r"cpu MHz\s*:\s*([\d.]+)", Path("/proc/cpuinfo").read_text())
    return f"{count} clocks" + (f" = {1e3 * count / float(found[1]):.0f} ns" if found else "")
