"""FMUs that hang, hide, spread, overflow or aim elsewhere: each ends as a message, in time, and leaves nothing."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest

from errpipe.errors import DataError
from errpipe.simulation import external
from tests.unit.simulation.test_fmu import recorded

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("pythonfmu") is None, reason="pythonfmu builds the FMUs"),
    pytest.mark.skipif(sys.platform != "linux", reason="processes and folders are confined on Linux only"),
]

MODEL = """
import os, signal, subprocess, time
from pythonfmu import Fmi2Causality as C, Fmi2Slave, Fmi2Variability as V, Real

TARGET = os.environ.get("NOT_PASSED", "TARGET_HERE")

class Hostile(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.rise, self.mode, self.z, self.done = 0.0, 0.0, 0.0, False
        self.register_variable(Real("rise", causality=C.input, start=0.0))
        self.register_variable(Real("mode", causality=C.parameter, variability=V.tunable, start=0.0))
        self.register_variable(Real("z", causality=C.output))

    def do_step(self, t, dt):
        if not self.done:
            self.done = True
            try:
                attacks = "nothing close spread write link pipe fill flood kill breed".split()
                getattr(self, attacks[int(self.mode)])()
            except OSError as err:
                print("refused:", err.strerror)
        return True

    def nothing(self): pass
    def close(self):
        for fd in range(256):
            try: os.close(fd)
            except OSError: pass
        time.sleep(600)
    def spread(self):
        subprocess.Popen(["sleep", "4242"], start_new_session=True)
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                os.execve("/bin/sleep", ["sleep", "4243"], {})
            os._exit(0)
    def write(self):
        open(TARGET, "w").write("overwritten")
    def link(self):
        os.symlink(TARGET, "out.npy")
        os.symlink(TARGET, "in.npy")
        os.symlink(TARGET, "printed.txt")
    def pipe(self):
        os.mkfifo("out.npy")
    def fill(self):
        for n in range(100):
            open(f"f{n}", "wb").write(b"x" * 2_000_000); time.sleep(0.02)
    def flood(self):
        while True:
            for fd in range(3, 12):
                try: os.write(fd, b"x" * 65536)
                except OSError: pass
    def breed(self):
        try:
            for _ in range(4000): subprocess.Popen(["sleep", "4245"], start_new_session=True)
        except OSError as err:
            print("refused:", err.strerror)
        time.sleep(600)
    def kill(self):
        for pid in (os.getppid(), int(open(f"/proc/{os.getppid()}/stat").read().rsplit(")")[-1].split()[1])):
            try: os.kill(pid, signal.SIGKILL)
            except OSError: pass
        subprocess.Popen(["sleep", "4244"], start_new_session=True)
        time.sleep(600)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The FMU, and a file outside its folder at which it aims."""
    folder = tmp_path_factory.mktemp("fmu")
    precious = folder / "precious.txt"
    precious.write_text("precious")
    precious.chmod(0o666)
    (folder / "hostile.py").write_text(MODEL.replace("TARGET_HERE", str(precious)))
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "hostile.py", "-d", "."]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "Hostile.fmu", precious


def running(word: str) -> list[str]:
    out = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            if word in line and "sleep" in line.split(" ")[0]:
                out.append(line)
    return out


def simulate(file: Path, mode: int, **options: float) -> None:
    how = {
        "kind": "fmu",
        "inputs": {"rise": {"column": "T", "unit": "K", "rise_from": 20.0}},
        "outputs": {"E_Z": {"variable": "z", "unit": "um"}},
        "parameters": {"mode": mode},
        "time_limit": 20.0,
        "step": 20.0,
    }
    external.with_twins(recorded(), external.FromFmu.model_validate(how | options), file)


def test_one_that_does_nothing_wrong_passes(built: tuple[Path, Path]) -> None:
    simulate(built[0], 0)


def test_one_that_closes_its_pipes_is_not_waited_for(built: tuple[Path, Path]) -> None:
    began = time.monotonic()
    with pytest.raises(DataError, match="took longer than 3 s"):
        simulate(built[0], 1, time_limit=3.0)
    assert time.monotonic() - began < 60


@pytest.mark.parametrize("mode, seconds", [(2, 4242), (8, 4244)])
def test_no_process_survives_also_not_in_a_session_of_its_own(
    built: tuple[Path, Path], mode: int, seconds: int
) -> None:
    if mode == 2:
        simulate(built[0], mode)
    else:
        with pytest.raises(DataError):
            simulate(built[0], mode, time_limit=3.0)
    assert running(str(seconds)) == [] and running(str(seconds + 1)) == []


@pytest.mark.skipif(os.getuid() != 0, reason="only root has rights to give up")
def test_started_by_root_it_has_no_rights(built: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """As nobody where that user can read the Python in use; the rights do not come back."""
    from errpipe.simulation import fmu_process, fmu_worker

    child = os.fork()
    if child == 0:
        fmu_worker.drop_privileges(fmu_process.UID_NOBODY)
        with contextlib.suppress(PermissionError):
            os.setuid(0)
        mine = (*os.getresuid(), *os.getresgid(), *os.getgroups())
        os._exit(0 if set(mine) == {fmu_process.UID_NOBODY} else 1)
    assert os.waitpid(child, 0)[1] == 0
    shut = built[0].parent / "shut"
    shut.mkdir(mode=0o700)
    (shut / "python").touch()
    monkeypatch.setattr(fmu_process.sys, "executable", str(shut / "python"))
    assert fmu_process.unprivileged_user() == 0
    monkeypatch.setattr(fmu_process.sys, "executable", "/bin/sh")
    monkeypatch.setattr(fmu_process.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(fmu_process, "__file__", "/bin/sh")
    assert fmu_process.unprivileged_user() == fmu_process.UID_NOBODY


def test_one_that_starts_processes_without_end_is_ended(built: tuple[Path, Path]) -> None:
    began = time.monotonic()
    with pytest.raises(DataError, match="more than 64 processes"):
        simulate(built[0], 9, time_limit=30.0)
    assert time.monotonic() - began < 25 and running("4245") == []


@pytest.mark.parametrize("mode", [3, 4])
def test_nothing_is_written_outside_neither_by_it_nor_by_us(built: tuple[Path, Path], mode: int) -> None:
    with contextlib.suppress(DataError):
        simulate(built[0], mode)
    assert built[1].read_text() == "precious"


def test_a_pipe_in_place_of_results_is_not_waited_for(built: tuple[Path, Path]) -> None:
    with pytest.raises(DataError, match=r"left no table of results|took longer"):
        simulate(built[0], 5, time_limit=5.0)


def test_a_disk_that_it_fills_ends_it(built: tuple[Path, Path]) -> None:
    with pytest.raises(DataError, match=r"wrote more than 64 MB|ended by itself"):
        simulate(built[0], 6, disk_mb=64)


def test_an_answer_without_end_is_cut(built: tuple[Path, Path]) -> None:
    with pytest.raises(DataError, match=r"endless response|took longer|invalid response"):
        simulate(built[0], 7, time_limit=5.0)


@pytest.mark.parametrize(
    "entry, size, word",
    [
        ("resources/zeros", 80 << 20, "MB in all"),
        ("../../evil", 3, "leads out"),
        ("/tmp/evil", 3, "leads out"),
        ("a\\..\\..\\evil", 3, "leads out"),
    ],
)
def test_an_archive_that_overflows_or_leads_out_is_refused(
    built: tuple[Path, Path], tmp_path: Path, entry: str, size: int, word: str
) -> None:
    file = tmp_path / "bomb.fmu"
    file.write_bytes(built[0].read_bytes())
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(entry, bytes(size))
    with pytest.raises(DataError, match=word):
        simulate(file, 0, disk_mb=64)
    assert not list(Path("/tmp").glob("evil")) and not os.path.exists("evil")


def test_a_link_in_the_archive_is_refused(built: tuple[Path, Path], tmp_path: Path) -> None:
    file = tmp_path / "link.fmu"
    file.write_bytes(built[0].read_bytes())
    with zipfile.ZipFile(file, "a") as archive:
        info = zipfile.ZipInfo("resources/link")
        info.external_attr = 0o120777 << 16
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(DataError, match="leads out"):
        simulate(file, 0)
