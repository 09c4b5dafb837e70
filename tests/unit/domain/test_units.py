"""Units on reading."""

import math

import pytest

from errpipe.domain import units
from errpipe.domain.recording import ROLE_UNITS


def test_every_unit_a_role_allows_can_be_converted():
    for role, allowed in ROLE_UNITS.items():
        for unit in allowed:
            assert units.conversion(role, unit) is not None, (role, unit)
    assert units.conversion("run", None) is None


@pytest.mark.parametrize(
    ("role", "unit", "value", "canonical", "expected"),
    [
        ("position", "inch", 1.0, "mm", 25.4),
        ("position", "rad", math.pi, "deg", 180.0),
        ("temperature", "degF", 68.0, "degC", 20.0),
        ("temperature", "K", 293.15, "degC", 20.0),
        ("error", "mm", 0.001, "um", 1.0),
        ("error", "nm", 1000.0, "um", 1.0),
        ("error", "arcsec", 3600.0, "urad", math.pi / 180 * 1e6),
        ("error", "mrad", 0.02, "urad", 20.0),
        ("velocity", "m/min", 60.0, "mm/s", 1000.0),
        ("feed", "mm/s", 10.0, "mm/min", 600.0),
        ("pressure", "bar", 1.0, "hPa", 1000.0),
        ("cut_length", "mm", 1500.0, "m", 1.5),
        ("spindle_speed", "1/s", 2.0, "rpm", 120.0),
        ("time", "h", 1.0, "s", 3600.0),
        ("load", "t", 0.5, "kg", 500.0),
    ],
)
def test_conversions(role, unit, value, canonical, expected):
    convert = units.conversion(role, unit)
    assert convert.unit == canonical
    assert convert(value) == pytest.approx(expected, rel=1e-14)


def test_a_canonical_value_passes_bit_for_bit():
    assert units.conversion("temperature", "degC")(0.1 + 0.2) == 0.1 + 0.2


def test_wrong_and_missing_units_are_refused():
    with pytest.raises(ValueError, match=r"'C' is not a unit of role temperature \(allowed: degC, degF, K\)"):
        units.conversion("temperature", "C")
    with pytest.raises(ValueError, match="role position needs a unit"):
        units.conversion("position", None)
    assert units.conversion("humidity", None).unit == "%"
    assert units.conversion("feed", None).unit == "mm/min"


def test_constants_keep_rises_and_deviations():
    assert units.constant("inch")(2.0) == pytest.approx(50.8)
    assert units.constant("m").unit == "mm"
    assert units.constant("um").identity
    assert units.constant("K").identity
    assert units.constant("N/um") is None
