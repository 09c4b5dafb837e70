"""The spread of a prediction as a driver: its value, and how much of a file it takes."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from errpipe.domain import driver as d
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.evaluation import drive
from errpipe.models.rises import Rises
from errpipe.thermal import spread
from tests.unit.guard import simulated_sensors


def test_the_root_of_variances_is_exact_and_holds_each_direction_once() -> None:
    values = np.array([-3e4, -2.5, -1e-4, 0.0, 1e-4, 7.0, 2e5])
    column = Column(role="temperature", unit="degC")
    recording = Recording(
        Manifest(recording=1, tables=("a.csv",), columns={"T_body": column}), pd.DataFrame({"T_body": values})
    )
    two = (d.Input(name="T_body"), d.Affine(offset=1.0, weights=(0.5,), of=(d.Input(name="T_body"),)))
    root = spread.root(0.4, [(0.2, two)])
    expected = np.sqrt(0.4 + 0.2 * spread.squared(two, recording))
    assert_allclose(drive(root, recording), expected, rtol=1e-9)
    assert root.model_dump_json().count("T_body") == len(two)


def test_a_deviation_without_noise_has_an_interval() -> None:
    """Its residual is rounding: as a unit of variances it made weights of 4e27, which no driver may have."""
    rows = simulated_sensors.machine(4, 5, hours=4.0)
    exact = sum(rows.array(n) for n in simulated_sensors.NAMES)
    rows = rows.with_columns({"E_Z": exact}, {"E_Z": Column(role="error", component="E_Z", unit="um")})
    (component,) = Rises.model_validate({"family": "rises", "component": "E_Z"}).fit(rows).model.components
    assert 0.0 <= component.half_width90 < 1e-6
