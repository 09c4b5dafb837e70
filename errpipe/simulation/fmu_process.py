"""The process that an FMU runs in: started anew for every simulation, given a time and a memory limit, then ended.

Orders go in and answers come out as lines of JSON (see `fmu_worker`); each answer is waited for until the time limit.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from errpipe.errors import DataError
from errpipe.simulation.fmu_options import FmuOptions

TAIL_CHARACTERS = 400  # of what the FMU printed last: about three lines in a message
ENVIRONMENT = (
    "PATH",
    "LANG",
    "LC_ALL",
    "TZ",
    "LD_LIBRARY_PATH",
    "SYSTEMROOT",
    "TEMP",
    "TMP",
    "TMPDIR",
    "HOME",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
)  # variables that the process is given; nothing else of the environment


class FmuProcess:
    """The FMU's process: one order at a time, each answered in time or the end of it."""

    def __init__(self, file: Path, folder: Path, how: FmuOptions):
        self.file, self.folder, self.how = file, folder, how

    def __enter__(self) -> FmuProcess:
        script = Path(__file__).with_name("fmu_worker.py")
        self.printed = (self.folder / "printed.txt").open("wb")
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(script)],
            cwd=self.folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.printed,
            start_new_session=True,
            env={k: os.environ[k] for k in ENVIRONMENT if k in os.environ},
        )
        assert self.process.stdin is not None and self.process.stdout is not None
        self.orders, self.answers = self.process.stdin, self.process.stdout
        return self

    def __exit__(self, *_: object) -> None:
        try:
            os.killpg(self.process.pid, signal.SIGKILL)  # it, and whatever the FMU may have started
        except (ProcessLookupError, PermissionError, AttributeError):
            self.process.kill()
        self.process.wait()
        for stream in (self.orders, self.answers, self.printed):
            with contextlib.suppress(BrokenPipeError):
                stream.close()

    def load(self) -> dict[str, Any]:
        """The FMU unpacked and described."""
        order = {"do": "load", "fmu": str(self.file.resolve()), "memory_mb": self.how.memory_mb}
        return self._ask(order, "loading")

    def simulate(self, order: dict[str, Any]) -> None:
        """One session simulated into its output file."""
        self._ask({"do": "simulate", **order}, "simulating")

    def _ask(self, order: dict[str, Any], doing: str) -> Any:
        try:
            self.orders.write((json.dumps(order) + "\n").encode())
            self.orders.flush()
        except (BrokenPipeError, ValueError):
            raise self._ended(doing) from None
        line = self._line(doing)
        if not line.endswith(b"\n"):
            raise self._ended(doing)
        answer = json.loads(line)
        if "error" in answer:
            printed = " ".join(answer["error"].replace(str(self.folder), "...").split())
            raise DataError(f"{self.file.name}: {doing} it failed: {printed}{self._tail()}")
        return answer["ok"]

    def _line(self, doing: str) -> bytes:
        """One line of the answer. Raises DataError when time is up."""
        pipe, line = self.answers, b""
        end = time.monotonic() + self.how.time_limit
        while not line.endswith(b"\n"):
            left = end - time.monotonic()
            if left <= 0 or not select.select([pipe], [], [], left)[0]:
                raise DataError(
                    f"{self.file.name}: {doing} it took longer than {self.how.time_limit:g} s (time_limit); it was "
                    f"ended{self._tail()}"
                )
            piece = os.read(pipe.fileno(), 65536)
            if not piece:
                break
            line += piece
        return line

    def _ended(self, doing: str) -> DataError:
        code = self.process.wait()
        how = f"exit status {code}"
        if code < 0:
            how = signal.Signals(-code).name
        return DataError(f"{self.file.name}: {doing} it, its process ended by itself ({how}){self._tail()}")

    def _tail(self) -> str:
        self.printed.flush()
        text = (self.folder / "printed.txt").read_text("utf-8", errors="replace").strip()
        text = text.replace(str(self.folder), "...")
        lines = [line.strip() for line in text[-TAIL_CHARACTERS:].splitlines() if line.strip()]
        return f". It said: {' | '.join(lines[-3:])}" if lines else ""
