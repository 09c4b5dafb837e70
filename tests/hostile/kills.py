"""Runs killed at any moment while their data change: every published file is whole, the next run mends the rest."""

from __future__ import annotations

import hashlib
import json
import os
import random
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.hostile.processes import forked, fresh, killed, memory, quiet, victim

FRESH = 50  # of so many victims one is an interpreter of its own, which takes ten times as long
EXPORTED = """  - kind: fit
    components: [{component: EXX, terms: [{term: offset}, {term: backlash, axis: X}]}]
  - {kind: export, ungated: true, targets: [linuxcnc_screw]}
"""


def measured(at: np.ndarray) -> np.ndarray:
    """Deviations (um) of rows 0, 1, ... of an axis 10 um too long, with noise."""
    return 10 * (at % 10) / 9 + 0.3 * np.sin(7.0 * at)


def tree(out: Path) -> dict[str, str]:
    """Name -> SHA-256 of all published files; what is unfinished (.errpipe, .tmp) does not count."""
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and ".errpipe" not in path.parts and not path.name.endswith(".tmp")
    }


def kills(folder: Path, count: int, rng: random.Random, end: float) -> tuple[int, list[str]]:
    """Kill runs at any moment while the data change to and fro; every file must be whole, the next run mends all.

    Counted are the runs that were killed, not those that had ended before the signal came. Victims are forked from this
    process, which has imported and compiled everything; each FRESH-th is an interpreter of its own instead.
    """
    from errpipe.cli.app import main
    from tests.hostile.command_line import PIPELINE, recording_folder

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "p.yaml").write_text(PIPELINE + EXPORTED)
    out, line = folder / "out", ["run", str(folder / "p.yaml"), "--out", str(folder / "out")]
    whole, sources, took, at = [], [], 0.0, np.arange(40)
    for version in (0, 1, 0):  # in this process: the forked ones need not import or compile
        recording_folder(folder / "rec", dev=measured(at) * (1 + version))
        sources.append((folder / "rec/rows.csv").read_bytes())
        began = time.monotonic()
        with quiet():
            assert main(line) == 0
        took = time.monotonic() - began
        whole.append(tree(out))
    known = {(name, digest) for versions in whole for name, digest in versions.items()}
    began = time.monotonic()
    fresh(line).wait()
    fresh_took = time.monotonic() - began
    pair, tried, done, version = [], 0, 0, 0
    while done < count and time.monotonic() < end:
        version = 1 - version if rng.random() < 0.7 else version
        (folder / "rec/rows.csv").write_bytes(sources[version])
        tried += 1
        if tried % FRESH == 0:
            gone = killed(fresh(line).pid, rng.uniform(0, 1.2 * fresh_took))
        else:
            gone = killed(victim(lambda: main(line)), rng.uniform(0, 1.2 * took))
        done += gone
        torn = [name for name, digest in tree(out).items() if (name, digest) not in known and name != "errpipe.lock"]
        pair += [f"kill {done}: {name} is neither old nor new" for name in torn]
        try:
            json.loads((out / "errpipe.lock").read_text())
        except (OSError, ValueError) as err:
            pair.append(f"kill {done}: errpipe.lock: {err}")
        if gone and (done % 20 == 0 or done == count):
            code, said = forked(lambda: main(line), folder)
            if code != 0 or tree(out) != whole[version]:
                pair.append(f"kill {done}: the next run gave {code} or other bytes: {said.strip()[:200]}")
    return done, pair


def beside(count: int, seed: int, end: float) -> Callable[[], tuple[int, list[str], float]]:
    """Start the kill campaign in a process of its own; the function returned waits for what it counted and found."""
    reader, writer = os.pipe()
    began = time.monotonic()
    pid = os.fork()
    if pid == 0:
        try:
            with tempfile.TemporaryDirectory(prefix="errpipe-attack-", dir=memory()) as name:
                output = kills(Path(name), count, random.Random(seed), end)
        except BaseException as err:
            output = 0, [f"the kill campaign ended: {type(err).__name__}: {err}"]
        with os.fdopen(writer, "w") as stream:
            json.dump([*output, time.monotonic() - began], stream)
        os._exit(0)
    os.close(writer)

    def wait() -> tuple[int, list[str], float]:
        with os.fdopen(reader) as stream:
            done, load_result, took = json.load(stream)
        os.waitpid(pid, 0)
        return done, load_result, took

    return wait
