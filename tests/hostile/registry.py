"""Writers of a registry killed at any moment, and on a disk that fills: nothing that was promoted is ever lost.

python -m tests.hostile.registry --kills 1000 --seed 7          (a part of `make attack`)
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import tempfile
import time
from pathlib import Path

from errpipe.errors import GateError
from errpipe.registry import minisign
from errpipe.registry.store import Registry

EVERY = 50  # kills after which a new registry begins: checking a history takes a time that grows with it


def writer(store: Registry, key: minisign.SecretKey, text: str, full_after: int | None) -> None:
    """Promote without end; with `full_after`, no file may grow beyond so many bytes (a full disk)."""
    if full_after is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (full_after, full_after))
    while True:
        try:
            after = len(store.history("7"))
            store.append(
                "7", "promote", os.urandom(random.Random(text).randrange(10, 4000)), text, "2026-01-01", key, after
            )
        except (OSError, GateError):  # the disk is full; another writer was first
            continue


def _seconds_of_one(folder: Path, key: minisign.SecretKey) -> float:
    begin, store = time.perf_counter(), Registry(folder, key.public)
    store.append("7", "promote", b"table", "first", "2026-01-01", key, 0)
    return time.perf_counter() - begin


def campaign(folder: Path, count: int, seed: int, writers: int = 2) -> tuple[int, list[str]]:
    """Entries that were promoted while `count` writers were killed, and what went wrong: nothing, if all is well."""
    rng, key = random.Random(seed), minisign.generate()
    entries, wrong, killed, store, seen = 0, list[str](), 0, Registry(folder, key.public), list[str]()
    longest = max(0.25, 10 * _seconds_of_one(folder / "first", key))  # s; on a busy machine a promotion takes longer
    while killed < count and not wrong:
        if killed % EVERY < writers:
            entries, seen = entries + len(seen), []
            store = Registry(folder / f"{killed}", key.public)
        pids = []
        for number in range(writers):
            pid = os.fork()
            if pid == 0:
                try:
                    full = rng.choice((None, None, 200, 900)) if number else None
                    writer(store, key, f"kill {killed} writer {number}", full)
                finally:
                    os._exit(1)
            pids.append(pid)
        time.sleep(rng.uniform(0.0, longest))
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        killed += writers
        try:
            history = store.history("7")
            now = [entry.digest for entry in history]
            if now[: len(seen)] != seen:
                wrong.append(f"after {killed} kills an entry is gone or another one")
            if not all(store.table(entry) for entry in history):
                wrong.append(f"after {killed} kills a table is empty")
            seen = now
        except Exception as err:
            wrong.append(f"after {killed} kills: {type(err).__name__}: {err}")
    return entries + len(seen), wrong


def main() -> int:
    parser = argparse.ArgumentParser(description="Registry: killed writers and full disks.")
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="errpipe-registry-") as name:
        entries, wrong = campaign(Path(name), given.kills, given.seed)
    print(f"registry: {given.kills} SIGKILLs, {entries} promotions, lost or broken: {len(wrong)}")
    print("\n".join(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
