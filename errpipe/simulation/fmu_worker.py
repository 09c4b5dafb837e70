"""Runs one FMU in a separate process: started as a script, never imported. A crash ends this process only.

Two processes: a supervisor that does not load the FMU, and the one that runs it. When the supervisor's control pipe
closes, when the FMU ends or when it has filled its disk limit, all its processes are killed, including those in a
session of their own (the supervisor is the parent of every orphan). Started as root, the FMU runs as nobody if that
user can read the Python in use. On Linux (Landlock) it can write only below its working folder, and signal only itself.

Requests are lines of JSON on standard input, responses are lines of JSON on the original standard output; the FMU's
own output goes to standard error. Arrays are passed as .npy files in the start folder of the process.

    {"do": "load", "fmu": "model.fmu", "memory_mb": 2048}
    {"do": "simulate", "inputs": "in.npy", "output": "out.npy", "outputs": [...], "start_values": {...},
     "stop": 3600.0, "step": 1.0, "kind": "CoSimulation"}
"""

from __future__ import annotations

import json
import os
import select
import signal
import stat
import sys
import time
import zipfile
from pathlib import PurePosixPath
from typing import Any

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER, PR_SET_NO_NEW_PRIVS = 1, 36, 38  # of linux/prctl.h
MAX_ENTRIES = 20_000  # of the archive; FMUs with sources and documentation have a few hundred
# Simultaneous processes of an FMU; those with a solver or an interpreter have two or three
MAX_PROCESSES = 64
MAX_THREADS = 512  # of all of them together
POLL = 0.2  # s between checks of the FMU and its disk


def limit(memory_mb: int, disk_mb: int) -> None:
    """No more address space than this, no larger files, no core dumps."""
    try:
        import resource
    except ImportError:  # Windows: only the time limit applies
        return
    size = memory_mb * 1024 * 1024
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_FSIZE, (disk_mb << 20, disk_mb << 20))


def unpack(archive: str, folder: str, disk_mb: int) -> str:
    """Unpack an FMU. Raises ValueError for an archive that is too large or names files outside the folder."""
    with zipfile.ZipFile(archive) as source:
        entries = source.infolist()
        total = sum(entry.file_size for entry in entries)
        if len(entries) > MAX_ENTRIES or total > disk_mb << 20:
            raise ValueError(f"{len(entries)} files of {total >> 20} MB in all (at most {MAX_ENTRIES} of {disk_mb} MB)")
        for entry in entries:
            path = PurePosixPath(entry.filename.replace("\\", "/"))
            outside = path.is_absolute() or ".." in path.parts or ":" in entry.filename
            if outside or stat.S_ISLNK(entry.external_attr >> 16):
                raise ValueError(f"{entry.filename!r} leads out of the archive's folder")
        source.extractall(folder)
    return folder


def unit_of(variable: Any) -> str | None:
    """A variable's unit: its own, or its declared type's."""
    declared = getattr(variable, "declaredType", None)
    return variable.unit or (declared.unit if declared is not None else None)


def describe(model: Any) -> dict[str, Any]:
    """The parts of the model description that the parent needs."""
    experiment = model.defaultExperiment
    kinds = [k for k, have in (("CoSimulation", model.coSimulation), ("ModelExchange", model.modelExchange)) if have]
    return {
        "name": model.modelName,
        "version": model.fmiVersion,
        "kinds": kinds,
        "step": getattr(experiment, "stepSize", None) if experiment is not None else None,
        "variables": {
            v.name: {
                "causality": v.causality,
                "variability": v.variability,
                "type": v.type,
                "unit": unit_of(v),
                "start": None if v.start is None else str(v.start),
                "scalar": not v.dimensions,
                "min": getattr(v, "min", None),
                "max": getattr(v, "max", None),
            }
            for v in model.modelVariables
        },
    }


class Work:
    """The loaded FMU, unpacked in the process' own folder."""

    def load(self, order: dict[str, Any]) -> dict[str, Any]:
        limit(order["memory_mb"], order["disk_mb"])
        import fmpy

        self.folder = unpack(order["fmu"], os.path.abspath("unpacked"), order["disk_mb"])
        self.model = fmpy.read_model_description(self.folder)
        return describe(self.model)

    def simulate(self, order: dict[str, Any]) -> dict[str, Any]:
        import fmpy
        import numpy as np

        signals = None
        if order.get("inputs"):
            plain = np.load(order["inputs"], allow_pickle=False)
            kinds = {v.name: v.type for v in self.model.modelVariables}
            dtypes = {"Real": float, "Float64": float, "Float32": float, "Boolean": bool}
            types = [(n, dtypes.get(kinds.get(n, "Real"), int)) for n in plain.dtype.names]
            signals = np.empty(plain.shape, dtype=types)
            for name in plain.dtype.names:
                signals[name] = plain[name]
        result = fmpy.simulate_fmu(
            self.folder,
            model_description=self.model,
            fmi_type=order["kind"],
            start_time=0.0,
            stop_time=order["stop"],
            output_interval=order["step"],
            step_size=order["step"],
            input=signals,
            output=order["outputs"],
            start_values=order["start_values"],
            validate=False,
        )
        table = np.column_stack([np.asarray(result[n], dtype=float) for n in ("time", *order["outputs"])])
        np.save(order["output"], table, allow_pickle=False)
        return {"rows": len(table)}


def serve() -> None:
    """Answer requests until there are no more."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # the FMU's output must not be mistaken for a response
    work = Work()
    for line in sys.stdin:
        order = json.loads(line)
        try:
            answer = {"ok": getattr(work, {"load": "load", "simulate": "simulate"}[order["do"]])(order)}
        except MemoryError:
            answer = {"error": "out of memory"}
        except Exception as err:
            answer = {"error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


# ---------------------------------------------------------------- the supervisor


def switch_on(option: int) -> None:
    """Switch on an option of prctl(2); without effect if there is no such call (not Linux)."""
    import contextlib
    import ctypes

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(option, 1, 0, 0, 0)


def threads_of(user: int) -> int:
    """Number of threads of a user at present, from /proc; 0 if there is no /proc."""
    total = 0
    for name in os.listdir("/proc") if os.path.isdir("/proc") else []:
        try:
            if name.isdigit() and os.stat(f"/proc/{name}").st_uid == user:
                total += len(os.listdir(f"/proc/{name}/task"))
        except OSError:
            continue
    return total


def drop_privileges(user: int) -> None:
    """Drop root's rights for good, and the ability to regain any; at most MAX_THREADS more threads."""
    import resource

    switch_on(PR_SET_NO_NEW_PRIVS)
    limit = threads_of(user or os.getuid()) + MAX_THREADS
    _, hard = resource.getrlimit(resource.RLIMIT_NPROC)
    limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
    resource.setrlimit(resource.RLIMIT_NPROC, (limit, limit))  # the kernel counts threads of a user; root's it does not
    if user:
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)


def restrict_writes(folder: str) -> None:
    """Let this process and its children write only below one folder (Linux' Landlock; elsewhere without effect)."""
    import ctypes

    kernel = ctypes.CDLL(None, use_errno=True)
    create, add, restrict = 444, 445, 446  # system calls, the same on all architectures
    version = kernel.syscall(create, None, 0, 1) if sys.platform == "linux" else -1
    if version < 1:
        return
    # linux/landlock.h: write, remove, make of every kind; moving between folders since version 2, truncating since 3
    bits = (1, *range(4, 13), *([13] if version > 1 else []), *([14] if version > 2 else []))
    writing = sum(1 << bit for bit in bits)
    scopes = 0b11 if version >= 6 else 0  # signals and abstract sockets to processes outside
    fields = (writing, 0, scopes)[: 1 if version < 4 else 2 if version < 6 else 3]
    rules = b"".join(value.to_bytes(8, sys.byteorder) for value in fields)
    ruleset = kernel.syscall(create, rules, len(rules), 0)
    if ruleset < 0:
        return
    for path, allowed in ((folder, writing), ("/dev/null", 1 << 1)):
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        rule = allowed.to_bytes(8, sys.byteorder) + handle.to_bytes(4, sys.byteorder)
        kernel.syscall(add, ruleset, 1, rule, 0)
        os.close(handle)
    kernel.syscall(restrict, ruleset, 0)
    os.close(ruleset)


def descendants(of: int) -> list[int]:
    """All processes below one, from /proc; [] if there is no /proc."""
    parents: dict[int, int] = {}
    for name in os.listdir("/proc") if os.path.isdir("/proc") else []:
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat", "rb") as stream:
                    parents[int(name)] = int(stream.read().rpartition(b")")[2].split()[1])
            except (OSError, IndexError, ValueError):
                continue
    pids, waiting = [], [of]
    while waiting:
        parent_pid = waiting.pop()
        below = [child for child, parent in parents.items() if parent == parent_pid]
        pids += below
        waiting += below
    return pids


def end_all() -> None:
    """Kill every process below this one repeatedly until none is left (a dying one may have started another)."""
    end = time.monotonic() + 5.0  # s: killed processes are gone long before
    while time.monotonic() < end:
        for process in descendants(os.getpid()):
            try:
                os.kill(process, signal.SIGKILL)
            except OSError:
                continue
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        time.sleep(0.01)


def size_mb(folder: str) -> int:
    """Size of all files below a folder, links not followed, MB."""
    total = 0
    for directory, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(os.path.join(directory, name)).st_blocks * 512
            except OSError:
                continue
    return total >> 20


def supervise(control: int, user: int, disk_mb: int) -> None:
    """Start the process that runs the FMU; end all of it on request, and exit with its exit code."""
    switch_on(PR_SET_CHILD_SUBREAPER)
    child = os.fork()
    if child == 0:
        os.close(control)
        drop_privileges(user)
        restrict_writes(".")
        serve()
        os._exit(0)
    for handle in (0, 1):
        os.close(handle)  # of the child, so that it is notified when it closes them
    status = None
    while status is None:
        if select.select([control], [], [], POLL)[0]:
            break
        pid, code = os.waitpid(child, os.WNOHANG)
        status = code if pid == child else None
        beyond = ""
        if size_mb(".") > disk_mb:
            beyond = f"wrote more than {disk_mb} MB"
        elif len(descendants(os.getpid())) > MAX_PROCESSES:
            beyond = f"started more than {MAX_PROCESSES} processes"
        if status is None and beyond:
            sys.stderr.write(f"it {beyond} and was ended\n")
            sys.stderr.flush()
            break
    end_all()
    if status is None:
        os._exit(1)
    if os.WIFSIGNALED(status):
        signal.signal(os.WTERMSIG(status), signal.SIG_DFL) if os.WTERMSIG(status) != signal.SIGKILL else None
        os.kill(os.getpid(), os.WTERMSIG(status))
    os._exit(os.waitstatus_to_exitcode(status) if not os.WIFSIGNALED(status) else 1)


if __name__ == "__main__":
    supervise(*map(int, sys.argv[1:]))
