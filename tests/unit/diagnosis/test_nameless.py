"""What has no name: what comes anew with each run, what follows place and temperature, what a display rounds."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from errpipe.diagnosis import coloured, diagnose, empirical, own_noise, plausible, report, unnamed
from errpipe.diagnosis.holdout import HeldOut
from errpipe.diagnosis.shapes import shapes
from errpipe.domain.diagnosis import Empirical, EmpiricalTerm, Finding
from errpipe.drivers.library import candidates
from errpipe.terms import resolved_times
from errpipe.terms.air_refraction import AirRefraction
from errpipe.terms.scale_expansion import ScaleExpansion

from .machines import axis, recording, spindle


def library(made):
    """Columns of the empirical library on all rows, by name."""
    return {c.name: c for c in candidates(made, np.arange(len(made)), resolved_times(made)[1])}


def term_of(column):
    return EmpiricalTerm(
        column=column.name, coefficient=1.0, unit="um/K", ci95=(0.9, 1.1), rms_um=1.0, driver=column.driver
    )


def test_a_decay_at_the_start_of_each_run_is_a_shape():
    """Three runs show it; two may be a reading that wanders."""
    for runs, offered in ((6, True), (2, False)):
        made = axis(runs=runs)
        kinds = [s.kind for s in shapes(made, "EXX", np.arange(len(made)))]
        assert ("start of each run" in kinds) == offered


def test_a_profile_that_grows_with_a_temperature_is_a_shape():
    made = axis()
    x, rise = made.array("x"), made.array("T_nut")
    wave = np.cos(2 * np.pi * (x - x.min()) / np.ptp(x)) * (rise - rise.mean())
    every = shapes(made, "EXX", np.arange(len(made)))
    own = next(s for s in every if s.kind == "place and input" and s.drivers == ("x", "T_nut"))
    left = wave - own.columns @ np.linalg.lstsq(own.columns, wave, rcond=None)[0]
    assert np.std(left) < 1e-6 * np.std(wave)


def settling(seed: int = 0):
    """A slide that settles over 40 s at the start of each of eight runs; nothing recorded drives it."""
    rng = np.random.default_rng(seed)
    places = np.linspace(0, 500, 25)
    x, run = np.tile(np.r_[places, places[::-1]], 8), np.repeat(np.arange(8), 50)
    since = np.tile(2.0 * np.arange(50), 8)
    simulated = 0.02 * x + 0.3 * np.sin(x / 60)
    error = simulated + 4 * np.exp(-since / 40.0) + 0.6 * rng.standard_normal(x.size)
    columns = {"run": run.astype(str), "t": since + 1200.0 * run, "x": x, "E": error, "S": simulated}
    columns["d"] = np.tile(np.repeat([1.0, -1.0], 25), 8)
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "d": {"role": "direction", "axis": "X"},
        "E": {"role": "error", "component": "EXX", "unit": "um"},
        "S": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    return recording(columns, kinds)


@pytest.mark.slow
def test_what_settles_in_each_run_is_not_named_surely():
    (response,) = diagnose(settling())[0].responses
    assert max(f.confidence for f in response.findings if f.effect not in ("unknown", "recalibration")) < 0.5


@pytest.mark.parametrize(("step", "noise", "rounded"), [(4.0, 0.1, True), (4.0, 2.0, False), (0.01, 0.5, False)])
def test_what_is_left_of_a_coarse_reading_may_be_its_rounding(step, noise, rounded):
    """Along a smooth trend the rounding is a wave; noise of half a step is more than rounding."""
    trend = np.linspace(0, 60, 400)
    read = np.round((trend + noise * np.random.default_rng(1).standard_normal(400)) / step) * step
    case = SimpleNamespace(recording=SimpleNamespace(array=lambda name: read))
    case.pair = SimpleNamespace(error="E", rows=np.arange(400))
    residual, own_noise.residual = own_noise.residual, lambda case, chosen: read - trend
    try:
        assert own_noise.rounded(case) == rounded  # type: ignore[arg-type]
    finally:
        own_noise.residual = residual


@pytest.mark.slow
def test_a_rounded_trend_lacks_nothing():
    """One pass over 800 mm with a display whose step is a twelfth of the trend: the rounding is a wave of 70 mm."""
    rng, x = np.random.default_rng(1), np.linspace(0, 800, 300)
    simulated = 0.05 * x
    read = np.round((1.05 * simulated + 0.3 * rng.standard_normal(300) + 0.5) / 3.5) * 3.5
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "E": {"role": "error", "component": "EXX", "unit": "um"},
        "S": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    made = recording({"t": 5.0 * np.arange(300), "x": x, "E": read, "S": simulated}, kinds)
    (response,) = diagnose(made)[0].responses
    assert response.verdict in ("no_mismatch", "recalibrate")


@pytest.mark.parametrize(("column", "known"), [("(T_room - {mean:.5g})", True), ("(T_room - {mean:.5g})^2", False)])
def test_one_column_that_an_effect_follows_is_no_unknown_mechanism(column, known):
    from errpipe.diagnosis import hypotheses

    made = spindle()
    rows = np.arange(len(made))
    name = column.format(mean=made.array("T_room").mean())
    name = name if known else f"({name[:-2]})^2"
    law = Empirical(
        terms=(term_of(library(made)[name]),), constant=0.0, unit="um", share=0.9, p=0.01, scheme="", says=""
    )
    case = SimpleNamespace(recording=made, library=hypotheses.build(made, "E_Z", rows), pair=SimpleNamespace(rows=rows))
    case.explanation, case.simulated = SimpleNamespace(accepted=()), np.zeros(rows.size)
    assert empirical.has_a_name(case, law, np.zeros(rows.size)) == known  # type: ignore[arg-type]


def test_of_many_rows_the_same_ones_are_asked_for_a_name(monkeypatch):
    """The mean in a column's name is that of the rows that took part in the equation."""
    from errpipe.diagnosis import hypotheses

    monkeypatch.setattr(empirical, "MOST_ROWS", 100)
    made = spindle()
    rows, room = np.arange(len(made)), made.array("T_room")
    whole = 3 * (room - room.mean()) + 0.01 * np.random.default_rng(5).normal(size=rows.size)
    law = empirical.equation(made, rows, whole, "um")
    case = SimpleNamespace(recording=made, library=hypotheses.build(made, "E_Z", rows), pair=SimpleNamespace(rows=rows))
    case.explanation, case.simulated = SimpleNamespace(accepted=()), np.zeros(rows.size)
    assert law is not None and empirical.has_a_name(case, law, whole)  # type: ignore[arg-type]


@pytest.mark.parametrize(("further", "known"), [(0.2, True), (3.0, False)])
def test_a_term_that_explains_little_with_a_name_makes_no_unknown_mechanism(further, known):
    """What is left of the simulated signal by a gain that played the name is no further term."""
    from errpipe.diagnosis import hypotheses

    made = spindle()
    rows, room = np.arange(len(made)), made.array("T_room") - made.array("T_room").mean()
    other = np.random.default_rng(4).normal(size=rows.size) * np.std(room)
    name = f"(T_room - {made.array('T_room').mean():.5g})"
    terms = [term_of(library(made)[c]) for c in (name, "rpm")]
    law = Empirical(terms=tuple(terms), constant=0.0, unit="um", share=0.95, p=0.01, scheme="", says="")
    case = SimpleNamespace(recording=made, library=hypotheses.build(made, "E_Z", rows), pair=SimpleNamespace(rows=rows))
    case.explanation, case.simulated = SimpleNamespace(accepted=()), np.sin(rows / 7.0)
    whole = 3 * room + further * other - 4 * np.std(room) * case.simulated
    assert empirical.has_a_name(case, law, whole) == known  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("column", "known"), [("(T_bed - {bed:.5g})", True), ("(T_room - {room:.5g}) (T_bed - {bed:.5g})", False)]
)
def test_an_equation_that_two_names_hold_together_is_no_unknown_mechanism(column, known):
    from errpipe.diagnosis import hypotheses

    made = spindle()
    rows = np.arange(len(made))
    effects = hypotheses.build(made, "E_Z", rows)
    mean = {"room": made.array("T_room").mean(), "bed": made.array("T_bed").mean()}
    columns = [c.format(**mean) for c in ("(T_room - {room:.5g})", column)]
    listed = library(made)
    columns[1] = (
        columns[1] if columns[1] in listed else " ".join(reversed([f"{c})" for c in columns[1][:-1].split(") ")]))
    )
    terms = [term_of(listed[c]) for c in columns]
    law = Empirical(terms=tuple(terms), constant=0.0, unit="um", share=0.9, p=0.01, scheme="", says="")
    drifts = [
        (i, h)
        for i, h in enumerate(effects.hypotheses)
        if h.effect == "thermal_drift" and h.drivers[0] in ("T_room", "T_bed")
    ]
    accepted = tuple(SimpleNamespace(index=i, hypothesis=h) for i, h in drifts)
    case = SimpleNamespace(recording=made, library=effects, pair=SimpleNamespace(rows=rows))
    case.explanation, case.simulated = SimpleNamespace(accepted=accepted), np.zeros(rows.size)
    case.recal = np.ones((rows.size, 1))
    assert len(drifts) == 2
    assert empirical.has_a_name(case, law, sum(listed[c].values for c in columns)) == known  # type: ignore[arg-type]


def test_an_equation_that_is_the_named_effect_is_no_unknown_mechanism():
    """A lagged temperature beside a name that follows it late."""
    from errpipe.diagnosis import hypotheses

    made = spindle()
    rows = np.arange(len(made))
    effects = hypotheses.build(made, "E_Z", rows)
    lags = [c for name, c in library(made).items() if name.startswith("lag(T_bed") and ") " not in name]
    law = Empirical(terms=(term_of(lags[-1]),), constant=0.0, unit="um", share=0.9, p=0.01, scheme="", says="")
    case = SimpleNamespace(
        recording=made, library=effects, pair=SimpleNamespace(rows=rows), simulated=np.zeros(rows.size)
    )
    lag = next(h for h in effects.hypotheses if h.effect == "thermal_lag")
    case.recal, index = np.ones((rows.size, 1)), effects.hypotheses.index(lag)
    for accepted, known in (((), False), ((SimpleNamespace(hypothesis=lag, index=index),), True)):
        case.explanation = SimpleNamespace(accepted=accepted)
        assert empirical.has_a_name(case, law, np.zeros(rows.size)) == known  # type: ignore[arg-type]


@pytest.mark.parametrize(("low", "high", "implausible_size"), [(7.0, 9.0, True), (4.0, 9.0, False), (-9.0, -7.0, True)])
def test_air_refracts_by_a_constant_of_nature(low, high, implausible_size):
    """What grows by 8 um/m/K is a scale that expands; a scale's own coefficient has no such limit."""
    span = SimpleNamespace(name="per_kelvin", low=low, high=high)
    for term, expected in (
        (AirRefraction(axis="X", sensor="T_room"), implausible_size),
        (ScaleExpansion(axis="X", sensor="T_room"), False),
    ):
        spans = [span, SimpleNamespace(name="coefficient", low=1e3 * low, high=1e3 * high)]
        made = SimpleNamespace(hypothesis=SimpleNamespace(terms=[term]), estimates=spans)
        assert plausible.implausible_size(made) == expected  # type: ignore[arg-type]


def test_lost_motion_that_grows_with_a_temperature_is_a_shape():
    """A screw that has lost its pretension: no effect of the vocabulary is a step that a temperature sizes."""
    made = axis()
    rise = made.array("T_nut")
    form = made.array("dir") * np.cos(2 * np.pi * (rise - rise.min()) / np.ptp(rise))
    every = shapes(made, "EXX", np.arange(len(made)))
    own = next(s for s in every if s.kind == "direction and input" and s.drivers == ("x", "T_nut"))
    assert np.std(form - own.columns @ np.linalg.lstsq(own.columns, form, rcond=None)[0]) < 1e-6


def left_by(values: np.ndarray, sigma: float, shaped=1.0, bare=1.8, again=1.0, worth=40.0, named=4.6):
    """A case whose names leave these values: rms, on held-out rows beside shapes and without names; noise 1."""
    scene = SimpleNamespace(rms=lambda: 4.6, coefficients=lambda: np.array([0.0, named]))
    case = SimpleNamespace(residual=values, run=np.zeros(values.size, int), sigma=sigma, noise_estimate=1.0)
    case.explanation, case.chosen = SimpleNamespace(accepted=(SimpleNamespace(gain=99.0),)), lambda: [(0, 1.0)]
    case.library = SimpleNamespace(block=lambda i, recording, rows: np.tile([-1.0, 1.0], values.size // 2)[:, None])
    case.recal = np.ones((values.size, 1))
    case.search = SimpleNamespace(scene=lambda chosen: scene)
    case.remainder = SimpleNamespace(shapes=((SimpleNamespace(of_inputs=True), worth),))
    case.recording = SimpleNamespace(time=lambda: np.arange(values.size), array=lambda name: values)
    case.pair = SimpleNamespace(rows=slice(None), error="e")
    return case, HeldOut("40 blocks", bare, 1.0, (again,), 1.0, shaped, 1.0, bare, 1.0)


@pytest.mark.parametrize(
    ("kind", "sigma", "shaped", "unexplained"),
    [
        ("large", 3.0, 1.0, False),  # real noise may come in events: it is small beside what the name holds
        ("teeth", 3.0, 1.0, True),  # two fifths of what is no noise, in a rhythm
        ("teeth", 1.5, 1.0, False),  # a real part departs by a few per cent
        ("walk", 3.0, 1.0, False),  # noise that wanders beside an effect
        ("white", 1.0, 0.9, True),  # shapes over inputs predict a fifth of what names leave on held-out rows
        ("white", 1.0, 0.99, False),
    ],
)
def test_what_names_must_not_leave(monkeypatch, kind, sigma, shaped, unexplained):
    rng, rows = np.random.default_rng(2), np.arange(1000)
    walk = np.cumsum(rng.standard_normal(1000))
    left = {
        "teeth": 2.0 * (rows % 13) / 13 + 0.1 * rng.standard_normal(1000),
        "walk": walk,
        "large": 2.0 * (rows % 13) / 13 + 0.1 * rng.standard_normal(1000),
        "white": rng.normal(size=1000),
    }
    monkeypatch.setattr(unnamed, "residual", lambda case: case.residual)
    case, held = left_by(left[kind], sigma, shaped, named=6.0 if kind == "large" else 4.6)
    assert unnamed.unexplained(case, held) == unexplained  # type: ignore[arg-type]


def test_what_shapes_must_predict_to_take_a_name_away(monkeypatch):
    """Not where names explain 95 % of the held-out variance, nor where shapes are worth little on all rows.

    Shapes that stand beside the names on all rows are no stand-in for a name that a fold misses.
    """
    monkeypatch.setattr(unnamed, "residual", lambda case: case.residual)
    white = np.random.default_rng(2).standard_normal(1000)
    ways = ((1.8, 1.0, 40.0, True), (4.0, 1.0, 40.0, False), (1.8, 0.4, 40.0, True), (1.8, 1.0, 12.0, False))
    for bare, again, worth, expected in ways:
        assert unnamed.unexplained(*left_by(white, 1.0, 0.9, bare, again, worth)) == expected  # type: ignore[arg-type]
    assert unnamed.unexplained(*left_by(white, 3.0, 0.8, worth=12.0))  # type: ignore[arg-type]
    for again in (0.4, 1.0):  # on held-out rows alone they may stand in
        case, held = left_by(white, 3.0, 0.8, again=again)
        case.remainder = SimpleNamespace(shapes=())
        assert unnamed.unexplained(case, held) == (again == 1.0)  # type: ignore[arg-type]


def test_a_rhythm_a_little_above_the_noise_is_reported():
    """Saw teeth over the order of the parts, not twice as large as the noise: no column goes with them."""
    made = spindle(3, hidden=lambda c: 0.9 * ((np.arange(c["t"].size) % 13) / 6.0 - 1.0))
    (response,) = diagnose(made)[0].responses
    assert (response.verdict, response.findings[0].effect) == ("unexplained", "unknown")


@pytest.mark.parametrize(("share", "taken_back", "named", "far", "expected"), [
    (0.06, False, False, 1.0, True),  # saw teeth in noise of the usual colour
    (0.06, False, False, 3.0, False),  # within the noise between neighbours
    (0.06, False, True, 1.0, False),  # names are judged by the colour alone
    (0.9, False, True, 1.0, True),
    (0.06, True, False, 1.0, True),
])  # fmt: skip
def test_a_wandering_residual_is_predicted_or_coloured_noise(monkeypatch, share, taken_back, named, far, expected):
    teeth = 2.0 * ((np.arange(600) % 11) / 5.0 - 1.0) + 0.5 * np.random.default_rng(1).standard_normal(600)
    case, _ = left_by(teeth, 1.0)
    monkeypatch.setattr(unnamed, "residual", lambda case: case.residual)
    colour = coloured.USUAL if share == coloured.USUAL.share else coloured.Colour(8.0, share)
    case.library, case.taken_back, case.noise_estimate = (
        SimpleNamespace(table=SimpleNamespace(colour=colour)), taken_back, 0.5 * far)  # fmt: skip
    case.explanation = SimpleNamespace(accepted=(1,) if named else ())
    assert bool(unnamed.has_slow_drift(case)) is expected  # type: ignore[arg-type]
    case.residual = np.random.default_rng(1).standard_t(2, 600)  # heavy tails alone are foretold by nothing
    assert bool(unnamed.has_slow_drift(case)) is (expected and (share > 0.5 or taken_back))  # type: ignore[arg-type]


@pytest.mark.parametrize(("parts", "kinds", "named", "after", "most"), [
    ((), (), 0.8, 1.0, unnamed.NOISE),  # recorded twice: names predict a third of the held-out variance
    ((), (), 0.9, 1.0, unnamed.PROVISIONAL),  # a fifth
    ((), (), 0.8, 1.8, unnamed.PROVISIONAL),  # names that held-out rows do not confirm
    ((1,), ("gain",), 0.8, 1.0, unnamed.PROVISIONAL),  # a simulation without noise, a sum of effects
    ((1,), ("gain", "noise"), 0.8, 1.0, unnamed.NOISE),
])  # fmt: skip
def test_a_signal_that_was_itself_recorded_accounts_for_what_names_leave(monkeypatch, parts, kinds, named, after, most):
    tests = ("departures_predict_held_out", "shapes_predict_held_out")
    for asked in ("rounded", "unnamed_structure", "is_noise", *tests):
        monkeypatch.setattr(unnamed, asked, lambda *_: False)
    monkeypatch.setattr(unnamed, "unexplained", lambda *_: True)  # a rhythm remains
    monkeypatch.setattr(unnamed.confidence, "unknown", lambda s: 0.3)
    case, held = left_by(np.zeros(200), 1.0)
    case.decomposition = SimpleNamespace(parts=parts)
    case.of_a_twin = False
    case.nuisances = [SimpleNamespace(kind=kind) for kind in kinds]
    case.explanation, case.run = SimpleNamespace(accepted=[SimpleNamespace(gain=20.0)]), np.zeros(200)
    case.search.rows = None
    held = replace(held, before=2.0, after=after, named=named, bare=1.0)
    assert unnamed.unknown_probability(case, [1], held) == most  # type: ignore[arg-type, list-item]


@pytest.mark.parametrize(("wandering", "reset", "jump"), [(0.0, 3.0, True), (0.4, 0.0, False), (0.0, 0.0, False)])
def test_a_datum_that_is_lost_between_runs_is_no_wandering(wandering, reset, jump):
    """Runs of 500 s with pauses of 2000 s; noise 1; a random walk goes on in the pauses."""
    rng, run = np.random.default_rng(4), np.repeat(np.arange(10), 100)
    t = 5.0 * np.arange(1000) + 2000.0 * run
    walk = wandering * np.cumsum(rng.standard_normal(1000) * np.sqrt(np.diff(t, prepend=t[0]) / 5.0))
    left = walk + reset * rng.standard_normal(10)[run] + rng.standard_normal(1000)
    assert coloured.levels_jump(left, run, t) == jump


def test_a_clock_that_starts_anew_with_each_run_tells_nothing_of_the_time_between() -> None:
    rng, run = np.random.default_rng(4), np.repeat(np.arange(10), 100)
    left = 3.0 * rng.standard_normal(10)[run] + rng.standard_normal(1000)
    assert coloured.levels_jump(left, run, 5.0 * np.arange(1000.0))
    assert not coloured.levels_jump(left, run, 5.0 * np.tile(np.arange(100.0), 10))


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_noise_of_few_rows_has_a_rhythm_by_chance_only(memory: float) -> None:
    """Of 200 draws of 248 rows: 18 of white noise had one where single slow frequencies were judged."""
    rng, run = np.random.default_rng(11), np.zeros(248, dtype=int)
    rhythms = 0
    for _ in range(200):
        noise = rng.standard_normal(248)
        for k in range(1, noise.size):
            noise[k] += memory * noise[k - 1]
        rhythms += not coloured.is_linear_noise(noise, run)
    assert rhythms <= 4


@pytest.mark.parametrize(
    ("masks", "sure", "shapes", "unlikely"),
    [
        ([("range", "t", 3.0, 9.0)], 0.4, [], True),
        ([("range", "t", 3.0, 9.0)], 0.6, [], False),
        ([("runs", ("1", "2", "4"))], 0.4, [], True),
        ([("runs", ("5", "6"))], 0.4, [], False),
        ([("runs", ("5", "6"))], 0.4, [True], True),
        ([("runs", ("5", "6"))], 0.4, [False], False),
        ([()], 0.4, [True], False),
        ([("range", "t", 3.0, 9.0), ()], 0.4, [], False),
        ([()], 0.05, [], True),
    ],
)
def test_a_name_in_a_part_that_is_one_of_many_must_be_likelier_than_not(monkeypatch, masks, sure, shapes, unlikely):
    """Else `unknown` comes first; one or two runs are few, unless a shape over inputs remains (not one over time)."""
    monkeypatch.setattr(unnamed, "is_a_level", lambda case: False)
    accepted = [SimpleNamespace(hypothesis=SimpleNamespace(mask=mask)) for mask in masks]
    left = SimpleNamespace(shapes=[(SimpleNamespace(of_inputs=of_inputs), 40.0) for of_inputs in shapes])
    case = SimpleNamespace(explanation=SimpleNamespace(accepted=accepted), remainder=left)
    found = [SimpleNamespace(group_confidence=lambda: sure)] * len(masks)
    assert unnamed.unlikely(case, found) is unlikely  # type: ignore[arg-type]


@pytest.mark.parametrize(("unknown", "limit"), [(0.4, 0.4), (0.7, 0.3)])
def test_a_name_behind_unknown_is_no_likelier_than_it(monkeypatch, unknown, limit):
    monkeypatch.setattr(report, "needs_recalibration", lambda case: False)
    monkeypatch.setattr(unnamed, "finding", lambda case, p: Finding(effect="unknown", confidence=p))
    names = [Finding(effect="stribeck_friction", confidence=0.8)]
    found, verdict = report._verdict(None, names, unknown, nameless=True)  # type: ignore[arg-type]
    assert verdict == "unexplained"
    assert [(f.effect, f.confidence) for f in found] == [("unknown", unknown), ("stribeck_friction", limit)]
    for sure, first in ((0.35, "unknown"), (0.45, "stribeck_friction")):  # the likelier one comes first
        names = [Finding(effect="stribeck_friction", confidence=sure)]
        assert report._verdict(None, names, unnamed.PROVISIONAL, nameless=False)[0][0].effect == first  # type: ignore[arg-type]
    # noise that is a linear process is left: no reason to put it before a name
    assert report._verdict(None, names, unnamed.NOISE, nameless=True) == (names, "missing_physics")  # type: ignore[arg-type]
