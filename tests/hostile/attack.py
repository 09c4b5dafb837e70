"""A bounded campaign against every door: mutated files, and processes that are killed at any moment. `make attack`.

    python -m tests.hostile.attack --seconds 600 --kills 1000 --seed 7

Every attempt runs in a process of its own (forked, so it starts in milliseconds) with a limit on memory and time. It
has to end with a message: exit code 0, 2, 3, 4 or 6. The kills go on beside it, on a second core. Found is: an internal
error, a crash, a time-out, a file outside the given folder that is touched, an output that is neither the old one nor
the new one after a kill.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

TIME_LIMIT = 60  # s of one attempt on a busy machine; none should take two
MEMORY = 4 << 30  # bytes of address space; Arrow and Numba reserve much that they do not use
FRESH = 50  # of so many victims one is an interpreter of its own, which takes ten times as long
LONGEST = 2  # times the given seconds, for the kills beside the files
LEAST = 20  # files that are tried however busy the machine is
ALLOWED = (0, 2, 3, 4, 6)
WRITTEN = ("said.txt", "found-", "out", "imported", "unpacked", "o.ngc", "p.csv", "d.fmu")  # by commands, as asked
TOKENS = [
    b"../../precious.txt", b"/etc/passwd", b"\0", b"nan", b"-inf", b"1e400", b"1e30", b"9" * 400, b"-", b"&a", b"*a",
    b"${HOME}", b"!!python/object:os.system", b"{", b"[" * 60, b"}", b"'", b'"', b"\xff\xfe", b"\n", b"\r", b",", b";",
    b"G2 I-400", b"G4 P1 X500", b"(", b"%", b"X9999999999", b"P99999999", b"#1", b"0", b"null", b"true",
]  # fmt: skip


@dataclass
class Door:
    """A file that somebody hands over: its sound bytes, its place, and the command lines that open it."""

    name: str
    file: Path
    lines: list[list[str]]
    sound: bytes = b""
    fresh: Path | None = None  # what a command writes, removed before each attempt
    tried: int = 0
    codes: Counter[int] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.sound = self.file.read_bytes()


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, cut, repeated or replaced by what parsers dislike."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(7):
            case 0 if out:
                out[at % len(out)] = rng.randrange(256)
            case 1 if out:
                out[at % len(out)] ^= 1 << rng.randrange(8)
            case 2:
                del out[at : at + rng.choice((1, 2, 8, 64, len(out)))]
            case 3:
                out[at:at] = rng.choice(TOKENS)
            case 4:
                out[at : at + rng.randrange(1, 12)] = rng.choice(TOKENS)
            case 5:
                out[at:at] = out[at : at + rng.choice((1, 16, 200))] * rng.choice((1, 2, 50))
            case _:
                lines = bytes(out).split(b"\n")
                rng.shuffle(lines) if len(lines) < 200 and rng.random() < 0.2 else lines.insert(
                    rng.randrange(len(lines)), rng.choice(lines)
                )
                out = bytearray(b"\n".join(lines))
    return bytes(out[: 1 << 20])


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Nothing is printed."""
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        yield


def forked(work: Callable[[], int], folder: Path) -> tuple[int | None, str]:
    """Exit code of `work` in a process of its own (None: killed by a signal, or out of time), and what it said."""
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


# ---------------------------------------------------------------- the doors


def measured(at: np.ndarray) -> np.ndarray:
    """Deviations (um) of rows 0, 1, ... of an axis 10 um too long, with noise."""
    return 10 * (at % 10) / 9 + 0.3 * np.sin(7.0 * at)


def doors(folder: Path) -> list[Door]:
    """Sound files of every kind in `folder`, each with the commands that read it."""
    from errpipe.cli.app import main
    from errpipe.tables import ect
    from tests.hostile.doors import PIPELINE, recording_folder
    from tests.hostile.test_tables import parquet_folder
    from tests.unit.targets import machines

    def command(*words: str | Path) -> list[str]:
        return [str(word) for word in words]

    rec, par = (
        recording_folder(folder / "rec", dev=measured(np.arange(40))),
        parquet_folder(folder / "par" / "rec", 200),
    )
    pipeline, second = folder / "p.yaml", folder / "par" / "p.yaml"
    pipeline.write_text(PIPELINE + EXPORTED)
    machine, model = folder / "machine.yaml", folder / "model.json"
    machine.write_bytes((Path(__file__).parents[2] / "examples/machines/horizontal-centre-ni-1997.yaml").read_bytes())
    second.write_text(PIPELINE)
    ect_file, twin, program, laser = (folder / name for name in ("t.ect", "t.json", "p.ngc", "laser.rtl"))
    table = machines.wavy_both_directions()
    ect.write(table, ect_file)
    ect.write_json(table, twin)
    program.write_text(PROGRAM)
    laser.write_text(LASER)
    run = command("run", pipeline, "--out", folder / "out")
    correct = command("correct", program, "--table", ect_file, "--start", "0,0,0", "--out", folder / "o.ngc")
    at = ["--at", "x=100"]
    with quiet():
        assert main(run) == 0
    shutil.copy(folder / "out" / "fit" / "error_model.json", model)
    predict = command("predict", model, rec, "--out", folder / "p.csv")
    found = [
        Door("table (.ect)", ect_file, [command("eval", ect_file, *at), command("whatis", ect_file)]),
        Door("table (JSON)", twin, [command("eval", twin, *at)]),
        Door("manifest", rec / "recording.yaml", [command("check", rec), run]),
        Door(
            "pipeline", pipeline, [command("check", pipeline), command("plan", pipeline, "--out", folder / "out"), run]
        ),
        Door("CSV", rec / "rows.csv", [run]),
        Door("Parquet", par / "rows.parquet", [command("run", second, "--out", folder / "out2")]),
        Door("NC program", program, [correct]),
        Door("lock file", folder / "out" / "errpipe.lock", [run]),
        Door("journal", _journal(folder / "out"), [run]),
        Door("model", model, [predict, command("whatis", model)]),
        Door("machine", machine, [command("synthesis", machine), command("check", machine)]),
        Door("exported folder", folder / "out/export/export.json", [command("verify", folder / "out" / "export")]),
        Door("laser file", laser, [command("whatis", laser)]),
    ]
    with quiet():  # all of it once in this process: the forked ones need not import
        for door in found:
            for line in door.lines:
                code = main(line)
                assert code == 0, (line, code)
    for door in _measurements(folder):
        with quiet():
            assert main(door.lines[0]) == 0, door.name
        shutil.rmtree(door.fresh)
        code, said = forked(partial(main, door.lines[0]), folder)
        assert code == 0, (door.name, said)
        found.append(door)
    found.append(Door("FMU archive", _archive(folder), []))
    found.append(Door("FMU description", _description(folder), []))
    return found


def _journal(out: Path) -> Path:
    """The journal of a stage, as an interrupted run leaves it."""
    path = out / ".errpipe" / "clean.json"
    path.write_text(json.dumps(["clean/cleaning.json", "clean/recording.parquet", "clean/gone.txt"]))
    return path


def _measurements(folder: Path) -> list[Door]:
    """Files of each importing door, of the same axis."""
    import h5py
    import nptdms
    import openpyxl
    from scipy.io import savemat

    rows = [(x, 0.02 * x + 0.3 * (n % 3), 20 + 0.1 * n) for n, x in enumerate([0.0, 100.0, 200.0, 300.0] * 6)]
    names = ("position [mm]", "EXX [um]", "T nut [degC]")
    columns = {name: [row[n] for row in rows] for n, name in enumerate(names)}
    book = openpyxl.Workbook()
    for row in [names, *rows]:
        book.active.append(row)
    book.save(folder / "m.xlsx")
    with nptdms.TdmsWriter(str(folder / "m.tdms")) as writer:
        writer.write_segment([nptdms.ChannelObject("g", n, c) for n, c in columns.items()])
    with h5py.File(folder / "m.h5", "w") as file:
        for name, values in columns.items():
            file[name] = values
    savemat(
        folder / "m.mat",
        {name.split(" ")[0].replace("EXX", "deviation_um"): values for name, values in columns.items()},
        do_compression=True,
    )
    (folder / "m.csv").write_text(";".join(names) + "\n" + "".join(";".join(map(str, r)) + "\n" for r in rows))
    out = folder / "imported"
    said = ["--yes", "--axis", "X", "--component", "EXX", "--unit", "um", "--sign", "actual-minus-commanded"]
    kinds = {"spreadsheet": "m.xlsx", "TDMS": "m.tdms", "HDF5": "m.h5", "MAT": "m.mat", "CSV to import": "m.csv"}
    return [
        Door(kind, folder / name, [["import", str(folder / name), "--out", str(out), *said]], fresh=out)
        for kind, name in kinds.items()
    ]


def _description(folder: Path) -> Path:
    """The description of an FMU; the FMU is packed around it."""
    path = folder / "modelDescription.xml"
    path.write_text(DESCRIPTION)
    return path


def _described(door: Door, folder: Path) -> int:
    """Exit code 3 where the process of an FMU refuses its description."""
    from errpipe.simulation import fmu_worker

    with zipfile.ZipFile(folder / "d.fmu", "w") as archive:
        archive.write(door.file, "modelDescription.xml")
    os.chdir(folder)
    shutil.rmtree(folder / "unpacked", ignore_errors=True)
    work = fmu_worker.Work()
    try:
        json.dumps(work.load({"fmu": str(folder / "d.fmu"), "memory_mb": MEMORY >> 20, "disk_mb": 16}))
    except MemoryError:
        raise
    except Exception:  # whatever the FMU library raises becomes a message of the process
        return 3
    return 0


def _archive(folder: Path) -> Path:
    """A zip of three files, unpacked by what unpacks FMUs."""
    path = folder / "m.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("modelDescription.xml", "resources/a.txt", "binaries/linux64/m.so"):
            archive.writestr(name, name * 20)
    return path


def _unpack(door: Door, folder: Path) -> int:
    """Exit code 3 where the archive is refused, as the FMU's process reports it."""
    from errpipe.simulation import fmu_worker

    target = folder / "unpacked"
    shutil.rmtree(target, ignore_errors=True)
    try:
        fmu_worker.unpack(str(door.file), str(target), 16)
    except MemoryError:
        raise
    except Exception:  # whatever the zip library raises becomes a message of the process
        return 3
    return 0


DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="{1}" variableNamingConvention="structured">
<CoSimulation modelIdentifier="m" canHandleVariableCommunicationStepSize="true"/>
<UnitDefinitions><Unit name="K"><BaseUnit K="1"/></Unit></UnitDefinitions>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
<ModelVariables>
<ScalarVariable name="rise" valueReference="0" causality="input"><Real unit="K" start="0.0"/></ScalarVariable>
<ScalarVariable name="z" valueReference="1" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>
"""
LASER = """HEADER::
File type: rtl
USER-TEXT::
Axis: X
TARGET DATA::
Target-count: 3
Targets:
0 50 100
DEVIATIONS::
1 1 0.1
1 2 0.4
1 3 1.0
EOF::
"""
EXPORTED = """  - kind: fit
    components: [{component: EXX, terms: [{term: offset}, {term: backlash, axis: X}]}]
  - {kind: export, ungated: true, targets: [linuxcnc_screw]}
"""
PROGRAM = """%
N5 G17 G21 G90 G54 G94
N30 G0 X0 Y0 Z20
N40 G1 Z-2 F200
N50 G1 X80 Y10 F800 (first cut)
N60 G3 X80 Y50 I0 J20
N70 G2 X60 Y70 R20
G91 G1 X-10 Y-5 ; was (LOGOPEN,f)
X-10
G90 G4 P1
G17 G20 G1 X2 Y1 F30
G21 X10 Y10
M2
%
"""


def _sealed(data: bytes) -> bytes:
    """A binary table with the length and check sum that it should have, so that the rest of it is looked at."""
    import struct
    import zlib

    from errpipe.tables import layout

    if len(data) < layout.HEADER_SIZE:
        return data
    out = bytearray(data)
    struct.pack_into("<I", out, 16, len(out))
    struct.pack_into("<I", out, 20, zlib.crc32(bytes(out[layout.CRC_FROM :])))
    return bytes(out)


def _repacked(data: bytes, rng: random.Random) -> bytes:
    """An archive with one of its files changed, whole otherwise."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        chosen = rng.choice(source.namelist())
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, mutated(content, rng) if name == chosen else content)
    return out.getvalue()


def modification_times(folder: Path) -> dict[str, int]:
    """What lies beside the folder and in it, files with the time of their last change: no attempt may touch it."""
    rows = [row for top in (folder.parent, folder) for row in os.scandir(top) if not row.name.startswith(WRITTEN)]
    return {row.path: row.stat().st_mtime_ns if row.is_file() else 0 for row in rows}


def attack(folder: Path, end: float, rng: random.Random) -> tuple[list[Door], list[str]]:
    """Mutate files until `end`, at least LEAST of them; the doors with what they answered, and what was found."""
    from errpipe.cli.app import main

    (folder.parent / "precious.txt").write_text("precious")
    opened, found = doors(folder), []
    while time.monotonic() < end or sum(door.tried for door in opened) < LEAST:
        door = rng.choice(opened)
        data = mutated(door.sound, rng)
        if door.name == "table (.ect)" and rng.random() < 0.8:
            data = _sealed(data)
        elif zipfile.is_zipfile(io.BytesIO(door.sound)) and rng.random() < 0.8:
            data = _repacked(door.sound, rng)
        door.file.write_bytes(data)
        if door.fresh is not None:
            shutil.rmtree(door.fresh, ignore_errors=True)
        line = rng.choice(door.lines) if door.lines else ["unpack"]
        inside = _unpack if door.file.suffix == ".fmu" else _described
        work = partial(main, line) if door.lines else partial(inside, door, folder)
        before = modification_times(folder)
        code, said = forked(work, folder.parent)
        touched = {path for path, _ in before.items() ^ modification_times(folder).items()}
        found += [f"{door.name}: {' '.join(line[:1])} touched {path}" for path in sorted(touched)]
        door.file.write_bytes(door.sound)
        door.tried += 1
        door.codes[-1 if code is None else code] += 1
        if code not in ALLOWED or "internal error" in said:
            kept = folder.parent / f"found-{len(found)}-{door.file.name}"
            kept.write_bytes(data)
            found.append(f"{door.name}: {' '.join(line[:1])} gave {code}: {said.strip()[:300]} (kept as {kept.name})")
    return opened, found


# ---------------------------------------------------------------- kills


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
    from tests.hostile.doors import PIPELINE, recording_folder

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
    found, tried, done, version = [], 0, 0, 0
    while done < count and time.monotonic() < end:
        version = 1 - version if rng.random() < 0.7 else version
        (folder / "rec/rows.csv").write_bytes(sources[version])
        tried += 1
        if tried % FRESH == 0:
            killed = _killed(fresh(line).pid, rng.uniform(0, 1.2 * fresh_took))
        else:
            killed = _killed(victim(lambda: main(line)), rng.uniform(0, 1.2 * took))
        done += killed
        torn = [name for name, digest in tree(out).items() if (name, digest) not in known and name != "errpipe.lock"]
        found += [f"kill {done}: {name} is neither old nor new" for name in torn]
        try:
            json.loads((out / "errpipe.lock").read_text())
        except (OSError, ValueError) as err:
            found.append(f"kill {done}: errpipe.lock: {err}")
        if killed and (done % 20 == 0 or done == count):
            code, said = forked(lambda: main(line), folder)
            if code != 0 or tree(out) != whole[version]:
                found.append(f"kill {done}: the next run gave {code} or other bytes: {said.strip()[:200]}")
    return done, found


def fresh(line: list[str]) -> subprocess.Popen[bytes]:
    """The command line in an interpreter and a session of its own."""
    words = [sys.executable, "-m", "errpipe.cli.app", *line]
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.Popen(
        words, env=env, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def victim(work: Callable[[], int]) -> int:
    """Number of a process, in a session of its own, that does `work`."""
    pid = os.fork()
    if pid == 0:
        os.setsid()
        with quiet():
            os._exit(work())
    return pid


def _killed(pid: int, after: float) -> bool:
    """Whether a process and those of its session were killed `after` s; False where it had ended by then."""
    time.sleep(after)
    os.kill(pid, signal.SIGKILL)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])


def beside(count: int, seed: int, end: float) -> Callable[[], tuple[int, list[str], float]]:
    """Start the kill campaign in a process of its own; the function returned waits for what it counted and found."""
    reader, writer = os.pipe()
    began = time.monotonic()
    pid = os.fork()
    if pid == 0:
        try:
            with tempfile.TemporaryDirectory(prefix="errpipe-attack-", dir=memory()) as name:
                told = kills(Path(name), count, random.Random(seed), end)
        except BaseException as err:
            told = 0, [f"the kill campaign ended: {type(err).__name__}: {err}"]
        with os.fdopen(writer, "w") as stream:
            json.dump([*told, time.monotonic() - began], stream)
        os._exit(0)
    os.close(writer)

    def wait() -> tuple[int, list[str], float]:
        with os.fdopen(reader) as stream:
            done, found, took = json.load(stream)
        os.waitpid(pid, 0)
        return done, found, took

    return wait


# ---------------------------------------------------------------- the report


def report(opened: list[Door], killed: str, found: list[str]) -> Iterator[str]:
    """What was tried and what was found, as a table and lines."""
    yield f"{'door':<16} {'tried':>7}  exit codes"
    for door in opened:
        codes = ", ".join(f"{code}: {n}" for code, n in sorted(door.codes.items()))
        yield f"{door.name:<16} {door.tried:>7}  {codes}"
    yield f"{sum(door.tried for door in opened)} files; SIGKILL: {killed}"
    yield f"found: {len(found)}"
    yield from found


def memory() -> str | None:
    """A folder in memory where there is one: a kill loses nothing that a disk keeps, and fsync does not wait."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


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
        (top / "doors").mkdir()
        opened, found = attack(top / "doors", began + given.seconds, random.Random(given.seed))
        if given.keep is not None:
            given.keep.mkdir(parents=True, exist_ok=True)
            for path in top.glob("found-*"):
                shutil.copy(path, given.keep)
    killed, torn, took = counted()
    found += torn
    print(f"seed {given.seed}, {time.monotonic() - began:.0f} s")
    print("\n".join(report(opened, f"{killed} of {given.kills} in {took:.0f} s", found)))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main_())
