"""Shared libraries of the tests, each compiled once for all test files and workers: gcc takes seconds for each.

What a library is made of is its key: command, sources and headers. Each caller gets a copy of its own, for a loaded
library keeps state.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from filelock import FileLock

FOLDER = Path(tempfile.gettempdir()) / f"errpipe-compiled-{os.getuid()}"


def compile_once(command: Sequence[str | Path], sources: Sequence[Path], out: Path, *last: str) -> Path:
    """Run `command SOURCES -o OUT LAST`, or copy what the same command made of the same bytes before.

    Headers are those beside the sources. Raises CalledProcessError where the compiler refuses.
    """
    beside = sorted(h for folder in {s.parent for s in sources} for h in folder.glob("*.h"))
    compiler = Path(shutil.which(str(command[0])) or command[0]).resolve()
    key = hashlib.sha256(repr([compiler.name, compiler.stat().st_mtime_ns, *map(str, command[1:]), *last]).encode())
    for file in (*sources, *beside):
        key.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    FOLDER.mkdir(mode=0o700, exist_ok=True)
    if FOLDER.is_symlink() or FOLDER.stat().st_uid != os.getuid():
        raise RuntimeError(f"{FOLDER} is not ours")
    made = FOLDER / f"{key.hexdigest()}.so"
    with FileLock(f"{made}.lock"):
        if not made.exists():
            parts = [*command, *sources, "-o", made.with_suffix(".part"), *last]
            done = subprocess.run(list(map(str, parts)), capture_output=True, text=True)
            if done.returncode:
                raise subprocess.CalledProcessError(done.returncode, parts, done.stdout, done.stderr)
            made.with_suffix(".part").replace(made)
    return Path(shutil.copyfile(made, out))
