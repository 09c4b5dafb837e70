"""One run: what it predicts of the next, and what is not exported although blocks of the run were predicted well."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.errors import GateError
from errpipe.fitting import holdout
from errpipe.fitting.judging import HeldOut
from errpipe.formats import manifest_folder
from errpipe.models.auto import Auto
from errpipe.validation import significance
from errpipe.validation.gate import pass_gate
from errpipe.validation.held_out import component_figures
from errpipe.validation.predict import predict
from tests.unit.models.test_competition import machine
from tests.validation_document import held_out
from trials import folder
from trials.thermal import logs

FAMILY = Auto(component="E_Z", among=("rises", "lagged"))


def recorded(tmp_path, seed: int, number: int, days: int):
    """The log that fits, and the later ones."""
    out = []
    for name, sheet in zip(("fit", "judge"), logs.recordings(seed, number, days), strict=True):
        folder.write(tmp_path / f"{number}-{name}", sheet)
        out.append(manifest_folder.read(tmp_path / f"{number}-{name}"))
    return out


def test_halves_of_one_run_fit_and_judge_in_turn() -> None:
    one = machine(2, seasons=("winter",), runs=1)
    label, folds = FAMILY.folds(one, None)
    assert label == "halves" and len(folds) == 6
    assert np.array_equal(np.sum([f.test for f in folds], axis=0), np.ones(len(one)))
    for number, fold in enumerate(folds):
        others = [f.test for k, f in enumerate(folds) if (k < 3) != (number < 3)]
        assert np.array_equal(fold.train, np.any(others, axis=0))


def test_of_two_runs_each_judges_the_other() -> None:
    two = machine(2, seasons=("winter",), runs=2)
    short = two.take(np.r_[0 : len(two) // 4, len(two) // 2 : len(two)])
    for fold in holdout.groups(short, "halves"):
        run = short.run_codes()
        assert np.unique(run[fold.train]).size == np.unique(run[fold.test]).size == 1
        assert run[fold.train][0] != run[fold.test][0]


def test_two_runs_of_two_seasons_are_halves_too() -> None:
    """No test over two runs can pass the gate, whatever the model leaves; their blocks can."""
    two = machine(2, seasons=("winter", "spring"), runs=1)
    label, folds = FAMILY.folds(two, None)
    assert label == "halves" and len(folds) == 6
    assert FAMILY.folds(two, "leave-one-group-out:season")[0] == "leave-one-group-out:season"
    assert held_out(two, FAMILY)["components"][0]["gain"] > 0.0


def test_a_row_without_a_deviation_divides_no_half() -> None:
    """Temperatures that were logged long before the deviation count in neither half."""
    one = machine(2, seasons=("winter",), runs=1)
    late = one.with_columns({"E_Z": np.where(np.arange(len(one)) < 0.6 * len(one), np.nan, one.array("E_Z"))}, {})
    seen = np.isfinite(late.array("E_Z"))
    counts = [int(np.sum(f.test & seen)) for f in holdout.groups(late, "halves")]
    assert len(counts) == 6 and max(counts) - min(counts) <= 1


def test_coverage_of_the_next_run_is_not_claimed_and_the_widths_are_larger() -> None:
    one = machine(2, seasons=("winter",), runs=1)
    halves, blocks = held_out(one, FAMILY), held_out(one, FAMILY, "blocks:5")
    (figures,), (inside,) = halves["components"], blocks["components"]
    assert figures["coverage90"] is None and {g["coverage90"] for g in figures["groups"]} == {None}
    assert inside["coverage90"] is not None
    assert figures["half_width90"] > inside["half_width90"]


@pytest.mark.parametrize("days", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_later_logs_lie_in_the_interval(days: int, tmp_path) -> None:
    """Machines of a seed that chose nothing: 85 % of their rows at least, and not at twice the width needed."""
    covered, wide = [], []
    for number in range(8):
        fit, judge = recorded(tmp_path, 6101, number, days)
        output = predict(Auto(component="E_Z", among=("rises", "lagged")).fit(fit).model, judge)
        left = since(judge.array("E_Z"), judge) - since(output["E_Z_predicted"].to_numpy(), judge)
        half = 0.5 * (output["E_Z_upper"] - output["E_Z_lower"]).to_numpy()
        covered.append(np.mean(np.abs(left) <= half))
        wide.append(np.mean(half) / np.quantile(np.abs(left), 0.9))
    assert np.mean(covered) > 0.85, covered
    assert np.median(wide) < 2.0, wide


def since(values: np.ndarray, recording) -> np.ndarray:
    """Values less the mean of each run's first three."""
    out, run = values.copy(), recording.run_codes()
    for code in np.unique(run):
        out[run == code] -= values[run == code][:3].mean()
    return out


def test_a_log_of_one_day_that_helps_is_exported_and_one_that_wanders_is_not() -> None:
    one = machine(2, seasons=("winter",), runs=1)
    assert pass_gate(FAMILY.fit(one).model, [held_out(one, FAMILY)]).left_out == ()
    walk = np.cumsum(np.random.default_rng(1).normal(0.0, 1.0, len(one)))
    wanders = one.with_columns({"E_Z": walk}, {})
    with pytest.raises(GateError, match=r"independent rows.*measure further days"):
        pass_gate(FAMILY.fit(wanders).model, [held_out(wanders, FAMILY)])


@pytest.mark.parametrize(("blocks", "gain"), [(1.0, 1.0), (1.3, 0.75)])
def test_halves_that_go_too_far_do_not_alone_take_a_share_of_the_correction(blocks: float, gain: float) -> None:
    """Halves predict 1.3 times what is there, blocks between fitted rows once or as often; the next run is between."""
    one = machine(2, seasons=("winter",), runs=1)
    deviation = since(one.array("E_Z"), one)

    def folds(times: float) -> list[HeldOut]:
        parts = np.array_split(np.arange(len(one)), 6)
        return [HeldOut("", k, deviation[k], (1.0 - times) * deviation[k], np.zeros(k.size), 0.0) for k in parts]

    figures = component_figures(one, "E_Z", folds(1.3), halves=lambda: {"E_Z": folds(blocks)})
    assert figures["rms_by_gain"]["0.75"] < figures["rms_by_gain"]["1"] and figures["gain"] == gain


def test_a_day_that_warms_one_way_is_exported_by_its_blocks(tmp_path) -> None:
    """Its halves alone are worth three rows (p = 7e-4), too few to be exported by."""
    fit, judge = recorded(tmp_path, 6101, 3, 1)
    family = Auto(component="E_Z", among=("rises",))  # one family: a third of the time of two that compete
    (figures,) = held_out(fit, family)["components"]
    assert significance.HALVES_LEVEL < figures["p_value"] <= significance.HALVES_LIKELY and figures["gain"] > 0.0
    predicted = predict(family.fit(fit).model, judge)
    left = since(judge.array("E_Z"), judge) - since(predicted["E_Z_predicted"].to_numpy(), judge)
    assert np.std(left) < 0.5 * np.std(since(judge.array("E_Z"), judge))
