"""What a new machine borrows from its type, through `errpipe fleet`."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from trials import pooled


@pytest.mark.slow
def test_a_machine_with_two_runs_is_better_off_with_its_type() -> None:
    ((_, (nothing, own, together)),) = pooled.of_fleets(seed=1, fleets=1, first=3)
    assert together < 0.5 * own and together < 0.5 * nothing


def test_a_machine_whose_two_runs_had_one_temperature_borrows_its_expansion() -> None:
    """Slope and expansion are one column there: the fit alone refuses, and the machine would have no table."""
    terms = "{term: scale_error, axis: X}, {term: scale_expansion, axis: X, sensor: T_nut, fixed: {}}"
    machines, judged = pooled.simulated(11)
    first = machines["new"][machines["new"]["run"] == "run 1"]
    machines["new"] = pd.concat([first, first.assign(run="run 2", t=first["t"] + 86400.0)])
    nothing, own, borrowed = pooled.left(
        machines, "new", judged, pooled.MANIFEST, pooled.PIPELINE.format(component="EXX", terms=terms)
    )
    assert np.isnan(own) and borrowed < 0.5 * nothing


def test_a_parameter_that_is_fixed_for_all_machines_is_no_parameter_of_the_type() -> None:
    terms = "{term: scale_error, axis: X}, {term: scale_expansion, axis: X, sensor: T_nut, fixed: {coefficient: 10.5}}"
    machines, judged = pooled.simulated(1003)
    nothing, own, together = pooled.left(
        machines, "new", judged, pooled.MANIFEST, pooled.PIPELINE.format(component="EXX", terms=terms)
    )
    assert own < 0.5 * nothing and together < 0.5 * nothing
