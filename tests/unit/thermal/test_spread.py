"""The spread of a prediction as a driver: its value, and how much of a file it takes."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from errpipe.domain import driver as d
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.evaluation import drive
from errpipe.thermal import spread


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
