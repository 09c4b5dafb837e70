"""Limits belong to an axis: the outputs that move it share them, because a controller adds them up."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.tables import limits
from errpipe.tables.reference import Evaluator


def three_on_x() -> t.CompensationTable:
    """X is corrected for its own position and for two straightnesses, Y for nothing but itself."""
    bends = {"EXX": ("X", 60.0), "EXY": ("Y", 30.0), "EXZ": ("Z", 30.0), "EYY": ("Y", 20.0)}
    inputs = [
        t.TableInput(name=a.lower(), kind="position", axis=a, unit="mm", low=-50, high=550, default=0) for a in "XYZ"
    ]
    sources = [
        tables.ComponentSource(name, "um", (Lowered(d.ONE, axis, lambda x, size=size: size * np.sin(x / 40.0)),))
        for name, (axis, size) in bends.items()
    ]
    return tables.compile_table(sources, inputs=inputs, travel=dict.fromkeys("XYZ", (0, 500)), error_bound=0.1)


def steps(made: t.CompensationTable) -> tuple[float, float]:
    """Largest step, um in a cycle, and largest size, um, of what X gets while all axes jump about."""
    evaluator, r, seen = Evaluator(made), np.random.default_rng(1), []
    for k in range(3000):
        if k % 300 == 0:
            at = dict(zip("xyz", r.uniform(0, 500, 3).tolist(), strict=True))
        value = evaluator.cycle(at).correction
        seen.append(1e3 * sum(v for name, v in value.items() if name.startswith("EX")))
    return float(np.abs(np.diff(seen, prepend=0.0)).max()), float(np.abs(seen).max())


def test_an_axis_of_three_outputs_moves_by_one_micrometre_a_millisecond():
    made = tables.limited(three_on_x())
    assert sum(o.slew for o in made.outputs if o.axis == "X") == pytest.approx(limits.MAX_DEFAULT_SLEW)
    assert next(o.slew for o in made.outputs if o.axis == "Y") == limits.MAX_DEFAULT_SLEW
    step, _ = steps(made)
    assert 0.9 < step <= 1.0 + 1e-9


def test_stated_limits_are_of_the_whole_axis():
    made = tables.limited(three_on_x(), of_axes=tables.Limits(magnitude=40.0, slew=400.0))
    step, size = steps(made)
    assert 0.35 < step <= 0.4 + 1e-9 and 20.0 < size <= 40.0 + 1e-9
    (only,) = [o for o in made.outputs if o.axis == "Y"]
    assert (only.magnitude, only.slew) == (40.0, 400.0)
