"""Table 1 of Ni (1997): what compensation of cutting-force errors left of a diameter, from the printed diameters.

The paper's text says 85, 78 and 67 percent. Its own table gives 84.5, 77.7 and 63.8: the first two are roundings, the
third is not. Printed diameters in mm; D1 to D3 along the workpiece; columns: without compensation, tests 1 to 3.
"""

from __future__ import annotations

import numpy as np
import pytest

TABLE = {
    "I": (
        [39.3700, 39.3571, 39.3370],
        [[39.3751, 39.3725, 39.3776], [39.3751, 39.3725, 39.3751], [39.3725, 39.3700, 39.3675]],
    ),
    "II": (
        [38.8087, 38.8010, 38.7858],
        [[38.8214, 38.8239, 38.8239], [38.8239, 38.8264, 38.8290], [38.8188, 38.8239, 38.8239]],
    ),
    "III": (
        [39.3217, 39.3192, 39.2938],
        [[39.3243, 39.3294, 39.3344], [39.3294, 39.3294, 39.3268], [39.3243, 39.3294, 39.3217]],
    ),
}
PRINTED_ERRORS = {
    "I": (0.0330, 0.0051, 0.0026, 0.0050),
    "II": (0.0229, 0.0025, 0.0051, 0.0051),
    "III": (0.0279, 0.0101, 0.0026, 0.0077),
}
REDUCTION = {"I": 84.5, "II": 77.7, "III": 63.8}
TEXT = {"I": 85, "II": 78, "III": 67}


def spread(diameters) -> float:
    """Largest less smallest diameter, mm."""
    return float(np.ptp(diameters))


@pytest.mark.parametrize("cut", TABLE)
def test_printed_errors_are_the_spread_of_the_printed_diameters(cut):
    bare, tests = TABLE[cut]
    assert [spread(d) for d in (bare, *tests)] == pytest.approx(PRINTED_ERRORS[cut], abs=1.01e-4)


@pytest.mark.parametrize("cut", TABLE)
def test_the_reduction_of_the_largest_error(cut):
    bare, tests = TABLE[cut]
    reduction = 100 * (1 - max(map(spread, tests)) / spread(bare))
    assert reduction == pytest.approx(REDUCTION[cut], abs=0.06)
    if cut == "III":
        assert abs(reduction - TEXT[cut]) > 3  # the text's 67 percent does not follow from the table
    else:
        assert reduction == pytest.approx(TEXT[cut], abs=0.6)
