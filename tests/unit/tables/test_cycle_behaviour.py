"""What a controller does with a table when things go wrong or change: sensors, validity, limits, direction."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.tables import ComponentSource, Limits, compile_table, with_limits
from errpipe.tables.reference import Evaluator
from tests.unit.tables.made import position, sensor


def thermal(channel, more=(), limits=None, **options):
    """E_Z = 2 um/K above 20 degC, every cycle a thermal one of 0.1 s."""
    source = ComponentSource("E_Z", "um", (Lowered(d.Affine(weights=(2.0,), of=(d.above("T", 20.0),))),))
    spare = ComponentSource("E_X", "um", tuple(Lowered(d.Input(name=i.name)) for i in more))
    sources = [source, spare] if more else [source]
    options = {"position_cycle_s": 0.1, "thermal_cycle_s": 0.1, "ramp_s": 0.0, "fade_s": 0.0} | options
    return Evaluator(with_limits(compile_table(sources, inputs=[channel, *more], **options), limits or {}))


def z(evaluator, **inputs):
    return evaluator.cycle(inputs).deviation["E_Z"]


def test_reading_out_of_range_is_held_then_default_after_its_time():
    e = thermal(sensor("T", hold_s=0.25, fade_on_default=False))
    assert z(e, T=25.0) == 10.0
    assert [z(e, T=200.0) for _ in range(4)] == [10.0, 10.0, 0.0, 0.0]
    last = e.cycle({"T": -50.0})
    assert last.faults["T"] == "range" and last.sources["T"] == "default" and "defaulted" in last.status_names()
    assert z(e, T=26.0) == 12.0


def test_a_jump_faster_than_believable_is_held_until_time_allows_it():
    e = thermal(sensor("T", max_rate=10.0))
    assert z(e, T=20.0) == 0.0
    assert z(e, T=20.9) == pytest.approx(1.8)
    seen = [e.cycle({"T": 25.0}) for _ in range(5)]
    assert [c.faults["T"] for c in seen] == ["rate"] * 4 + ["none"]
    assert seen[3].deviation["E_Z"] == pytest.approx(1.8) and seen[4].deviation["E_Z"] == 10.0


def test_a_stale_reading_is_not_believed():
    e = thermal(sensor("T", stale_after_s=0.15, hold_s=0.0, fade_on_default=False))
    assert z(e, T=25.0) == 10.0
    assert z(e) == 10.0
    cycle = e.cycle({})
    assert cycle.faults["T"] == "stale" and cycle.deviation["E_Z"] == 0.0


def test_a_lost_sensor_is_replaced_by_the_weighted_others():
    parts = (t.Substitute(input="A", weight=0.5), t.Substitute(input="B", weight=0.5))
    e = thermal(sensor("T", substitute=parts, substitute_offset=1.0), (sensor("A"), sensor("B")))
    assert z(e, T=30.0, A=24.0, B=28.0) == 20.0
    cycle = e.cycle({"T": np.nan, "A": 24.0, "B": 28.0})
    assert cycle.deviation["E_Z"] == 14.0 and "substituted" in cycle.status_names()
    cycle = e.cycle({"T": np.nan, "A": np.nan, "B": 28.0})
    assert cycle.deviation["E_Z"] == 20.0 and cycle.sources["T"] == "held"


def test_a_substitute_stays_within_the_plausible_range():
    parts = (t.Substitute(input="A", weight=100.0),)
    e = thermal(sensor("T", substitute=parts), (sensor("A"),))
    assert z(e, T=np.nan, A=24.0) == 2.0 * (120.0 - 20.0)


def test_outside_validity_it_fades_over_the_margin_and_never_jumps():
    e = thermal(sensor("T", valid=(15.0, 40.0), margin=10.0))
    seen = [z(e, T=T) for T in (40.0, 42.5, 45.0, 50.0, 60.0, 45.0)]
    assert seen == [40.0, 40.0 * 0.75, 40.0 * 0.5, 0.0, 0.0, 20.0]  # its driver stays within validity too
    assert e.cycle({"T": 60.0}).status_names()[-2:] == ("fading", "faded")


def test_a_fade_takes_its_time():
    e = thermal(sensor("T", valid=(15.0, 40.0), margin=10.0), fade_s=1.0)
    assert z(e, T=40.0) == 40.0
    seen = [z(e, T=90.0) for _ in range(11)]
    assert seen == pytest.approx([40.0 * max(0.0, 1.0 - 0.1 * k) for k in range(1, 12)])


def test_when_only_the_default_is_left_the_thermal_part_fades_and_the_geometric_part_stays():
    pairs = (Lowered(d.ONE, "X", lambda x: 0.01 * x), Lowered(d.above("T", 0.0), "X", lambda x: 0.001 * x))
    channel = sensor("T", valid=(15.0, 40.0), margin=5.0, hold_s=0.0)
    table = compile_table([ComponentSource("EXX", "um", pairs)], inputs=[position(), channel], travel={"X": (0, 1000)})
    e = Evaluator(table)
    assert e.cycle({"x": 1000.0, "T": 30.0}, dt=0.0).deviation["EXX"] == pytest.approx(40.0)
    cycle = e.cycle({"x": 1000.0, "T": np.nan}, dt=0.0)
    assert cycle.deviation["EXX"] == pytest.approx(10.0)
    assert "defaulted" in cycle.status_names() and "faded" in cycle.status_names()


def test_references_and_lags_wait_for_the_first_believed_reading():
    driver = d.Lag(of=d.rise("T"), tau_up=10.0, tau_down=10.0)
    table = compile_table([ComponentSource("E_Z", "um", (Lowered(driver), Lowered(d.rise("T"))))], inputs=[sensor("T")])
    e = Evaluator(table)
    for _ in range(5):
        cycle = e.cycle({"T": np.nan}, dt=1.0)
        assert "waiting" in cycle.status_names() and cycle.deviation["E_Z"] == 0.0
    cycle = e.cycle({"T": 35.0}, dt=1.0)
    assert "waiting" not in cycle.status_names() and cycle.deviation["E_Z"] == 0.0
    assert e.cycle({"T": 36.0}, dt=1.0).deviation["E_Z"] == 1.0


def test_direction_changes_after_the_threshold_and_starts_as_stated():
    source = ComponentSource("EXX", "um", (Lowered(d.Direction(axis="X", threshold=0.5, start=-1)),))
    e = Evaluator(compile_table([source], inputs=[position()], ramp_s=0.0))
    way = (5.0, 5.4, 5.6, 10.0, 9.6, 9.4, 9.8, 9.95)
    assert [e.cycle({"x": x}).deviation["EXX"] for x in way] == [-1, -1, 1, 1, 1, -1, -1, 1]


def test_a_known_direction_goes_before_travel():
    known = t.TableInput(name="dir", kind="direction", axis="X", low=-1, high=1, default=0, optional=True)
    source = ComponentSource("EXX", "um", (Lowered(d.Direction(axis="X")),))
    e = Evaluator(compile_table([source], inputs=[position(), known], ramp_s=0.0))
    assert e.cycle({"x": 5.0, "dir": -1.0}).deviation["EXX"] == -1
    assert e.cycle({"x": 6.0, "dir": -1.0}).deviation["EXX"] == -1
    cycle = e.cycle({"x": 7.0, "dir": np.nan})
    assert cycle.deviation["EXX"] == 1 and cycle.status_names() == ("running", "active")


def test_pre_sliding_builds_up_over_travel():
    source = ComponentSource("EXX", "um", (Lowered(d.Approach(axis="X", length=0.2, threshold=0.0)),))
    e = Evaluator(compile_table([source], inputs=[position()], ramp_s=0.0))
    assert e.cycle({"x": 0.0}).deviation["EXX"] == 1
    assert e.cycle({"x": -0.2}).deviation["EXX"] == pytest.approx(-1 + 2 * np.exp(-1))
    assert e.cycle({"x": -0.2}).deviation["EXX"] == pytest.approx(-1 + 2 * np.exp(-1))


def test_ramp_in_and_out():
    e = thermal(sensor("T"), ramp_s=1.0)
    seen = [e.cycle({"T": 25.0}).correction["E_Z"] for _ in range(12)]
    assert seen == pytest.approx([-0.01 * min(1.0, 0.1 * k) for k in range(1, 13)])
    seen = [e.cycle({"T": 25.0}, enable=False).correction["E_Z"] for _ in range(12)]
    assert seen == pytest.approx([-0.01 * max(0.0, 1.0 - 0.1 * k) for k in range(1, 13)], abs=1e-15)


def limited(**limits):
    return thermal(sensor("T"), limits={"E_Z": Limits(**limits)})


def test_magnitude_and_slew():
    e = limited(magnitude=30.0, slew=50.0)
    corrections = [e.cycle({"T": 60.0}) for _ in range(8)]
    assert [c.correction["E_Z"] for c in corrections] == pytest.approx([-0.001 * min(30, 5 * k) for k in range(1, 9)])
    assert (
        corrections[0].status_names()[-2:] == ("at_magnitude", "at_rate")
        and corrections[-1].status_names()[-1] == "at_magnitude"
    )


@pytest.mark.parametrize("slew", [None, 80.0])
def test_acceleration_limit_reaches_the_target_smoothly_and_stays(slew):
    e = limited(magnitude=1000.0, slew=slew, acceleration=40.0)
    rng = np.random.default_rng(3)
    last = rate = 0.0
    for _ in range(40):
        T = rng.uniform(-15, 110)
        for _ in range(200):
            cycle = e.cycle({"T": T})
            c = 1000 * cycle.correction["E_Z"]
            assert slew is None or abs(c - last) <= slew * 0.1 + 1e-9
            assert abs((c - last) - rate) <= 40.0 * 0.01 + 1e-9
            last, rate = c, c - last
        assert cycle.correction["E_Z"] == -cycle.deviation["E_Z"] * 0.001


def test_acceleration_limit_does_not_overshoot_a_step_by_more_than_one_brake():
    e = limited(magnitude=1000.0, acceleration=40.0)
    e.cycle({"T": 20.0})
    seen = [1000 * e.cycle({"T": 70.0}).correction["E_Z"] for _ in range(300)]
    assert min(seen) >= -100.0 - 0.41 and seen[-1] == -100.0


def test_limits_are_transparent_for_motion_within_them():
    e = limited(magnitude=1000.0, slew=1e5, acceleration=1e7)
    for k in range(300):
        cycle = e.cycle({"T": 40.0 + 15.0 * np.sin(k / 20)})
        assert cycle.correction["E_Z"] == -cycle.deviation["E_Z"] * 0.001
        assert "at_rate" not in cycle.status_names()


def test_heartbeat_counts_and_reset_starts_anew():
    e = thermal(sensor("T"))
    assert [e.cycle({"T": 25.0}).heartbeat for _ in range(3)] == [1, 2, 3]
    e.reset()
    assert e.cycle({"T": 25.0}).heartbeat == 1


def test_unknown_input_is_refused_by_name():
    with pytest.raises(KeyError, match="no input 'T_nut'"):
        thermal(sensor("T")).cycle({"T_nut": 3.0})
