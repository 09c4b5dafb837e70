"""Files of every format are those in tests/golden/targets; a change there is shown, explained and written again."""

from __future__ import annotations

import pytest

from errpipe.targets import TARGETS
from tests.golden import target_files


@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_files_are_as_kept(target):
    made = target_files.files(target)
    if made is None:
        pytest.skip("holds the table's own bytes")
    folder = target_files.FOLDER / target.name
    kept = {p.name: p.read_text(encoding="utf-8") for p in folder.glob("*")}
    assert kept, f"no folder {folder.name}: python -m tests.golden.target_files"
    assert made == kept


def test_no_folder_is_left_over():
    assert {p.name for p in target_files.FOLDER.iterdir()} <= {t.name for t in TARGETS}
