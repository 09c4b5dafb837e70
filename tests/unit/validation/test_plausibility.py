"""Wrong declarations are refused with what was meant; right ones, however unusual, are not."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Recording
from errpipe.errors import GateError
from errpipe.validation import codes, plausibility
from tests.unit.validation.sound_recordings import sound_recording
from tests.unit.validation.wrong_declarations import (
    WRONG,
    Wrong,
    axis_test,
    declare,
    mirrored,
    page,
    put,
    rotary_test,
    with_actual,
)


def test_there_are_forty_and_more() -> None:
    assert len(WRONG) >= 40
    assert len({w.declared for w in WRONG}) == len(WRONG)


@pytest.mark.parametrize("wrong", WRONG, ids=lambda w: w.declared.replace(" ", "-"))
def test_a_wrong_declaration_is_refused_by_its_name(wrong: Wrong) -> None:
    findings = plausibility.findings(wrong.made())
    named = [f for f in findings if f.code == wrong.code]
    assert named, [str(f) for f in findings]
    assert wrong.meant in str(named[0])
    with pytest.raises(GateError, match="export: refused") as refusal:
        plausibility.refuse(findings)
    assert wrong.code in str(refusal.value) and wrong.meant in str(refusal.value)
    codes = sorted({f.code for f in findings})
    assert any("Allowed by name" in note for note in plausibility.refuse(findings, codes))


@pytest.mark.parametrize("seed", range(5))
def test_a_right_declaration_is_not_refused(seed: int) -> None:
    for recording in (axis_test(seed), axis_test(seed, warm=False), with_actual(axis_test(seed)), rotary_test()):
        assert [str(f) for f in plausibility.findings(recording)] == []


def test_what_is_rare_but_true_is_not_refused() -> None:
    plain = axis_test(3)
    f = plain.frame
    belt = put(plain, EXX=f.EXX + 20.0 * f.x)  # a belt whose pulley is 2 % too large: only the limit speaks
    assert [x.code for x in plausibility.findings(belt)] == []
    upside_down = put(plain, EXX=f.EXX - 40e-3 * f.x)  # a lead that is too short: the slope is negative, not its change
    assert [x.code for x in plausibility.findings(upside_down)] == []
    noisy = put(plain, EXX=f.EXX + 30 * np.random.default_rng(1).normal(size=len(f)))
    assert [x.code for x in plausibility.findings(noisy)] == []
    short = put(plain, x=f.x / 100 + 300, EXX=20 * np.sin(f.x / 10) - 10 * f["dir"])  # 8 mm of a screw, one pitch
    short = declare(short, {"x": Column(role="command", axis="X", unit="mm")})
    assert [x.code for x in plausibility.findings(short)] in ([], ["outside-travel"])


def test_backlash_of_the_other_sign_is_asked_not_refused() -> None:
    plain = axis_test(4)
    turned = put(plain, EXX=plain.frame.EXX + 16 * plain.frame["dir"])
    (findings,) = plausibility.findings(turned)
    assert findings.code == "reversal-sign" and findings.level == "ask"
    assert plausibility.refuse([findings])[0].startswith("Check: ")


@pytest.mark.parametrize(("lost", "says"), [(2.0, True), (0.4, False)])
def test_small_lost_motion_of_the_other_sign_is_reported(lost: float, says: bool) -> None:
    """Below 5 um it was silent. An import asks for a sign that the file does not state."""
    plain = axis_test(4, warm=False)
    f = plain.frame
    turned = put(plain, EXX=0.02 * f.x + lost / 2 * f["dir"] + 0.2 * np.random.default_rng(6).normal(size=len(f)))
    found = plausibility.findings(turned)
    assert [x.code for x in found] == (["reversal-sign"] if says else [])
    assert all(x.of_sign for x in found)


def test_backlash_of_the_other_sign_shows_with_a_larger_curve() -> None:
    """8 um of lost motion of an axis that is 60 um too long: judged at each target, not over the whole axis."""
    plain = axis_test(4, warm=False)
    f = plain.frame
    turned = put(plain, EXX=0.075 * f.x + 4.0 * f["dir"] + 0.5 * np.random.default_rng(4).normal(size=len(f)))
    assert [x.code for x in plausibility.findings(turned)] == ["reversal-sign"]
    right = put(plain, EXX=0.075 * f.x - 4.0 * f["dir"] + 0.5 * np.random.default_rng(4).normal(size=len(f)))
    assert plausibility.findings(right) == []


def test_a_log_of_many_places_is_judged_in_time_that_grows_with_its_rows() -> None:
    """200,000 rows, hardly two at one place: comparing every place with every row took 5 s."""
    t = 0.001 * np.arange(200_000)
    x = 400.0 + 300.0 * np.sin(0.5 * t)
    columns = {
        "x": Column(role="command", axis="X", unit="mm"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    manifest = axis_test(1).manifest.model_copy(update={"columns": columns, "constants": {}})
    log = Recording(manifest, pd.DataFrame({"x": x, "EXX": 0.02 * x + np.sin(3.0 * t)}))
    started = time.process_time()
    assert plausibility.findings(log) == []
    assert time.process_time() - started < 1.5


def test_a_worn_screw_is_asked_not_refused() -> None:
    """Lost motion that varies along the travel more than the lead does: both directions have opposite shapes."""
    plain = axis_test(5, warm=False)
    f = plain.frame
    worn = put(plain, EXX=-(8 + 12 * np.sin(np.pi * f.x / 800)) * f["dir"] + 0.3 * np.sin(f.x / 50))
    (findings,) = plausibility.findings(worn)
    assert findings.code == "mixed-sign" and findings.level == "ask"


def test_targets_in_a_random_order_have_no_direction_of_motion() -> None:
    plain = axis_test(6)
    order = np.random.default_rng(2).permutation(len(plain.frame))
    f = plain.frame.iloc[order].sort_values("run", kind="stable").reset_index(drop=True)
    f["t"] = 12.0 * np.arange(len(f))
    assert plausibility.findings(Recording(plain.manifest, f)) == []


def test_a_machine_that_cooled_over_night_has_no_broken_sensor() -> None:
    plain = axis_test(7)
    f = plain.frame
    night = f.run.isin(["run-4", "run-5"])
    cold = put(plain, T_nut=f.T_nut - 20.0 * night, EXX=f.EXX - 11.5e-3 * f.x * 20.0 * night, t=f.t + 40000.0 * night)
    assert plausibility.findings(cold) == []


def test_a_sensor_that_lost_its_power_is_asked() -> None:
    plain = axis_test(9)
    f = plain.frame
    (findings,) = plausibility.findings(put(plain, T_nut=f.T_nut.where(~f.index.isin(range(60, 75)), 85.0)))
    assert findings.code == "temperature-jump" and findings.level == "ask"


def test_a_heated_bed_has_no_broken_sensor() -> None:
    plain = axis_test(8, warm=False)
    heated = np.where(np.arange(210) > 60, 75.0 - 0.3 * np.maximum(np.arange(210) - 90, 0), 20.0)
    assert plausibility.findings(put(plain, T_nut=heated)) == []


def test_allowing_one_name_allows_no_other() -> None:
    findings = plausibility.findings(next(w for w in WRONG if w.declared == "positions in m declared as mm").made())
    codes = {f.code for f in findings if f.level == "refuse"}
    assert len(codes) > 1
    with pytest.raises(GateError):
        plausibility.refuse(findings, [codes.pop()])


@pytest.mark.parametrize(
    ("largest", "travel", "limit", "refused"),
    [
        (499.0, 300.0, None, False),
        (501.0, 300.0, None, True),
        (501.0, None, None, True),
        (900.0, 1000.0, None, False),
        (1100.0, 1000.0, None, True),
        (40.0, 1000.0, 30.0, True),
    ],
)
def test_a_correction_beyond_its_limit(largest: float, travel: float, limit: float, refused: bool) -> None:
    assert (plausibility.too_large("EXX", largest, "um", travel, limit) is not None) is refused


def test_the_limit_names_the_unit_that_would_fit() -> None:
    problems = plausibility.too_large("EXX", 12_000.0, "um", 300.0)
    assert problems is not None and "um that were declared as mm" in problems.meant
    assert plausibility.too_large("ECC", 999.0, "urad", None) is None
    as_far_as_the_travel = plausibility.too_large("EXX", 310_000.0, "um", 300.0)
    assert as_far_as_the_travel is not None and as_far_as_the_travel.meant.startswith("absolute readings")
    assert plausibility.too_large("ECC", 1001.0, "urad", None) is not None
    assert plausibility.too_large("F_X", 1e9, "N", None) is None


def test_the_consequence_in_one_sentence() -> None:
    says = plausibility.consequence("X", "X", 600.0, 1.0, 16.6)
    assert says == (
        "at X = 600 mm approached from below the axis stands 16.6 um too far and will be commanded 16.6 um less"
    )
    assert plausibility.consequence("X", "X", 5.7e-14, 1.0, 16.6).startswith("at X = 0 mm")
    says = plausibility.consequence("Z", "X", 600.0, -1.0, -10.0)
    assert says == (
        "at X = 600 mm approached from above the axis Z stands 10.0 um short and will be commanded 10.0 um further"
    )


def test_the_page_of_wrong_declarations_is_up_to_date() -> None:
    path = Path(__file__).parents[3] / "docs" / "wrong-declarations.md"
    again = "python -m tests.unit.validation.wrong_declarations"
    written = [line.split("|")[1:3] for line in path.read_text(encoding="utf-8").splitlines()]
    assert written == [line.split("|")[1:3] for line in page().splitlines()], f"write it again: {again}"


def test_every_name_is_explained() -> None:
    assert {w.code for w in WRONG} <= set(codes.EXPLANATIONS)


@pytest.mark.parametrize("count", [100, pytest.param(400, marks=pytest.mark.slow)])
def test_sound_recordings_of_any_layout_are_not_refused(count: int) -> None:
    """400 axis tests of random layout, seeds that chose no threshold: at most one refusal (0.25 %)."""
    made = [(seed, plausibility.findings(sound_recording(seed))) for seed in range(20_000, 20_000 + count)]
    refused = [(seed, str(f)) for seed, match in made for f in match if f.level == "refuse"]
    assert len(refused) <= 1, refused


@pytest.mark.parametrize("code", ["shifted-rows", "mirrored-rows", "too-small"])
def test_wrong_rows_are_refused_whatever_the_noise_drew(code: str) -> None:
    change: dict[str, Callable[[pd.DataFrame], object]] = {
        "shifted-rows": lambda f: np.roll(f.EXX, 1),
        "mirrored-rows": mirrored,
        "too-small": lambda f: f.EXX / 1e3,
    }
    for seed in range(100, 120):
        recording = axis_test(seed)
        codes_found = {f.code for f in plausibility.findings(put(recording, EXX=change[code](recording.frame)))}
        assert code in codes_found, seed


def test_one_side_throughout_is_asked_about() -> None:
    recording = axis_test(7)
    (findings,) = plausibility.findings(put(recording, dir=1.0))
    assert findings.code == "direction-not-of-motion" and findings.level == "ask"


def test_a_long_accurate_axis_is_not_refused_as_too_small() -> None:
    plain = axis_test(3, travel=(0.0, 5000.0), warm=False)
    f = plain.frame
    good = 1.5 * np.sin(f.x / 900) - 0.4 * f["dir"] + 0.3 * np.random.default_rng(5).normal(size=len(f))
    assert [x.code for x in plausibility.findings(put(plain, EXX=good))] == []
    assert [x.code for x in plausibility.findings(put(plain, EXX=good / 1000))] == ["too-small"]


@pytest.mark.parametrize(("added", "means_kelvin"), [(273.15, True), (500.0, False)])
def test_kelvin_in_some_rows_is_distinguished_from_a_broken_sensor(added: float, means_kelvin: bool) -> None:
    """Before: "another column, or a sensor that failed", where one season was logged in K."""
    recording = axis_test()
    half = np.where(np.arange(len(recording)) < len(recording) // 2, added, 0.0)
    found = plausibility.findings(put(recording, T_nut=recording.array("T_nut") + half))
    (said,) = [str(f) for f in found if f.code == "temperature-range"]
    assert ("degC in some rows and K in others" in said) == means_kelvin
