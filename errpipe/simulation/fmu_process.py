"""The process of an FMU: started for each run with limits of time, memory and disk, then ended with its children.

Requests and responses are lines of JSON (see `fmu_worker`); the time limit applies to each response.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import os
import secrets
import select
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from errpipe import files
from errpipe.errors import DataError, UsageError
from errpipe.simulation.twin_options import FmuOptions

TOKEN = "ERRPIPE_FMU"
UID_NOBODY = 65534  # the user without rights on Linux
END_PATIENCE = 10.0  # s for the supervisor to end everything before it is ended itself
MAX_ANSWER_BYTES = 16 << 20  # the description of an FMU of 50,000 variables
MAX_MESSAGE = 2000  # characters of an error
TAIL_CHARACTERS = 400  # of the FMU's last output: about three lines in a message
# Environment variables of the process; no others are passed.
ENVIRONMENT = (
    *("PATH", "LANG", "LC_ALL", "TZ", "LD_LIBRARY_PATH", "SYSTEMROOT", "TEMP", "TMP"),
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
)


class FmuProcess:
    """The FMU's process: one request at a time, each answered in time or terminated.

    Below `folder` (of the caller) are `given`, which only errpipe writes, and `work`, where the FMU may write:
    errpipe never writes through what the FMU creates there, such as a link, and treats its results as hostile files.
    """

    def __init__(self, file: Path, folder: Path, how: FmuOptions):
        self.file, self.folder, self.how = file, folder, how
        self.given, self.work = folder / "given", folder / "work"
        self.user = unprivileged_user()
        self.token = secrets.token_hex(16)  # in its environment: identifies processes that outlive it

    def __enter__(self) -> FmuProcess:
        """Raises UsageError on a system without POSIX processes: there an FMU cannot be isolated."""
        if not hasattr(os, "fork"):
            raise UsageError(
                f"{self.file.name}: an FMU runs on Linux, macOS and in WSL only, where its process can be limited and "
                "ended; on this system simulate elsewhere and give its results as CSV (source: {kind: csv})"
            )
        script = Path(__file__).with_name("fmu_worker.py")
        self._prepare()
        self.printed = (self.folder / "printed.txt").open("w+b")
        listener, self.control = os.pipe()
        environment = {k: os.environ[k] for k in ENVIRONMENT if k in os.environ}
        environment |= {"HOME": str(self.work), "TMPDIR": str(self.work)}
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-B", str(script), str(listener), str(self.user), str(self.how.disk_mb)],
            cwd=self.work,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.printed,
            pass_fds=[listener],
            start_new_session=True,
            env=environment | {TOKEN: self.token},
        )
        os.close(listener)
        assert self.process.stdin is not None and self.process.stdout is not None
        self.orders, self.answers = self.process.stdin, self.process.stdout
        self.deadline = time.monotonic() + self.how.time_limit
        return self

    def _prepare(self) -> None:
        """The folders, and a copy of the FMU that its process can read."""
        self.folder.chmod(0o711)
        self.given.mkdir(mode=0o755)
        self.work.mkdir(mode=0o700)
        if self.user:
            os.chown(self.work, self.user, self.user)
        left = self.how.disk_mb << 20
        with files.open_regular(self.file) as source, (self.given / "model.fmu").open("xb") as target:
            while data := source.read(1 << 20):
                left -= len(data)
                if left < 0:
                    raise DataError(f"{self.file.name}: has more than {self.how.disk_mb} MB (disk_mb)")
                target.write(data)
        (self.given / "model.fmu").chmod(0o644)

    def __exit__(self, *_: object) -> None:
        os.close(self.control)  # its supervisor now ends all that the FMU has started
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(END_PATIENCE)
        for pid in [self.process.pid, *_with_token(self.token)]:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        for stream in (self.orders, self.answers, self.printed):
            with contextlib.suppress(BrokenPipeError):
                stream.close()

    def load(self) -> dict[str, Any]:
        """The FMU unpacked and described. Raises DataError."""
        order = {"do": "load", "fmu": str(self.given / "model.fmu")}
        description = self._ask(order | {"memory_mb": self.how.memory_mb, "disk_mb": self.how.disk_mb}, "loading")
        if not isinstance(description, dict) or not isinstance(description.get("variables"), dict):
            raise DataError(f"{self.file.name}: loading it, its process returned no description")
        return description

    def simulate(self, order: dict[str, Any], inputs: np.ndarray | None) -> np.ndarray:
        """One session simulated: time and outputs, shape (steps, 1 + outputs). Raises DataError."""
        if inputs is not None:
            order = order | {"inputs": str(self.given / "in.npy")}
            with (self.given / "in.npy").open("wb") as stream:
                np.save(stream, inputs, allow_pickle=False)
        self._ask({"do": "simulate", **order, "output": "out.npy"}, "simulating")
        return self._result(1 + len(order["outputs"]))

    def _result(self, columns: int) -> np.ndarray:
        name = f"{self.file.name}: simulating it"
        try:
            data = files.read(self.work / "out.npy", self.how.disk_mb << 20, DataError, follow=False)
            table = np.load(io.BytesIO(data), allow_pickle=False)
        except (DataError, ValueError, OSError, EOFError, MemoryError):
            raise DataError(f"{name}, its process left no table of results{self._tail()}") from None
        if table.ndim != 2 or table.shape[1] != columns or not len(table) or table.dtype != np.float64:
            raise DataError(f"{name}, its process left a table of results of another shape")
        return table

    def _ask(self, order: dict[str, Any], doing: str) -> Any:
        self.deadline = time.monotonic() + self.how.time_limit
        try:
            self.orders.write((json.dumps(order) + "\n").encode())
            self.orders.flush()
        except (BrokenPipeError, ValueError):
            raise self._ended(doing) from None
        line = self._line(doing)
        if not line.endswith(b"\n"):
            raise self._ended(doing)
        try:
            answer = json.loads(line)
            if "error" not in answer:
                return answer["ok"]
            text = " ".join(str(answer["error"]).replace(str(self.folder), "...").split())[:MAX_MESSAGE]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise DataError(f"{self.file.name}: {doing} it, its process returned an invalid response") from None
        raise DataError(f"{self.file.name}: {doing} it failed: {text}{self._tail()}")

    def _late(self, doing: str) -> DataError:
        limit = f"{self.how.time_limit:g} s (time_limit)"
        return DataError(f"{self.file.name}: {doing} it took longer than {limit}; it was ended{self._tail()}")

    def _line(self, doing: str) -> bytes:
        """One line of the answer. Raises DataError when time is up."""
        pipe, line = self.answers, b""
        while not line.endswith(b"\n"):
            left = self.deadline - time.monotonic()
            if left <= 0 or not select.select([pipe], [], [], left)[0]:
                raise self._late(doing)
            piece = os.read(pipe.fileno(), 65536)
            if not piece:
                break
            line += piece
            if len(line) > MAX_ANSWER_BYTES:
                raise DataError(f"{self.file.name}: {doing} it, its process returned an endless response")
        return line

    def _ended(self, doing: str) -> DataError:
        try:
            code = self.process.wait(max(self.deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:  # it closed its pipes and continues
            return self._late(doing)
        how = f"exit status {code}"
        if code < 0:
            how = signal.Signals(-code).name
        return DataError(f"{self.file.name}: {doing} it, its process ended by itself ({how}){self._tail()}")

    def _tail(self) -> str:
        """The FMU's last output, from the stream that was opened before it ran."""
        size = os.fstat(self.printed.fileno()).st_size
        start = max(size - 4 * TAIL_CHARACTERS, 0)
        text = os.pread(self.printed.fileno(), 4 * TAIL_CHARACTERS, start).decode("utf-8", errors="replace").strip()
        text = "".join(c if c.isprintable() or c == "\n" else " " for c in text.replace(str(self.folder), "..."))
        lines = [line.strip() for line in text[-TAIL_CHARACTERS:].splitlines() if line.strip()]
        return f". Its output: {' | '.join(lines[-3:])}" if lines else ""


def unprivileged_user() -> int:
    """Number of the user that runs the FMU if errpipe runs as root; 0: the user that runs errpipe.

    If `nobody` cannot read the Python in use the FMU runs as root, but is still confined.
    """
    if os.name != "posix" or os.getuid() != 0:
        return 0
    fmpy = importlib.util.find_spec("fmpy")
    needed = [Path(sys.executable), Path(os.path.realpath(sys.executable)), Path(__file__)]
    needed += [Path(fmpy.origin)] if fmpy is not None and fmpy.origin else []
    open_to_all = all(
        path.stat().st_mode & stat.S_IROTH and all(p.stat().st_mode & stat.S_IXOTH for p in path.parents)
        for path in needed
    )
    return UID_NOBODY if open_to_all else 0


def _with_token(token: str) -> list[int]:
    """Processes that have inherited the FMU's environment."""
    pids = []
    for name in os.listdir("/proc") if os.path.isdir("/proc") else []:
        if name.isdigit() and int(name) != os.getpid():
            with contextlib.suppress(OSError):
                if f"{TOKEN}={token}".encode() in Path(f"/proc/{name}/environ").read_bytes():
                    pids.append(int(name))
    return pids
