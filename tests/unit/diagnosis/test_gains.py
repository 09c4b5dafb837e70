"""Gains beyond what simulations are off by cost evidence, and give way to another explanation."""

import numpy as np
import pandas as pd
import pytest

from errpipe.diagnosis import diagnose, gains, recalibration
from errpipe.diagnosis.evidence import ActiveSet, Data, Scene, Table
from errpipe.diagnosis.gains import DATUM, WHOLE, Nuisance

from .machines import axis, recording

PARTS = [Nuisance("part", name, name, name) for name in "ab"]


def scene(off: float, sd: float = 0.1, seed: int = 0) -> tuple[Scene, np.ndarray]:
    """A signal of two parts, the second `off` by so much; the nuisances' rows."""
    rng = np.random.default_rng(seed)
    parts = rng.standard_normal((500, 2)) * 8.0
    whole = parts.sum(axis=1)
    y = off * parts[:, 1] + rng.standard_normal(500)
    columns = np.column_stack([np.ones(500), whole, parts])
    made = Table(np.zeros(500, dtype=int), [columns], np.arange(500) * 5 // 500)
    sizes = np.ones(4)
    active = ActiveSet(np.arange(4), np.r_[np.inf, sd, sd, sd])
    return Scene(Data(made, y), active, 1.0), gains.totals([DATUM, WHOLE, *PARTS], sizes)[1]


@pytest.mark.parametrize("off", [0.0, 0.1, -0.15])
def test_gains_within_the_limits_cost_nothing(off):
    cost, beyond = gains.penalty(*scene(off))
    assert cost == 0.0
    assert not beyond.any()


@pytest.mark.parametrize(("off", "count"), [(0.3, 0), (0.8, 1), (-0.9, 1)])
def test_gains_that_no_simulation_has_are_counted(off, count):
    """Each costs as much as a finding where an explanation with narrower gains competes."""
    made, _ = scene(off, sd=1.0)
    assert gains.count_distant_gains(made, [DATUM, WHOLE, *PARTS], np.ones(4)) == count
    assert gains.count_distant_gains(made, [DATUM, WHOLE], np.ones(2)) == 0


@pytest.mark.parametrize("off", [0.5, -0.5])
def test_a_gain_far_off_costs_what_the_limit_would_leave_unexplained(off):
    cost, beyond = gains.penalty(*scene(off))
    assert beyond.tolist() == [False, True]
    made, _ = scene(off)
    left = made.Q + (0.3 * 8.0) ** 2 * 500  # a third of the part stays in the rows
    assert cost == pytest.approx(250 * np.log(left / made.Q), rel=0.15)


def test_slack_and_doubt_are_no_parts_of_their_own():
    beside = [Nuisance("departure", f"a, {what}", "a", "a") for what in ("not textbook", "in doubt")]
    parts, rows = gains.totals([DATUM, WHOLE, PARTS[0], *beside, PARTS[1]], np.ones(6))
    assert parts == PARTS
    assert rows.tolist() == [[0, 1, 1, 0, 0, 0], [0, 1, 0, 0, 0, 1]]


def test_a_step_is_missing_and_no_gain_of_minus_one():
    """The simulation's step between directions has the other sign: not its gain, a second step is what is missing."""
    made = axis(7, hidden=lambda c: -3.0 * c["dir"], gains=(1.0, 1.0))
    small = made.with_columns({"EXX_sim": made.array("EXX_sim") - 0.4 * made.array("dir")}, {})
    response = diagnose(small)[0].responses[0]
    assert response.verdict == "missing_physics"
    assert {"backlash", "friction_hysteresis"} & {response.findings[0].effect}


def test_what_the_gain_of_a_small_part_would_play_is_missing():
    """A slow drift of the spindle that goes with the room as a part of the simulation does, only faster."""
    rng = np.random.default_rng(1)
    t = np.arange(900) * 60.0
    lagged = lambda v, tau: pd.Series(v).ewm(alpha=1 - np.exp(-60.0 / tau), adjust=False).mean().to_numpy()  # noqa: E731
    speed = np.repeat(rng.choice([0.0, 4000.0, 8000.0, 12000.0], 30), 30)
    room = 2 * np.sin(t / 9000 + 1) + 0.8 * np.sin(t / 3100)
    housing = lagged(room, 2000.0) + lagged(6 * speed / 12000, 1500.0)
    simulated = 2.0 * housing + 0.3 * lagged(room, 14000.0)
    error = 1.06 * simulated - 0.2 * lagged(room, 10000.0) + 0.3 * rng.standard_normal(t.size)
    kinds = {"t": {"role": "time", "unit": "s"}, "rpm": {"role": "spindle_speed", "unit": "rpm"}}
    for name, where in (("T_housing", "spindle housing"), ("T_room", "room")):
        kinds[name] = {"role": "temperature", "unit": "degC", "location": where}
    kinds["E_Z"] = {"role": "error", "component": "E_Z", "unit": "um"}
    kinds["E_Z_sim"] = {"role": "simulated", "component": "E_Z", "unit": "um"}
    columns = {"t": t, "rpm": speed, "T_housing": 20 + housing, "T_room": 20 + room}
    made = recording(columns | {"E_Z": error, "E_Z_sim": simulated}, kinds)
    found = diagnose(made)[0].responses[0].findings[0]
    assert found.effect in ("ambient_drift", "thermal_lag")
    assert found.drivers == ("T_room",)


def test_a_gain_far_off_is_a_gain_where_nothing_else_plays_it():
    assert diagnose(axis(7, gains=(1.0, 0.6)))[0].responses[0].verdict == "recalibrate"


def warm_up_and_its_twin(seed, missing, noise=1.2, gains=(1.0, 1.0, 1.0), scatter=1.2):
    """A recording of E_Z and its repetition, which lacks `missing`, um, of the rises of bed and room.

    noise: of the repetition; gains: of its parts; scatter: of the recording.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(300) * 60.0
    bed = 80 * (1 - np.exp(-t / 900.0))
    frame = 15 * (1 - np.exp(-t / 6000.0)) + 0.02 * rng.standard_normal(t.size)
    room = 8 * (1 - np.exp(-t / 4500.0)) + np.sin(t / 2500)
    drawn, parts = rng.standard_normal((2, t.size)), np.array([bed, -4.0 * frame, 3.0 * room])
    recorded, twin = parts.sum(axis=0) + scatter * drawn[0], np.array(gains) @ parts + noise * drawn[1]
    kinds = {"t": {"role": "time", "unit": "s"}}
    for name, where in (("T_frame", "frame"), ("T_bed", "bed"), ("T_room", "room")):
        kinds[name] = {"role": "temperature", "unit": "degC", "location": where}
    kinds["E_Z"] = {"role": "error", "component": "E_Z", "unit": "um"}
    kinds["E_Z_sim"] = {"role": "simulated", "component": "E_Z", "unit": "um"}
    columns = {"t": t, "T_frame": 22 + frame, "T_bed": 24 + bed, "T_room": 23 + room}
    return recording(columns | {"E_Z": recorded + missing(bed, room), "E_Z_sim": twin}, kinds)


def test_a_twin_that_was_measured_itself_lacks_a_drift_of_what_it_holds():
    """Its gains are 1: what goes with the bed and is more than it holds is missing, though a gain would play it."""
    made = warm_up_and_its_twin(3, lambda bed, room: 0.15 * bed)
    found = diagnose(made)[0].responses[0].findings[0]
    assert (found.effect, found.drivers) == ("thermal_drift", ("T_bed",))
    assert found.confidence <= 0.45  # it may be a gain after all


def test_a_twin_lacks_a_lagged_drift_that_departures_of_its_parts_would_play():
    late = lambda v: pd.Series(v).ewm(alpha=1 - np.exp(-60.0 / 1500.0), adjust=False).mean().to_numpy()  # noqa: E731
    response = diagnose(warm_up_and_its_twin(4, lambda bed, room: -1.5 * late(room)))[0].responses[0]
    assert response.verdict == "missing_physics"
    assert response.findings[0].drivers == ("T_room",)
    assert response.findings[0].confidence <= 0.45


@pytest.mark.parametrize("seed", [3, 4])
def test_gains_off_as_usual_are_likelier_than_an_effect_that_imitates_them(seed):
    made = warm_up_and_its_twin(seed, lambda bed, room: 0.0 * room, noise=0.0, gains=(0.9, 1.1, 0.88))
    assert diagnose(made)[0].responses[0].verdict == "recalibrate"


@pytest.mark.parametrize(("odds", "verdict"), [(6.0, "recalibrate"), (3.0, "missing_physics")])
def test_one_effect_replaces_gains_that_imitate_it_if_likelier_than_the_odds_against_it(monkeypatch, odds, verdict):
    """Half of a drift is likelier than the gains of two collinear parts by 4.5."""
    monkeypatch.setattr(recalibration, "ALL_ONE", odds)
    response = diagnose(warm_up_and_its_twin(3, lambda bed, room: 0.5 * room, noise=0.0))[0].responses[0]
    assert response.verdict == verdict
    assert all(f.confidence <= 0.45 for f in response.findings if f.effect != "recalibration")


@pytest.mark.parametrize(("relative", "verdict"), [(recalibration.EXACT_SD, "missing_physics"), (0.03, "recalibrate")])
def test_gains_of_a_large_signal_play_no_small_effect_if_they_are_exactly_one(monkeypatch, relative, verdict):
    """0.3 % of parts of 80 um reproduce a drift of 1 um."""
    monkeypatch.setattr(recalibration, "EXACT_SD", relative)
    made = warm_up_and_its_twin(3, lambda bed, room: np.linspace(0.0, 1.0, room.size), noise=0.0, scatter=0.4)
    response = diagnose(made)[0].responses[0]
    assert response.verdict == verdict
