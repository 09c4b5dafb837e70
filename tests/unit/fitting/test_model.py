import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe import jsonfile
from errpipe.domain.error_model import ErrorModel, FittedTerm
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.motion import position
from errpipe.errors import DataError, NotIdentifiable
from errpipe.fitting.judging import judge_all
from errpipe.fitting.lowering import lower, uncompensated_terms
from errpipe.fitting.model import ModelSpec, evaluate, fit, term_of
from errpipe.models.terms import Terms
from tests.unit.fitting.axis_recordings import axis_recording, with_response
from tests.validation_document import held_out


@pytest.fixture(name="axis")
def _axis():
    return axis_recording()


def spec_of(*terms, component="EXX", **more):
    return ModelSpec.model_validate({"components": [{"component": component, "terms": list(terms)}], **more})


OFFSET = {"term": "offset"}
SCALE = {"term": "scale_expansion", "axis": "X", "sensor": "T_nut"}
BACKLASH = {"term": "backlash", "axis": "X"}
BOW = {"term": "chebyshev", "axis": "X", "degree": 4}
LATE = {"term": "thermal_lag", "sensor": "T_bed", "reference": 20.0}


def truth(recording, axis="X"):
    x = position(recording, axis)
    return (
        5.0
        + 0.010 * x
        + 3.0 * np.cos(2 * np.arccos(np.clip(2 * (x - x.min()) / (x.max() - x.min()) - 1, -1, 1)))
        + 11.5e-3 * x * (recording.array("T_nut") - 20.0)
        - 3.5 * recording.array("dir")
    )


def parameters(model):
    return {(f.term["term"], p.name): p for f in model.components[0].terms for p in f.parameters}


def test_parameters_come_back_within_their_intervals(axis):
    model = fit(with_response(axis, truth(axis), 0.4), spec_of(OFFSET, BOW, SCALE, BACKLASH))
    values = parameters(model)
    for key, value in {("scale_expansion", "coefficient"): 11.5, ("backlash", "lost_motion"): 7.0}.items():
        assert values[key].ci95[0] < value < values[key].ci95[1]
        assert values[key].ci95[1] - values[key].ci95[0] < 0.5
    assert values[("scale_expansion", "coefficient")].unit == "um/m/K"
    component = model.components[0]
    assert component.rms_after == pytest.approx(0.4, rel=0.1)
    assert component.noise_floor == pytest.approx(0.4, rel=0.25)
    assert component.half_width90 == pytest.approx(1.645 * 0.4, rel=0.2)
    assert len(component.parameter_names) == len(component.covariance) == 7


def test_exact_data_give_exact_parameters(axis):
    model = fit(with_response(axis, truth(axis)), spec_of(OFFSET, BOW, SCALE, BACKLASH), calibrate=False)
    values = parameters(model)
    assert values[("scale_expansion", "coefficient")].value == pytest.approx(11.5, abs=1e-8)
    assert values[("backlash", "lost_motion")].value == pytest.approx(7.0, abs=1e-8)
    assert values[("chebyshev", "c2")].value == pytest.approx(3.0, abs=1e-8)


def test_another_axis_gives_the_same_numbers(axis):
    other = axis_recording("Y")
    terms = [{**t, **({"axis": "Y"} if "axis" in t else {})} for t in (OFFSET, BOW, SCALE, BACKLASH)]
    one = fit(with_response(axis, truth(axis), 0.4), spec_of(OFFSET, BOW, SCALE, BACKLASH))
    two = fit(with_response(other, truth(other, "Y"), 0.4), spec_of(*terms, component="EYY"))
    assert [p.value for f in one.components[0].terms for p in f.parameters] == [
        p.value for f in two.components[0].terms for p in f.parameters
    ]


def test_a_lag_is_found(axis):
    from errpipe.domain.driver import Input, Lag

    tau = 1500.0
    y = 4.0 * (drive(Lag(of=Input(name="T_nut"), tau_up=tau, tau_down=tau), axis) - 20.0)
    late = {"term": "thermal_lag", "sensor": "T_nut"}
    model = fit(with_response(axis, y, 0.02), spec_of(late), calibrate=False)
    values = parameters(model)
    assert values[("thermal_lag", "tau")].ci95[0] < tau < values[("thermal_lag", "tau")].ci95[1]
    assert values[("thermal_lag", "tau")].ci95[1] < 1.5 * tau
    assert values[("thermal_lag", "tau")].ci95[0] > 0


def test_the_model_survives_its_file_and_equal_input_gives_equal_bytes(axis):
    recording = with_response(axis, truth(axis), 0.4)
    spec = spec_of(OFFSET, BOW, SCALE, BACKLASH)
    one, two = (jsonfile.dumps(fit(recording, spec).model_dump(mode="json")) for _ in range(2))
    assert one == two
    back = ErrorModel.model_validate_json(one)
    assert_allclose(evaluate(back, recording)["EXX"], evaluate(fit(recording, spec), recording)["EXX"], atol=0)


def test_nothing_to_fit_is_a_model_too(axis):
    model = fit(with_response(axis, truth(axis), 0.4), spec_of())
    assert model.components[0].rms_before == model.components[0].rms_after
    assert (evaluate(model, axis)["EXX"] == 0).all()


def test_a_fixed_parameter_stays_and_the_rest_makes_room(axis):
    fixed = {**SCALE, "fixed": {"coefficient": 10.0}}
    values = parameters(
        fit(with_response(axis, truth(axis), 0.1), spec_of(OFFSET, BOW, fixed, BACKLASH), calibrate=False)
    )
    assert values[("scale_expansion", "coefficient")].value == 10.0
    assert values[("scale_expansion", "coefficient")].ci95 is None
    assert values[("backlash", "lost_motion")].value == pytest.approx(7.0, abs=0.3)


def test_a_prior_settles_what_the_rows_cannot(axis):
    cold = axis_recording(same_warmth=True)
    y = with_response(cold, truth(cold), 0.2)
    line = {"term": "chebyshev", "axis": "X", "degree": 2}
    prior = {"term": "scale_expansion", "parameter": "coefficient", "value": 11.5, "spread": 0.5}
    spec = {"components": [{"component": "EXX", "terms": [OFFSET, line, SCALE, BACKLASH], "priors": [prior]}]}
    with pytest.raises(NotIdentifiable):
        fit(y, spec_of(OFFSET, line, SCALE, BACKLASH))
    model = fit(y, ModelSpec.model_validate({**spec, "most_inflation": 1e6}), calibrate=False)
    assert parameters(model)[("scale_expansion", "coefficient")].value == pytest.approx(11.5, abs=0.3)


def test_robust_is_not_moved_by_outliers(axis):
    y = truth(axis) + np.random.default_rng(0).normal(0, 0.3, len(axis))
    y[::25] += 80.0
    model = fit(with_response(axis, y), spec_of(OFFSET, BOW, SCALE, BACKLASH, method="robust"), calibrate=False)
    values = parameters(model)[("scale_expansion", "coefficient")]
    assert values.ci95[0] < 11.5 < values.ci95[1] and values.standard_error < 0.2


def test_ridge_holds_twins_that_least_squares_refuses(axis):
    twin = axis.with_columns(
        {"T_twin": axis.array("T_nut") + np.random.default_rng(7).normal(0, 0.01, len(axis))},
        {"T_twin": axis.manifest.columns["T_nut"]},
    )
    y = with_response(twin, 3.0 * (twin.array("T_nut") - 20.0), 0.3)
    both = [{"term": "thermal_drift", "sensor": s} for s in ("T_nut", "T_twin")]
    with pytest.raises(NotIdentifiable, match="use method: ridge"):
        fit(y, spec_of(OFFSET, *both))
    model = fit(y, spec_of(OFFSET, *both, method="ridge"))
    gains = [p.value for f in model.components[0].terms[1:] for p in f.parameters]
    assert sum(gains) == pytest.approx(3.0, abs=0.1) and min(gains) > 0.5


def test_a_smooth_curve_follows_a_local_bump_without_a_hint(axis):
    x = axis.array("x")
    y = with_response(axis, 6.0 * np.exp(-(((x - 180) / 30) ** 2)) + 0.004 * x, 0.3)
    model = fit(y, spec_of(OFFSET, {"term": "smooth_curve", "axis": "X", "segments": 40}))
    assert model.components[0].rms_after == pytest.approx(0.3, rel=0.12)
    exact = 6.0 * np.exp(-(((x - 180) / 30) ** 2)) + 0.004 * x
    assert np.sqrt(np.mean((evaluate(model, axis)["EXX"] - exact) ** 2)) < 0.15


def test_selection_leaves_out_what_held_out_rows_do_not_need(axis):
    y = with_response(axis, truth(axis), 0.4)
    idle = {"term": "thermal_drift", "sensor": "T_bed"}
    model = fit(y, spec_of(OFFSET, BOW, SCALE, BACKLASH, idle, selection="held-out"))
    assert [f.term["term"] for f in model.components[0].terms] == ["offset", "chebyshev", "scale_expansion", "backlash"]


def test_selection_on_noise_does_nothing(axis):
    y = with_response(axis, np.zeros(len(axis)), 0.4)
    model = fit(y, spec_of(OFFSET, BOW, SCALE, BACKLASH, selection="held-out"))
    assert model.components[0].terms == ()


def test_run_start_counts_from_each_runs_first_row(axis):
    rise = axis.array("T_nut") - 20.0
    run = axis.run_codes()
    y = 4.0 * rise + np.array([30.0, -20, 5, 60, -80, 12, 7, 1])[run]
    spec = spec_of({"term": "thermal_drift", "sensor": "T_nut"}, datum="run_start")
    model = fit(with_response(axis, y, 0.01), spec)
    assert parameters(model)[("thermal_drift", "gain")].value == pytest.approx(4.0, abs=0.02)
    values = evaluate(model, axis)["EXX"]
    first = np.flatnonzero(np.r_[True, run[1:] != run[:-1]])
    assert_allclose(values[first], 0.0, atol=0)


def test_run_start_is_judged_from_each_runs_first_readings(axis):
    level = np.array([30.0, -20, 5, 60, -80, 12, 7, 1])[axis.run_codes()]
    y = with_response(axis, 4.0 * (axis.array("T_nut") - 20.0) + level, 0.01)
    judged = judge_all(
        y, spec_of({"term": "thermal_drift", "sensor": "T_nut"}, datum="run_start"), axis.array("x") < 1e9
    )
    for fold in judged["EXX"]:
        assert 1.5 < fold.rms(fold.before) < 3.0  # a rise of 1 K in each run, whatever its level
        assert fold.rms(fold.after) < 0.03


def test_a_datum_per_run_is_nuisance_and_not_part_of_the_model(axis):
    level = np.array([30.0, -20, 5, 60, -80, 12, 7, 1])[axis.run_codes()]
    spec = spec_of({"term": "chebyshev", "axis": "X", "degree": 2}, nuisance=[{"term": "run_offset"}])
    model = fit(with_response(axis, 0.02 * axis.array("x") + level, 0.1), spec)
    nuisance = {p.name: p.value for p in model.components[0].nuisance[0].parameters}
    assert nuisance["level_r3"] - nuisance["level_r1"] == pytest.approx(80.0, abs=0.2)
    assert model.components[0].rms_before == pytest.approx(0.02 * np.std(axis.array("x")), rel=0.05)
    assert [f.term["term"] for f in model.components[0].terms] == ["chebyshev"]


def test_validity_is_what_was_seen(axis):
    model = fit(with_response(axis, truth(axis), 0.4), spec_of(OFFSET, SCALE, BACKLASH), calibrate=False)
    assert set(model.validity.ranges) == {"x", "T_nut"}
    assert model.validity.ranges["x"] == (axis.array("x").min(), axis.array("x").max())


def test_units_follow_the_response(axis):
    kinds = dict(axis.manifest.columns)
    kinds["E"] = kinds["E"].model_copy(update={"component": "EBX", "unit": "urad"})
    tilt = Recording(
        axis.manifest.model_copy(update={"columns": kinds}), axis.frame.assign(E=2.0 + 0.01 * axis.array("x"))
    )
    model = fit(tilt, spec_of(OFFSET, BOW, component="EBX"), calibrate=False)
    assert parameters(model)[("offset", "level")].unit == "urad"
    assert model.components[0].unit == "urad"


def test_rows_that_lack_a_sensor_are_left_out_and_none_left_is_refused(axis):
    y = with_response(axis, truth(axis), 0.4)
    holes = Recording(y.manifest, y.frame.assign(T_nut=y.frame["T_nut"].where(y.frame.index % 3 > 0)))
    assert fit(holes, spec_of(OFFSET, SCALE), calibrate=False).components[0].rows == 320
    empty = Recording(y.manifest, y.frame.assign(T_nut=np.nan))
    with pytest.raises(DataError, match=r"no row has both EXX and everything its terms need"):
        fit(empty, spec_of(OFFSET, SCALE))


def test_a_response_that_is_not_there_is_named(axis):
    with pytest.raises(DataError, match=r"no response EXY \(present: EXX\)\. Did you mean EXX"):
        fit(axis, spec_of(OFFSET, component="EXY"))


def refusal(recording, *terms):
    with pytest.raises(NotIdentifiable) as match:
        fit(recording, spec_of(*terms))
    return str(match.value)


def test_refusals_name_the_pair_the_reason_and_a_remedy(axis):
    y = with_response(axis, truth(axis), 0.4)
    cold = axis_recording(same_warmth=True)
    cold = with_response(cold, truth(cold), 0.4)
    drift = [{"term": "thermal_drift", "sensor": s} for s in ("T_nut", "T_bed")]
    follows = 2.0 * y.frame["T_nut"] - 20.0 + 0.01 * np.sin(y.frame["t"])
    together = Recording(y.manifest, y.frame.assign(T_bed=follows))
    assert refusal(
        y, OFFSET, {"term": "scale_error", "axis": "X"}, {"term": "chebyshev", "axis": "X", "degree": 1}
    ) == (
        "fit: slope (scale_error) and c1 (chebyshev) of EXX cannot be distinguished: they are equivalent"
        " (correlation 1.000).\n     Omit one of them, or fix its value."
    )
    assert refusal(cold, OFFSET, {"term": "scale_error", "axis": "X"}, SCALE) == (
        "fit: slope (scale_error) and coefficient (scale_expansion) of EXX cannot be distinguished: T_nut hardly"
        " changed (correlation 1.000).\n     Fix one of them, or record runs at clearly different temperatures."
    )
    assert refusal(together, OFFSET, *drift) == (
        "fit: gain (thermal_drift) and gain (thermal_drift) of EXX cannot be distinguished: T_nut rose with T_bed"
        " (correlation 1.000).\n     Omit one sensor, use method: ridge, or record a run in which the two"
        " temperatures differ."
    )


def test_a_run_without_a_sensor_judges_nothing_and_is_named(axis):
    """Before: validation refused the recording, and the interval was that of the fitted rows."""
    recording = with_response(axis, truth(axis), 0.4)
    nut = np.where(recording.frame["run"] == "r3", np.nan, recording.array("T_nut"))
    recording = recording.with_columns({"T_nut": nut}, {})
    terms = [OFFSET, BOW, SCALE, BACKLASH]
    model = fit(recording, spec_of(*terms))
    assert not model.notes and model.components[0].half_width90 == pytest.approx(1.645 * 0.4, rel=0.2)
    document = held_out(recording, Terms.of(spec_of(*terms)))
    assert [g["label"] for g in document["components"][0]["groups"]] == [f"r{k}" for k in range(8) if k != 3]
    (why,) = document["not_judged"]
    assert why.startswith("hold-out r3: no judged row") and "T_nut" in why
    with pytest.raises(DataError, match="no row has both EXX and everything"):
        held_out(recording.with_columns({"T_nut": np.full(nut.size, np.nan)}, {}), Terms.of(spec_of(*terms)))


def test_a_level_and_a_level_per_run_say_the_same(axis):
    spec = spec_of(OFFSET, nuisance=[{"term": "run_offset"}])
    with pytest.raises(NotIdentifiable, match="level"):
        fit(with_response(axis, truth(axis), 0.4), spec)


def test_lowered_pairs_add_up_to_the_model(axis):
    wave = {"term": "harmonics", "axis": "X", "period": 10.0}
    mixed = {
        "term": "profile_driver",
        "axis": "X",
        "profile": {"kind": "polynomial", "degree": 3, "lowest": 0},
        "driver": [{"input": "T_bed", "reference": 20.0, "lag": True}],
    }
    spec = spec_of(OFFSET, BOW, wave, SCALE, BACKLASH, mixed)
    model = fit(with_response(axis, truth(axis), 0.4), spec, calibrate=False)
    pairs = lower(model)["EXX"]
    x = position(axis, "X")
    total = sum((p.profile(x) if p.profile else 1.0) * drive(p.driver, axis) for p in pairs)
    assert_allclose(total, evaluate(model, axis)["EXX"], atol=1e-9)
    # static curve, wave, scale x rise, mixed x late rise, and all levels in one
    assert [p.period for p in pairs] == [None, 10.0, None, None, None]
    assert [p.axis for p in pairs] == ["X", "X", "X", "X", None]
    assert uncompensated_terms(model) == {"EXX": []}


def test_an_option_that_a_term_does_not_have_is_refused():
    with pytest.raises(DataError, match="error model: term offset: axis: extra inputs"):
        term_of(FittedTerm(term={"term": "offset", "axis": "X"}, parameters=()))


def test_a_prior_names_one_parameter_of_one_term(axis):
    """A prior that means nothing was passed over in silence; one that means two terms settled both."""
    both = [{"term": "thermal_drift", "sensor": s} for s in ("T_nut", "T_bed")]

    def spec(**prior):
        prior = {"term": "thermal_drift", "parameter": "gain", "value": 1.0, "spread": 0.5} | prior
        return ModelSpec.model_validate({"components": [{"component": "EXX", "terms": both, "priors": [prior]}]})

    with pytest.raises(ValueError, match=r"2 terms thermal_drift .select one by `where`"):
        spec()
    with pytest.raises(ValueError, match=r"0 terms thermal_drfit .allowed: thermal_drift"):
        spec(term="thermal_drfit")
    with pytest.raises(ValueError, match=r"no linear parameter gian of thermal_drift .allowed: gain"):
        spec(parameter="gian", where={"sensor": "T_bed"})
    prior = spec(where={"sensor": "T_bed"}).components[0].priors[0]
    assert [prior.applies_to(t) for t in spec(where={"sensor": "T_bed"}).components[0].terms] == [False, True]
