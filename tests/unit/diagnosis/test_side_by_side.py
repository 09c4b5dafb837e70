"""Responses judged on two cores say what they say one by one; columns of a table are those of the filter."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe import diagnosis
from errpipe.diagnosis import evidence, hypotheses
from errpipe.diagnosis.coloured import Colour, whiten
from errpipe.diagnosis.evidence import Table

from . import long


@pytest.mark.slow
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


@pytest.mark.parametrize("before", ["as made", "in its own noise", "on other rows"])
def test_a_response_takes_columns_of_the_one_before_to_the_bit(before: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long, "ROWS", 600)
    recording, alone = (long.linear_axis(6, 0.02, ("EXX", "EYX")) for _ in range(2))
    rows, made = np.arange(600), []
    first = hypotheses.build(recording, "EXX", rows[: 590 if before == "on other rows" else 600])
    if before == "in its own noise":
        first.recolour(Colour(30.0, 0.5))
    of = hypotheses.columns_of
    monkeypatch.setattr(hypotheses, "columns_of", lambda h, *a: made.append(h) or of(h, *a))
    taken, own = (hypotheses.build(r, "EYX", rows) for r in (recording, alone))
    assert np.array_equal(taken.table.whitened, own.table.whitened)
    assert taken.table.names == own.table.names
    for one in ("places", "freedoms", "scales"):
        assert all(map(np.array_equal, getattr(taken, one), getattr(own, one)))
    assert [h.key for h in taken.hypotheses] == [h.key for h in own.hypotheses]
    assert (len(made) < 1.5 * len(own.hypotheses)) == (before == "as made")


@pytest.mark.parametrize("width", [1, 4, 6])
def test_a_column_of_a_table_is_the_filtered_one_to_the_bit(width: int) -> None:
    rng = np.random.default_rng(3)
    run, columns = np.repeat([0, 1, 2], [40, 1, 59]), rng.standard_normal((100, width))
    table = Table(run, [columns], np.zeros(100, dtype=int))
    assert np.array_equal(table.whitened, whiten(columns, run))
    table.recolour(Colour(30.0, 0.5))
    added = table.add(columns)
    assert np.array_equal(table.whitened[:, added], whiten(columns, run, table.colour))
