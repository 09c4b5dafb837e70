"""The `errpipe` command: one file per verb in this folder, loaded on demand.

A new verb is one file with a function `command`, and one word in `_names.VERBS`. The function's signature is the
verb's arguments (typer), its docstring the help: a first line of at most 70 characters, then a block
that starts with `Example:`. A verb returns nothing; it ends with `print_result`, or raises an ErrpipeError.
"""

from __future__ import annotations

import atexit
import errno
import gc
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from errpipe.cli._deferred import defer
from errpipe.cli._names import VERBS
from errpipe.cli.output import module_of, print_error
from errpipe.errors import ErrpipeError, UsageError, did_you_mean

# Failures of the system that name no file: no errors of errpipe.
_OUTSIDE_CAUSES = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENFILE)

# New objects between two collections (Python: 700). Most objects are modules and models that stay; chosen on the demo,
# where collections took 0.58 of 5.6 s and take 0.18, with the same peak of memory.
NEW_OBJECTS = 30_000
ELSEWHERE = ("-h", "--h", "--s")  # beginnings of the options of a fleet that needs no processes: help, a scheduler


class _Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP: of a CI job's time limit, a shutdown, a closed terminal."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code. The one place where errors become messages."""
    gc.set_threshold(NEW_OBJECTS)
    defer("numpy", "pandas", "pyarrow", "pyarrow.csv", "pyarrow.parquet")
    if argv is None:
        _end_cleanly()
        atexit.register(gc.freeze)  # what is left ends with the process: to search it for garbage took a fleet 0.16 s
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments
    arguments = [word for word in arguments if word != "--debug"]
    name = next((word for word in arguments if not word.startswith("-")), "")
    as_json = "--json" in arguments
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # looking for plugins reads every installed package's files
    try:
        if name and name not in VERBS:
            raise UsageError(f"no verb {name!r} (errpipe --help lists them).{did_you_mean(name, VERBS)}")
        if name == "fleet" and not any(word.startswith(ELSEWHERE) for word in arguments):
            module_of("verbs.fleet_processes").start_imports()  # before typer's, for they take longest
        code = _plain_check(arguments) if name == "check" else None
        if code is None:
            from errpipe.cli import _verbs

            code = _verbs.invoke(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        return _closed_pipe()
    except KeyboardInterrupt as stop:
        return _interrupted(name, stop, as_json)
    except Exception as err:
        if isinstance(err.__cause__, KeyboardInterrupt):  # in `__set_name__`: Python 3.11 raises a RuntimeError
            return _interrupted(name, err.__cause__, as_json)
        if debug:
            import traceback

            traceback.print_exc()
        return _refusal(name, err, as_json)


def _interrupted(name: str, stop: KeyboardInterrupt, as_json: bool) -> int:
    what, code = ("terminated", 143) if isinstance(stop, _Terminated) else ("interrupted", 130)
    return print_error(name, f"{what}; the same command continues from here", code, as_json)


def _end_cleanly() -> None:
    """Let SIGTERM and SIGHUP end this process as Ctrl-C does: by itself Python would leave temporary files."""

    def stop(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_IGN)  # a second one would interrupt the cleaning up
        raise _Terminated

    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        if signal.getsignal(number) == signal.SIG_DFL:  # `nohup` ignores SIGHUP, and means it
            signal.signal(number, stop)


def _plain_check(arguments: list[str]) -> int | None:
    """The exit code of a check of files with no other options than these two; None for any other command line.

    Typer takes a fifth of a check's time, which editors and hooks wait for.
    """
    files = [word for word in arguments[1:] if word not in ("--json", "--no-data")]
    if arguments[0] != "check" or not files or any(word.startswith("-") for word in files):
        return None
    from errpipe.cli._check import check

    # Classes and functions that stay until the end, most of them of pydantic: there is nothing to collect.
    gc.disable()
    try:
        return check([Path(file) for file in files], "--no-data" not in arguments, "text", "--json" in arguments)
    finally:
        gc.enable()


def _refusal(name: str, err: Exception, as_json: bool) -> int:
    """The message and exit code of an exception."""
    if isinstance(err, ErrpipeError):
        return print_error(name, str(err), err.exit_code, as_json, err)
    verbs = sys.modules.get("errpipe.cli._verbs")
    if verbs is not None and isinstance(err, verbs.CLICK_USAGE):
        text = verbs.usage(err)
        line = f"errpipe {name}".strip()
        text = f"{line}: {text[0].lower()}{text[1:]}\n({line} --help shows what is possible)"
        return print_error(name, text, 2, as_json)
    if isinstance(err, OSError) and err.strerror and (err.filename is not None or err.errno in _OUTSIDE_CAUSES):
        where = f"{err.filename}: " if err.filename is not None else ""
        return print_error(name, f"{where}{err.strerror.lower()}", 2, as_json)
    if isinstance(err, MemoryError):
        return print_error(name, "out of memory: fewer rows or columns at a time, or a larger machine", 3, as_json)
    text = f"internal error, please report it: {type(err).__name__}: {err}\n(--debug shows where it happened)"
    return print_error(name, text, 1, as_json)


def _closed_pipe() -> int:
    """The reader of our output has closed the pipe (`errpipe ... | head`); this is not an error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 141


if __name__ == "__main__":
    sys.exit(main())
