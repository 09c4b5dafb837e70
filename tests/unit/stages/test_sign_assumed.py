"""A sign that an import assumed stands first on every checklist, until a person states it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from errpipe.domain.error_model import ComponentModel, ErrorModel
from errpipe.domain.error_model import joined as joined_models
from errpipe.domain.recording import Manifest, Recording
from errpipe.stages import _artefacts
from errpipe.stages import targets as stage
from errpipe.tables import ect
from errpipe.tables.joined import joined
from errpipe.targets import TARGETS
from tests.unit.targets import machines

MODEL = ErrorModel(components=(ComponentModel(component="EXX", terms=()),))


def recording(constants: dict[str, object]) -> Recording:
    columns = {"x": {"role": "position", "axis": "X", "unit": "mm"}}
    manifest = {"recording": 1, "tables": ["t.csv"], "constants": constants, "columns": columns}
    return Recording(Manifest.model_validate(manifest), pd.DataFrame({"x": [0.0, 1.0]}))


@pytest.mark.parametrize("assumed", [True, False])
def test_the_first_line_of_a_checklist(tmp_path: Path, assumed: bool) -> None:
    of = recording({"sign": {"value": "assumed"}} if assumed else {})
    title = _artefacts.sign_title("X axis") if _artefacts.sign_assumed([of]) else "X axis"
    table = machines.too_long_at_plus_x().model_copy(update={"title": title})
    ect.write(table, tmp_path / "table.ect")
    stage.export(tmp_path / "table.ect", ["linuxcnc_screw"], tmp_path / "out")
    text = (tmp_path / "out" / "linuxcnc_screw" / "CHECKLIST.md").read_text()
    assert (text.splitlines()[2].startswith("**The sign of the readings was assumed")) is assumed


@pytest.mark.parametrize("target", [t for t in TARGETS if t.remark and "screw" in t.holds], ids=lambda t: t.name)
def test_the_files_of_a_controller_that_takes_comments_say_it_too(tmp_path: Path, target: Any) -> None:
    title = _artefacts.sign_title("X axis")
    table = machines.too_long_at_plus_x().model_copy(update={"title": title})
    rows = stage.write_targets(table, [target.name], tmp_path)
    texts = [(tmp_path / row["file"]).read_text() for row in rows]
    assert any("The sign of the readings was assumed" in text for text in texts)
    plain = stage.write_targets(table.model_copy(update={"title": "X axis"}), [target.name], tmp_path / "plain")
    assert [row["losses"] for row in rows] == [row["losses"] for row in plain]


def test_models_of_several_recordings_keep_the_mark_of_any() -> None:
    """An export reads one recording; the mark of another one's fit is in its model."""
    noted = _artefacts.with_sign_note(MODEL)
    assert _artefacts.sign_noted(noted) and not _artefacts.sign_noted(MODEL)
    assert _artefacts.with_sign_note(noted) == noted
    other = MODEL.components[0].model_copy(update={"component": "EYY"})
    both = joined_models([MODEL.model_copy(update={"components": (other,)}), noted])
    assert _artefacts.sign_noted(both)


def test_tables_of_several_axes_keep_what_their_titles_begin_with() -> None:
    """The titles were cut at 127 characters together: that of the second axis was lost."""
    tables = [
        machines.compile_((f"E{axis}{axis}", [machines.straight(axis, 10.0)])).model_copy(
            update={"title": f"Sign assumed: {axis}" + 100 * "-"}
        )
        for axis in "XY"
    ]
    assert joined(tables).title.count("Sign assumed: ") == 2
