"""Evidence of many hypotheses at once: what columns see beside active ones, and how likely they are at every size."""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel

AT_ONCE = 64  # columns that stay in the fastest memory while they are worked on


@kernel
def freed(chol, cross, half, products):
    """Columns freed of the active ones: chol^-1 cross into `cross` (m, c), and products - cross.T @ half, shape (c,).

    chol: lower Cholesky factor (m, m) of the active columns; cross: their products with the columns.
    """
    m, count = cross.shape
    left = products.copy()
    for first in range(0, count, AT_ONCE):
        last = min(first + AT_ONCE, count)
        for i in range(m):
            for j in range(i):
                factor = chol[i, j]
                for c in range(first, last):
                    cross[i, c] -= factor * cross[j, c]
            scale = 1.0 / chol[i, i]
            for c in range(first, last):
                cross[i, c] *= scale
                left[c] -= cross[i, c] * half[i]
    return left


@kernel
def forward(chol, b):
    """chol^-1 b for a lower triangle (m, m)."""
    x = np.empty(b.size)
    for i in range(b.size):
        total = b[i]
        for j in range(i):
            total -= chol[i, j] * x[j]
        x[i] = total / chol[i, i]
    return x


@kernel
def backward(chol, b):
    """chol'^-1 b for a lower triangle (m, m)."""
    x = b.copy()
    for i in range(b.size - 1, -1, -1):
        x[i] /= chol[i, i]
        for j in range(i):
            x[j] -= chol[i, j] * x[i]
    return x


@kernel
def scores(which, where, starts, freedom, cores, places, blocks, half, seen, spare, rows, sizes):
    """Log Bayes factor over sizes, the size that fits best, and the textbook form's share at it, of hypotheses.

    which: hypotheses; where: position in `half` (m, c) and `seen` (c,) of every hypothesis' columns, flat as
    `freedom`; hypothesis k has entries starts[k] to starts[k + 1], its products `blocks` from places[k] on, and
    cores[k] columns of textbook form. spare: sum of squares that is left; rows: effective number of rows.

    S + I / size^2 is made tridiagonal once (Householder), so that each size costs a few divisions per column.
    """
    m, tried = half.shape[0], sizes.size
    widest = 1
    for k in which:
        widest = max(widest, starts[k + 1] - starts[k])
    S = np.empty((widest, widest))
    H = np.empty((m, widest))
    u, v, p = np.empty(widest), np.empty(widest), np.empty(widest)
    d, y, x = np.empty(widest), np.empty(widest), np.empty(widest)
    e, beta = np.zeros(widest), np.zeros(widest)
    found = np.empty(tried)
    gain, best, share = np.empty(which.size), np.empty(which.size), np.empty(which.size)
    for n in range(which.size):
        k = which[n]
        first, w = starts[k], starts[k + 1] - starts[k]
        at = places[k]
        for i in range(w):
            column, free = where[first + i], freedom[first + i]
            u[i] = free * seen[column]
            for r in range(m):
                H[r, i] = free * half[r, column]
            for j in range(w):
                S[i, j] = blocks[at + i * w + j]
        for r in range(m):
            for i in range(w):
                h = H[r, i]
                for j in range(w):
                    S[i, j] -= h * H[r, j]
        # tridiagonal: S = Q T Q', u becomes Q' u; each reflection stays in v, kept in the lower part of S
        for c in range(w - 2):
            beta[c] = 0.0
            norm = 0.0
            for i in range(c + 2, w):
                norm += S[i, c] * S[i, c]
            if norm == 0.0:
                e[c] = S[c + 1, c]
                continue
            top = S[c + 1, c]
            alpha = -np.sqrt(norm + top * top) if top > 0 else np.sqrt(norm + top * top)
            e[c] = alpha
            v[c + 1] = top - alpha
            for i in range(c + 2, w):
                v[i] = S[i, c]
            b = 2.0 / (norm + v[c + 1] * v[c + 1])
            beta[c] = b
            for j in range(c + 1, w):
                p[j] = 0.0
            for i in range(c + 1, w):
                factor = b * v[i]
                for j in range(c + 1, w):
                    p[j] += factor * S[i, j]
            inner = 0.0
            turned = 0.0
            for i in range(c + 1, w):
                inner += p[i] * v[i]
                turned += v[i] * u[i]
            inner *= 0.5 * b
            turned *= b
            for i in range(c + 1, w):
                p[i] -= inner * v[i]
                u[i] -= turned * v[i]
            for i in range(c + 1, w):
                vi, pi = v[i], p[i]
                for j in range(c + 1, w):
                    S[i, j] -= vi * p[j] + pi * v[j]
            for i in range(c + 1, w):
                S[i, c] = v[i]
        if w > 1:
            e[w - 2] = S[w - 1, w - 2]
        top_size = 0
        for t in range(tried):
            a2 = sizes[t] * sizes[t]
            least = 1.0 / a2
            pivot = max(S[0, 0] + least, least)
            came = u[0]
            took = came * came / pivot
            product, logs = a2 * pivot, 0.0
            for i in range(1, w):
                factor = e[i - 1] / pivot
                pivot = max(S[i, i] + least - e[i - 1] * factor, least)
                came = u[i] - factor * came
                took += came * came / pivot
                product *= a2 * pivot
                if product > 1e250:
                    logs += np.log(product)
                    product = 1.0
            left = max(spare - took, 1e-9 * spare)
            found[t] = -0.5 * (logs + np.log(product)) - 0.5 * rows * np.log(left / spare)
            if found[t] > found[top_size]:
                top_size = t
        total = 0.0
        for t in range(tried):
            total += np.exp(found[t] - found[top_size])
        gain[n] = found[top_size] + np.log(total / tried)
        best[n] = sizes[top_size]
        # coefficients at the best size
        least = 1.0 / (best[n] * best[n])
        d[0], y[0] = max(S[0, 0] + least, least), u[0]
        for i in range(1, w):
            factor = e[i - 1] / d[i - 1]
            d[i] = max(S[i, i] + least - e[i - 1] * factor, least)
            y[i] = u[i] - factor * y[i - 1]
        x[w - 1] = y[w - 1] / d[w - 1]
        for i in range(w - 2, -1, -1):
            x[i] = (y[i] - e[i] * x[i + 1]) / d[i]
        for c in range(w - 3, -1, -1):
            if beta[c] != 0.0:
                turned = 0.0
                for i in range(c + 1, w):
                    turned += S[i, c] * x[i]
                turned *= beta[c]
                for i in range(c + 1, w):
                    x[i] -= turned * S[i, c]
        core, slack = 0.0, 0.0
        for i in range(w):
            carried = freedom[first + i] * x[i]
            if i < cores[k]:
                core += abs(carried)
            else:
                slack += carried * carried
        share[n] = core / max(core + np.sqrt(slack), 1e-300)
    return gain, best, share
