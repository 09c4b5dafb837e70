"""Responses judged on two cores say what they say one by one; columns of a table are those of the filter."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe import diagnosis
from errpipe.diagnosis import evidence, hypotheses
from errpipe.diagnosis.coloured import Colour, whiten
from errpipe.diagnosis.evidence import Table

from . import long


def test_responses_side_by_side_are_judged_as_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three: the first has both cores to itself, its columns made ahead and its products formed in two threads."""
    monkeypatch.setattr(long, "ROWS", 1200)
    monkeypatch.setattr(hypotheses, "MANY_ROWS", 1000)
    monkeypatch.setattr(evidence, "WORTH", 1e-9)
    recording = long.linear_axis(6, 0.02, ("EXX", "EYX", "EZX"))
    said = []
    for at_once in (1, 2):
        monkeypatch.setattr(diagnosis, "SIDE_BY_SIDE", at_once)
        monkeypatch.setattr("os.cpu_count", lambda cores=at_once: cores)
        shares: list[float] = []
        judged, rows = diagnosis.diagnose(recording, lambda share, text, into=shares: into.append(share))
        said.append((judged.model_dump_json(), [r.after.tobytes() for r in rows]))
        assert shares == sorted(shares) or at_once == 2
        assert max(shares) <= 1.0
    assert said[0] == said[1]
    assert [r.component for r in judged.responses] == ["EXX", "EYX", "EZX"]


@pytest.mark.parametrize("width", [1, 4, 6])
def test_a_column_of_a_table_is_the_filtered_one_to_the_bit(width: int) -> None:
    rng = np.random.default_rng(3)
    run, columns = np.repeat([0, 1, 2], [40, 1, 59]), rng.standard_normal((100, width))
    table = Table(run, [columns], np.zeros(100, dtype=int))
    assert np.array_equal(table.W, whiten(columns, run))
    table.recolour(Colour(30.0, 0.5))
    added = table.add(columns)
    assert np.array_equal(table.W[:, added], whiten(columns, run, table.colour))
