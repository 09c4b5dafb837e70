"""One known positioning test, which the files of these tests hold in many dialects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.formats import manifest_folder
from errpipe.importing.proposed import ImportOptions, Proposal
from errpipe.importing.sheet import ReaderOptions
from errpipe.verbs import import_files

TARGETS = np.linspace(0, 600, 13)


def deviation(run: int, side: float) -> np.ndarray:
    """The known deviation at every target in um: 10 um too long at the far end, 4 um of lost motion."""
    return np.round(TARGETS / 60 + 3 * np.sin(TARGETS / 80) - 2 * side + 0.1 * run, 1)


def number(value: float, mark: str, digits: int = 4) -> str:
    return f"{value:.{digits}f}".replace(".", mark)


def long_rows() -> list[tuple[str, float, float, float]]:
    """(run, target, side, deviation in um) in the order of measuring."""
    rows = []
    for run in range(1, 4):
        for side in (1.0, -1.0):
            order = range(13) if side > 0 else range(12, -1, -1)
            rows += [(str(run), TARGETS[i], side, deviation(run, side)[i]) for i in order]
    return rows


def prepared(files: list[Path], reader: ReaderOptions | None = None, **said: Any) -> tuple[Proposal, ImportOptions]:
    """The proposal of files; where they name no axis a person says X."""
    options = import_files.options_of(sets=said.pop("sets", []), **said)
    try:
        proposal, _ = import_files.prepare(files, reader or ReaderOptions(), options)
    except DataError as err:
        if "no axis is named in the file" not in str(err):
            raise
        options = replace(options, axis="X")
        proposal, _ = import_files.prepare(files, reader or ReaderOptions(), options)
    return proposal, options


def imported(tmp_path: Path, file: Path | list[Path], reader: ReaderOptions | None = None, **said: Any) -> Recording:
    """The recording of a file, written and read back."""
    files = file if isinstance(file, list) else [file]
    proposal, options = prepared(files, reader, **said)
    import_files.write(proposal, tmp_path / "rec", options, files)
    return manifest_folder.read(tmp_path / "rec")


def holds_the_truth(recording: Recording) -> None:
    """The recording says what was measured: target, side and deviation of every reading."""
    (error,) = recording.names("error", component="EXX")
    place = recording.name("command", axis="X") or recording.name("position", axis="X")
    side = recording.name("direction", axis="X")
    assert place and side
    run = recording.frame[recording.name("run")].astype(str)
    by_name = {
        (r[-1], round(x, 6), s): d
        for r, x, s, d in zip(run, recording.array(place), recording.array(side), recording.array(error), strict=True)
    }
    for label, x, s, d in long_rows():
        assert by_name[label, x, s] == pytest.approx(d, abs=1e-6), (label, x, s)
