"""A bounded campaign against all that reads files: mutated files, and processes killed at any moment. `make attack`.

    python -m tests.hostile.attack --seconds 600 --kills 1000 --seed 7

Every attempt runs in a process of its own (forked, so it starts in milliseconds) with a limit on memory and time. It
has to end with a message: exit code 0, 2, 3, 4 or 6. The kills go on beside it, on a second core. Found is: an internal
error, a crash, a time-out, a file outside the given folder that is touched, an output that is neither the old one nor
the new one after a kill.
"""

from __future__ import annotations

import argparse
import io
import os
import random
import shutil
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from tests.hostile import mutations
from tests.hostile.attacked_files import AttackedFile, attacked_files, described, unpack
from tests.hostile.kills import beside
from tests.hostile.processes import ALLOWED, forked

LONGEST = 2  # times the given seconds, for the kills beside the files
LEAST = 20  # files that are tried however busy the machine is
WRITTEN = ("said.txt", "found-", "out", "imported", "unpacked", "o.ngc", "p.csv", "d.fmu")  # by commands, as asked


def modification_times(folder: Path) -> dict[str, int]:
    """What lies beside the folder and in it, files with the time of their last change: no attempt may touch it."""
    rows = [row for top in (folder.parent, folder) for row in os.scandir(top) if not row.name.startswith(WRITTEN)]
    return {row.path: row.stat().st_mtime_ns if row.is_file() else 0 for row in rows}


def attack(folder: Path, seconds: float, rng: random.Random) -> tuple[list[AttackedFile], list[str]]:
    """Mutate files for so long, at least LEAST of them; the files with what was answered, and what was found."""
    from errpipe.cli.app import main

    (folder.parent / "precious.txt").write_text("precious")
    opened, pair = attacked_files(folder), []
    end = time.monotonic() + seconds
    while time.monotonic() < end or sum(attacked.tried for attacked in opened) < LEAST:
        attacked = rng.choice(opened)
        data = mutations.mutated(attacked.sound, rng)
        if attacked.sound.startswith(b"ECT") and rng.random() < 0.8:
            data = mutations.sealed(data)
        elif zipfile.is_zipfile(io.BytesIO(attacked.sound)) and rng.random() < 0.8:
            data = mutations.repacked(attacked.sound, rng)
        elif attacked.sound[:1] == b"{" and rng.random() < 0.6:
            data = mutations.reshaped(attacked.sound, rng)
        attacked.file.write_bytes(data)
        if attacked.fresh is not None:
            shutil.rmtree(attacked.fresh, ignore_errors=True)
        line = rng.choice(attacked.lines) if attacked.lines else ["unpack"]
        inside = unpack if attacked.file.suffix == ".fmu" else described
        work = partial(main, line) if attacked.lines else partial(inside, attacked, folder)
        before = modification_times(folder)
        code, said = forked(work, folder.parent)
        touched = {path for path, _ in before.items() ^ modification_times(folder).items()}
        pair += [f"{attacked.name}: {' '.join(line[:1])} touched {path}" for path in sorted(touched)]
        attacked.file.write_bytes(attacked.sound)
        attacked.tried += 1
        attacked.codes[-1 if code is None else code] += 1
        if code not in ALLOWED or "internal error" in said:
            kept = folder.parent / f"found-{len(pair)}-{attacked.file.name}"
            kept.write_bytes(data)
            pair.append(
                f"{attacked.name}: {' '.join(line[:1])} gave {code}: {said.strip()[:300]} (kept as {kept.name})"
            )
    return opened, pair


def report(opened: list[AttackedFile], killed: str, found: list[str]) -> Iterator[str]:
    """What was tried and what was found, as a table and lines."""
    yield f"{'attacked':<16} {'tried':>7}  exit codes"
    for attacked in opened:
        codes = ", ".join(f"{code}: {n}" for code, n in sorted(attacked.codes.items()))
        yield f"{attacked.name:<16} {attacked.tried:>7}  {codes}"
    yield f"{sum(attacked.tried for attacked in opened)} files; SIGKILL: {killed}"
    yield f"found: {len(found)}"
    yield from found


def main_() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--keep", type=Path, default=None, help="folder for the files that broke something")
    given = parser.parse_args()
    began = time.monotonic()
    counted = beside(given.kills, given.seed, began + LONGEST * given.seconds)
    with tempfile.TemporaryDirectory(prefix="errpipe-attack-") as name:
        top = Path(name)
        (top / "files").mkdir()
        opened, counts = attack(top / "files", given.seconds, random.Random(given.seed))
        if given.keep is not None:
            given.keep.mkdir(parents=True, exist_ok=True)
            for path in top.glob("found-*"):
                shutil.copy(path, given.keep)
    killed, torn, took = counted()
    counts += torn
    print(f"seed {given.seed}, {time.monotonic() - began:.0f} s")
    print("\n".join(report(opened, f"{killed} of {given.kills} in {took:.0f} s", counts)))
    return 1 if counts else 0


if __name__ == "__main__":
    sys.exit(main_())
