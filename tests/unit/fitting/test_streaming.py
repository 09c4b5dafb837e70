import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.errors import DataError, NotIdentifiable
from errpipe.fitting import streaming
from errpipe.fitting.streaming import StreamingFit, fit_chunks

UNITS = np.logspace(-4, 4, 8)  # columns of very different sizes, as um, rpm and K are


@pytest.fixture
def rows():
    rng = np.random.default_rng(1)
    design = rng.normal(size=(30_000, 8)) * UNITS
    return design, design @ (np.arange(8) / UNITS) + rng.normal(size=30_000)


def lstsq(design, y):
    """numpy's answer on columns of one size: on these it loses eight digits by itself."""
    return np.linalg.lstsq(design / UNITS, y, rcond=None)[0] / UNITS


def chunks(design, y, size):
    return ((design[i : i + size], y[i : i + size]) for i in range(0, y.size, size))


@pytest.mark.parametrize("size", [1, 999, 4096, 30_000])
def test_equals_lstsq_however_the_rows_are_cut(rows, size):
    design, y = rows[0][: 200 if size == 1 else None], rows[1][: 200 if size == 1 else None]
    found, inverse, left = fit_chunks(chunks(design, y, size))
    expected = lstsq(design, y)
    assert_allclose(found, expected, rtol=1e-10)
    assert_allclose(left, np.sum((y - design @ expected) ** 2), rtol=1e-10)
    scaled = design / UNITS
    assert_allclose(inverse * np.outer(UNITS, UNITS), np.linalg.inv(scaled.T @ scaled), rtol=1e-9, atol=1e-15)


def test_memory_does_not_grow_with_rows(rows):
    running = StreamingFit(8)
    for design, y in chunks(*rows, 1000):
        running.add(design, y)
        assert running._factor.shape == (9, 9)


def test_parts_fitted_apart_merge(rows):
    design, y = rows
    one, two = StreamingFit(8).add(design[:7000], y[:7000]), StreamingFit(8).add(design[7000:], y[7000:])
    assert_allclose(one.merge(two).solve()[0], lstsq(design, y), rtol=1e-10)
    assert one.rows == 30_000


def test_rows_with_a_gap_are_left_out(rows):
    design, y = rows[0][:500].copy(), rows[1][:500].copy()
    design[3, 2], y[7] = np.nan, np.nan
    keep = np.isfinite(y) & np.isfinite(design).all(axis=1)
    running = StreamingFit(8).add(design, y)
    assert running.rows == 498
    assert_allclose(running.solve()[0], lstsq(design[keep], y[keep]), rtol=1e-10)


def test_refuses_twins_and_too_few_rows(rows):
    design = np.column_stack([rows[0][:100, :2], rows[0][:100, 0]])
    with pytest.raises(NotIdentifiable, match="column 3 is a combination"):
        StreamingFit(3).add(design, rows[1][:100]).solve()
    with pytest.raises(NotIdentifiable, match="2 rows cannot tell 8 parameters"):
        StreamingFit(8).add(rows[0][:2], rows[1][:2]).solve()
    with pytest.raises(DataError, match="no rows"):
        fit_chunks([])
    with pytest.raises(DataError, match="for 8 columns"):
        StreamingFit(8).add(rows[0][:, :3], rows[1])


def test_cutting_does_not_change_a_bit_of_the_setting(rows, monkeypatch):
    a = fit_chunks(chunks(*rows, 10_000))[0]
    monkeypatch.setattr(streaming, "ROWS_AT_ONCE", 1000)
    assert_allclose(fit_chunks(chunks(*rows, 10_000))[0], a, rtol=1e-10)
