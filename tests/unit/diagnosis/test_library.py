"""The columns of an empirical regression: each is what its driver computes, and its parameters are those stated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.library import Candidate, candidates
from errpipe.fitting.pursuit import NuisanceColumns, Pursuit
from errpipe.terms import resolved_times
from tests.unit.diagnosis.machines import axis, spindle, trace

MACHINES = {"axis": axis, "spindle": spindle, "trace": trace}


def library(machine: str) -> tuple[list[Candidate], Recording]:
    made = MACHINES[machine]()
    return candidates(made, np.arange(len(made)), resolved_times(made)[1]), made


@pytest.mark.parametrize("machine", list(MACHINES))
def test_a_column_is_what_its_driver_computes(machine: str) -> None:
    every, made = library(machine)
    assert len({c.name for c in every}) == len(every) > 3
    for c in every:
        assert_allclose(drive(c.driver, made), c.values, atol=1e-9 * np.abs(c.values).max(), err_msg=c.name)


@pytest.mark.parametrize("machine", list(MACHINES))
def test_a_column_with_its_own_parameters_is_itself(machine: str) -> None:
    for c in library(machine)[0]:
        assert len(c.free) == len(c.spans) and bool(c.free) == (c.at is not None)
        if c.at is not None:
            same = c.at(*c.free)
            assert (same.name, same.unit, same.free) == (c.name, c.unit, c.free)
            assert_allclose(same.values, c.values)


def test_a_lag_of_no_time_is_the_input() -> None:
    every, _ = library("spindle")
    late = next(c for c in every if c.name.startswith("lag(T_bed") and c.at is not None)
    assert late.at is not None and late.at(0.0, *late.free[1:]).name.startswith("(T_bed - ")


def test_a_pursuit_whose_columns_are_all_nuisances_selects_none() -> None:
    every, made = library("trace")
    held = np.column_stack([np.ones(len(made)), *(c.values for c in every)])
    search = Pursuit(every, np.arange(len(made)) % 4, NuisanceColumns(held, np.zeros(held.shape[1])))
    shares, _ = search.held_out(np.sin(np.arange(len(made))), 3)
    assert search.library == [] and not shares.any()
