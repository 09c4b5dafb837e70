"""Commands stopped at any moment: retrain by SIGKILL, correct, run and export by SIGTERM and SIGINT.

python -m tests.hostile.interrupted --count 200 --seed 7          (a part of `make attack`)
"""

from __future__ import annotations

import argparse
import contextlib
import random
import shutil
import signal
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from errpipe import jsonfile
from errpipe.cli.app import main
from errpipe.errors import VerifyError
from tests.hostile.command_line import PIPELINE, recording_folder
from tests.hostile.kills import EXPORTED, measured, tree
from tests.hostile.processes import forked, fresh, killed, memory, quiet, victim

EVERY = 5  # of so many kills one is followed by the look that mends the rest
STOPPED = {signal.SIGTERM: 143, signal.SIGINT: 130}


def torn(out: Path, known: set[tuple[str, str]]) -> list[str]:
    """Files below OUT that are no known ones; of lock files, which grow stage by stage, those that cannot be read."""
    names = dict(set(tree(out).items()) - known)
    for name in [name for name in names if name.endswith("errpipe.lock")]:
        with contextlib.suppress(VerifyError):
            jsonfile.read(out / name)
            del names[name]
    return sorted(names)


def retrain_kills(folder: Path, count: int, rng: random.Random) -> tuple[int, list[str]]:
    """How many looks were killed, and what went wrong: the champion and each file of OUT are as before or as after."""
    from tests.e2e.retrain.test_retrain import PIPELINE as AXIS
    from tests.e2e.retrain.test_retrain import record

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "axis.yaml").write_text(AXIS)
    champion, out, before = folder / "champion", folder / "out", folder / "before"
    line = ["retrain", str(folder / "axis.yaml"), "--champion", str(champion), "--out", str(out)]
    with quiet():  # in this process: the forked ones need not import or compile
        record(folder / "recording", 12)
        main(["run", str(folder / "axis.yaml"), "--out", str(champion)])
        record(folder / "recording", 14)
        main(line)
        shutil.copytree(out, before)
        record(folder / "recording", 15)
        began = time.monotonic()
        main(line)
    took, kept, after = time.monotonic() - began, tree(champion), tree(out)
    known, wrong, done, tried = {*tree(before).items(), *after.items()}, [], 0, 0
    while done < count and tried < 10 * count:
        shutil.rmtree(out)
        shutil.copytree(before, out)
        tried += 1
        done += killed(victim(lambda: main(line)), rng.uniform(0, 1.2 * took))
        wrong += [f"kill {done}: {name} is torn" for name in torn(out, known)]
        if tried % EVERY == 0 or done == count:
            code, said = forked(lambda: main(line), folder)
            if code not in (0, 4) or tree(out) != after:
                wrong.append(f"kill {done}: the next look gave {code} or other bytes: {said.strip()[:200]}")
        if tree(champion) != kept:
            wrong.append(f"kill {done}: the champion was touched")
    return done, wrong


def commands(folder: Path) -> dict[str, list[str]]:
    """Command lines for one folder that write below `folder`/out, made with their inputs."""
    recording_folder(folder / "rec", dev=measured(np.arange(40)))
    (folder / "p.yaml").write_text(PIPELINE + EXPORTED)
    table = folder / "made/export/table.ect"
    with quiet():
        assert main(["run", str(folder / "p.yaml"), "--out", str(folder / "made")]) == 0
    moves = "".join(f"G1 X{100 + 200 * (n % 2)} Y{n % 9}.5\n" for n in range(20_000))
    (folder / "part.ngc").write_text(f"G90 G21 G54\nG0 X0 Y0 Z0\n{moves}")
    out = folder / "out"
    return {
        "run": ["run", str(folder / "p.yaml"), "--out", str(out)],
        "export": ["export", str(table), "--target", "linuxcnc_screw", "--target", "c_runtime", "--out", str(out)],
        "correct": [
            "correct", str(folder / "part.ngc"), "--table", str(table), "--start", "0,0,0", "--out", str(out / "p.ngc")
        ],
    }  # fmt: skip


def stopped(line: Sequence[str], out: Path, number: signal.Signals, after: float) -> tuple[bool, list[str]]:
    """Whether a command was stopped before its end, and what is wrong with its exit code or what it left."""
    process = fresh(list(line))
    time.sleep(after)
    process.send_signal(number)
    code = process.wait(60)
    left = [str(p.relative_to(out)) for p in out.rglob("*") if p.name.endswith(".tmp")]
    left += [p.name for p in (out / ".errpipe" / "work").glob("*")]
    wrong = [f"{line[0]}: {name} is left" for name in left]
    # before the program's first line Python itself ends it, by the signal
    return code != 0, wrong if code in (0, STOPPED[number], -number) else [*wrong, f"{line[0]}: exit code {code}"]


def signals(folder: Path, count: int, rng: random.Random) -> tuple[int, list[str]]:
    """How many commands were stopped, and what went wrong; OUT holds what it held before, or all of the new files."""
    lines, out, took, whole = commands(folder), folder / "out", {}, {}
    for name, line in lines.items():
        began = time.monotonic()
        fresh(line).wait()
        took[name], whole[name] = time.monotonic() - began, tree(out)
        shutil.rmtree(out)
    done, wrong = 0, []
    for tried in range(4 * count):
        if done == count:
            break
        name, number = list(lines)[tried % 3], rng.choice(list(STOPPED))
        out.mkdir()
        gone, found = stopped(lines[name], out, number, rng.uniform(0.0, 1.1 * took[name]))
        done, wrong = done + gone, wrong + found
        wrong += [f"{name}: {file} is torn" for file in torn(out, set(whole[name].items()))]
        if gone and tried % EVERY == 0 and (fresh(lines[name]).wait() or tree(out) != whole[name]):
            wrong.append(f"{name}: the next command does not give the same bytes")
        shutil.rmtree(out)
    return done, wrong


def campaign(count: int, seed: int) -> int:
    """Both, in a folder in memory; 1 where anything went wrong."""
    bad = 0
    for what, work in (("retrain, SIGKILL", retrain_kills), ("correct, run, export, SIGTERM and SIGINT", signals)):
        with tempfile.TemporaryDirectory(prefix="errpipe-interrupted-", dir=memory()) as name:
            done, wrong = work(Path(name), count, random.Random(seed))
        print(f"{what}: {done} stopped, torn or left: {len(wrong)}", *wrong, sep="\n", flush=True)
        bad += bool(wrong)
    return int(bad > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Commands stopped at any moment.")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    raise SystemExit(campaign(given.count, given.seed))
