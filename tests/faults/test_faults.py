"""Nothing that goes wrong around a table moves an axis: random sequences of faults in every evaluator.

`make faults` runs ten thousand of them and writes the figures of `docs/safety.md`.
"""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import table as t
from errpipe.kernels import table_cycle
from errpipe.kernels.table_codes import HOLD, OFF, ON
from errpipe.tables import ect, limits, pack
from errpipe.tables.reference import Evaluator
from tests.faults import campaign, runners, sequences
from tests.unit.targets.st import matiec

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
toolchain = pytest.mark.toolchain


@pytest.mark.parametrize("seed", range(12))
def test_reference_and_kernels_agree_to_the_bit_and_are_safe(seed):
    parts = sequences.sequence(seed)
    evaluated = runners.by_reference(parts)
    assert np.array_equal(evaluated, runners.by_numba(parts))
    assert sequences.judge(parts, evaluated).is_safe()


@needs_gcc
@toolchain
@pytest.mark.parametrize("name", ["C, double", "C, single", "Structured Text"])
def test_compiled_evaluators_are_safe(name, tmp_path):
    run = campaign.compiled(name, tmp_path)
    for seed in range(40):
        parts = sequences.sequence(seed)
        result = run(parts)
        assert sequences.judge(parts, result).is_safe(single=name == "C, single"), seed
        if name != "C, single":
            assert np.array_equal(result, runners.by_numba(parts)), seed


@needs_gcc
@toolchain
@pytest.mark.skipif(matiec.compiler() is None, reason="no iec2c: set IEC2C to a MATIEC that was built")
def test_the_blocks_compiled_by_matiec_give_the_same_bits(tmp_path):
    run = campaign.compiled("Structured Text, MATIEC", tmp_path)
    for seed in range(40):
        parts = sequences.sequence(seed)
        assert np.array_equal(run(parts), runners.by_numba(parts)), seed


@pytest.mark.slow
def test_five_hundred_sequences():
    assert campaign.run({"kernels": runners.by_numba}, 500)["kernels"].unsafe == 0


def test_without_limits_the_same_sequences_are_unsafe(monkeypatch):
    """What the judge says of a table of version 1 as it was exported before: a magnitude and nothing else."""

    @sequences.cache
    def bare(number: int) -> t.CompensationTable:
        made = tables.limited(limited(number), stated={"EXX": limits.Limits(), "EZX": limits.Limits()})
        free = tuple(o.model_copy(update={"slew": None, "acceleration": None}) for o in made.outputs)
        return made.model_copy(update={"outputs": free})

    limited = sequences.table
    safe = 0
    for seed in range(12):
        parts = sequences.sequence(seed)
        monkeypatch.setattr(runners, "table", bare)
        by_numba_values = runners.by_numba(parts)
        monkeypatch.setattr(runners, "table", limited)
        safe += sequences.judge(parts, by_numba_values).is_safe()
    assert safe <= 1


def test_without_the_undo_one_bad_sample_turns_the_lost_motion(monkeypatch):
    """What the judge says of a direction that accepts every single sample, as in version 1 of the format."""
    monkeypatch.setattr(Evaluator, "_recall", lambda *_: None)
    judged = [sequences.judge(p, runners.by_reference(p)) for p in map(sequences.sequence, range(24))]
    assert sum(j.once > sequences.BAD_SAMPLE and j.off > sequences.BAD_SAMPLE for j in judged) > 5


def stand(evaluator: Evaluator, cycles: int, x: float = 450.0, **mode) -> float:
    for _ in range(cycles):
        cycle = evaluator.cycle({"x": x, "T nut": 30.0, "T column": 24.0}, **mode)
    return 1e3 * cycle.correction["EXX"]


def test_four_emergency_stops_leave_the_axis_where_it_is():
    """A drive that holds while the correction ramps out would be moved by the whole correction at each reset."""
    evaluator = Evaluator(sequences.table(0))
    before = stand(evaluator, 4000)
    assert abs(before) > 30.0
    for _ in range(4):
        assert stand(evaluator, 700, hold=True) == before
        assert stand(evaluator, 1) == before
        assert stand(evaluator, 700) == before


def test_homing_and_a_jump_of_the_position_are_ramped():
    evaluator = Evaluator(sequences.table(0))
    seen = [stand(evaluator, 3000)]
    seen += [stand(evaluator, 1, x=0.0) for _ in range(200)]
    seen += [stand(evaluator, 1, x=450.0, enable=False) for _ in range(200)]
    assert abs(seen[0]) > 30.0 and seen[-1] == 0.0
    assert np.abs(np.diff(seen)).max() <= 1.0 + 1e-9


def test_the_magnitude_is_the_last_word_with_an_acceleration_too():
    made = tables.limited(sequences.table(0), stated={"EXX": limits.Limits(30.0, 4000.0, 20000.0)})
    evaluator = Evaluator(made)
    seen = []
    for k in range(4000):
        x = 1000.0 if (k // 37) % 2 else 0.0
        cycle = evaluator.cycle({"x": x, "T nut": 39.0, "T column": 24.0})
        seen.append(1e3 * cycle.correction["EXX"])
    assert np.abs(seen).max() <= 30.0 and np.abs(seen).max() == pytest.approx(30.0)


def standing(number: int, mode: int = ON, cycles: int = 3000) -> sequences.Part:
    """X stands at 450 mm in a warm machine; `number` is the table that begins."""
    readings = np.tile([450.0, 30.0, 24.0, 0.0], (cycles, 1))
    return sequences.Part("table", number, readings, np.ones(readings.shape, np.uint8), np.full(cycles, mode, np.uint8))


@needs_gcc
@toolchain
@pytest.mark.parametrize("name", ["reference", "kernels", "C, double", "C, single", "Structured Text"])
def test_a_table_of_a_smaller_magnitude_takes_the_correction_back_at_its_slew(name, tmp_path, monkeypatch):
    """The magnitude as the last word took it back at once: 25 um in a cycle, while the axis cut."""
    tight = tables.limited(sequences.table(0), stated={"EXX": limits.Limits(10.0, 1000.0, 100000.0)})
    chosen = (sequences.table(0), tight)
    monkeypatch.setattr(runners, "table", lambda number: chosen[number])
    monkeypatch.setattr(runners, "_bytes", lambda number: ect.dumps(chosen[number]))
    run = {"reference": runners.by_reference, "kernels": runners.by_numba}.get(name) or campaign.compiled(
        name, tmp_path
    )
    seen = run([standing(0), standing(1)])[:, 0]
    assert abs(seen[2999]) > 30.0 and abs(seen[-1]) == pytest.approx(10.0)
    assert np.abs(np.diff(seen)).max() <= 1.0 + 1e-4
    size = np.abs(seen[2999:])
    within = int(np.argmax(size <= 10.0))
    assert np.all(np.diff(size[: within + 1]) < 0.0) and size[within:].max() <= 10.0 + 1e-4


@needs_gcc
@toolchain
@pytest.mark.parametrize("name", ["kernels", "C, double", "C, single"])
def test_a_mode_that_is_none_takes_corrections_to_0(name, tmp_path):
    run = runners.by_numba if name == "kernels" else campaign.compiled(name, tmp_path)
    assert np.all(run([standing(0), standing(0, mode=7)])[-1] == 0.0)


@pytest.mark.parametrize("dt", [3600.0, -1.0, np.nan])
def test_a_clock_that_steps_moves_nothing(dt):
    """A cycle of 3600 s was given the slew of an hour: the whole correction in a cycle."""
    ended = []
    for given in (sequences.CYCLE, dt):
        program = pack.program(sequences.table(0))
        state = pack.state(program)
        for k in range(20):
            readings = np.array([450.0, 30.0, 24.0, 0.0])
            fresh = np.ones(4, np.uint8)
            step = given if k == 12 else sequences.CYCLE
            table_cycle.cycle(program, state, readings, fresh, step, False, ON)
        ended.append(state.outputs["limited"].copy())
    assert np.array_equal(*ended) and ended[0].any()


def test_a_table_with_other_outputs_is_not_taken_over():
    fewer = sequences.table(0).model_copy(update={"outputs": sequences.table(0).outputs[:1]})
    with pytest.raises(ValueError, match="other outputs"):
        Evaluator(fewer).continue_from(Evaluator(sequences.table(0)))


@needs_gcc
@toolchain
@pytest.mark.parametrize("name", ["C, double", "Structured Text"])
def test_a_table_that_is_refused_leaves_the_running_one_alone(name, tmp_path):
    run = campaign.compiled(name, tmp_path)
    calm = sequences.sequence(0)[0]
    session = run.open(ect.dumps(sequences.table(0)))
    before = run.part(session, calm, 2)
    fewer = sequences.table(1).model_copy(update={"outputs": sequences.table(1).outputs[:1]})
    corrupt = bytearray(ect.dumps(sequences.table(1)))
    corrupt[700] ^= 1
    for data in (ect.dumps(fewer), bytes(corrupt)):
        assert run.reload(session, data) == 0
        after = run.part(session, calm, 2)
        assert np.abs(np.diff(np.vstack([before[-1:], after]), axis=0)).max() <= 1.0 + 1e-9
        before = after
    assert {ON, OFF, HOLD} == {0, 1, 2}
