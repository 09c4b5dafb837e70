"""Laser and level records to curves: each correction with its sign, and the conventions."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines import ready
from numpy.testing import assert_allclose

from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import DataError
from errpipe.kinematics import air, direct

P = np.linspace(0, 800, 17)


def recording(columns: dict[str, dict], **values) -> Recording:
    manifest = Manifest.model_validate({"recording": 1, "tables": ["t.csv"], "columns": columns})
    return Recording(manifest, pd.DataFrame(values))


X = {"role": "position", "axis": "X", "unit": "mm"}


def error(component: str) -> dict:
    return {"role": "error", "component": component, "unit": "urad" if component[1] in "ABC" else "um"}


def test_a_beam_off_the_axis_reads_short():
    laser = direct.Laser(misalignment=2000.0)
    shown = P * np.cos(2e-3) - P  # mm
    assert_allclose(direct.corrected(P, shown * 1e3, laser), 0.0, atol=1e-6)


def test_warmer_air_makes_the_reading_short():
    index = air.index_change(temperature=np.linspace(20, 22, 17))
    shown = P * (1 + index) - P
    assert shown[-1] * 1e3 == pytest.approx(-0.93 * 2 * 0.8, rel=0.01)  # -0.93 um/m/K
    laser = direct.Laser(wavelength_corrected=False)
    assert_allclose(direct.corrected(P, shown * 1e3, laser, air=index), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("degrees", "pascal", "dry"), [(20, 60e3, 16092.41), (20, 100e3, 26824.44), (30, 100e3, 25937.25)]
)
def test_dry_air_as_by_another_equation(degrees, pascal, dry):
    """(n - 1) x 1e8 at 632.99 nm by Ciddor's equation (Applied Optics 35, 1996, 1566), 450 ppm of carbon dioxide."""
    assert 1e8 * air.refractivity(degrees, pascal / 100, 0.0) == pytest.approx(dry, abs=0.5)


def test_a_display_fixed_at_another_index_is_wrong_in_proportion():
    """Fixed at 20 degC and 1013.25 hPa, used at 28 degC and 960 hPa: -21.1 um/m, by density alone (p / T)."""
    by_density = -271.8 * (1 - 960 / 1013.25 * 293.15 / 301.15)
    fixed = (20.0, 1013.25, 50.0)
    weather = {"temperature": np.full(17, 28.0), "pressure": np.full(17, 960.0)}
    display = air.index_change(**weather, since=fixed)
    shown = P * (1 + display) - P
    assert shown[-1] / (P[-1] - P[0]) * 1e6 == pytest.approx(by_density, abs=0.05)
    laser = direct.Laser(wavelength_corrected=False, display_air=fixed)
    here = air.index_change(**weather)
    assert_allclose(direct.corrected(P, shown * 1e3, laser, air=here, display=display), 0.0, atol=1e-6)
    # without the key the same record keeps all of it, for the weather did not change during it
    left = direct.corrected(P, shown * 1e3, direct.Laser(wavelength_corrected=False), air=here)
    assert left[-1] == pytest.approx(by_density * 0.8, abs=0.05)


def test_dead_path_is_an_offset_that_follows_the_weather():
    index = air.index_change(pressure=np.linspace(1000, 1010, 17))
    shown = 1000.0 * index * 1e3  # 1 m dead path, um
    assert shown[-1] == pytest.approx(2.7, rel=0.01)
    assert_allclose(direct.corrected(P, shown, direct.Laser(dead_path=1000.0), air=index), 0.0, atol=1e-9)


def test_abbe_offset_times_angle_is_added():
    """Carriage turns 10 urad about +Y; the functional point lies 300 mm below the beam: -3 um along X."""
    turn = 10.0 * np.cos(2 * np.pi * P / 800)  # has no offset, as angles have none
    columns = {"x": X, "EXX": error("EXX"), "EBX": error("EBX")}
    measured = recording(columns, x=P, EXX=np.zeros(17), EBX=turn)
    chain, laser = ready("cmm"), direct.Laser(offset=(0, 0, -300.0))
    got = direct.curves(measured, chain, {"EXX": laser})["EXX"].mean
    assert_allclose(got - got[0], -0.3 * (turn - turn[0]), atol=1e-9)


def test_both_directions_stay_apart():
    x = np.r_[P, P[::-1], P, P[::-1]]
    side = np.repeat([1, -1, 1, -1], 17)
    columns = {"x": X, "d": {"role": "direction", "axis": "X"}, "EXX": error("EXX")}
    curve = direct.curves(recording(columns, x=x, d=side, EXX=0.02 * x - 3.0 * side), ready("cmm"))["EXX"]
    assert_allclose(curve.up - curve.down, -6.0)
    assert_allclose(curve.mean, 0.02 * P, atol=1e-9)


def test_positioning_is_zero_at_the_datum_straightness_has_no_line_angles_no_offset():
    columns = {"x": X, "EXX": error("EXX"), "EYX": error("EYX"), "EBX": error("EBX")}
    straight = 4 + 0.03 * P + 2 * np.cos(P / 100)
    chain = ready("cmm")
    curves = direct.curves(recording(columns, x=P, EXX=5 + 0.01 * P, EYX=straight, EBX=7 + 0.02 * P), chain)
    assert np.interp(chain.machine.axes["X"].zero, P, curves["EXX"].mean) == pytest.approx(0.0, abs=1e-9)
    assert abs(np.polyfit(P, curves["EYX"].mean, 1)).max() < 1e-9
    assert np.trapezoid(curves["EBX"].mean, P) == pytest.approx(0.0, abs=1e-6)


def test_a_component_without_its_axis_is_refused():
    with pytest.raises(DataError, match="no position of axis Y"):
        direct.curves(recording({"x": X, "EYY": error("EYY")}, x=P, EYY=P), ready("cmm"))
