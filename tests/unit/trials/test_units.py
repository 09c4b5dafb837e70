"""Units of parameters, whichever way they are spelled."""

import pytest

from trials.units import ratio


@pytest.mark.parametrize(
    ("unit", "wanted", "factor"),
    [
        ("mm", "um", 1e3),
        ("um/mm", "um/m", 1e3),
        ("ppm", "um/m", 1.0),
        ("um/(m K)", "um/m/K", 1.0),
        ("1e-6/K", "um/m/K", 1.0),
        ("ppm/K", "um/m/K", 1.0),
        ("um/degC", "um/K", 1.0),
        ("um/(mm/s)", "ms", 1.0),
        ("um s/mm", "s", 1e-3),
        ("um/s", "um/h", 3600.0),
        ("min", "s", 60.0),
        ("N/(mm/s)", "N s/m", 1e3),
        ("um s2/m", "um/(m/s2)", 1.0),
        ("um/(mm/s2)", "um/(m/s2)", 1e3),
        ("arcsec", "urad", 4.84813681),
        ("kN", "N", 1e3),
    ],
)
def test_compatible_units(unit, wanted, factor):
    assert ratio(unit, wanted) == pytest.approx(factor)


@pytest.mark.parametrize(
    ("unit", "wanted"), [("um", "um/K"), ("s", "um"), ("N", "N s/m"), ("furlong", "um"), ("um/m", "urad")]
)
def test_other_dimensions_do_not_compare(unit, wanted):
    assert ratio(unit, wanted) is None


def test_a_plain_number_is_no_slope() -> None:
    assert ratio("1", "um/m") is None and ratio("um/m", "1") is None
    assert ratio("1", "1") == 1.0
