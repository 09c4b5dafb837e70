"""Every rule: finds what was planted, leaves alone what is physics, says which rows and why, keeps to its share."""

import numpy as np
import pytest

from errpipe import jsonfile
from errpipe.cleaning import RULES, WHOLE_RUN, clean
from errpipe.cleaning._base import resolution
from errpipe.cleaning.gaps import Gaps
from errpipe.cleaning.outliers import Outliers
from errpipe.cleaning.quantisation import Quantisation
from errpipe.cleaning.repeated_rows import RepeatedRows
from errpipe.cleaning.time_order import TimeOrder
from errpipe.cleaning.unit_slips import UnitSlips
from errpipe.domain.recording import Constant
from errpipe.errors import DataError
from tests.unit.cleaning.faulty_recordings import changed, noise, recording, touched, warm_up


def test_a_clean_recording_stays_as_it_is():
    for seed in range(5):
        source = warm_up(seed, step=0.05)
        cleaned, report = clean(source)
        removing = [d for r in report.rules for d in r.done if d.what != "note"]
        assert removing == [] and cleaned.frame.equals(source.frame)


def test_the_report_is_canonical_json_and_names_every_rule_and_option():
    source = warm_up()
    source.frame.loc[100, "E_Z"] += 40.0
    _, report = clean(source)
    text = jsonfile.dumps(report.plain())
    assert text == jsonfile.dumps(clean(source)[1].plain())
    assert [r.rule for r in report.rules] == [rule.model_fields["rule"].default for rule in RULES if rule.by_default]
    plain = {r["rule"]: r for r in report.plain()["rules"]}
    assert plain["outliers"]["options"] == {"threshold": 6.0, "most": 0.02}
    (done,) = plain["outliers"]["done"]
    assert (done["what"], done["column"], done["rows"], done["count"]) == ("blank cells", "E_Z", [[100, 101]], 1)


def test_every_option_has_a_meaning():
    for rule in RULES:
        for name, field in rule.model_fields.items():
            assert name == "rule" or field.description, f"{rule.__name__}.{name}"


def test_row_numbers_are_those_of_the_recording_that_came_in():
    source = warm_up()
    doubled = source.take(np.r_[0:50, 49, 50:1200])
    doubled.frame.loc[200, "E_Z"] += 40.0  # row 200 here, row 199 once the double is gone
    _, report = clean(doubled)
    assert touched(report, "repeated_rows") == [50]
    assert touched(report, "outliers") == [200]


# ---------------------------------------------------------------- units


@pytest.mark.parametrize("name", ["T_bearing", "T_motor", "T_column", "T_room"])
def test_a_fahrenheit_column_is_named_and_set_aside(name):
    source = warm_up()
    slipped = changed(source, **{name: source.array(name) * 1.8 + 32})
    cleaned, report = clean(slipped, (UnitSlips(),))
    (done,) = report.rules[0].done
    assert done.column == name and done.what == "set column aside" and "degF, not degC" in done.reason
    assert name not in cleaned.frame
    assert clean(slipped, (UnitSlips(trust=(name,)),))[0].frame.equals(slipped.frame)


@pytest.mark.parametrize(("unit", "factor", "offset"), [("degF", 1.8, 32.0), ("K", 1.0, 273.15)])
def test_runs_in_another_unit_are_blanked_and_the_others_stay(unit, factor, offset):
    """Before: the median over three and more runs hid it."""
    source = warm_up(runs=6)
    second, values = np.isin(source.run_codes(), (1, 2)), source.array("T_bearing")
    slipped = changed(source, T_bearing=np.where(second, factor * values + offset, values))
    cleaned, report = clean(slipped, (UnitSlips(),))
    (done,) = report.rules[0].done
    assert (done.column, done.what) == ("T_bearing", "blank cells")
    assert done.reason.startswith("run 2 starts at") and f"taken as {unit}" in done.reason and "; run 3" in done.reason
    assert np.array_equal(np.isnan(cleaned.array("T_bearing")), second)
    hot = np.where(second, values + 50.0 * np.exp(-source.time() / 3600), values)  # restarted while hot
    assert clean(changed(source, T_bearing=hot), (UnitSlips(),))[1].rules[0].done == ()


def test_kelvin_pressure_and_humidity_slips_are_named():
    source = warm_up()
    source = source.with_columns(
        {"p": np.full(1200, 1.013), "rh": np.linspace(0.4, 0.5, 1200)},
        {"p": recording(p=[1.0]).manifest.columns["p"], "rh": recording(rh=[1.0]).manifest.columns["rh"]},
    )
    _, report = clean(changed(source, T_room=source.array("T_room") + 273.15), (UnitSlips(),))
    reasons = {d.column: d.reason for d in report.rules[0].done}
    assert "these are kelvin" in reasons["T_room"]
    assert reasons["p"] == "reads 1.013 hPa, which no air has; as bar it is 1013 hPa"
    assert reasons["rh"] == "never exceeds 0.5 %: a fraction, not per cent"


def test_a_hot_oil_is_not_taken_for_fahrenheit():
    source = warm_up()
    assert clean(changed(source, T_motor=source.array("T_motor") + 35), (UnitSlips(),))[1].rules[0].done == ()


def axis_rows(rows=200):
    x = 400 + 390 * np.sin(np.arange(rows) / 20)
    return {"run": ["1"] * rows, "t": np.arange(rows) * 0.1, "x": x, "v": np.gradient(x, 0.1), "E_Z": noise(rows)}


@pytest.mark.parametrize(
    ("column", "factor", "message"),
    [
        ("x", 1 / 25.4, "x: spans 30.71 of a travel of 800 mm; taken as inch it spans 780: inch, not mm"),
        ("x", 1e-3, "x: spans 0.78 of a travel of 800 mm; taken as m it spans 780: m, not mm"),
        ("v", 60.0, "v: the change of x in time is 0.0166"),
    ],
)
def test_a_slipped_position_or_speed_is_refused_with_the_evidence(column, factor, message):
    rows = axis_rows()
    travel = {"X": Constant(role="axis", kind="linear", travel=(0, 800), unit="mm")}
    assert clean(recording(travel, **rows), (UnitSlips(),))[1].rules[0].done == ()
    rows[column] = rows[column] * factor
    with pytest.raises(DataError) as refusal:
        clean(recording(travel, **rows), (UnitSlips(),))
    assert str(refusal.value).splitlines()[0].startswith(f"clean, unit_slips: {message}")


def test_a_response_in_millimetres_with_its_twin_is_refused():
    shape = 30 * np.sin(np.arange(300) / 30)
    source = recording(run=["1"] * 300, t=np.arange(300.0), E_Z=shape * 1e-3, E_Z_sim=shape)
    with pytest.raises(DataError, match=r"E_Z: E_Z_sim is 1000 times as large .*: mm\. Mend its unit in the manifest"):
        clean(source)
    gain_off = changed(source, E_Z=shape * 1.15)
    assert clean(gain_off, (UnitSlips(),))[1].rules[0].done == ()


# ---------------------------------------------------------------- rows


def test_repeated_rows_go_and_equal_readings_at_other_times_stay():
    source = recording(run=list("111122"), t=[0, 1, 1, 2, 3, 3], T1=[20, 21, 21, 21, 21, 22.0])
    cleaned, report = clean(source, (RepeatedRows(most=0.5),))
    assert touched(report, "repeated_rows") == [2, 5]  # 2 is removed, 5 is noted: same time, another reading
    assert [d.what for d in report.rules[0].done] == ["remove rows", "note"]
    assert len(cleaned) == 5


def test_rows_equal_in_what_is_missing_are_repeated_too():
    source = recording(run=list("111"), t=[0, 1, 1.0], T1=[20, np.nan, np.nan])
    assert touched(clean(source, (RepeatedRows(most=0.5),))[1], "repeated_rows") == [2]
    with pytest.raises(DataError, match=r"would remove 1 of 3 rows .* the first at row 2 \(run 1, t = 1 s\)"):
        clean(source, (RepeatedRows(),))


def test_the_fewest_rows_go_where_time_steps_back():
    t = np.arange(300.0)
    t[100] = 5.0
    t[200:202] = 999.0
    t[250] = np.nan
    source = recording(run=["1"] * 300, t=t, T1=t)
    cleaned, report = clean(source, (TimeOrder(most=0.05),))
    assert touched(report, "time_order") == [100, 200, 201, 250]
    assert (np.diff(cleaned.time()) >= 0).all()


# ---------------------------------------------------------------- gaps


def test_short_holes_hold_the_reading_before_and_long_ones_stay():
    values = np.arange(20.0)
    values[[0, 5, 6, 12, 13, 14, 15, 16]] = np.nan
    source = recording(run=["1"] * 20, t=60.0 * np.arange(20), T1=values)
    cleaned, report = clean(source, (Gaps(hold=200, most=0.5),))
    assert touched(report, "gaps") == [5, 6]
    np.testing.assert_array_equal(cleaned.array("T1")[[4, 5, 6, 7]], [4, 4, 4, 7])
    assert np.isnan(cleaned.array("T1")[[0, 12, 16]]).all()


def test_a_hole_over_the_end_of_a_run_is_not_held():
    source = recording(run=list("111222"), t=[0, 1, 2, 0, 1, 2.0], T1=[20, 21, np.nan, np.nan, 25, 26])
    cleaned, _ = clean(source, (Gaps(most=0.5),))
    assert cleaned.array("T1")[2] == 21 and np.isnan(cleaned.array("T1")[3])


def test_a_long_pause_splits_the_run_and_the_whole_stays_a_group():
    t = np.r_[0:5, 20000:20005, 90000:90005, 0:3].astype(float)
    source = recording(run=["a"] * 15 + ["b"] * 3, t=t, T1=t)
    cleaned, report = clean(source, (Gaps(longest=7200),))
    assert cleaned.run_labels() == ("a", "a part 2", "a part 3", "b")
    assert list(cleaned.frame[WHOLE_RUN]) == ["a"] * 15 + ["b"] * 3
    assert cleaned.manifest.columns[WHOLE_RUN].of == "run"
    assert touched(report, "gaps") == list(range(5, 15))


# ---------------------------------------------------------------- display steps


def test_the_display_step_is_noted():
    done = clean(warm_up(noise=0.02, step=0.1), (Quantisation(),))[1].rules[0].done
    assert {d.column for d in done} == {"T_bearing", "T_motor", "T_column", "T_room"}
    assert done[0].reason == "displayed in steps of 0.1 degC: rounding alone is 0.029 degC rms"
    assert clean(warm_up(), (Quantisation(),))[1].rules[0].done == ()


def test_a_step_is_read_off_a_column_of_text():
    values = np.array([float(f"{0.05 * k:.2f}") for k in range(300, 420)])
    assert resolution(values) == 0.05
    assert resolution(np.random.default_rng(0).standard_normal(100)) == 0.0
    assert resolution(np.array([1.0, 1.0])) == 0.0
    assert resolution(np.linspace(0.0, 1.0, 1_100_000)) == 0.0  # denser than any display: was an internal error
    commanded = np.linspace(0.0, 600.0, 88)
    derived = 1e3 * ((commanded + 0.01 * np.arange(88) % 7) - commanded)  # 10 um, but for the arithmetic
    assert resolution(derived) == pytest.approx(10.0)


def test_a_rule_that_is_not_by_default_waits_to_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from errpipe import cleaning

    monkeypatch.setattr(cleaning.RULES["gaps"], "by_default", False)
    waiting = {rule.rule for rule in cleaning.DEFAULT} - {rule.rule for rule in cleaning.by_default()}
    assert waiting == {"gaps"}


def test_a_refusal_names_sensors_whose_plugs_were_exchanged_in_a_run():
    source, rows = warm_up(runs=4), [30, 90, 150, 210]
    spoilt = source.array("T_bearing").copy()
    spoilt[rows] += 30.0
    second = source.run_codes() == 1
    for exchanged in (False, True):
        pair = [spoilt, source.array("T_column")]
        own, other = (np.where(second & exchanged, b, a) for a, b in (pair, pair[::-1]))
        with pytest.raises(DataError, match="the first at row 30 ") as refusal:
            clean(changed(source, T_bearing=own, T_column=other), (Outliers(most=0.001),))
        assert ("T_bearing and T_column seem to be exchanged in run 2 (" in str(refusal.value)) == exchanged
