"""A sign that an import assumed stands first on every checklist, until a person states it."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from errpipe.domain.recording import Manifest, Recording
from errpipe.stages import _artefacts
from errpipe.stages import targets as stage
from errpipe.tables import ect
from errpipe.tables.joined import joined
from tests.unit.targets import machines


def recording(constants: dict[str, object]) -> Recording:
    columns = {"x": {"role": "position", "axis": "X", "unit": "mm"}}
    manifest = {"recording": 1, "tables": ["t.csv"], "constants": constants, "columns": columns}
    return Recording(Manifest.model_validate(manifest), pd.DataFrame({"x": [0.0, 1.0]}))


@pytest.mark.parametrize("assumed", [True, False])
def test_the_first_line_of_a_checklist(tmp_path: Path, assumed: bool) -> None:
    of = recording({"sign": {"value": "assumed"}} if assumed else {})
    title = _artefacts.title_of("X axis", of)
    table = machines.too_long_at_plus_x().model_copy(update={"title": title})
    ect.write(table, tmp_path / "table.ect")
    stage.export(tmp_path / "table.ect", ["linuxcnc_screw"], tmp_path / "out")
    text = (tmp_path / "out" / "linuxcnc_screw" / "CHECKLIST.md").read_text()
    assert (text.splitlines()[2].startswith("**The sign of the readings was assumed")) is assumed


def test_tables_of_several_axes_keep_what_their_titles_begin_with() -> None:
    """The titles were cut at 127 characters together: that of the second axis was lost."""
    tables = [
        machines.compile_((f"E{axis}{axis}", [machines.straight(axis, 10.0)])).model_copy(
            update={"title": f"Sign assumed: {axis}" + 100 * "-"}
        )
        for axis in "XY"
    ]
    assert joined(tables).title.count("Sign assumed: ") == 2
