import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout


def recording(runs: int = 4, rows: int = 10) -> Recording:
    columns = {
        "run": Column(role="run"),
        "day": Column(role="group", of="day"),
        "t": Column(role="time", unit="s"),
        "E_Z": Column(role="error", component="E_Z", unit="um"),
    }
    count = runs * rows
    frame = pd.DataFrame(
        {
            "run": np.repeat([f"r{k}" for k in range(runs)], rows),
            "day": np.repeat(["mon", "tue"], [count // 2, count - count // 2]),
            "t": np.tile(np.arange(rows) * 10.0, runs),
            "E_Z": np.zeros(count),
        }
    )
    return Recording(Manifest(recording=1, tables=("r.csv",), columns=columns), frame)


@pytest.mark.parametrize(
    "scheme", ["auto", "leave-one-run-out", "leave-one-group-out:day", "batches:2", "blocks:4", "forward"]
)
def test_no_row_both_fits_and_judges(scheme):
    for fold in holdout.groups(recording(), scheme):
        assert not (fold.train & fold.test).any()
        assert fold.train.any() and fold.test.any()


def test_every_row_judges_once():
    judged = sum(fold.test.astype(int) for fold in holdout.groups(recording(), "leave-one-run-out"))
    assert (judged == 1).all()


def test_group_by_what_it_is_of():
    folds = holdout.groups(recording(), "leave-one-group-out:day")
    assert [fold.label for fold in folds] == ["mon", "tue"]


def test_forward_never_fits_on_the_future():
    for fold in holdout.groups(recording(), "forward:run"):
        assert np.flatnonzero(fold.train).max() < np.flatnonzero(fold.test).min()


def test_gap_clears_both_sides_of_a_block():
    (_, fold, *_) = holdout.groups(recording(runs=1, rows=30), holdout.HoldOut(scheme="blocks", blocks=3, gap=20.0))
    assert np.flatnonzero(fold.test).tolist() == list(range(10, 20))
    assert np.flatnonzero(~fold.train & ~fold.test).tolist() == [8, 9, 20, 21]


def test_gap_does_not_reach_another_run():
    folds = holdout.groups(recording(), holdout.HoldOut(scheme="leave-one-run-out", gap=1e6))
    assert all((fold.train ^ fold.test).all() for fold in folds)


def test_auto_takes_blocks_where_runs_are_few():
    assert holdout.resolved(recording(runs=2)).scheme == "blocks"
    assert holdout.resolved(recording(runs=3)).scheme == "leave-one-run-out"


def test_unknown_scheme_and_group_are_named():
    with pytest.raises(DataError, match="Did you mean blocks"):
        holdout.groups(recording(), "block:4")
    with pytest.raises(DataError, match=r"no group 'dya' \(present: day\)\. Did you mean day"):
        holdout.groups(recording(), "leave-one-group-out:dya")


def test_one_run_cannot_sit_out():
    with pytest.raises(DataError, match="only one group"):
        holdout.groups(recording(runs=1), "leave-one-run-out")


def test_runs_that_only_log_judge_nothing():
    logged = recording()
    silent = logged.frame["run"] == "r1"
    logged = Recording(logged.manifest, logged.frame.assign(E_Z=np.where(silent, np.nan, 0.0)))
    assert [fold.label for fold in holdout.groups(logged)] == ["r0", "r2", "r3"]


def test_batches_keep_runs_whole_and_auto_takes_them_where_runs_are_many():
    many = recording(runs=40, rows=3)
    assert holdout.name(holdout.resolved(many)) == "batches:10"
    folds = holdout.groups(many)
    assert [fold.label for fold in folds][:2] == ["r0 to r3", "r4 to r7"]
    run = many.run_codes()
    for fold in folds:
        assert not set(run[fold.train]) & set(run[fold.test])
    assert (sum(fold.test.astype(int) for fold in folds) == 1).all()
