"""Further attacked_files: what retraining, comparing and exporting a table read back, and files of controllers."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from tests.hostile.kills import measured
from tests.hostile.processes import quiet


def _command(*words: str | Path) -> list[str]:
    return [str(word) for word in words]


def files(folder: Path) -> list[tuple[str, Path, list[list[str]]]]:
    """(name, sound file, commands that read it) of each attacked file."""
    return [*_retrained(folder / "site2"), *_diagnosed(folder), *_exported(folder), *_history(folder)]


def _retrained(site: Path) -> list[tuple[str, Path, list[list[str]]]]:
    """A champion, a challenger, and what is kept of earlier judgements."""
    from errpipe.cli.app import main
    from tests.e2e.retrain.test_retrain import PIPELINE, record

    site.mkdir()
    pipeline, champion, out = site / "axis.yaml", site / "champion", site / "out"
    pipeline.write_text(PIPELINE)
    record(site / "recording", 6)
    with quiet():
        assert main(_command("run", pipeline, "--out", champion)) == 0
        record(site / "recording", 8)
        line = _command("retrain", pipeline, "--champion", champion, "--out", out)
        assert main(line) == 4
    return [
        ("retrain.json", out / "retrain.json", [line]),
        ("champion's model", champion / "fit/error_model.json", [line]),
        ("champion's rows", champion / "ingest/recording.yaml", [line]),
    ]


def _diagnosed(folder: Path) -> list[tuple[str, Path, list[list[str]]]]:
    """A diagnosis, read by what compares and explains."""
    from errpipe.cli.app import main
    from tests.hostile.command_line import MANIFEST, recording_folder

    rec, out = folder / "twin", folder / "diagnosis"
    at = np.arange(120.0)
    recording_folder(rec, 120, dev=measured(at), sim=0.0 * at)
    (rec / "recording.yaml").write_text(MANIFEST + "  sim: {role: simulated, component: EXX, unit: um}\n")
    with quiet():
        assert main(_command("diagnose", rec, "--out", out)) == 0
    pair, kept, same = out / "diagnosis.json", folder / "earlier.json", folder / "same"
    shutil.copy(pair, kept)
    shutil.copytree(rec, same)
    return [
        ("diagnosis", kept, [_command("compare", kept, pair), _command("whatis", kept)]),
        ("rows to compare", same / "rows.csv", [_command("compare", rec, same), _command("show", same)]),
    ]


def _exported(folder: Path) -> list[tuple[str, Path, list[list[str]]]]:
    """A table to export, and controllers' files that are read again."""
    from errpipe.cli.app import main
    from errpipe.tables import ect
    from tests.unit.targets import machines

    table, out = folder / "foreign.ect", folder / "out5"
    ect.write(machines.wavy_both_directions(), table)
    names = ("linuxcnc_screw", "fanuc_pitch", "sinumerik_cec", "heidenhain_com", "c_runtime")
    export = _command("export", table, "--out", out, *(word for name in names for word in ("--target", name)))
    with quiet():
        assert main(export) == 0
    kept = {path.parent.name: path for path in sorted(out.glob("*/*")) if path.name != "CHECKLIST.md"}
    again = [*export[:3], str(folder / "out6"), *export[4:]]
    read = [
        (f"file of {name}", path, [_command("verify", out), *([_command("whatis", path)] if name in names[:3] else [])])
        for name, path in kept.items()
    ]
    return [("table to export", table, [again]), *read]


def _history(folder: Path) -> list[tuple[str, Path, list[list[str]]]]:
    """The table of a registry that is put back."""
    registry, keys = folder / "registry", folder / "keys"
    (kept,) = (p for p in registry.rglob("*") if p.is_file() and p.read_bytes()[:3] == b"ECT")
    back = _command("rollback", registry, "7", "--to", "1", "--why", "x", "--key", keys / "errpipe.key")
    back += _command("--public-key", keys / "errpipe.pub", "--out", folder / "out7.ect")
    return [("registry's table", kept, [back])]
