"""`errpipe retrain` from the command line: a machine that changes is followed, one that does not is left alone."""

from __future__ import annotations

import json
import shutil
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from errpipe.cli._pipeline import load_pipeline_file
from errpipe.cli.app import main
from errpipe.pipeline.lock import exclusive_lock
from errpipe.pipeline.step import NO_CALLBACKS
from errpipe.verbs.retrain import _first_runs
from errpipe.verbs.retrain import retrain as one_look

MANIFEST = """recording: 1
title: X axis, one run a day
tables: [recording.csv]
constants:
  X: {role: axis, kind: linear, travel: [0, 600], screw_lead: 10, unit: mm}
columns:
  run: {role: run}
  t: {role: time, unit: s}
  x: {role: position, axis: X, unit: mm}
  dir: {role: direction, axis: X}
  T_nut: {role: temperature, unit: degC, location: nut}
  T_bed: {role: temperature, unit: degC, location: bed}
  T_air: {role: temperature, unit: degC, location: air}
  EXX: {role: error, component: EXX, unit: um}
"""
PIPELINE = """pipeline: 1
title: X axis
stages:
  - {kind: ingest, recording: recording}
  - kind: fit
    components:
      - component: EXX
        terms:
          - {term: offset}
          - {term: chebyshev, axis: X, degree: 2}
          - {term: scale_expansion, axis: X, sensor: T_nut}
    holdout: {scheme: batches, blocks: 4}
  - {kind: validate}
"""


def record(
    folder: Path,
    days: int,
    first: int = 0,
    changed_from: int | None = None,
    sensor_drift_from: int | None = None,
    read_from: int = 0,
    as_read: Callable[[float], float] = float,
) -> None:
    """Days of a machine that is 10 um too long at x = 600 and expands by 11 um/m/K; later perhaps by 17.

    Rows of days before `first` are not kept. as_read: what is recorded of an error from the day `read_from` on.
    """
    rng = np.random.default_rng(4)
    rows = []
    for day in range(days):
        air = 20 + 3 * np.sin(day / 5)
        nut = air + 4 * rng.random()
        bed = air + 0.3 * (nut - air)
        drift = 0.0 if sensor_drift_from is None else 0.5 * max(0, day - sensor_drift_from)
        alpha = 17.0 if changed_from is not None and day >= changed_from else 11.0
        for k, (x, side) in enumerate([(x, 1) for x in range(0, 601, 60)] + [(x, -1) for x in range(600, -1, -60)]):
            error = 10.0 * x / 600 + alpha * 1e-3 * x * (nut - 20) + rng.normal(0, 0.8)
            show = [round(v + rng.normal(0, 0.05), 2) for v in (nut + drift, bed, air)]
            if day >= read_from:
                error = as_read(error)
            rows.append([f"day {day}", 86400 * day + 5 * k, x, side, *show, round(error, 3)])
    rows = [row for row in rows if row[1] >= 86400 * first]
    folder.mkdir(parents=True, exist_ok=True)
    columns = ["run", "t", "x", "dir", "T_nut", "T_bed", "T_air", "EXX"]
    pd.DataFrame(rows, columns=columns).to_csv(folder / "recording.csv", index=False)
    (folder / "recording.yaml").write_text(MANIFEST, encoding="utf-8")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pipeline, and a champion fitted on the first twelve days."""
    where = tmp_path_factory.mktemp("made")
    (where / "axis.yaml").write_text(PIPELINE, encoding="utf-8")
    record(where / "recording", 12)
    assert main(["run", str(where / "axis.yaml"), "--out", str(where / "champion")]) == 0
    return where


@pytest.fixture
def site(made: Path, tmp_path: Path) -> Path:
    """A copy of it for one test."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path


def retrain(site: Path, *more: str) -> tuple[int, dict]:
    arguments = ["--champion", str(site / "champion"), "--out", str(site / "out"), *more]
    code = main(["retrain", str(site / "axis.yaml"), *arguments])
    return code, json.loads((site / "out" / "retrain.json").read_text(encoding="utf-8"))


def failed(document: dict) -> list[str]:
    return [g["name"] for g in document["gates"] if not g["passed"]]


def test_a_machine_that_did_not_change_keeps_its_champion(site: Path) -> None:
    record(site / "recording", 40)
    code, document = retrain(site)
    assert code == 4 and document["decision"] == "keep the champion"
    assert failed(document) == ["evidence"]
    assert document["drift"] == {key: [] for key in ("inputs", "residuals", "sizes", "rms", "changes", "runs")}


@pytest.mark.parametrize(
    "as_read, means",
    [
        (lambda e: 0.05 * e, "compensation switched on"),
        (lambda e: -e, "their sign is reversed"),
        (lambda e: e / 1000.0, "another unit, 1/1000"),
    ],
    ids=["compensated", "sign", "unit"],
)
def test_readings_that_are_no_deviations_of_the_machine_stop_a_promotion(
    site: Path, as_read: Callable[[float], float], means: str
) -> None:
    """All new days were read otherwise, and the old ones are no longer kept: the challenger suits what was read."""
    record(site / "recording", 44, first=12, read_from=12, as_read=as_read)
    code, document = retrain(site)
    assert code == 4 and "readings of EXX" in failed(document)
    (size,) = document["drift"]["sizes"]
    assert means in size["meaning"] and int(size["since"].split()[1]) == 12


def test_one_night_of_another_sign_stops_promotions_until_it_is_left_out_by_name(site: Path, capsys: Any) -> None:
    """Sound nights follow it: what holds since then forgets it, and every later challenger was fitted on it."""
    record(site / "recording", 24)
    file = site / "recording/recording.csv"
    frame = pd.read_csv(file)
    frame.loc[frame["run"] == "day 14", "EXX"] *= -1.0
    frame.to_csv(file, index=False)
    code, document = retrain(site)
    assert code == 4 and "readings of EXX" in failed(document)
    assert "in run day 14 their sign is reversed" in capsys.readouterr().out
    assert "day 14" not in [s["run"] for s in document["runs"]]
    code, document = retrain(site, "--set", 'ingest.without_runs=["day 14"]')
    assert failed(document) == ["evidence"] and document["drift"]["runs"] == []


def test_what_changed_is_reported_in_the_terms_of_the_model(site: Path) -> None:
    record(site / "recording", 22, changed_from=12)
    _, document = retrain(site)
    (change,) = document["drift"]["changes"]
    assert [t["term"] for t in change["terms"]] == ["scale_expansion"]
    assert "What changed of EXX since run day 1" in (site / "out/retrain.md").read_text(encoding="utf-8")


def test_after_a_change_that_an_earlier_look_dated_the_challenger_is_fitted_on_the_runs_since(site: Path) -> None:
    """Fitted on all 22 days it leaves half of the change, and the evidence was 2.4 of the 20 that are needed.

    Days as cold as no run of the champion are no evidence: both tables correct next to nothing there.
    """
    for days in (13, 17, 20, 23, 26, 29, 32):
        record(site / "recording", days, changed_from=12)
        code, document = retrain(site)
        if code == 0:
            break
    assert code == 0 and document["fitted_since"] in ("day 12", "day 13"), document["e_value"]
    shutil.rmtree(site / "champion")
    shutil.copytree(site / "out/run", site / "champion")
    code, document = retrain(site)  # days before the change are no new ones of the champion that was promoted
    assert code == 4 and document["runs"] == [] and document["fitted_since"] == document["kept_from"]


def test_a_challenger_of_few_runs_corrects_where_the_champion_did(site: Path) -> None:
    """Nine days since the change are of other temperatures: in those of the champion the new table may not fade."""
    champion = json.loads((site / "champion/fit/error_model.json").read_text(encoding="utf-8"))["validity"]
    record(site / "recording", 23, first=12, changed_from=12)
    assert retrain(site)[0] == 4
    _, document = retrain(site)
    new = json.loads((site / "out/run/fit/error_model.json").read_text(encoding="utf-8"))["validity"]
    (low, high), (least, most) = champion["ranges"]["T_nut"], new["ranges"]["T_nut"]
    assert least <= low and most >= high and new["seen"]["T_nut"] != [least, most]
    assert new["margins"]["T_nut"] == pytest.approx(0.5 * (most - least)) and list(new["seen"]) == ["T_nut"]
    (says,) = document["narrower"]
    assert says.endswith("degC, as the champion does.")


def test_a_date_whose_run_the_shop_no_longer_keeps_is_nothing_to_tell(site: Path) -> None:
    for days in (23, 24, 30):
        record(site / "recording", days, first=12, changed_from=12)
        retrain(site)
    shutil.rmtree(site / "champion")
    shutil.copytree(site / "out/run", site / "champion")
    record(site / "recording", 42, first=25, changed_from=12)
    _, document = retrain(site)
    assert document["kept_from"] and document["fitted_on_all"] == "", document["fitted_on_all"]


def test_a_pipeline_file_that_cannot_be_read_leaves_no_pages_of_the_look_before(site: Path) -> None:
    record(site / "recording", 14)
    retrain(site)
    (site / "axis.yaml").write_text("pipeline: 1\nstages: [{kind: ingst}]\n", encoding="utf-8")
    assert retrain(site)[0] == 2
    assert "not judged" in (site / "out/retrain.md").read_text(encoding="utf-8")


def test_a_champion_of_another_version_says_what_to_do(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = site / "champion/fit/error_model.json"
    model.write_text(
        model.read_text(encoding="utf-8").replace('"error_model": 1', '"error_model": 0'), encoding="utf-8"
    )
    code = main(["retrain", str(site / "axis.yaml"), "--champion", str(site / "champion"), "--out", str(site / "out")])
    assert code == 6 and "of another version? Run the pipeline into" in capsys.readouterr().err


def test_of_two_looks_at_once_one_waits_for_the_other(site: Path) -> None:
    record(site / "recording", 14)
    pipeline, waits = load_pipeline_file(site / "axis.yaml", []), threading.Event()
    callbacks = replace(NO_CALLBACKS, waiting=waits.set)
    with ThreadPoolExecutor(1) as pool:
        with exclusive_lock(site / "out"):
            look = pool.submit(one_look, pipeline, site / "champion", site / "out", callbacks=callbacks)
            assert waits.wait(60) and not (site / "out/run").exists()
        assert look.result(120)["decision"] == "keep the champion"


def test_of_two_changes_in_a_week_the_second_dates_the_challenger(site: Path) -> None:
    """A new screw on day 12, another laser on day 16; on the runs since day 12 no one machine is to be fitted."""
    for days in (13, 17, 21, 23):
        record(site / "recording", days, changed_from=12, read_from=16, as_read=lambda e: e + 6.0)
        _, document = retrain(site)
    (change,) = document["drift"]["changes"]
    assert change["since"] == "day 16" == document["fitted_since"]
    assert {t["term"] for t in change["terms"]} == {"offset", "scale_expansion"}


def test_a_challenger_fitted_on_all_runs_though_the_machine_changed_says_why(site: Path, capsys: Any) -> None:
    """The runs since the change are too few: before, nothing said that the other machine's runs had a part in it."""
    for days in (14, 15):
        record(site / "recording", days, changed_from=12)
        capsys.readouterr()
        _, document = retrain(site)
    says = "The machine changed at run day 12, but the challenger is fitted on all runs: 3 runs since then, 5 needed."
    assert document["fitted_since"] is None and document["fitted_on_all"] == says
    assert says in capsys.readouterr().out and says in (site / "out/retrain.md").read_text(encoding="utf-8")


def test_where_too_few_runs_follow_the_latest_date_the_one_before_counts() -> None:
    """Else one look at a date of two runs ago had fitted a challenger on the machine of before."""
    look = {"champion": "a", "challenger": "b", "kept_from": None, "fitted_since": "day 12"}
    drift = {"changes": [{"since": "day 20"}]}
    assert _first_runs(look | {"drift": drift}, "a") == (None, ["day 20", "day 12"])
    assert _first_runs(look | {"drift": {"changes": []}}, "a") == (None, [])
    assert _first_runs(look | {"drift": drift, "kept_from": "day 3"}, "a") == ("day 3", ["day 20", "day 12", "day 3"])
    assert _first_runs(look | {"drift": drift}, "b") == ("day 12", ["day 12"])
    assert _first_runs({}, "a") == (None, [])


def test_a_first_run_that_the_pipeline_names_is_the_one_that_the_report_names(site: Path) -> None:
    for days in (18, 20):
        record(site / "recording", days, changed_from=12)
        _, document = retrain(site, "--set", "ingest.since_run=day 14")
    assert document["fitted_since"] == "day 14" and document["drift"]["changes"]


def test_temperatures_that_change_their_unit_together_stop_a_promotion(site: Path) -> None:
    """They agree with each other as before, and a challenger that was fitted in degF suits them: it was promoted."""
    record(site / "recording", 44, first=12)
    file = site / "recording/recording.csv"
    frame = pd.read_csv(file)
    frame[["T_nut", "T_bed", "T_air"]] = frame[["T_nut", "T_bed", "T_air"]] * 1.8 + 32.0
    frame.to_csv(file, index=False)
    code, document = retrain(site)
    assert code == 4 and failed(document) == ["temperatures"]
    (says,) = (g["says"] for g in document["gates"] if g["name"] == "temperatures")
    assert says == "since run day 12 all of them read as if in degF instead of degC"


def test_a_machine_that_changed_gets_the_challenger_and_the_residual_drift_is_dated(site: Path) -> None:
    record(site / "recording", 44, first=12, changed_from=12)
    code, document = retrain(site)
    assert code == 0 and document["decision"] == "promote" and failed(document) == []
    assert document["drift"]["residuals"][0]["component"] == "EXX"
    assert int(document["drift"]["residuals"][0]["since"].split()[1]) in range(12, 17)
    tree = ElementTree.fromstring((site / "out" / "retrain.junit.xml").read_text(encoding="utf-8"))
    assert tree.get("failures") == "0" and int(tree.get("tests", 0)) == len(document["gates"])
    assert "promote" in (site / "out" / "retrain.md").read_text(encoding="utf-8").splitlines()[0]
    assert (site / "out" / "retrain.svg").read_text(encoding="utf-8").startswith("<svg")


def test_nightly_looks_score_each_run_once_and_end_where_one_look_ends(site: Path) -> None:
    for days in (16, 22, 30):
        record(site / "recording", days, changed_from=14)
        _, document = retrain(site)
    keys = [run["key"] for run in document["runs"]]
    assert len(keys) == len(set(keys)) == 18


def test_a_limit_on_the_change_keeps_the_champion(site: Path) -> None:
    record(site / "recording", 44, first=12, changed_from=12)
    code, document = retrain(site, "--max-change-um-per-k", "1")
    assert code == 4 and failed(document) == ["change of EXX per kelvin"]


def test_a_sensor_that_drifts_is_named_with_the_decision(site: Path, capsys: pytest.CaptureFixture) -> None:
    record(site / "recording", 40, sensor_drift_from=14)
    code, document = retrain(site, "--annotations", "github")
    isolated = [d["column"] for d in document["drift"]["inputs"] if d["isolated"]]
    assert isolated == ["T_nut"] and code == 4 and "sensors" in failed(document)
    assert "::warning title=sensor::T_nut drifts since run" in capsys.readouterr().out


def test_readings_are_not_called_compensated_where_the_sensor_drifts_that_predicts_them(site: Path) -> None:
    """A nut that reads 25 K too warm predicts five times what is measured: no table ran."""
    record(site / "recording", 66, first=12, sensor_drift_from=14)
    code, document = retrain(site)
    (size,) = document["drift"]["sizes"]
    assert size["meaning"] == "it predicts by T_nut, which drifts" and code == 4


def test_an_earlier_judgement_that_is_none_is_refused_with_its_place(site: Path, capsys) -> None:
    record(site / "recording", 14)
    _, document = retrain(site)
    first, second = document["runs"]
    arguments = ["--champion", str(site / "champion"), "--out", str(site / "out")]
    for hostile, says in (
        ([document], "not a document of retrain"),
        (document | {"runs": "x"}, "runs: "),
        (document | {"runs": [first, second | {"key": {}}]}, "runs.1.key: "),
        (document | {"runs": [first | {"champion": [1.0]}]}, "runs.0.champion: "),
        (document | {"runs": [first | {"challenger": -1.0}]}, "runs.0: a mean square"),
        ({k: v for k, v in document.items() if k != "runs"}, "runs: "),
    ):
        (site / "out/retrain.json").write_text(json.dumps(hostile), encoding="utf-8")
        capsys.readouterr()
        assert main(["retrain", str(site / "axis.yaml"), *arguments]) == 6
        said = capsys.readouterr().err
        assert "retrain.json" in said and says in said and "internal" not in said


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (lambda at: shutil.rmtree(at), 3, "no champion here"),
        (lambda at: shutil.rmtree(at / "ingest"), 3, "no champion here (ingest/recording.yaml is missing"),
        (lambda at: (at / "fit/error_model.json").write_text('{"hello": 1}'), 6, "not an error model"),
        (lambda at: (at / "ingest/recording.parquet").write_bytes(b"PAR1 x"), 3, "not a Parquet file"),
        (lambda at: edit(at / "fit/error_model.json", '"scale_expansion"', '"old"'), 3, "of another version?"),
        (lambda at: edit(at.parent / "recording/recording.yaml", "run: {", "run : {"), 4, ""),
        (lambda at: rewrite(at / "fit/error_model.json", "components", []), 3, "the champion has no EXX"),
        (lambda at: huge(at / "fit/error_model.json"), 6, "EXX predicts more than 1e+15 um"),
        (lambda at: (at.parent / "out").mkdir() or (at.parent / "out/retrain.json").write_text("[1]"), 6, "version 1"),
    ],
    ids=["none", "no recording", "foreign", "damaged", "older", "no new run", "no component", "huge", "out is foreign"],
)
def test_a_champion_that_is_none_is_refused_by_name(site: Path, capsys: Any, change: Any, code: int, says: str) -> None:
    change(site / "champion")
    assert retrain_code(site) == code
    assert says in capsys.readouterr().err


def rewrite(path: Path, key: str, value: Any) -> None:
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | {key: value}), encoding="utf-8")


def huge(path: Path) -> None:
    components = json.loads(path.read_text(encoding="utf-8"))["components"]
    for term in components[0]["terms"]:
        term["parameters"] = [p | {"value": 1e300} for p in term["parameters"]]
    rewrite(path, "components", components)


def edit(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")


def test_a_champion_of_another_machine_is_refused(site: Path, capsys: pytest.CaptureFixture) -> None:
    folder = site / "recording"
    for path in (folder / "recording.yaml", folder / "recording.csv", site / "axis.yaml"):
        edit(path, "T_nut", "T_spindle")
    assert retrain_code(site) == 3
    assert "the champion needs T_nut, which the recording does not have" in capsys.readouterr().err


def test_a_champion_where_the_challenger_is_written_is_refused_and_left(
    site: Path, capsys: pytest.CaptureFixture
) -> None:
    """Else a challenger that is kept out has replaced the champion all the same."""
    shutil.copytree(site / "champion", site / "out/run")
    before = (site / "out/run/fit/error_model.json").read_bytes()
    record(site / "recording", 14, changed_from=12)
    assert (
        main(["retrain", str(site / "axis.yaml"), "--champion", str(site / "out/run"), "--out", str(site / "out")]) == 2
    )
    assert "would replace it before" in capsys.readouterr().err
    assert (site / "out/run/fit/error_model.json").read_bytes() == before


def test_a_run_in_which_a_sensor_is_empty_is_named_with_the_sensor(site: Path, capsys: pytest.CaptureFixture) -> None:
    file = site / "recording/recording.csv"
    rows = [line.split(",") for line in file.read_text(encoding="utf-8").splitlines()]
    lines = [",".join([*row[:4], "" if row[0] in ("day 9", "day 10", "day 11") else row[4], *row[5:]]) for row in rows]
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")
    assert retrain_code(site) == 4
    says = "no judged row has a value in every column that the model reads (empty in all of them: T\\_nut)"
    assert says in (site / "out/retrain.md").read_text(encoding="utf-8")


def retrain_code(site: Path) -> int:
    return main(["retrain", str(site / "axis.yaml"), "--champion", str(site / "champion"), "--out", str(site / "out")])
