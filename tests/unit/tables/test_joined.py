"""Tables of single axes as one."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import CompensationTable, TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.errors import UsageError
from errpipe.tables.joined import joined
from errpipe.targets import _sample
from errpipe.targets.fanuc_pitch import FanucPitch


def table(axis: str, um: float, machine: str = "m", **more: float) -> CompensationTable:
    """One axis of 500 mm, 2 um of lost motion, a screw that warms; inputs called as for every other axis."""
    travel = {axis: (0.0, 500.0)}
    inputs = [
        TableInput(name="place", kind="position", axis=axis, low=-50, high=550, default=0),
        TableInput(name="screw", kind="sensor", unit="degC", low=0, high=60, default=20, valid=(15, 30), margin=5),
    ]
    warm = Lowered(d.above("screw", 20.0), axis, lambda x: 1e-3 * um * x)
    gap = Lowered(d.Direction(axis=axis), None, lambda x: np.full(np.shape(x), -1.0))
    parts = [tables.ComponentSource(f"E{axis}{axis}", "um", (Lowered(d.ONE, axis, lambda x: um * x / 500), warm, gap))]
    return tables.compile_table(parts, inputs=inputs, travel=travel, error_bound=0.002, machine=machine, **more)


def test_each_axis_is_corrected_as_alone_by_its_own_sensor() -> None:
    single = {axis: table(axis, um) for axis, um in (("X", 10.0), ("Y", -7.0), ("Z", 4.0))}
    both = joined(list(single.values()))
    x, side = np.linspace(0, 500, 9), np.where(np.arange(9) % 2, 1.0, -1.0)
    for axis, alone in single.items():
        warm = {"place": x, "screw": np.full(9, 24.0)}
        expected = _sample.corrections(alone, axis, warm, side)
        own = {f"{name}_{axis}": values for name, values in warm.items()}
        assert np.ptp(expected) > 1e-3
        np.testing.assert_allclose(_sample.corrections(both, axis, own, side), expected, atol=1e-12)


def test_no_point_of_a_control_is_taken_by_two_axes() -> None:
    """Files made apart begin with the same point: the second would move the first axis too."""
    text = FanucPitch.write(joined([table("X", 10.0), table("Y", -7.0)]))["PITCH.TXT"]
    points = [line for line in text.splitlines() if line.startswith("N1")]
    assert len({line.split("Q")[0] for line in points}) == len(points)


def test_what_does_not_join_is_refused() -> None:
    with pytest.raises(UsageError, match="two of the tables move X"):
        joined([table("X", 10.0), table("X", 3.0)])
    with pytest.raises(
        UsageError, match=r"tables of different machines \(lathe, mill\): of one machine, write one name"
    ):
        joined([table("X", 10.0, machine="lathe"), table("Y", 3.0, machine="mill")])
    with pytest.raises(UsageError, match="position_cycle_s"):
        joined([table("X", 10.0), table("Y", 3.0, position_cycle_s=0.002)])
    long = {"place": "p" * 30 + "1", "screw": "p" * 30 + "2"}
    with pytest.raises(UsageError, match="shorter names"):
        joined([_called(table("X", 10.0), long), _called(table("Y", 3.0), long)])


def test_a_table_that_names_no_machine_takes_the_name_of_the_others() -> None:
    assert joined([table("X", 10.0, machine=""), table("Y", 3.0, machine="lathe")]).machine == "lathe"


def _called(made: CompensationTable, names: dict[str, str]) -> CompensationTable:
    """The table with its inputs called by other names."""
    text = made.model_dump_json()
    for name, other in names.items():
        text = text.replace(f'"{name}"', f'"{other}"')
    return CompensationTable.model_validate_json(text)
