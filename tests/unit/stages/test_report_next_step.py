"""The next step that the report of a run states."""

from __future__ import annotations

import pytest

from errpipe.stages.report import _next_step

TABLE = {"export": {"files": [{"file": "table.ect"}]}}
FILES = {"export": {"files": [{"file": "table.ect"}, {"file": "linuxcnc_screw/x.comp"}]}}


@pytest.mark.parametrize(
    ("exported", "refusal", "rms_after", "first"),
    [
        ({}, "", (1.0, 1.0), "add an export stage"),
        ({}, "", (1.0, 9.0), "add an export stage"),
        ({}, "", (9.0, 5.0), "do not export this model"),
        ({}, "why", (9.0, 9.0), "read why"),
        (TABLE, "", (1.0, 1.0), "errpipe whatis"),
        (FILES, "", (1.0, 9.0), "follow CHECKLIST.md"),
    ],
)
def test_a_model_that_is_no_better_than_nothing_is_not_recommended(exported, refusal, rms_after, first) -> None:
    """The report of the drilled plates, 5.39 -> 5.59 um, advised to add an export stage."""
    figures = [{"rms_before": 5.0, "rms_after": after} for after in rms_after]
    assert _next_step(exported, refusal, figures).startswith(first)
