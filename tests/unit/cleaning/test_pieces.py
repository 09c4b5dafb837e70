"""A long recording, cleaned some whole runs at a time, is what cleaning in memory makes of it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe import jsonfile
from errpipe.cleaning import DEFAULT, WHOLE_RUN, clean
from errpipe.cleaning._pieces import Cleaning, in_pieces, returning_run
from errpipe.cleaning.gaps import Gaps
from errpipe.cleaning.outliers import Outliers
from errpipe.cli.app import main
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.formats import manifest_folder
from tests.unit.cleaning.faulty_recordings import changed, warm_up

PIPELINE = """\
pipeline: 1
stages:
  - {kind: ingest, recording: raw}
  - {kind: clean, rows_in_memory: ROWS}
"""


def faulty(pause: float = 0.0) -> Recording:
    """Twelve runs of 600 rows with a spike, a doubled row, a hole, a dead sensor, and a pause in the ninth run."""
    source = warm_up(seed=4, runs=12, step=0.05)
    source.frame.loc[100, "E_Z"] += 40.0
    source.frame.loc[5000, "E_Z"] -= 40.0
    source.frame.loc[3000:3002, "T_motor"] = np.nan
    source.frame.loc[5100:5399, "t"] += pause
    source = changed(source, T_column=np.full(len(source), 21.5))
    return source.take(np.r_[0:4000, 3999, 4000 : len(source)])


def batches(recording: Recording, rows: int):
    """The rows in batches that begin anywhere in a run."""
    for at in range(0, len(recording), rows):
        yield recording.take(np.arange(at, min(at + rows, len(recording))))


def test_pieces_are_whole_runs_in_their_order():
    source = faulty()
    pieces = list(in_pieces(batches(source, 250), 1000))
    assert [len(set(p.rows.frame["run"])) for p in pieces] == [2, 2, 2, 2, 2, 2]
    assert all(p.first == 0 and p.end == len(p.rows) >= 1000 for p in pieces)
    assert pd.concat([p.rows.frame for p in pieces], ignore_index=True).equals(source.frame)


def test_a_run_that_is_too_long_is_cut_and_its_pieces_see_their_neighbours():
    source = one_run()
    pieces = list(in_pieces(batches(source, 250), 1000))
    assert [(p.first, p.end, len(p.rows)) for p in pieces] == [
        (0, 1000, 1500),
        *[(500, 1500, 2000)] * 4,
        (500, 2500, 2500),
    ]
    counted = [p.rows.frame.iloc[p.first : p.end] for p in pieces]
    assert pd.concat(counted, ignore_index=True).equals(source.frame)


def test_a_run_that_comes_back_is_named():
    source = faulty()
    assert returning_run(batches(source, 250)) is None
    source.frame.loc[7000, "run"] = "1"
    assert returning_run(batches(source, 250)) == "1"


def one_run(pause: float = 0.0) -> Recording:
    """Seven thousand rows in one run with spikes, a hole and a doubled row, some where pieces of 1000 meet."""
    source = warm_up(seed=4, rows=7000, runs=1, step=0.05)
    source.frame.loc[[100, 999, 1000, 5000], "E_Z"] += 40.0
    source.frame.loc[1998:2003, "T_motor"] = np.nan
    for row in (3000, 6500):
        source.frame.loc[row:, "t"] += pause
    return source.take(np.r_[0:4000, 3999, 4000 : len(source) - 1])


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("pause", [0.0, 50_000.0])
def test_what_pieces_make_of_one_long_run_is_what_memory_makes(tmp_path, pause, named):
    source = one_run(pause)
    if not named:
        columns = {n: c for n, c in source.manifest.columns.items() if n != "run"}
        source = Recording(source.manifest.model_copy(update={"columns": columns}), source.frame.drop(columns="run"))
    whole, report = clean(source)
    cleaning = Cleaning(DEFAULT, source.manifest)
    pieces = cleaning.pieces(in_pieces(batches(source, 250), 1000))
    manifest_folder.write_pieces(pieces, cleaning.written(), cleaning.manifest, tmp_path)
    back = manifest_folder.read(tmp_path)
    kept = list(whole.frame.columns)
    assert set(back.frame.columns) == set(kept) and ((WHOLE_RUN in kept) == (pause > 0))
    pd.testing.assert_frame_equal(back.frame[kept], whole.frame, check_dtype=False)
    assert rows_of(cleaning.report()) == rows_of(report) and cleaning.report().rows_after == len(whole)


@pytest.mark.parametrize("pause", [0.0, 50_000.0])
def test_what_pieces_make_is_what_memory_makes(tmp_path, pause):
    source = faulty(pause)
    whole, report = clean(source)
    cleaning = Cleaning(DEFAULT, source.manifest)
    pieces = cleaning.pieces(in_pieces(batches(source, 250), 1000))
    rows = manifest_folder.write_pieces(pieces, cleaning.written(), cleaning.manifest, tmp_path)
    back = manifest_folder.read(tmp_path)
    kept = {n for n, c in back.manifest.columns.items() if c.role != "ignore"}
    assert rows == len(whole) == len(source) - 1 and kept == set(whole.manifest.columns) - {"T_column"}
    assert (WHOLE_RUN in kept) == (pause > 0)
    pd.testing.assert_frame_equal(back.frame[sorted(kept)], whole.frame[sorted(kept)], check_dtype=False)
    assert rows_of(cleaning.report()) == rows_of(report)


def rows_of(report) -> set[tuple[str, str, str, int]]:
    """(rule, what, column, row) of every row that was changed."""
    return {
        (r.rule, d.what, str(d.column), row)
        for r in report.rules
        for d in r.done
        if d.what not in ("note", "set column aside")
        for a, b in d.rows
        for row in range(a, b)
    }


def test_a_share_is_exceeded_by_a_piece_and_the_message_says_where():
    source = warm_up(seed=4, runs=4)
    source.frame.loc[1300:2300:20, "E_Z"] += 40.0
    cleaning = Cleaning([Outliers(most=0.01)], source.manifest)
    with pytest.raises(DataError, match=r"outliers: would remove .* \(rows counted from row 1200\)"):
        list(cleaning.pieces(in_pieces(batches(source, 250), 1000)))


@pytest.mark.parametrize(("rows", "in_pieces"), [(1000, True), (100_000, False)])
def test_the_stage_takes_what_the_pipeline_says(tmp_path, rows, in_pieces):
    source = faulty()
    (tmp_path / "raw").mkdir()
    manifest_folder.write(source, tmp_path / "raw")
    (tmp_path / "pipeline.yaml").write_text(PIPELINE.replace("ROWS", str(rows)), "utf-8")
    assert main(["run", str(tmp_path / "pipeline.yaml"), "--out", str(tmp_path / "out")]) == 0
    cleaned = manifest_folder.read(tmp_path / "out/clean")
    assert len(cleaned) == len(source) - 1 and "T_column" not in cleaned.frame
    output = jsonfile.read(tmp_path / "out/clean/cleaning.json")
    aside = [d for r in output["rules"] for d in r["done"] if d["what"] == "set column aside"]
    assert (output["rows_before"], output["rows_after"]) == (7201, 7200)
    assert len(aside) == (2 if in_pieces else 1), "each piece says it"


def test_a_rule_that_splits_runs_says_so():
    assert Gaps.splits_runs and not Outliers.splits_runs
