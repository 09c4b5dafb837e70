"""Synthesis as plain data: compiled into a table, the table says what the kinematics says; lattices and their bound."""

from __future__ import annotations

import numpy as np
import pytest
from machines import corrected, ready
from numpy.testing import assert_allclose

from errpipe.domain.machine import Machine
from errpipe.domain.table import TableInput
from errpipe.kinematics import compensation, observability, synthesis
from errpipe.kinematics import observations as o
from errpipe.kinematics.chain import compile_chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.simulation import metrology
from errpipe.tables.compile import ComponentSource, compile_table
from errpipe.tables.reference import Evaluator


def table_of(chain, errors):
    """What a stage does: plain data of kinematics handed to tables."""
    pairs = compensation.lowered(errors)
    outputs = compensation.outputs(chain, used=tuple(pairs))
    inputs = [
        TableInput(
            name=a,
            kind="position",
            axis=a,
            unit="mm" if chain.machine.axes[a].kind == "linear" else "deg",
            low=lo - 1,
            high=hi + 1,
            default=float(np.clip(0, lo, hi)),
        )
        for a, (lo, hi) in zip(chain.axes, chain.travel, strict=True)
    ]
    inputs += [TableInput(name="tool_length", kind="tool", unit="mm", low=0, high=500, default=100)]
    inputs += [
        TableInput(name=f"tool_offset_{d}", kind="tool", unit="mm", low=-300, high=300, default=0) for d in "XYZ"
    ]
    return compile_table(
        [ComponentSource(n, chain.unit(n), p) for n, p in pairs.items()],
        inputs=inputs,
        outputs=outputs,
        travel={a: tuple(t) for a, t in zip(chain.axes, chain.travel, strict=True)},
        error_bound=0.002,
    )


def test_x_y_and_z_correct_a_quill_that_a_rotary_axis_turns():
    """W lies behind B: its direction turns, so that it corrects nothing; 10 um too long at +W moves Z and X back."""
    chain = compile_chain(
        Machine.model_validate(
            {
                "machine": 1,
                "name": "quill",
                "chain": ["workpiece", "bed", "X", "Y", "Z", "B", "W", "spindle", "tool"],
                "axes": {n: {"kind": "linear", "travel": [0, 500]} for n in "XYZ"}
                | {"W": {"kind": "linear", "travel": [0, 200]}, "B": {"kind": "rotary", "travel": [-90, 90]}},
            }
        )
    )
    errors = MachineErrors.of(chain, {"EZW": lambda w: w / 20.0})
    table = table_of(chain, errors)
    assert [o.axis for o in table.outputs] == ["X", "Z"]
    for b, expected in ((0.0, (0.0, 10.0)), (90.0, (10.0, 0.0))):
        got = Evaluator(table).cycle({"W": 200.0, "B": b}, dt=1.0).deviation
        assert_allclose((got["E_X"], got["E_Z"]), expected, atol=0.01)


@pytest.mark.parametrize(
    "name", ["cmm", "vertical-centre", "horizontal-centre-ni-1997", "turning-centre", "five-axis-head-head"]
)
def test_the_table_says_what_the_kinematics_says(name):
    chain = ready(name)
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 3), nodes=65)
    table = table_of(chain, errors)
    linear = [a for a in chain.axes if chain.machine.axes[a].kind == "linear"]
    directions = np.array([chain.machine.direction(a) for a in linear]).T
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1])
        length, offset = rng.uniform(50, 250), rng.uniform(-60, 60, 3)
        readings = dict(zip(chain.axes, q, strict=True)) | {"tool_length": length}
        readings |= {f"tool_offset_{d}": v for d, v in zip("XYZ", offset, strict=True)}
        got = Evaluator(table).cycle(readings, dt=1.0).deviation
        want = synthesis.first_order(chain, q, errors.at(q), chain.tip(length, tuple(offset)))[0, :3]
        # head-head: all rotary axes carry the tool, so the work's frame is the bed's
        assert_allclose([got[f"E_{a}"] for a in linear], np.linalg.pinv(directions) @ want, atol=0.05)


def test_outputs_by_axis_undo_the_deviation_of_a_turning_table():
    """A table turned by C and A: the outputs are along the machine's axes, not the work's."""
    chain = ready("five-axis-table-table")
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 4), nodes=65)
    table = table_of(chain, errors)
    rng = np.random.default_rng(1)
    for _ in range(10):
        q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1])
        readings = dict(zip(chain.axes, q, strict=True)) | {"tool_length": 150.0}
        got = Evaluator(table).cycle(readings | {f"tool_offset_{d}": 0.0 for d in "XYZ"}, dt=1.0).deviation
        deviation = synthesis.first_order(chain, q, errors.at(q), chain.tip(150.0))
        command = corrected(chain, q[None], deviation, chain.tip(150.0))[0]
        assert_allclose([got[f"E_{a}"] for a in "XYZ"], (q - command)[:3] * 1e3, atol=0.05)


def test_tool_length_is_an_input():
    chain = ready("vertical-centre")
    errors = MachineErrors.of(chain, {"EBZ": 30.0})
    table = table_of(chain, errors)
    base = {"X": 400.0, "Y": 200.0, "Z": -100.0} | {f"tool_offset_{d}": 0.0 for d in "XYZ"}
    base = {n: v for n, v in base.items() if n in {i.name for i in table.inputs}}
    short, long = (Evaluator(table).cycle(base | {"tool_length": v}, dt=1.0).deviation["E_X"] for v in (100.0, 200.0))
    assert_allclose(long - short, -30e-3 * 100.0, atol=0.01)  # 30 urad about +Y, 100 mm further down


def test_a_full_synthesis_has_few_terms():
    assert sum(len(o.terms) for o in compensation.outputs(ready("cmm"))) <= 40
    assert sum(len(o.terms) for o in compensation.outputs(ready("five-axis-table-table"))) <= 100


def test_a_component_left_out_leaves_its_terms_out():
    outputs = compensation.outputs(ready("cmm"), used=("EXX", "C0Y"))
    assert {t.component for o in outputs for t in o.terms} == {"EXX", "C0Y"}
    assert {o.name for o in outputs} == {"E_X"}


@pytest.mark.parametrize("counts", [(9, 9, 9), (21, 15, 12)])
def test_no_deviation_lies_further_from_the_lattice_than_its_bound(counts):
    chain = ready("gantry")
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 2))
    lattice = compensation.lattice(errors, counts)
    assert 0.05 * lattice.bound < lattice.largest_seen <= lattice.bound
    q = np.random.default_rng(5).uniform(chain.travel[:, 0], chain.travel[:, 1], (20000, 3))
    true = synthesis.first_order(chain, q, errors.at(q))[:, :3]
    gap = np.linalg.norm(true - compensation.interpolate(lattice.grids, lattice.values, q), axis=1)
    assert gap.max() <= lattice.bound


def test_a_lattice_over_rotary_axes_is_refused():
    chain = ready("five-axis-table-table")
    with pytest.raises(ValueError, match="use the synthesis"):
        compensation.lattice(MachineErrors.of(chain, {}), (3,) * 5)


def test_profiles_that_are_off_move_the_tool_no_further_than_their_bound():
    """Every profile off by its allowance with any sign, anywhere: within the bound; and the bound is not idle."""
    chain = ready("vertical-centre")
    off = {n: 0.05 for n in chain.components if n[0] == "E"}
    bound = compensation.profile_bound(chain, off)
    rng = np.random.default_rng(1)
    q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1], (2000, 3))
    size = np.array([off.get(n, 0.0) for n in chain.components])
    worst = np.linalg.norm(np.abs(synthesis.jacobian(chain, q)[:, :3]) @ size, axis=1).max()
    assert 0.6 * bound < worst <= bound


@pytest.mark.parametrize("way", [(0, 0, 1), (0, 0, -1)])
def test_each_of_two_parallel_axes_corrects_its_own_error_whole(way):
    """A quill W along Z: halves on both would be half a correction in files over the axis itself. +10 um at the end."""
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZW"}
    axes["W"]["direction"] = way
    machine = {"machine": 1, "name": "m", "chain": ["workpiece", "bed", "X", "Y", "Z", "W", "tool"], "axes": axes}
    chain = compile_chain(Machine.model_validate(machine))
    both = compensation.outputs(chain, ("EZZ", "EZW", "EZX"))
    weights = {out.axis: {t.component: t.weight for t in out.terms} for out in both}
    assert weights["Z"] == pytest.approx({"EZZ": 1.0, "EZX": 1.0}) and weights["W"] == pytest.approx({"EZW": way[2]})
    (alone,) = compensation.outputs(chain, ("EZZ", "EZW"), ("W",))
    assert {t.component: t.weight for t in alone.terms} == pytest.approx({"EZZ": way[2], "EZW": way[2]})


def test_no_circle_of_parallel_axes_is_proposed():
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZW"}
    machine = {"machine": 1, "name": "m", "chain": ["workpiece", "bed", "X", "Y", "Z", "W", "tool"], "axes": axes}
    chain = compile_chain(Machine.model_validate(machine))
    seen = o.along(chain, np.linspace([0.0] * 4, [500.0, 0, 0, 0], 9), chain.tip(), (1, 0, 0))
    offered = observability.candidates(chain, seen)
    assert "ball-bar circle XZ (24 readings)" in offered and "ball-bar circle ZW (24 readings)" not in offered
    assert all(np.isfinite(test.weights).all() for test in offered.values())
