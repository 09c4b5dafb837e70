"""Every file that somebody may hand over, sound, with the commands that read it."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from tests.hostile import attack_more
from tests.hostile.kills import EXPORTED, measured
from tests.hostile.processes import MEMORY, forked, quiet

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
FLEET = """fleet: 1
pipeline: site/p.yaml
recordings: site
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


@dataclass
class AttackedFile:
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


def attacked_files(folder: Path) -> list[AttackedFile]:
    """Sound files of every kind in `folder`, each with the commands that read it; every command succeeds once."""
    from errpipe.cli.app import main

    out = [*_tables(folder), *_runs(folder), *_signed(folder), *_tabular(folder)]
    out += [AttackedFile(*facts) for facts in attack_more.files(folder)]
    with quiet():  # all of it once in this process: the forked ones need not import
        for attacked in out:
            for line in attacked.lines:
                code = main(line)
                assert code == 0 or line[0] == "retrain", (line, code)
    for attacked in _measurements(folder):
        with quiet():
            assert main(attacked.lines[0]) == 0, attacked.name
        shutil.rmtree(attacked.fresh)
        code, said = forked(partial(main, attacked.lines[0]), folder)
        assert code == 0, (attacked.name, said)
        out.append(attacked)
    out.append(AttackedFile("FMU archive", _archive(folder), []))
    out.append(AttackedFile("FMU description", _description(folder), []))
    return out


def _command(*words: str | Path) -> list[str]:
    return [str(word) for word in words]


def _tables(folder: Path) -> list[AttackedFile]:
    """Tables, and what is read beside them."""
    from errpipe.tables import ect
    from tests.unit.targets import machines

    ect_file, twin, program, laser = (folder / name for name in ("t.ect", "t.json", "p.ngc", "laser.rtl"))
    table = machines.wavy_both_directions()
    ect.write(table, ect_file)
    ect.write_json(table, twin)
    program.write_text(PROGRAM)
    laser.write_text(LASER)
    machine = folder / "machine.yaml"
    machine.write_bytes((Path(__file__).parents[2] / "examples/machines/horizontal-centre-ni-1997.yaml").read_bytes())
    correct = _command("correct", program, "--table", ect_file, "--start", "0,0,0", "--out", folder / "o.ngc")
    at = ["--at", "x=100"]
    return [
        AttackedFile("table (.ect)", ect_file, [_command("eval", ect_file, *at), _command("whatis", ect_file)]),
        AttackedFile("table (JSON)", twin, [_command("eval", twin, *at), _command("compare", ect_file, twin)]),
        AttackedFile("NC program", program, [correct]),
        AttackedFile("machine", machine, [_command("synthesis", machine), _command("check", machine)]),
        AttackedFile("laser file", laser, [_command("whatis", laser)]),
    ]


def _runs(folder: Path) -> list[AttackedFile]:
    """Recordings, pipelines, and what a run of them leaves."""
    from errpipe.cli.app import main
    from tests.hostile.command_line import PIPELINE, recording_folder
    from tests.hostile.test_tables import parquet_folder

    rec = recording_folder(folder / "rec", dev=measured(np.arange(40)))
    par = parquet_folder(folder / "par" / "rec", 200)
    pipeline, second = folder / "p.yaml", folder / "par" / "p.yaml"
    pipeline.write_text(PIPELINE + EXPORTED)
    second.write_text(PIPELINE)
    out, model, readings = folder / "out", folder / "model.json", folder / "readings.csv"
    run = _command("run", pipeline, "--out", out)
    with quiet():
        assert main(run) == 0
    shutil.copy(out / "fit" / "error_model.json", model)
    readings.write_text("time,EXX\n5,1.5\n20,3.0\n31,-2\n")
    predict = _command("predict", model, rec, "--out", folder / "p.csv")
    plan = _command("plan", pipeline, "--out", out)
    return [
        AttackedFile("manifest", rec / "recording.yaml", [_command("check", rec), run]),
        AttackedFile("pipeline", pipeline, [_command("check", pipeline), plan, run]),
        AttackedFile("CSV", rec / "rows.csv", [run]),
        AttackedFile("Parquet", par / "rows.parquet", [_command("run", second, "--out", folder / "out2")]),
        AttackedFile("lock file", out / "errpipe.lock", [run]),
        AttackedFile("journal", _journal(out), [run]),
        AttackedFile("note", out / ".errpipe" / "unchanged.json", [run]),
        AttackedFile("model", model, [predict, _command("whatis", model), _command("compare", model, model)]),
        AttackedFile("readings", readings, [[*predict, "--readings", str(readings)]]),
        AttackedFile("exported folder", out / "export/export.json", [_command("verify", out / "export")]),
    ]


def _signed(folder: Path) -> list[AttackedFile]:
    """Signatures, keys, and the history of a machine."""
    from errpipe.cli.app import main
    from errpipe.tables import ect
    from tests.unit.targets import machines

    table, keys, registry = folder / "signed.ect", folder / "keys", folder / "registry"
    ect.write(machines.wavy_both_directions(), table)
    public = ["--public-key", str(keys / "errpipe.pub")]
    promote = _command("promote", registry, "7", table, "--why", "new", "--key", keys / "errpipe.key", *public)
    with quiet():
        assert main(_command("keygen", keys)) == 0
        assert main(_command("sign", table, "--key", keys / "errpipe.key")) == 0
        assert main(promote) == 0
    verify, log = _command("verify-signature", table, *public), _command("log", registry, *public)
    (entry,) = (registry / "machines" / "7").iterdir()
    (signature,) = registry.rglob("*.minisig")
    return [
        AttackedFile("signature", Path(f"{table}.minisig"), [verify]),
        AttackedFile("public key", keys / "errpipe.pub", [verify, log]),
        AttackedFile("secret key", keys / "errpipe.key", [_command("sign", table, "--key", keys / "errpipe.key")]),
        AttackedFile("registry entry", entry, [log]),
        AttackedFile("signed entry", signature.with_suffix(""), [log]),
        AttackedFile("entry's signature", signature, [log]),
    ]


def _tabular(folder: Path) -> list[AttackedFile]:
    """A field of candidate places, and a fleet of one machine."""
    from tests.hostile.command_line import PIPELINE, recording_folder

    field, fleet = folder / "field.csv", folder / "fleet.yaml"
    rows = [(f"d{n // 8}", n, np.sin(n), np.cos(n), 3 * np.sin(n) + 0.1 * np.cos(7 * n)) for n in range(40)]
    lines = ["duty_cycle,time,near,far,error", *(",".join(map(str, row)) for row in rows)]
    field.write_text("\n".join([*lines, ""]))
    recording_folder(folder / "site" / "m1", dev=measured(np.arange(40)))
    (folder / "site" / "p.yaml").write_text(PIPELINE)
    fleet.write_text(FLEET)
    return [
        AttackedFile("field of places", field, [_command("place", field, "--time", "time")]),
        AttackedFile("fleet", fleet, [_command("fleet", fleet, "--out", folder / "out3", "--jobs", "1")]),
    ]


def _journal(out: Path) -> Path:
    """The journal of a stage, as an interrupted run leaves it."""
    path = out / ".errpipe" / "clean.json"
    path.write_text(json.dumps(["clean/cleaning.json", "clean/recording.parquet", "clean/gone.txt"]))
    return path


def _measurements(folder: Path) -> list[AttackedFile]:
    """Files of each importing attacked, of the same axis."""
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
        AttackedFile(kind, folder / name, [["import", str(folder / name), "--out", str(out), *said]], fresh=out)
        for kind, name in kinds.items()
    ]


def _description(folder: Path) -> Path:
    """The description of an FMU; the FMU is packed around it."""
    path = folder / "modelDescription.xml"
    path.write_text(DESCRIPTION)
    return path


def described(attacked: AttackedFile, folder: Path) -> int:
    """Exit code 3 where the process of an FMU refuses its description."""
    from errpipe.simulation import fmu_worker

    with zipfile.ZipFile(folder / "d.fmu", "w") as archive:
        archive.write(attacked.file, "modelDescription.xml")
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


def unpack(attacked: AttackedFile, folder: Path) -> int:
    """Exit code 3 where the archive is refused, as the FMU's process reports it."""
    from errpipe.simulation import fmu_worker

    target = folder / "unpacked"
    shutil.rmtree(target, ignore_errors=True)
    try:
        fmu_worker.unpack(str(attacked.file), str(target), 16)
    except MemoryError:
        raise
    except Exception:  # whatever the zip library raises becomes a message of the process
        return 3
    return 0
