"""Work in processes of its own: with limits and a message at the end, or to be killed."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

TIME_LIMIT = 60  # s of one attempt on a busy machine; none should take two
MEMORY = 4 << 30  # bytes of address space; Arrow and Numba reserve much that they do not use
ALLOWED = (0, 2, 3, 4, 6)  # exit codes of a message


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Nothing is printed."""
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        yield


def forked(work: Callable[[], int], folder: Path) -> tuple[int | None, str]:
    """Exit code of `work` in a process of its own (None: killed by a signal, or out of time), and its output."""
    said = folder / "said.txt"
    pid = os.fork()
    if pid == 0:
        try:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            signal.alarm(TIME_LIMIT)
            with (
                said.open("w") as stream,
                contextlib.redirect_stderr(stream),
                contextlib.redirect_stdout(io.StringIO()),
            ):
                code = work()
        except BaseException as err:
            said.write_text(f"escaped: {type(err).__name__}: {err}")
            code = 1
        os._exit(code)
    _, status = os.waitpid(pid, 0)
    text = said.read_text(errors="replace") if said.exists() else ""
    if os.WIFSIGNALED(status):
        return None, f"signal {signal.Signals(os.WTERMSIG(status)).name}; {text}"
    return os.waitstatus_to_exitcode(status), text


def fresh(line: list[str]) -> subprocess.Popen[bytes]:
    """The command line in an interpreter and a session of its own, which Ctrl-C stops.

    What a shell starts in the background ignores it, and so would all that tests start there.
    """
    words = [sys.executable, "-m", "errpipe.cli.app", *line]
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    heard = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    null = subprocess.DEVNULL
    return subprocess.Popen(words, env=env, start_new_session=True, stdout=null, stderr=null, preexec_fn=heard)


def victim(work: Callable[[], int]) -> int:
    """Number of a process, in a session of its own, that does `work`."""
    pid = os.fork()
    if pid == 0:
        os.setsid()
        with quiet():
            os._exit(work())
    return pid


def killed(pid: int, after: float) -> bool:
    """Whether a process and those of its session were killed `after` s; False where it had ended by then."""
    time.sleep(after)
    os.kill(pid, signal.SIGKILL)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])


def memory() -> str | None:
    """A folder in memory where there is one: a kill loses nothing that a disk keeps, and fsync does not wait."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
