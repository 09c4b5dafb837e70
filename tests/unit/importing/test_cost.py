"""The cost of an import grows with the rows, not with their square."""

from pathlib import Path

import pytest

from errpipe.importing.layout import RawColumn
from errpipe.importing.readers import ReaderOptions
from errpipe.verbs import import_files


def passes_over_columns(path: Path, rows: int, monkeypatch: pytest.MonkeyPatch) -> int:
    """How often the cells of a column were counted while a log with dates, sides and remarks was read."""
    lines = ["Date;Pos X [mm];Side;Deviation X [um];Remark"]
    for i in range(rows):
        up, turn = i % 40 < 20, i % 20
        place, read = (turn if up else 19 - turn) + 0.5, 0.1 * (i % 7) - 3.0 * up
        clock = f"08:{i // 60:02d}:{i % 60:02d}"
        lines.append(f"2026-03-02 {clock};{place};{'up' if up else 'down'};{read:.2f};ok")
    path.write_text("\n".join(lines))
    count, numeric = [0], RawColumn.numeric.fget

    def counted(column: RawColumn) -> bool:
        count[0] += 1
        return numeric(column)

    with monkeypatch.context() as patch:
        patch.setattr(RawColumn, "numeric", property(counted))
        import_files.prepare([path], ReaderOptions(), import_files.options_of(sets=[]))
    return count[0]


def test_columns_are_counted_as_often_in_a_long_log_as_in_a_short_one(tmp_path: Path, monkeypatch) -> None:
    short, long = (passes_over_columns(tmp_path / "log.csv", rows, monkeypatch) for rows in (80, 800))
    assert long < short + 20, (short, long)
