"""Evidence of many hypotheses at once: what columns see beside active ones, and how likely they are at every size."""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel

AT_ONCE = 64  # columns that stay in the fastest memory while they are worked on


@kernel
def rms_and_spread(columns):
    """Rms and standard deviation of each of several columns (rows, k): the bits of numpy, in a tenth of its time.

    numpy adds a single column up in pairs, and several row by row.
    """
    rows, count = columns.shape
    total, squares, around = np.zeros(count), np.zeros(count), np.zeros(count)
    for i in range(rows):
        for j in range(count):
            total[j] += columns[i, j]
            squares[j] += columns[i, j] * columns[i, j]
    mean = total / rows
    for i in range(rows):
        for j in range(count):
            off = columns[i, j] - mean[j]
            around[j] += off * off
    return np.sqrt(squares / rows), np.sqrt(around / rows)


@kernel
def project_out(chol, cross, half, products):
    """Project the active columns out of others: chol^-1 cross into `cross` (m, c); products - cross.T @ half, (c,).

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
def _centred_on_active(first, width, where, freedom, block, half, seen, matrix, projected_half, products):
    """Fill `matrix` (w, w): a hypothesis' products beside the active columns, and `products` (w,): what it sees."""
    m = half.shape[0]
    for i in range(width):
        column, free = where[first + i], freedom[first + i]
        products[i] = free * seen[column]
        for r in range(m):
            projected_half[r, i] = free * half[r, column]
        for j in range(width):
            matrix[i, j] = block[i * width + j]
    for r in range(m):
        for i in range(width):
            h = projected_half[r, i]
            for j in range(width):
                matrix[i, j] -= h * projected_half[r, j]


@kernel
def _tridiagonal(width, matrix, products, off_diagonal, scale, v, p):
    """Householder: matrix = Q T Q' in place, products become Q' products; each reflection stays in the lower part.

    off_diagonal: of T (w - 1,); scale: 2 / |v|^2 of each reflection, 0 if there is none; v, p: work, (w,).
    """
    for c in range(width - 2):
        scale[c] = 0.0
        norm = 0.0
        for i in range(c + 2, width):
            norm += matrix[i, c] * matrix[i, c]
        if norm == 0.0:
            off_diagonal[c] = matrix[c + 1, c]
            continue
        top = matrix[c + 1, c]
        alpha = -np.sqrt(norm + top * top) if top > 0 else np.sqrt(norm + top * top)
        off_diagonal[c] = alpha
        v[c + 1] = top - alpha
        for i in range(c + 2, width):
            v[i] = matrix[i, c]
        scale[c] = 2.0 / (norm + v[c + 1] * v[c + 1])
        _reflect(c, width, matrix, products, scale[c], v, p)
    if width > 1:
        off_diagonal[width - 2] = matrix[width - 1, width - 2]


@kernel
def _reflect(c, width, matrix, products, b, v, p):
    """Apply the reflection v of column c from both sides to what is right of and below it."""
    for j in range(c + 1, width):
        p[j] = 0.0
    for i in range(c + 1, width):
        factor = b * v[i]
        for j in range(c + 1, width):
            p[j] += factor * matrix[i, j]
    inner = 0.0
    turned = 0.0
    for i in range(c + 1, width):
        inner += p[i] * v[i]
        turned += v[i] * products[i]
    inner *= 0.5 * b
    turned *= b
    for i in range(c + 1, width):
        p[i] -= inner * v[i]
        products[i] -= turned * v[i]
    for i in range(c + 1, width):
        vi, pi = v[i], p[i]
        for j in range(c + 1, width):
            matrix[i, j] -= vi * p[j] + pi * v[j]
    for i in range(c + 1, width):
        matrix[i, c] = v[i]


@kernel
def _log_evidence(width, matrix, off_diagonal, products, size, spare, rows):
    """Log Bayes factor of one size: a tridiagonal determinant and solve."""
    a2 = size * size
    least = 1.0 / a2
    pivot = max(matrix[0, 0] + least, least)
    came = products[0]
    took = came * came / pivot
    product, logs = a2 * pivot, 0.0
    for i in range(1, width):
        factor = off_diagonal[i - 1] / pivot
        pivot = max(matrix[i, i] + least - off_diagonal[i - 1] * factor, least)
        came = products[i] - factor * came
        took += came * came / pivot
        product *= a2 * pivot
        if product > 1e250:
            logs += np.log(product)
            product = 1.0
    left = max(spare - took, 1e-9 * spare)
    return -0.5 * (logs + np.log(product)) - 0.5 * rows * np.log(left / spare)


@kernel
def _coefficients(width, matrix, off_diagonal, scale, products, size, d, x):
    """Solve (T + 1 / size^2) x = products and turn x back by the reflections; d: work, (w,)."""
    least = 1.0 / (size * size)
    d[0], x[0] = max(matrix[0, 0] + least, least), products[0]
    for i in range(1, width):
        factor = off_diagonal[i - 1] / d[i - 1]
        d[i] = max(matrix[i, i] + least - off_diagonal[i - 1] * factor, least)
        x[i] = products[i] - factor * x[i - 1]
    x[width - 1] /= d[width - 1]
    for i in range(width - 2, -1, -1):
        x[i] = (x[i] - off_diagonal[i] * x[i + 1]) / d[i]
    for c in range(width - 3, -1, -1):
        if scale[c] != 0.0:
            turned = 0.0
            for i in range(c + 1, width):
                turned += matrix[i, c] * x[i]
            turned *= scale[c]
            for i in range(c + 1, width):
                x[i] -= turned * matrix[i, c]


@kernel
def scores(which, where, starts, freedom, cores, places, blocks, half, seen, spare, rows, sizes):
    """Log Bayes factor over sizes, the size that fits best, and the textbook form's share at it, of hypotheses.

    which: hypotheses; where: position in `half` (m, c) and `seen` (c,) of every hypothesis' columns, flat as
    `freedom`; hypothesis k has entries starts[k] to starts[k + 1], its products `blocks` from places[k] on, and
    cores[k] columns of textbook form. spare: sum of squares that is left; rows: effective number of rows.

    S + I / size^2 is made tridiagonal once (Householder), so that each size costs a few divisions per column.
    """
    tried, widest = sizes.size, 1
    for k in which:
        widest = max(widest, starts[k + 1] - starts[k])
    matrix, projected_half = np.empty((widest, widest)), np.empty((half.shape[0], widest))
    products, v, p, d, x = np.empty(widest), np.empty(widest), np.empty(widest), np.empty(widest), np.empty(widest)
    off_diagonal, scale = np.zeros(widest), np.zeros(widest)
    logs = np.empty(tried)
    gain, best, share = np.empty(which.size), np.empty(which.size), np.empty(which.size)
    for n in range(which.size):
        k = which[n]
        first, width = starts[k], starts[k + 1] - starts[k]
        block = blocks[places[k] : places[k] + width * width]
        _centred_on_active(first, width, where, freedom, block, half, seen, matrix, projected_half, products)
        _tridiagonal(width, matrix, products, off_diagonal, scale, v, p)
        for t in range(tried):
            logs[t] = _log_evidence(width, matrix, off_diagonal, products, sizes[t], spare, rows)
        top = np.argmax(logs)
        total = 0.0
        for t in range(tried):
            total += np.exp(logs[t] - logs[top])
        gain[n], best[n] = logs[top] + np.log(total / tried), sizes[top]
        _coefficients(width, matrix, off_diagonal, scale, products, best[n], d, x)
        core, slack = 0.0, 0.0
        for i in range(width):
            carried = freedom[first + i] * x[i]
            if i < cores[k]:
                core += abs(carried)
            else:
                slack += carried * carried
        share[n] = core / max(core + np.sqrt(slack), 1e-300)
    return gain, best, share
