"""Beam elements beside closed forms: Euler-Bernoulli, Timoshenko with Cowper's factor, springs, a propped beam."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.kinematics.beam import Section, Support, compliance

E, NU = 210e3, 0.3
G = E / (2 * (1 + NU))


def test_a_slender_cantilever_is_f_z3_over_3ei():
    z = np.linspace(100.0, 400.0, 7)
    shaft = Section(400.0, diameter=4.0)
    assert compliance([shaft], z) == pytest.approx(z**3 / (3 * E * shaft.inertia()) * 1e3, rel=1e-3)


@pytest.mark.parametrize(
    "part, factor",
    [
        (Section(120.0, diameter=40.0), 6 * (1 + NU) / (7 + 6 * NU)),
        (Section(60.0, width=20.0, height=25.0), 10 * (1 + NU) / (12 + 11 * NU)),
        (Section(90.0, diameter=50.0, bore=49.999), 2 * (1 + NU) / (4 + 3 * NU)),  # Cowper's thin tube
    ],
)
def test_a_stubby_cantilever_is_timoshenko_with_cowpers_factor(part, factor):
    z = np.linspace(10.0, part.length, 6)
    closed = z**3 / (3 * E * part.inertia()) + z / (factor * G * part.area())
    assert compliance([part], z) == pytest.approx(closed * 1e3, rel=1e-3)


def test_clamped_and_propped_is_the_statically_indeterminate_closed_form():
    """Force at a from the clamped end of a slender beam, simply supported at the other: by superposition."""
    part, length = Section(300.0, diameter=1.5), 300.0
    a = np.array([60.0, 150.0, 240.0])
    bend = E * part.inertia()
    reaction = a**2 * (3 * length - a) / (2 * length**3)
    closed = (a**3 / 3 - reaction * a**2 * (3 * length - a) / 6) / bend
    assert compliance([part], a, Support(far=None)) == pytest.approx(closed * 1e3, rel=1e-3)


def test_steps_are_the_sum_of_their_parts():
    """Tip of a two-step cantilever by the unit load method: bending and shear of each step integrated."""
    first, second = Section(80.0, diameter=50.0), Section(120.0, diameter=30.0)
    total, closed = 200.0, 0.0
    for part, start in ((first, 0.0), (second, 80.0)):
        far, near = total - start, total - start - part.length
        closed += (far**3 - near**3) / (3 * E * part.inertia())
        closed += part.length / (part.shear_factor(NU) * G * part.area())
    assert compliance([first, second], np.array([total])) == pytest.approx(closed * 1e3, rel=1e-3)


def test_a_chuck_adds_its_springs_and_a_tailstock_carries():
    part, z = Section(200.0, diameter=40.0), np.array([50.0, 200.0])
    rigid = compliance([part], z)
    soft = compliance([part], z, Support(radial=100.0, turning=0.5))
    # 1/100 um/N; turning: F z / (0.5 N m/urad) in urad, times z
    assert soft - rigid == pytest.approx(1 / 100.0 + (z * 1e-3) ** 2 / 0.5, rel=1e-6)
    assert compliance([part], z, Support(far=50.0))[1] == pytest.approx(1 / (1 / rigid[1] + 50.0), rel=1e-6)


def test_a_force_beyond_the_shaft_is_refused():
    with pytest.raises(ValueError, match="not on a shaft of 100 mm"):
        compliance([Section(100.0, diameter=10.0)], np.array([120.0]))
