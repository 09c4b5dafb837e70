"""20 000 rows and ten or more columns: diagnosed in the time and the memory that the README promises."""

from __future__ import annotations

import pytest

from . import long


@pytest.mark.slow
@pytest.mark.parametrize("shape", long.SHAPES)
def test_a_long_recording_takes_neither_half_a_minute_nor_one_and_a_half_gigabytes(shape: str) -> None:
    took = long.measured(shape)
    assert took["columns"] >= 10
    assert took["named"][0] == long.SHAPES[shape][1]
    assert took["peak_mb"] < 1000  # of 1500; a fast trace 900, slow ones 390 to 540
    assert took["cpu_seconds"] < 25  # of 30 s; what other programs take of the clock is not its own
