"""Hold-outs of a calendar, the seasonal table and learning curves, on a machine whose truth is known."""

from __future__ import annotations

import learning_curve
import numpy as np
import pandas as pd
import pytest
import survey
from numpy.testing import assert_allclose

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.models.season import Season
from errpipe.thermal import arithmetic
from errpipe.thermal.season import SeasonOptions
from errpipe.validation import held_out, seasons

COLUMNS = {
    "run": Column(role="run"),
    "date": Column(role="group", of="day"),
    "season": Column(role="group", of="season"),
    "t": Column(role="time", unit="s", epoch="2017-01-30T00:00:00Z"),
    "T_a": Column(role="temperature", unit="degC", location="bed"),
    "T_b": Column(role="temperature", unit="degC", location="column"),
    "E_D": Column(role="error", component="E_D", unit="um"),
}


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Deviation 3 um per K of T_a; T_b follows T_a in winter, and the other way in spring."""
    rng = np.random.default_rng(4)
    frames = []
    for k, (day, season) in enumerate(
        [
            ("2017-01-30", "winter"),
            ("2017-01-31", "winter"),
            ("2017-02-01", "winter"),
            ("2017-02-02", "spring"),
            ("2017-02-03", "spring"),
        ]
    ):
        t = np.arange(60) * 300.0
        a = 20 + (4 + k) * (1 - np.exp(-t / 5000))
        b = a + rng.normal(0, 0.02, 60) if season == "winter" else 40 - a
        deviation = 50.0 + k + 3.0 * (a - a[0]) + rng.normal(0, 0.1, 60)
        labels = {"run": f"r{k}", "date": day, "season": season}
        frames.append(pd.DataFrame({**labels, "t": t + k * 86400.0, "T_a": a, "T_b": b, "E_D": deviation}))
    return Recording(Manifest(recording=1, tables=("x",), columns=COLUMNS), pd.concat(frames, ignore_index=True))


class Slope:
    """A least-squares slope on the rise of one sensor."""

    def __init__(self, recording: Recording, component: str, rows: np.ndarray, name: str = "T_a"):
        self.name = name
        x, y = self.rise(recording)[rows], arithmetic.since_start_of(recording, component)[rows]
        self.slope = float(x @ y / (x @ x))

    def rise(self, recording: Recording) -> np.ndarray:
        return arithmetic.since_start(recording.array(self.name), recording.run_codes(), 1)[0]

    def values(self, recording: Recording) -> np.ndarray:
        return self.slope * self.rise(recording)


def on_b(recording, component, rows):
    return Slope(recording, component, rows, "T_b")


def test_months_come_from_days_or_from_the_epoch(recording):
    folds = holdout.groups(recording, "forward:month")
    assert [f.label for f in folds] == ["2017-02"]
    assert recording.frame["date"][folds[0].train].max() == "2017-01-31"
    undated = Recording(
        recording.manifest.model_copy(update={"columns": {k: v for k, v in COLUMNS.items() if k != "date"}}),
        recording.frame.drop(columns="date"),
    )
    assert [f.label for f in holdout.groups(undated, "leave-one-group-out:month")] == ["2017-01", "2017-02"]
    days = [f.label for f in holdout.groups(undated, "forward:day")]
    assert days == ["2017-01-31", "2017-02-01", "2017-02-02", "2017-02-03"]
    timeless = {**undated.manifest.columns, "t": Column(role="time", unit="s")}
    dateless = Recording(undated.manifest.model_copy(update={"columns": timeless}), undated.frame)
    with pytest.raises(DataError, match="neither a column of days nor an epoch"):
        holdout.groups(dateless, "forward:month")


def test_no_row_both_fits_and_judges(recording):
    for scheme in ("leave-one-group-out:season", "leave-one-group-out:day", "forward:day", "blocks:4"):
        for fold in holdout.groups(recording, scheme):
            assert not (fold.train & fold.test).any()


def test_the_table_tells_a_season_that_fails(recording):
    good = seasons.table(recording, "E_D", Slope)
    assert good["never_worse"] and [r["left_out"] for r in good["groups"]] == ["winter", "spring"]
    for row in good["groups"]:
        assert row["out_of_season"] < 0.5 and row["ratio"] < 1.5
        assert_allclose(row["bias"] ** 2 + row["scatter"] ** 2, row["out_of_season"] ** 2, rtol=1e-9)
    bad = seasons.table(recording, "E_D", on_b)
    spring = bad["groups"][1]
    assert not bad["never_worse"] and spring["out_of_season"] > spring["uncompensated"]
    assert bad["optimism"]["gap"] > 3.0
    assert "spring" in survey.text(bad)


def test_days_are_pooled_by_months(recording):
    output = seasons.table(recording, "E_D", Slope, "forward:day", in_season=False)
    assert [m["month"] for m in output["months"]] == ["2017-01", "2017-02"]
    spring = [r for r in output["groups"] if r["left_out"].startswith("2017-02")]
    squares = sum(r["rows"] * r["out_of_season"] ** 2 for r in spring)
    assert_allclose(output["months"][1]["out_of_season"] ** 2 * output["months"][1]["rows"], squares)
    assert "months" not in seasons.table(recording, "E_D", Slope, in_season=False)
    assert "2017-02" in survey.text(output)


def test_a_season_model_is_judged_like_every_other_model(recording):
    fold = holdout.groups(recording, "leave-one-group-out:season")[1]
    output = Season(component="E_D", options=SeasonOptions(correction=False)).validate_fold(recording, fold)["E_D"]
    assert output.label == "spring" and (np.sort(output.rows) == np.flatnonzero(fold.test)).all()
    assert_allclose(output.before, arithmetic.since_start_of(recording, "E_D")[output.rows])
    assert output.rms(output.after) < output.rms(output.before) and (output.outside >= 0).all()


def test_one_season_is_judged_by_its_runs(recording):
    """`check` found nothing to say of it, and `validate` refused it: no group 'season'."""
    columns = {name: column for name, column in recording.manifest.columns.items() if column.of != "season"}
    manifest = recording.manifest.model_copy(update={"columns": columns})
    one = Recording(manifest, recording.frame.drop(columns="season"))
    family = Season(family="season", component="E_D")
    document, _ = held_out.cross_validate(one, family)
    assert document["scheme"] == "leave-one-run-out" and "seasons" not in document
    with pytest.raises(DataError, match="no group 'hall'"):  # one that a person names is not replaced
        family.model_copy(update={"options": SeasonOptions(environment="hall")}).folds(one, None)


def test_learning_curve_counts_hours_of_the_rows_that_fit(recording):
    curve = learning_curve.curve(recording, "E_D", Slope, sizes=(1, 2), orders=1)
    spring = [e for e in curve if e["left_out"] == "spring" and e["order"] == 0]
    assert [e["runs"] for e in spring] == [1, 2, 3]
    assert_allclose([e["hours"] for e in spring], np.array([1, 2, 3]) * 59 * 300 / 3600)
    assert all(e["rms"] < e["rms_before"] for e in curve)
    with pytest.raises(DataError):
        learning_curve.curve(recording, "E_D", Slope, sizes=(0,))
