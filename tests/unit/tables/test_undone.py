"""One reading of a position or direction that its neighbours contradict is undone by the next, and nothing else is."""

from __future__ import annotations

import pytest

from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.tables import ComponentSource, compile_table
from errpipe.tables.reference import Evaluator
from tests.unit.tables.made import position


def evaluator(driver: d.Driver) -> Evaluator:
    """EXX is the driver, 1 um for 1; nothing ramps. x is a position, v its velocity, which need not be known."""
    speed = t.TableInput(name="v", kind="velocity", axis="X", low=-9, high=9, default=0, optional=True)
    source = ComponentSource("EXX", "um", (Lowered(driver),))
    return Evaluator(compile_table([source], inputs=[position(), speed], ramp_s=0.0))


def sides(way, stated=None, dt: float | None = None) -> str:
    """+ or - per reading of an axis whose threshold is 1 mm, and which starts at +."""
    e = evaluator(d.Direction(axis="X", threshold=1.0))
    known = [{}] * len(way) if stated is None else [{"v": float(v)} for v in stated]
    cycles = (e.cycle({"x": float(x), **more}, dt=dt) for x, more in zip(way, known, strict=True))
    return "".join("+" if c.deviation["EXX"] > 0 else "-" for c in cycles)


@pytest.mark.parametrize(
    ("way", "right"),
    [
        pytest.param([12, 14, 14, 20, 14, 14], "++++++", id="in the way of the last travel"),
        pytest.param([12, 14, 14, 8, 14, 14], "+++-++", id="against it"),
        pytest.param(
            [14, 14, 13.5, 13.5, 20, 13.5, 13.5, 12.875], "+++++++-", id="gone back by less than the threshold"
        ),
        pytest.param([14, 20, 14, 14], "++++", id="the second reading of all"),
        pytest.param([14, 8, 14, 14], "+-++", id="the second reading of all, against"),
        pytest.param([14, 14, 20, 14, 8, 14, 14], "++++-++", id="two with a good one between"),
        pytest.param([14, 14, 20, 14, 20, 14, 14], "+++++++", id="twice the same"),
        pytest.param([14, 14, 15, 14, 14], "+++++", id="of exactly the threshold"),
        pytest.param([14, 14, 13, 14, 14], "+++++", id="of exactly the threshold, against"),
        pytest.param([14, 14, 20, 14.25, 13.75, 14], "++++++", id="an encoder that dithers"),
        pytest.param([14, 14.5, 20, 15.5, 16, 16.5], "++++++", id="moving slowly"),
        pytest.param([0, 5, 10, 40, 20, 25, 30], "++++-++", id="moving fast: right again after a cycle"),
    ],
)
def test_a_single_bad_position_turns_a_direction_for_a_cycle_at_most(way, right):
    assert sides(way) == right


@pytest.mark.parametrize(
    ("way", "right"),
    [
        pytest.param([14, 14.25, 14, 14.25, 14, 14.25], "++++++", id="dithering"),
        pytest.param([0, 5, 10, 15, 10, 5], "++++--", id="fast"),
        pytest.param(
            [0, 22.5, 40, 52.5, 60, 62.5, 60, 52.5, 40], "++++++---", id="a hard turn with a reading at its top"
        ),
        pytest.param([14, 14, 16, 16, 14, 14, 16, 16], "++++--++", id="steps of a handwheel"),
        pytest.param([14, 14, 16, 18, 16, 14, 14], "++++---", id="away for two readings"),
        pytest.param([14, 14, 8, 8, 8, 10, 10], "++---++", id="a jump that stays"),
    ],
)
def test_a_reversal_shows_in_the_cycle_in_which_it_is_read(way, right):
    assert sides(way) == right


@pytest.mark.parametrize(
    ("way", "stated", "right"),
    [
        pytest.param([14] * 5, [0, 0, -1, 0, 0], "++-++", id="at a standstill"),
        pytest.param([14] * 4, [-1, 0, 0, 0], "-+++", id="the first reading of all"),
        pytest.param([14, 14.25, 14, 14.25, 14], [0, 0, -1, 0, 0], "++-++", id="dithering"),
        pytest.param([14] * 5, [0, 1, -1, 0, 0], "++-++", id="one way and the other"),
        pytest.param([14] * 5, [0, -1, -1, 0, 0], "+----", id="told twice"),
        pytest.param([14, 14, 12.5, 12.5], [0, -1, 0, 0], "+---", id="and the axis went there"),
        pytest.param([14, 13.75, 13.5, 13.25, 13.25], [0, -1, -1, -1, 0], "+----", id="slow motion"),
    ],
)
def test_a_stated_direction_without_motion_is_reverted(way, stated, right):
    assert sides(way, stated) == right


def test_rows_of_a_recording_are_all_believed():
    assert sides([14, 14, 20, 14, 14], dt=1.0) == "+++--"


@pytest.mark.parametrize("spike", [0.5, -0.5, 30.0])
def test_a_single_bad_position_builds_up_no_pre_sliding(spike):
    """Far from built up after a reversal, where a spike adds twice its size of travel."""
    way = [10.0, 12.0, *(11.96875 - 0.03125 * k for k in range(4)), *[11.875] * 8]
    bad = list(way)
    bad[8] += spike
    values = []
    for places in (way, bad):
        e = evaluator(d.Approach(axis="X", length=0.5, threshold=0.015625))
        values.append([e.cycle({"x": x}).deviation["EXX"] for x in places])
    right, wrong = values
    assert -0.9 < right[-1] < 0.9
    assert wrong[:8] == right[:8] and wrong[8] != right[8] and wrong[9:] == right[9:]
