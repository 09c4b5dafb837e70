"""An export into the folder of another: nothing of the old one stays beside it, nothing of one's own goes with it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from errpipe import tables
from errpipe.errors import VerifyError
from errpipe.stages import targets
from errpipe.tables import ect
from errpipe.verbs.verify import verify
from tests.unit.targets import machines
from tests.unit.targets.by_hand import MACHINES, of


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    """The export of a machine of three axes, and a table of X alone beside it."""
    ect.write(tables.limited(of(*MACHINES["three axes"])), tmp_path / "xyz.ect")
    ect.write(tables.limited(machines.too_long_at_plus_x()), tmp_path / "x.ect")
    targets.export(tmp_path / "xyz.ect", ["linuxcnc_screw", "weihong_axeserr"], tmp_path / "out")
    return tmp_path / "out"


def names(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def test_no_screw_file_of_an_axis_outlives_its_table(exported: Path) -> None:
    (exported / "note.txt").write_text("mine")
    assert {"linuxcnc_screw/y.comp", "weihong_axeserr/axeserr.dat"} <= names(exported)
    targets.export(exported.parent / "x.ect", ["linuxcnc_screw"], exported)
    files = {f"linuxcnc_screw/{name}" for name in ("x.comp", "errpipe-mm.hal", "CHECKLIST.md")}
    assert names(exported) == files | {"table.ect", "table.json", "export.json", "note.txt"}
    assert not (exported / "weihong_axeserr").exists() and verify(exported)["checks"]


def test_a_file_that_was_edited_does_not_go_in_silence(exported: Path) -> None:
    with (exported / "linuxcnc_screw/y.comp").open("a") as out:
        out.write("500 0 0\n")
    before = {name: (exported / name).read_bytes() for name in names(exported)}
    with pytest.raises(VerifyError, match=r"y\.comp: of the export before, and changed since"):
        targets.export(exported.parent / "x.ect", ["linuxcnc_screw"], exported)
    assert {name: (exported / name).read_bytes() for name in names(exported)} == before


@pytest.mark.parametrize("after", range(5))
def test_an_interrupted_export_is_not_verified_and_the_next_one_mends_it(
    exported: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    """Killed behind any of the moves: the list, then file by file."""
    moves, move = [], os.replace

    def cut(source: Path, place: Path) -> None:
        if ".unfinished" in Path(source).parts and ".unfinished" not in Path(place).parts:
            if len(moves) == after:
                raise KeyboardInterrupt
            moves.append(place)
        move(source, place)

    monkeypatch.setattr(os, "replace", cut)
    with pytest.raises(KeyboardInterrupt):
        targets.export(exported.parent / "x.ect", ["linuxcnc_screw"], exported)
    monkeypatch.setattr(os, "replace", move)
    if after:
        with pytest.raises(VerifyError, match="an export was interrupted here"):
            verify(exported)
    else:
        assert "linuxcnc_screw/y.comp" in names(exported) and verify(exported)["checks"]
    targets.export(exported.parent / "x.ect", ["linuxcnc_screw"], exported)
    assert "linuxcnc_screw/y.comp" not in names(exported) and verify(exported)["checks"]
