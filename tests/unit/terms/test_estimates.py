"""Terms whose values are estimated from the signals: orders of a wave, a resonance, a dead time, two time constants.

Second opinions: scipy's integrators and linear systems, closed forms; none of the terms' own code makes the data.
"""

import itertools

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.signal import TransferFunction, lsim

from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.kernels import responses
from errpipe.terms import Signals
from errpipe.terms._lines import harmonic_series, lines, periods
from errpipe.terms._place import drive_periods, pole_periods
from errpipe.terms._search import Waves, search_of
from errpipe.terms.clock_offset import ClockOffset
from errpipe.terms.dead_time import DeadTime
from errpipe.terms.flexible_mode import FlexibleMode
from errpipe.terms.following_error import FollowingError
from errpipe.terms.pitch_cyclic import PitchCyclic
from errpipe.terms.thermal_lag import ThermalLag
from errpipe.terms.tool_wear import ToolWear
from errpipe.terms.torque_ripple import TorqueRipple
from errpipe.terms.workpiece_load import WorkpieceLoad


def recording(data: dict, kinds: dict, **constants) -> Recording:
    columns = {name: Column(**kinds[name]) for name in data}
    manifest = Manifest(recording=1, tables=("r.csv",), columns=columns, constants=constants)
    return Recording(manifest, pd.DataFrame(data))


def signals(*values: np.ndarray) -> Signals:
    return Signals(np.arange(values[0].size), values)


# ---------------------------------------------------------------- a limit, and what the loop makes up for
def test_a_limited_drive_catches_up_as_a_mass_in_a_critically_damped_loop_does():
    t, mass, catch_up, limit = np.linspace(0.0, 3.0, 30001), 7.0, 0.05, 6.0
    asked = lambda at: 10.0 * np.sin(3.0 * at) * np.exp(-((at - 1.0) ** 2))  # noqa: E731

    def pushed(at, speed, place):
        want = asked(at) + mass * (speed / catch_up + place / (2 * catch_up) ** 2)
        return np.clip(want, -limit, limit)

    def moves(at, state):  # how far the limited mass lags behind the one that is not
        return [(asked(at) - pushed(at, *state)) / mass, state[0]]

    lag = solve_ivp(moves, (0.0, 3.0), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=1e-3).y
    made = responses.limited(np.zeros(t.size, dtype=np.int64), t, asked(t), limit, catch_up)
    assert_allclose(made, pushed(t, *lag), atol=0.02)
    assert np.abs(made - np.clip(asked(t), -limit, limit)).max() > 1.0  # it does make up for it
    plain = responses.limited(np.zeros(t.size, dtype=np.int64), t, asked(t), limit, 0.0)
    assert_allclose(plain, np.clip(asked(t), -limit, limit))


# ---------------------------------------------------------------- a resonance
@pytest.mark.parametrize("damping", [0.003, 0.05, 0.6])
def test_vibration_against_a_linear_system(damping):
    rng = np.random.default_rng(1)
    t = 1e-3 * np.arange(1500)
    u = np.cumsum(rng.normal(size=t.size))
    u -= u[0]
    w = 2 * np.pi * 40.0
    made = responses.vibration(np.zeros(t.size, dtype=np.int64), t, u, 40.0, damping, 1.0)
    plant = [1, 2 * damping * w, w**2]
    for k, numerator in enumerate(([w**2], [w, 0])):
        assert_allclose(made[:, k], lsim(TransferFunction(numerator, plant), u, t)[1], atol=1e-9 * np.abs(u).max())


def test_vibration_between_uneven_rows_against_an_integrator():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.5e-3, 4e-3, 200))
    u = np.sin(30 * t) + rng.normal(size=t.size)
    w, damping = 2 * np.pi * 25.0, 0.08

    def rate(at, state):
        return [state[1], w**2 * (np.interp(at, t, u) - state[0]) - 2 * damping * w * state[1]]

    out, state = [u[0]], [u[0], 0.0]
    for a, b in itertools.pairwise(t):
        state = solve_ivp(rate, (a, b), state, rtol=1e-10, atol=1e-12).y[:, -1]
        out.append(state[0])
    made = responses.vibration(np.zeros(t.size, dtype=np.int64), t, u, 25.0, damping, 1.0)
    assert_allclose(made[:, 0], out, atol=1e-6)


def under_way(hertz: float = 500.0, seconds: float = 8.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and acceleration of strokes with bounded acceleration."""
    t = np.arange(int(hertz * seconds)) / hertz
    a = 2000.0 * np.sign(np.sin(2 * np.pi * t / 1.6)) * (np.abs(np.sin(2 * np.pi * t / 1.6)) > 0.7)
    return t, np.cumsum(np.cumsum(a)) / hertz**2, a


def log(**more) -> Recording:
    t, x, a = under_way()
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
        "EXX": {"role": "error", "component": "EXX", "unit": "um"},
        "EXX_sim": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    return recording({"t": t, "x": x, "a": a, "EXX": 0 * t, "EXX_sim": 0 * t} | more, kinds)


@pytest.mark.parametrize(("frequency", "damping"), [(12.0, 0.1), (37.0, 0.01), (61.0, 0.03)])
def test_a_resonance_is_located(frequency, damping):
    t, _, a = under_way()
    w = 2 * np.pi * frequency
    ringing = lsim(TransferFunction([w**2], [1, 2 * damping * w, w**2]), a, t)[1]
    seen = -2e-3 * ringing + 0.5 * np.random.default_rng(3).normal(size=t.size)
    names = {values[0] for _, values in FlexibleMode.estimates(log(), "EXX", signals(seen))}
    assert min(abs(f / frequency - 1) for f in names) < 0.02
    basis = FlexibleMode(axis="X", column="a").basis(log(), frequency, damping)[:, 0]
    assert_allclose(2 * basis, -2e-3 * ringing, atol=1e-9)


def test_noise_that_rings_is_no_mode():
    """Its resonance has nothing to do with the acceleration; without the test of phases 8 of 8 are offered."""
    t, offered = under_way()[0], 0
    for seed in range(8):
        force = np.random.default_rng(seed).normal(size=t.size)
        w = 2 * np.pi * 30.0
        noise = lsim(TransferFunction([w**2], [1, 0.06 * w, w**2]), force, t)[1]
        offered += bool(list(FlexibleMode.estimates(log(), "EXX", signals(noise))))
    assert offered == 0


def test_a_mode_is_offered_for_fast_logs_only():
    slow = log(t=np.arange(4000) * 0.5)
    assert not list(FlexibleMode.bind(slow, "EXX")) and list(FlexibleMode.bind(log(), "EXX"))


# ---------------------------------------------------------------- a dead time
@pytest.mark.parametrize("delay", [0.4e-3, 3.3e-3, 21e-3])
def test_a_dead_time_is_located(delay):
    rng = np.random.default_rng(4)
    t = under_way()[0]
    f = 40 * np.sin(9 * t) + 25 * np.sin(23 * t + 1)
    late = 40 * np.sin(9 * (t - delay)) + 25 * np.sin(23 * (t - delay) + 1)
    case = log(EXX_sim=f)
    mismatch = signals(late - f + 0.05 * rng.normal(size=t.size))
    (matches,) = [v[0] for term, v in DeadTime.estimates(case, "EXX", mismatch) if term.column]
    assert matches == pytest.approx(delay, abs=1e-4)
    basis = DeadTime(column="EXX_sim").basis(case, delay)[:, 0]
    assert_allclose(basis[50:], (late - f)[50:], atol=1e-3)


def test_an_axis_comes_late_behind_its_command_not_behind_its_own_late_position():
    """3 ms late at accelerations that 3 ms matter to: the recorded position is late already."""
    t = 1e-3 * np.arange(1500)

    def path(when):
        return 50 * np.sin(5 * when) + 20 * np.sin(17 * when)

    kinds = {name: {"role": name, "axis": "X", "unit": "mm"} for name in ("command", "position")}
    kinds["t"] = {"role": "time", "unit": "s"}
    case = recording({"t": t, "command": path(t), "position": path(t - 0.003)}, kinds)
    late = 1e3 * (path(t - 0.003) - path(t))
    ((_, (delay,)),) = DeadTime.estimates(case, "EXX", signals(late))
    assert delay == pytest.approx(0.003, abs=1e-6)
    assert_allclose(DeadTime(axis="X").basis(case, 0.003)[5:, 0], late[5:], atol=0.02)


# ---------------------------------------------------------------- a clock that differs
@pytest.mark.parametrize(("step", "offset"), [(0.0025, 0.059), (0.0025, -0.021), (90.0, 410.0), (1.0, -333.0)])
def test_a_clock_offset_is_located_at_any_sampling_rate(step, offset):
    rng = np.random.default_rng(11)
    t = step * np.arange(4000)
    corners = np.cumsum(rng.normal(size=200))

    def curve(when):
        return 20 * np.interp(when / step, np.linspace(-1000, 5000, 200), corners)

    seen = curve(t - offset) - curve(t) + rng.normal(size=t.size)
    (_, (found,)), *_ = ClockOffset.estimates(log(t=t, EXX_sim=curve(t)), "EXX", signals(seen))
    assert found == pytest.approx(offset, abs=0.2 * step)


@pytest.mark.parametrize("gain", [0.75, 1.3])
def test_a_wrong_gain_of_the_simulation_does_not_change_the_shift(gain):
    """Beside a gain of the undelayed signal the delay times the gain was found, here 0.0338 s for 0.026 s."""
    t = 0.005 * np.arange(4000)

    def curve(when):
        return 20 * np.sin(1.3 * when) + 8 * np.sin(5.1 * when + 1)

    case, seen = log(t=t, EXX_sim=curve(t)), signals(gain * curve(t - 0.026) - curve(t))
    (_, (offset,)), *_ = ClockOffset.estimates(case, "EXX", seen)
    (delay,) = [v[0] for term, v in DeadTime.estimates(case, "EXX", seen) if term.column]
    assert offset == pytest.approx(0.026, abs=1e-4) and delay == pytest.approx(0.026, abs=1e-4)


# ---------------------------------------------------------------- a loop that settles
def test_a_loop_that_settles_against_a_linear_system():
    t, _, a = under_way()
    v = np.cumsum(a) / 500.0
    late = lsim(TransferFunction([1.0], [0.012, 1.0]), v, t)[1]
    case = with_speed(v)
    basis = FollowingError(axis="X", column="v", settles=True).basis(case, 0.012)[:, 0]
    assert_allclose(basis, -late, atol=1e-9 * np.abs(v).max())
    seen = -15.0 * late + 0.5 * np.random.default_rng(8).normal(size=t.size)
    ((_, (tau,)),) = FollowingError.estimates(case, "EXX", signals(seen))
    assert tau == pytest.approx(0.012, rel=0.02)


def with_speed(v: np.ndarray) -> Recording:
    return log().with_columns({"v": v}, {"v": Column(role="velocity", axis="X", unit="mm/s")})


# ---------------------------------------------------------------- orders of a wave
def test_lines_and_what_they_are_orders_of():
    rng = np.random.default_rng(5)
    x = np.sort(rng.uniform(0, 700, 3000))
    y = 6 * np.cos(2 * np.pi * x / 24 + 1) + 3 * np.cos(2 * np.pi * 6 * x / 24 - 2) + 4 * np.cos(2 * np.pi * x / 55.5)
    spectral_lines = lines(x, y + 1.5 * rng.normal(size=x.size) + 1e-4 * x**2)
    assert_allclose(sorted(1 / f for f, _ in spectral_lines), [4.0, 24.0, 55.5], rtol=1e-3)
    assert_allclose([a for _, a in spectral_lines], [6, 4, 3], rtol=0.1)
    (base, orders, known), (_, every, _) = harmonic_series(spectral_lines, 700.0)
    assert orders == (1, 6) and not known and 1 / base == pytest.approx(24.0, rel=1e-4)
    assert every == (1, pytest.approx(24 / 55.5, rel=1e-3), 6)


def test_a_screw_and_a_coupling():
    """Two waves that are no multiples of each other are still one finding, as multiples of the stronger one."""
    ((base, orders, _),) = harmonic_series([(1 / 10, 4.0), (1 / 3.7, 3.0)], 400.0)
    assert 1 / base == pytest.approx(10.0) and orders == (1.0, 2.7027)


def test_noise_has_no_lines():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        assert not lines(np.sort(rng.uniform(0, 500, 1500)), rng.normal(size=1500))


def test_the_base_may_be_absent():
    """Orders 2 and 3 of a pole pair without the first."""
    ((base, orders, _),) = harmonic_series([(2 / 30, 5.0), (3 / 30, 4.0)], 600.0)
    assert 1 / base == pytest.approx(30.0) and orders == (2, 3)


def test_orders_of_one_turn_of_a_motor():
    """7 pole pairs and 12 slots over a single turn: all are orders of the turn."""
    out = [(7.01 / 360, 2.5), (27.98 / 360, 1.3), (12.02 / 360, 0.6), (36.0 / 360, 0.7)]
    *_, (base, orders, known) = harmonic_series(out, 360.0, [1 / 360])
    assert 1 / base == 360.0 and orders == (7, 28, 36, 12) and known


@pytest.mark.parametrize("kind", [PitchCyclic, TorqueRipple])
def test_several_orders_against_a_sum_of_cosines(kind):
    x = np.linspace(0, 100, 400)
    kinds = {"x": {"role": "position", "axis": "X", "unit": "mm"}}
    turn = 2 * np.pi * x / 20
    parameters = {"sine": 3.0, "cosine": -4.0, "sine_4": 0.6, "cosine_4": 0.8, "period": 20.0}
    made = kind(axis="X", orders=(1, 4)).value(recording({"x": x}, kinds), parameters)
    expected = 5 * np.cos(turn - np.arctan2(3, -4)) + np.cos(4 * turn - np.arctan2(0.6, 0.8))
    assert_allclose(made, expected, atol=1e-12)
    swapped = {"sine": 0.6, "cosine": 0.8, "sine_1": 3.0, "cosine_1": -4.0, "period": 5.0}
    assert_allclose(kind(axis="X", orders=(4, 1)).value(recording({"x": x}, kinds), swapped), expected, atol=1e-12)


def test_periods_that_a_manifest_states():
    belt = Constant(role="axis", kind="linear", tooth_pitch=5.0, teeth=30, gear_ratio=3.0, pole_pairs=4, unit="mm")
    assert drive_periods(belt) == (150.0, 50.0, 5.0) and pole_periods(belt) == (12.5,)
    worm = Constant(role="axis", kind="rotary", teeth=90, gear_ratio=90.0, pole_pairs=2, unit="deg")
    assert drive_periods(worm) == (4.0,) and pole_periods(worm) == (2.0,)
    assert pole_periods(Constant(role="axis", kind="linear", magnet_period=24.0, unit="mm")) == (24.0,)
    assert drive_periods(None) == pole_periods(None) == ()


# ---------------------------------------------------------------- two time constants, wear of several tools
def test_two_time_constants_against_the_step_response():
    t = 30.0 * np.arange(900)
    step = np.where(t >= 300, 10.0, 0.0)
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "T": {"role": "temperature", "unit": "degC"},
        "E_Z": {"role": "error", "component": "E_Z", "unit": "um"},
    }
    case = recording({"t": t, "T": 20 + step, "E_Z": 0 * t}, kinds)
    since = np.maximum(t - 300, 0)
    parts = [10 * (1 - np.exp(-since / tau)) for tau in (400.0, 6000.0)]
    term = ThermalLag(sensor="T", reference=20.0, two_stages=True)
    assert_allclose(term.basis(case, 400.0, 6000.0), np.column_stack(parts), atol=1e-9)
    seen = 2 * parts[0] + 3 * parts[1] + 0.2 * np.random.default_rng(6).normal(size=t.size)
    _, (match, taus) = ThermalLag.estimates(case, "E_Z", signals(seen))
    assert match.two_stages and is_close(taus, (400.0, 6000.0))
    ((single, tau),) = ThermalLag.estimates(case, "E_Z", signals(parts[1] + 0.01 * seen))
    assert not single.two_stages and tau[0] == pytest.approx(6000.0, rel=0.05)


@pytest.mark.parametrize(("place", "price"), [("room", 6.0), ("front bearing", 0.0)])
def test_only_a_lag_of_the_room_by_hours_has_another_name(place, price):
    t = 60.0 * np.arange(2000)
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "T": {"role": "temperature", "unit": "degC", "location": place},
        "E_Z": {"role": "error", "component": "E_Z", "unit": "um"},
    }
    case = recording({"t": t, "T": 20 + np.sin(t / 9000), "E_Z": 0 * t}, kinds)
    hypotheses, estimates = ThermalLag.hypotheses(case, case, "E_Z"), ThermalLag.estimates(case, "E_Z", signals(t))
    for term in (*hypotheses, *(made for made, _ in estimates)):
        (tau, *_), odds = term.nonlinear(), search_of(term.nonlinear()[0]).log_prior
        assert odds(3500.0, tau) == pytest.approx(-price, abs=0.01) and odds(1000.0, tau) == 0.0


def is_close(values, expected) -> bool:
    """Within half a step of the trial values."""
    return all(abs(np.log(v / e)) < np.log(1.5) for v, e in zip(values, expected, strict=True))


def test_wear_restarts_where_the_tool_changes():
    cut = np.cumsum(np.full(60, 2.0))
    tool = np.repeat(["a", "b", "a"], 20)
    kinds = {
        "tool": {"role": "group", "of": "tool"},
        "L": {"role": "cut_length", "unit": "m"},
        "E_D": {"role": "error", "component": "E_D", "unit": "um"},
    }
    case = recording({"tool": tool, "L": cut, "E_D": 0 * cut}, kinds)
    own = [t for t in ToolWear.hypotheses(case, case, "E_D") if t.tool == "tool"]
    assert len(own) == 1 and own[0].reference == 40.0
    assert_allclose(own[0].basis(case, 1.0)[:, 0], np.tile(np.arange(2, 42, 2) / 40, 3))
    restarted = case.with_columns({"L": np.tile(cut[:20], 3)}, {})
    assert not [t for t in ToolWear.hypotheses(restarted, restarted, "E_D") if t.tool]


def test_a_load_is_stated_at_the_largest_mass():
    mass = np.tile([0.0, 4.0, 9.0], 10)
    kinds = {"m": {"role": "load", "unit": "kg"}, "E_Z": {"role": "error", "component": "E_Z", "unit": "um"}}
    case = recording({"m": mass, "E_Z": 0 * mass}, kinds)
    (term,) = WorkpieceLoad.hypotheses(case, case, "E_Z")
    assert_allclose(term.value(case, {"settle": 18.0}), 2 * mass)


# ---------------------------------------------------------------- waves of few places
PLACES = np.array([0.0, 13, 31, 48, 58, 79, 92, 108, 127, 143, 157, 177, 190, 209, 226, 241, 257, 272, 291, 308, 320])


def visited(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Five runs there and back over places with an error each: positions and readings."""
    both = np.r_[profile, profile[::-1]]
    noise = np.random.default_rng(7).normal(size=5 * both.size)
    return np.tile(np.r_[PLACES, PLACES[::-1]], 5), np.tile(both, 5) + 0.3 * noise


@pytest.mark.parametrize("period", [97.0, 41.0, 19.0, 10.3])  # the last ones fall between the targets
def test_a_wave_of_few_places_is_found(period):
    x, y = visited(np.sin(2 * np.pi * PLACES / period + 1))
    estimates = periods(x, (y,))
    assert min(abs(320 / p - 320 / period) for p in estimates) < 0.15  # turns over the travel


def test_a_profile_of_chance_is_no_wave():
    """Its strongest wave is far beyond the noise, since every place is visited ten times."""
    rng = np.random.default_rng(11)
    assert sum(bool(periods(*visited_signal(rng))) for _ in range(100)) <= 4  # 1 % meant


def visited_signal(rng: np.random.Generator) -> tuple[np.ndarray, tuple[np.ndarray]]:
    x, y = visited(rng.normal(size=PLACES.size))
    return x, (y,)


# ---------------------------------------------------------------- whose wave it is
@pytest.mark.parametrize(("stated", "offered"), [(None, True), (0.04, False), (0.02, True)])
def test_a_wave_as_long_as_the_encoders_signal_is_the_encoders(stated, offered):
    """Its harmonics may be those of any wave: a free one has columns for more of them, and would be likelier."""
    x = np.linspace(0, 20, 8001) + 5e-4 * np.sin(np.arange(8001.0))
    wave = sum(np.sin(2 * np.pi * k * x / 0.04 + k) / k for k in (1, 2, 3))
    known = Constant(role="axis", kind="linear", unit="mm", encoder_period=stated)
    log = recording({"x": x}, {"x": {"role": "position", "axis": "X", "unit": "mm"}}, X=known)
    near = lambda periods: any(abs(p - 0.04) < 5e-5 for p in periods)  # noqa: E731
    free = next(t for t in PitchCyclic.bind(log, "EXX") if not t.fixed)
    assert near(Waves().values(free, "period", log, signals(wave))) == offered
    assert near(p for _, (p,) in PitchCyclic.estimates(log, "EXX", signals(wave))) == offered


def test_a_wave_is_refined_within_the_turns_that_are_searched():
    """With fewer than 1.25 it is any smooth curve, such as a decay."""
    x = PLACES
    log = recording({"x": x}, {"x": {"role": "position", "axis": "X", "unit": "mm"}})
    free = next(t for t in PitchCyclic.bind(log, "EXX") if not t.fixed)
    assert max(Waves().neighbours(250.0, free, log)) <= 320 / 1.25 * (1 + 1e-9)
    assert min(Waves().neighbours(250.0, free, log)) < 240.0


def test_harmonics_of_a_wave_of_few_places_are_its_orders():
    a = 2 * np.pi * PLACES / 110
    x, y = visited(2 * np.sin(a + 1) + np.sin(2 * a))
    log = recording({"x": x}, {"x": {"role": "position", "axis": "X", "unit": "mm"}})
    found = [(t.orders, p) for t, (p,) in PitchCyclic.estimates(log, "EXX", signals(y))]
    assert [orders for orders, _ in found] == [(1.0, 2.0)] and found[0][1] == pytest.approx(110, rel=0.03)
