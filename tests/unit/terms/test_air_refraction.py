"""Air in the beam of a laser: lengths are counted from where the laser was zeroed."""

import numpy as np

from errpipe.terms.air_refraction import AirRefraction
from tests.unit.diagnosis.machines import axis


def test_the_beam_may_be_as_long_as_the_way_from_any_place():
    """Zeroed at X = 250 and 21.5 degC: what is left is nothing (ISO 230-2, dead path)."""
    case = axis(3)
    term = AirRefraction(axis="X", sensor="T_air")
    base = term.basis(case)
    columns = np.column_stack([base, *[column for column, _ in term.slack(case, base)], np.ones(base.shape[0])])
    read = 0.93e-3 * (case.array("x") - 250.0) * (case.array("T_air") - 21.5)
    left = read - columns @ np.linalg.lstsq(columns, read, rcond=None)[0]
    assert np.std(left) < 1e-9
