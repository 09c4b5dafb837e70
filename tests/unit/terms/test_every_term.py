"""What holds for every term, from its worked case: a term added to TERMS is tested here without a line of code."""

import inspect
import re
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position
from errpipe.terms import TERMS, Term, example_of, plain

KINDS = {kind.model_fields["term"].default: kind for kind in TERMS}


@cache
def example(name):
    return example_of(KINDS[name])


@pytest.fixture(params=KINDS, ids=str)
def case(request):
    return example(request.param)


def basis(case, recording=None, values=None):
    """Design columns; of a term shared by two responses those of both, one below the other."""
    recording = case.recording if recording is None else recording
    values = case.term.nonlinear_values(case.parameters) if values is None else values
    shared = getattr(case.term, "shared", None)
    if shared is None:
        return case.term.basis(recording, *values)
    return np.vstack([shared(recording, component, *values) for component in ("E_X", "E_Y")])


def test_finite_and_one_column_per_parameter(case):
    names = [p.name for p in (*case.term.linear(), *case.term.nonlinear())]
    assert len(set(names)) == len(names) and set(names) == set(case.parameters)
    columns = basis(case)
    assert columns.shape[1] == len(case.term.linear()) and np.isfinite(columns).all()
    assert len(columns) % len(case.recording) == 0
    assert np.abs(columns).max() > 0


# What `domain.units` calls canonical, and what a parameter is usually stated in; 1: no unit.
DEFORMATIONS, MOTIONS = ("um", "urad", "1"), ("mm", "m", "deg", "s", "ms", "h", "mm/s", "rpm", "Hz")
UNITS = frozenset((*DEFORMATIONS, *MOTIONS, "N", "kN", "kg", "K", "K2", "hPa", "%", "A"))


def test_its_units_are_known(case):
    for p in (*case.term.linear(), *case.term.nonlinear()):
        parts = set(re.findall(r"[^ /()]+", p.unit)) if p.unit not in UNITS else set()
        unknown = parts - UNITS - {f"{u}{n}" for u in UNITS for n in (2, 3)}
        assert not unknown, f"{p.name} is in {p.unit!r}: {sorted(unknown)} is none of {', '.join(sorted(UNITS))}"


def test_no_parameters_no_deviation(case):
    assert_allclose(basis(case) @ np.zeros(len(case.term.linear())), 0.0, atol=0)


def test_its_linear_parameters_are_identifiable(case):
    columns = basis(case)
    size = np.linalg.norm(columns, axis=0)
    assert (size > 0).all()
    assert np.linalg.matrix_rank(columns / size) == columns.shape[1]


def test_plain_data_give_the_term_back(case):
    assert type(case.term).model_validate(plain(case.term)) == case.term


@pytest.mark.parametrize("stretch", [1.0, 1.05], ids=["", "beyond its span"])
def test_the_compiled_form_says_the_same(case, stretch):
    lowered = case.term.lower(case.parameters)
    if lowered is None:
        return
    assert case.term.compensable
    recording = _stretched(case.recording, stretch)
    total = np.zeros(len(recording))
    for pair in lowered:
        at = np.zeros(len(total)) if pair.axis is None else position(recording, pair.axis)
        profile = 1.0 if pair.profile is None else pair.profile(at)
        total = total + profile * drive(pair.driver, recording)
    value = case.term.value(recording, case.parameters)
    assert_allclose(total, value, rtol=1e-9, atol=1e-9 * np.abs(value).max())


def _stretched(recording, by):
    """The recording with all its positions further from their middle."""
    middle = {n: recording.array(n).mean() for n in recording.names("position")}
    return recording.with_columns({n: m + by * (recording.array(n) - m) for n, m in middle.items()}, {})


def test_its_equation_for_simulations_says_the_same(case):
    """Also of friction and forces, which no controller compensates; curves are tables of a driver, hence 1e-4.

    A spike that has not died away at the next reversal (here 6 % are left) is smaller by that in its equation.
    """
    pairs = case.term.equation(case.parameters)
    if pairs is None:
        return
    total = np.zeros(len(case.recording))
    for pair in pairs:
        if not isinstance(pair, Lowered):
            total = total + pair.value(case.recording)
            continue
        profile = 1.0 if pair.profile is None else pair.profile(position(case.recording, pair.axis))
        total = total + profile * drive(pair.driver, case.recording)
    value = case.term.value(case.recording, case.parameters)
    near = 0.07 if case.term.term == "reversal_spike" else 1e-4
    assert_allclose(total, value, rtol=0, atol=near * np.abs(value).max())


def test_what_is_compiled_knows_nothing_of_what_comes(case):
    if case.term.lower(case.parameters) is None:
        return
    rows = np.arange(len(case.recording)) < 300
    assert_allclose(basis(case, case.recording.take(rows)), basis(case)[rows], rtol=1e-12, atol=1e-12)


def difference(case, values, j: int, step: float) -> np.ndarray:
    """Central difference of the basis over one non-linear parameter, (rows, linear)."""
    up, down = (basis(case, values=[*values[:j], values[j] + s, *values[j + 1 :]]) for s in (step, -step))
    return (up - down) / (2 * step)


def test_a_basis_changes_smoothly_with_its_parameters(case):
    values = case.term.nonlinear_values(case.parameters)
    if not values or hasattr(case.term, "shared"):
        return
    for j, value in enumerate(values):
        narrow, wide = (difference(case, values, j, share * max(abs(value), 1e-6)) for share in (1e-7, 1e-6))
        # a threshold (a switch, a sample) makes a basis jump: compare where most rows are
        off = np.abs(narrow - wide) > 1e-2 * np.abs(wide).max() + 1e-12
        assert off.mean() < 0.02


def test_a_fixed_parameter_is_not_solved_for(case):
    if not case.term.nonlinear():
        return
    fixed = {p.name: case.parameters[p.name] for p in case.term.nonlinear()}
    term = case.term.model_copy(update={"fixed": fixed})
    assert term.free() == ()
    linear = {p.name: case.parameters[p.name] for p in term.linear()}
    assert_allclose(
        term.value(case.recording, linear), case.term.value(case.recording, case.parameters), rtol=0, atol=0
    )


def test_it_names_its_columns_and_reads_no_other(case):
    if not case.term.compensable:  # an artefact names the one column that tells, and may read more
        return
    drivers = case.term.drivers(case.recording)
    columns = case.recording.manifest.columns
    assert set(drivers) <= set(columns)
    others = [n for n, c in columns.items() if n not in drivers and c.role not in ("run", "time")]
    shifted = {name: case.recording.array(name)[::-1] for name in others}
    other = case.recording.with_columns(shifted, {})
    assert_allclose(basis(case, other), basis(case), rtol=0, atol=0)


def test_sizes_lie_within_bounds_and_have_units(case):
    for p in (*case.term.linear(), *case.term.nonlinear()):
        assert p.unit and p.bounds[0] <= p.typical[0] <= p.typical[1] <= p.bounds[1], p.name


def test_the_page_in_the_paper(case):
    """Equation, assumptions, sizes, direction and source stand in the docstring."""
    text = inspect.getdoc(type(case.term)) or ""
    assert text != inspect.getdoc(Term)
    for word in ("Equation", "Assumes", "Typical", "Moves", "Source"):
        assert f"\n{word}" in text, word


def test_a_sentence_for_people(case):
    said = case.term.sentence(case.parameters)
    assert said and "nan" not in said and "{" not in said
