"""The evidence of a column: large for the truth, small for noise, the same fold by fold as at once."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from errpipe.diagnosis.coloured import Colour, correlation_time, whiten
from errpipe.diagnosis.evidence import ActiveSet, Data, Scene, ScoredHypotheses, Table, averaged, textbook_share
from errpipe.diagnosis.hypotheses import rms_and_spread
from errpipe.kernels import noise


def table(rng, n=400, k=6):
    columns = rng.standard_normal((n, k))
    fold = np.arange(n) * 5 // n
    return columns, Table(np.zeros(n, dtype=int), [columns, np.ones((n, 1))], fold)


def scene(made, y):
    return Scene(Data(made, y), ActiveSet(np.array([6]), np.array([np.inf])), 1.0)


def test_the_true_column_wins_and_noise_pays():
    rng = np.random.default_rng(0)
    columns, made = table(rng)
    y = 0.6 * columns[:, 2] + rng.standard_normal(400)
    gains = list(scene(made, y).gains([np.array([i]) for i in range(6)], [np.ones(1)] * 6))
    assert np.argmax(gains) == 2
    assert gains[2] > 30
    assert max(g for i, g in enumerate(gains) if i != 2) < 3


def test_hypotheses_of_all_widths_at_once_have_the_evidence_of_each():
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((400, 40)) @ np.diag(np.geomspace(0.1, 10, 40))
    columns[:, 7] = columns[:, 3] - columns[:, 5]  # what two others say already
    made = Table(np.zeros(400, dtype=int), [columns, np.ones((400, 1))], np.arange(400) * 5 // 400)
    y = columns[:, 3] + columns[:, 30:] @ rng.standard_normal(10) + rng.standard_normal(400)
    beside = Scene(Data(made, y), ActiveSet(np.array([40, 30, 31]), np.array([np.inf, 2.0, 0.5])), 1.1)
    index = [np.arange(3, 3 + w) for w in (1, 2, 3, 6, 37)]
    freedom = [rng.uniform(0.05, 1.0, i.size) for i in index]
    gain, size, core = beside.scores(ScoredHypotheses(index, freedom, [1, 1, 2, 4, 20]), rows=300.0)
    for k, i in enumerate(index):
        half = np.linalg.solve(beside.chol, beside.with_active(i))
        S, s = made.whitened[:, i].T @ made.whitened[:, i] - half.T @ half, beside.Zy_all[i] - half.T @ beside.half
        S, s = S * freedom[k][:, None] * freedom[k], freedom[k] * s
        assert_allclose(gain[k], averaged(S[None], s[None, :, None], np.array([beside.Q]), 300.0)[0, 0], rtol=1e-6)
        b = np.linalg.solve(S + np.eye(i.size) / size[k] ** 2, s)
        assert_allclose(core[k], textbook_share(freedom[k] * b, [1, 1, 2, 4, 20][k]), rtol=1e-6)


def test_columns_are_whitened_one_by_one_as_side_by_side():
    rng = np.random.default_rng(11)
    for count, rows, runs in ((1, 1, 1), (2, 7, 7), (5, 300, 4), (9, 1000, 1)):
        columns, run = rng.standard_normal((count, rows)), np.sort(rng.integers(0, runs, rows))
        out, known = np.empty_like(columns), Colour(12.0, 0.3).filter()
        noise.whiten_each(run, columns, out, *known)
        assert out.tobytes() == noise.whiten(run, np.ascontiguousarray(columns.T), *known).T.tobytes()


def test_a_fingerprint_distinguishes_columns_that_differ_in_a_bit_a_sign_or_their_order():
    column = np.random.default_rng(12).standard_normal(1003)
    alike = [column]
    for k in range(column.size):
        alike += [column.copy(), column.copy()]
        alike[-2][k], alike[-1][k] = np.nextafter(column[k], 9.0), -column[k]
    for a, b in ((0, 1), (0, 4), (3, 900), (1001, 1002)):
        alike.append(column.copy())
        alike[-1][[a, b]] = column[[b, a]]
    assert len({noise.fingerprint(c) for c in alike}) == len(alike)
    assert noise.fingerprint(column.copy()) == noise.fingerprint(column)


def test_sizes_of_columns_have_the_bits_of_numpy():
    rng = np.random.default_rng(13)
    for shape in ((5, 1), (400, 1), (1000, 2), (999, 7)):
        columns = rng.standard_normal(shape) * np.geomspace(1e-3, 1e3, shape[1]) + 5.0
        rms, spread = rms_and_spread(columns)
        assert rms.tobytes() == np.sqrt(np.mean(columns**2, axis=0)).tobytes()
        assert spread.tobytes() == columns.std(axis=0).tobytes()


def test_columns_added_later_have_the_same_products():
    rng = np.random.default_rng(6)
    _, made = table(rng)
    more = rng.standard_normal((400, 600))  # more than there is room for
    asked = np.array([6, 2, 4])
    made.form_products(asked[:2])
    made.add(more[:, :5])
    made.form_products(asked)
    made.add(more[:, 5:])
    every = np.arange(made.width)
    for without, W in ((None, made.whitened), (2, made.whitened[made.fold != 2])):
        assert_allclose(made.products(asked, every, without), W[:, asked].T @ W, rtol=1e-9, atol=1e-9)
        assert_allclose(made.products_among(asked, without), W[:, asked].T @ W[:, asked], rtol=1e-9, atol=1e-9)


def test_products_are_formed_anew_for_another_noise_and_after_columns_are_forgotten():
    rng = np.random.default_rng(7)
    _, made = table(rng)
    asked, fresh = np.array([1, 5, 6]), rng.standard_normal((400, 3))
    for change in (lambda: made.recolour(Colour(20.0, 0.9)), lambda: made.truncate(7)):
        made.add(fresh)
        made.form_products(asked)
        made.products_among(asked)
        change()
        made.add(fresh[:, 1:])
        W = made.whitened[made.fold != 1]
        assert_allclose(made.products(asked, np.arange(made.width), 1), W[:, asked].T @ W, rtol=1e-9, atol=1e-9)
        assert_allclose(made.products_among(asked, 1), W[:, asked].T @ W[:, asked], rtol=1e-9, atol=1e-9)


def test_on_noise_alone_no_column_gains():
    rng = np.random.default_rng(1)
    best = []
    for _ in range(60):
        _, made = table(rng)
        scored = scene(made, rng.standard_normal(400)).gains([np.array([i]) for i in range(6)], [np.ones(1)] * 6)
        best.append(max(scored))
    assert np.mean(np.array(best) > 5) < 0.05


def test_white_noise_with_a_slow_share_is_made_white():
    rng = np.random.default_rng(2)
    n, phi = 20000, np.exp(-1 / 8)
    slow = np.zeros(n)
    for i in range(1, n):
        slow[i] = phi * slow[i - 1] + np.sqrt(1 - phi**2) * rng.standard_normal()
    y = np.sqrt(0.94) * rng.standard_normal(n) + np.sqrt(0.06) * slow
    w = whiten(y, np.zeros(n, dtype=int))
    assert_allclose(np.std(w), 1.0, rtol=0.02)
    assert abs(np.corrcoef(w[1:], w[:-1])[0, 1]) < 0.02


def test_a_fold_left_out_is_as_if_it_had_not_been_there():
    rng = np.random.default_rng(3)
    columns, made = table(rng)
    y = columns[:, 1] + rng.standard_normal(400)
    data = Data(made, y).hold_out(0)
    rows = made.rows[0]
    keep = np.setdiff1d(np.arange(400), rows)
    every = np.arange(made.width)
    assert_allclose(
        made.products(every, every, data.without), made.whitened[keep].T @ made.whitened[keep], rtol=1e-9, atol=1e-9
    )
    assert_allclose(data.products(), made.whitened[keep].T @ data.y[keep], rtol=1e-9, atol=1e-9)
    assert data.n == keep.size


def test_correlation_time_of_white_and_of_slow_noise():
    rng = np.random.default_rng(4)
    white = rng.standard_normal(5000)
    slow = np.convolve(rng.standard_normal(5100), np.ones(20) / 20, mode="valid")[:5000]
    run = np.zeros(5000, dtype=int)
    assert correlation_time(white, run) < 1.5
    assert 12 < correlation_time(slow, run) < 30
