"""One table of all signs: a machine that goes 10 um too far at X = +500 goes through every target and every runtime.

Formats that hold no screw map get the machine that they can hold, 10 um too far at the same place: Y over X for cross
compensation, Z over the bed, X on a warm day. Each must be told to go 10 um less far.
"""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from errpipe.domain import driver as d
from errpipe.ncprogram.modal import Setup
from errpipe.tables import batch, reference
from errpipe.targets import TARGETS
from errpipe.verbs.correct import deviation_of
from tests.nc import correct
from tests.unit.targets import machines

WARM = 10.0  # K, at which a machine of the temperature formats is 10 um too long


def by_target(target) -> tuple[str, float]:
    """(axis, how far it is moved at X = +500 against X = 0, um) of what the controller makes of the files.

    Formats that hold the reversal of an axis only: a machine that is 10 um too long where it comes from above.
    """
    one = np.ones(1)
    if set(target.holds) == {"reversal"}:
        read = target.read_back(target.write(machines.too_long_from_above()))
        up, down = (float(read.correction("X", {"X": 500.0 * one}, side * one, {})[0]) for side in (1, -1))
        return "X", 1e3 * (down - up)
    axis = "X"
    if "screw" not in target.holds:
        axis = {"cross": "Y", "bed": "Z", "temperature": "X"}[target.holds[0]]
    rise = WARM if target.holds[0] == "temperature" else 0.0
    warm = d.Affine(weights=(1.0 / WARM,), of=(d.above("T", 20.0),)) if rise else d.ONE
    read = target.read_back(target.write(machines.too_far(axis, warm)))
    at = {"X": np.array([0.0, 500.0]), "Y": np.zeros(2), "Z": np.full(2, -150.0)}
    moved = read.correction(axis, at, np.ones(2), {"T": np.full(2, 20.0 + rise)})
    return axis, 1e3 * float(moved[1] - moved[0])


def by_runtime(tmp_path) -> dict[str, float]:
    """Corrections at X = +500, um, of every evaluator: the first cycle of a run that stands there."""
    table = machines.too_long_at_plus_x()
    readings = {i.name: 500.0 if i.name == "x" else i.default for i in table.inputs}
    full = table.model_copy(update={"ramp_s": 0.0})
    evaluator = reference.Evaluator(full)
    (output,) = full.outputs
    out = {"reference (Python)": 1e3 * evaluator.cycle(readings).correction[output.name]}
    columns = {k: np.full(1, v) for k, v in readings.items()}
    replay = batch.Rows(full)(columns, np.zeros(1), np.zeros(1, dtype=int))
    out["Numba, recordings"] = -float(replay.deviation[output.name][0])
    out["Numba, points"] = -float(batch.position(full, np.array([list(readings.values())]), tuple(readings))[0, 0])
    setup = Setup({"G54": (0.0, 0.0, 0.0)}, {}, (0.0, 0.0, 0.0))
    program, _ = correct("G21 G90 G54 G1 X500 F1000\n", deviation_of(full, {}), setup)
    last = program.split("X")[-1].split()[0]
    out["NC program (correct)"] = 1e3 * (float(last) - 500.0)
    if shutil.which("gcc") is not None:
        out |= compiled(tmp_path, full, readings)
    return out


def compiled(tmp_path, table, readings) -> dict[str, float]:
    from tests.unit.targets.c import test_c_runtime as c
    from tests.unit.targets.st import test_iec_st as st
    from tests.unit.targets.st import translate

    engines = {
        "C, double": c.Library(c.build(tmp_path, compiler="gcc")),
        "C, single": c.Library(c.build(tmp_path, "-DECT_SINGLE", compiler="gcc", name="single.so"), np.float32),
        "Structured Text": st.Block(tmp_path, translate.by_lines(st.units())),
    }
    row, ones = np.array([list(readings.values())]), np.ones((1, len(readings)), dtype=np.uint8)
    return {
        name: 1e3 * float(engine.stream(table, row, ones, ones[:, 0].copy())[1][0, 0])
        for name, engine in engines.items()
    }


def test_every_target_and_every_runtime_moves_a_machine_that_goes_too_far_back(tmp_path, capsys):
    rows = [(t.name, *by_target(t)) for t in TARGETS]
    rows += [(name, "X", moved) for name, moved in by_runtime(tmp_path).items()]
    with capsys.disabled():
        print("\ncorrection at X = +500 of a machine that goes 10 um too far there")
        for name, axis, moved in rows:
            print(f"  {name:<24}{axis}{moved:+9.3f} um")
    assert len(rows) >= len(TARGETS) + 4
    rounding = {t.name: t.rounding_um for t in TARGETS}
    for name, _, moved in rows:
        assert moved == pytest.approx(-10.0, abs=rounding.get(name, 0.1)), name


@pytest.mark.parametrize("axis", ["U", "X2"])
def test_the_positioning_of_a_second_axis_along_x_moves_that_axis_and_not_x(axis):
    """EXU and EXX2 are deviations along X of the axes U and X2: X was commanded back by them."""
    from errpipe import tables
    from errpipe.domain import components
    from errpipe.domain.table import TableInput
    from errpipe.drivers.lowered import Lowered

    pairs = (Lowered(d.ONE, axis, lambda x: 10.0 * x / 500.0),)
    table = tables.compile_table(
        [tables.ComponentSource(components.positioning(axis), "um", pairs)],
        inputs=[TableInput(name="p", kind="position", axis=axis, low=-50, high=550, default=0)],
        travel={axis: (0.0, 500.0)},
        error_bound=0.002,
        machine="test",
    )
    assert [o.axis for o in table.outputs] == [axis]
    for target in (t for t in TARGETS if "screw" in t.holds and not t.limits.startswith("X, Y and Z;")):
        read = target.read_back(target.write(table))
        assert read.axes() == (axis,), target.name
        moved = np.diff(read.correction(axis, {axis: np.array([0.0, 500.0])}, np.ones(2), {}))
        assert 1e3 * moved == pytest.approx(-10.0, abs=target.rounding_um), target.name
