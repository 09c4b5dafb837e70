"""Random sequences of faults through the exported component in LinuxCNC's realtime thread, beside the reference."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.kernels.table_codes import HOLD, OFF
from errpipe.tables import ect
from errpipe.tables.reference import Evaluator
from errpipe.targets.linuxcnc_hal import COMPONENT, LinuxcncHal
from tests.e2e import test_one_bad_reading as one_bad_reading
from tests.e2e.linuxcnc import session
from tests.e2e.linuxcnc.test_hal_component import stream
from tests.faults import hal, sequences

pytestmark = session.MARKS

CYCLES = 7000
UNCONNECTED = 1e31  # what a pin reads that nobody drives: not sane, so missing
PRINT_UM = 1e-9  # halsampler prints six decimals of nm
STREAM = """loadrt threads name1=servo-thread period1=1000000
loadrt streamer depth=8000 cfg=fffbbbb
loadrt errpipe
loadrt scale count=2
setp scale.0.gain 1e6
setp scale.1.gain 1e6
loadrt sampler depth=8000 cfg=ffuu
addf streamer.0 servo-thread
addf errpipe servo-thread
addf scale.0 servo-thread
addf scale.1 servo-thread
addf sampler.0 servo-thread
net x streamer.0.pin.0 => errpipe.in-x
net nut streamer.0.pin.1 => errpipe.in-t-nut
net column streamer.0.pin.2 => errpipe.in-t-column
net on streamer.0.pin.3 => errpipe.enable
net home streamer.0.pin.4 => errpipe.homed
net off streamer.0.pin.5 => errpipe.off
net anew streamer.0.pin.6 => errpipe.reset
net cx errpipe.correction-x => scale.0.in
net cz errpipe.correction-z => scale.1.in
net cxn scale.0.out => sampler.0.pin.0
net czn scale.1.out => sampler.0.pin.1
net s errpipe.status => sampler.0.pin.2
net r errpipe.rejected-t-nut => sampler.0.pin.3
"""


def faults(first: int = 0) -> np.ndarray:
    """x, two sensors, enable, homed, off, reset per cycle: parts with faults of many sequences, then 300 cycles off."""
    rows = []
    for seed in range(first, first + 40):
        parts = sequences.sequence(seed)[:-1]
        for part in parts:
            mode = part.mode[:, None]
            homed = np.where(mode == OFF, seed % 2, 1)  # off by one pin or by the other
            anew = (np.arange(len(mode)) == 0)[:, None] & (part.begins == "reset")
            bits = np.hstack([mode != HOLD, homed, (mode == OFF) & (homed == 1), anew])
            rows.append(np.hstack([part.readings[:, :3], bits]))  # the velocity is not connected
    whole = np.vstack(rows)[:CYCLES].astype(float)
    whole[-300:, 3:] = (1, 1, 1, 0)
    whole[:, :3] = np.where(np.abs(whole[:, :3]) < 1e6, whole[:, :3], UNCONNECTED)  # NaN fails the comparison too
    return whole


def recorded(made, given: np.ndarray, hal: str, bits: int) -> np.ndarray:
    """What the component of a table gave for each cycle's input."""
    with session.alone() as folder:
        (folder / COMPONENT).write_text(LinuxcncHal.write(made)[COMPONENT])
        with session.installed(folder / COMPONENT):
            return stream(folder, given, hal, bits)[0]


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_seven_thousand_cycles_of_faults_stay_within_the_limits_and_are_the_reference(number, capsys):
    """Then the other table: this one is taken off first (`off`), and the other comes in from 0, as both runs show."""
    made = sequences.table(number)
    given = np.array([[float(f"{v:.9f}") for v in row] for row in faults(40 * number)])
    rows = recorded(made, given, STREAM, bits=4)
    assert len(rows) == CYCLES and np.array_equal(np.diff(rows[:, 0]), np.ones(CYCLES - 1)), "a cycle was lost"
    corrections = 1e-3 * rows[:, 1:3]
    want, rejected = by_reference(made, given)
    assert np.abs(corrections - want).max() < PRINT_UM
    assert rows[-1, 4] == rejected > 0
    slew = np.array([o.slew for o in made.outputs]) * sequences.CYCLE
    steps = np.abs(np.diff(corrections, axis=0, prepend=np.zeros((1, 2))))
    size = np.abs(corrections) / np.array([o.magnitude for o in made.outputs])
    largest = f"largest step {(steps / slew).max():.6f} of the slew, size {size.max():.6f} of the magnitude"
    assert np.all(corrections[-1] == 0.0) and np.abs(corrections[0]).max() <= slew.max(), (
        "a table can be exchanged here"
    )
    assert given[:, 6].sum() > 10, "resets"
    with capsys.disabled():
        print(f"\nHAL: {CYCLES} cycles of faults, {largest}")
    assert np.all(steps <= slew + PRINT_UM) and size.max() <= 1.0 + 1e-9
    held = (given[:, 3] == 0) & (given[:, 4] == 1) & (given[:, 5] == 0)
    assert held.sum() > 100 and steps[held].max() < PRINT_UM


@pytest.mark.slow
def test_whole_sequences_at_the_pace_of_the_thread_give_the_kernels_bits():
    """`make faults` runs ten thousand of them."""
    ran = 0
    for parts, match in hal.corrections([1, 4, 7, 10]):
        assert not hal.differ(parts, match) and sequences.judge(parts, match).is_safe()
        assert hal.differ(parts, np.nextafter(match, np.inf)), "a last bit is seen"
        ran += 1
    assert ran == 4


def by_reference(made, given: np.ndarray) -> tuple[np.ndarray, int]:
    """Corrections, um, and the nut's refused readings; one that does not change is not new where it may go stale."""
    evaluator, out = Evaluator(made), []
    names, last = [i.name for i in made.inputs], [0.0] * 3
    before = 0.0
    for x, nut, column, on, homed, off, anew in given.tolist():
        if anew and not before:
            evaluator.reset()
        before = anew
        readings = dict(zip(names[:3], (x, nut, column), strict=True))
        stale = {i.name for i in made.inputs if i.stale_after_s is not None}
        new = {n: v for (n, v), old in zip(readings.items(), last, strict=True) if n not in stale or v != old}
        last = list(readings.values())
        cycle = evaluator.cycle(new, enable=bool(homed and not off), hold=bool(homed and not off and not on))
        out.append(list(cycle.correction.values()))
    return 1e3 * np.array(out), cycle.rejected["T nut"]


PLAIN = """loadrt threads name1=servo-thread period1=1000000
loadrt streamer depth=24000 cfg=fffbu
loadrt errpipe
loadrt scale count=1
setp scale.0.gain 1e6
loadrt sampler depth=24000 cfg=fu
addf streamer.0 servo-thread
addf errpipe servo-thread
addf scale.0 servo-thread
addf sampler.0 servo-thread
net x streamer.0.pin.0 => errpipe.in-x
net side streamer.0.pin.1 => errpipe.in-dir
net nut streamer.0.pin.2 => errpipe.in-t-nut
net on streamer.0.pin.3 => errpipe.enable
net only streamer.0.pin.4 => errpipe.only
net c errpipe.correction-x => scale.0.in
net cn scale.0.out => sampler.0.pin.0
net r errpipe.rejected-t-nut => sampler.0.pin.1
"""
OUT = 1500  # cycles in which a correction ramps to 0
BAD = (75.0, -20.0, UNCONNECTED, 190.0, 25.3)


@pytest.mark.slow
def test_one_bad_sample_of_a_plain_axis_with_the_default_export(tmp_path, capsys):
    """Each meets a thermal cycle and, half a second on, none; then 75 degC for 2 s and back, none at all, no leave."""
    made = one_bad_reading.exported(tmp_path)
    samples = [np.r_[bad, np.full(1499, 25.0), bad, np.full(499, 25.0)] for bad in BAD]  # 1000 cycles a thermal cycle
    calm = [np.full(n, v) for n, v in ((2000, 75.0), (1000, 25.0), (500, UNCONNECTED), (OUT, 25.0))]
    nut = np.concatenate([np.full(6000, 25.0), *samples, *calm])
    only = np.full(nut.size, int(ect.fingerprint(made), 16))
    only[-OUT:] += 1  # another table is the only one that may run: this one is taken off, not dropped
    given = np.column_stack([np.full(nut.size, 1000.0), np.ones(nut.size), nut, np.ones(nut.size), only])
    rows = recorded(made, given, PLAIN, bits=2)
    assert len(rows) == nut.size and np.all(np.diff(rows[:, 0]) == 1), "a cycle was lost"
    moved = 1e-3 * rows[:, 1]
    right = moved[5999]
    step, off = np.abs(np.diff(moved, prepend=0.0)).max(), np.abs(moved[6000:-OUT] - right).max()
    with capsys.disabled():
        print(f"\nHAL, one bad sample: {step:.6f} um in 1 ms at most, {off:.4f} um beyond what is right ({right:.2f})")
    # Of the five, those within the range that the guard accepts are rejected; the others are no readings.
    assert abs(right) > 50.0 and rows[-1, 2] >= 1
    assert step <= one_bad_reading.STEP + PRINT_UM and off < one_bad_reading.BAD_SAMPLE
    assert moved[-1] == 0.0
