"""20 000 and a million rows, ten or more columns: diagnosed rightly in the memory that the README promises.

How long it takes is measured by `make bench`.
"""

from __future__ import annotations

import pytest

from . import long

MOST_MB = 2000  # what a million rows may take; each shape's own aim is measured by `make bench`


@pytest.mark.slow
@pytest.mark.parametrize("shape", long.SHAPES)
def test_a_long_recording_is_diagnosed_in_bounded_memory(shape: str) -> None:
    took = long.measured(shape)
    wanted = long.SHAPES[shape]
    assert took["columns"] >= 10
    assert wanted.names <= set(took["periods_by_name"])
    assert took["peak_mb"] < MOST_MB
    for period in took["periods_by_name"].get("pitch_cyclic", ()):
        assert abs(period - 0.9) < 0.002  # mm, the wave that was hidden in the million rows
