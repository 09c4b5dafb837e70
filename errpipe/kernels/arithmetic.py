"""exp, ln and power from + - * / and comparisons alone, so that every evaluator gets the same bits.

A controller has no mathematics library that all agree on: these three are written out, step by step, in
`schemas/ect-2.md`; the same steps stand in `ect.c` and in the function block. Plain Python: the reference evaluator
calls it as it is, `elementary.py` compiles it.
Errors against the true value, measured in tests: exp 1 ulp, ln 3 ulp, power 1e-14 relative.
"""

from __future__ import annotations

LOG2_E = 1.4426950408889634  # 1 / ln 2, rounded to double
LN2_HIGH = 0.6931471803691238  # ends in enough zero bits for n * LN2_HIGH to be exact here
LN2_LOW = 1.9082149292705877e-10  # the rest of ln 2
SQRT2 = 1.4142135623730951  # of the mantissa: ln is taken of 1/sqrt(2) to sqrt(2)
LARGEST_EXPONENT = 700.0  # exp(709.8) overflows
SMALLEST_BASE = 1e-30  # power() is 0 below it, also in single precision

# 1/13!, 1/12!, ... 1/1!, 1/0!
EXP = (
    1.6059043836821613e-10,
    2.08767569878681e-09,
    2.505210838544172e-08,
    2.755731922398589e-07,
    2.7557319223985893e-06,
    2.48015873015873e-05,
    0.0001984126984126984,
    0.001388888888888889,
    0.008333333333333333,
    0.041666666666666664,
    0.16666666666666666,
    0.5,
    1.0,
    1.0,
)
# 1/21, 1/19, ... 1/3, 1
LN = (
    0.047619047619047616,
    0.05263157894736842,
    0.058823529411764705,
    0.06666666666666667,
    0.07692307692307693,
    0.09090909090909091,
    0.1111111111111111,
    0.14285714285714285,
    0.2,
    0.3333333333333333,
    1.0,
)


def exp(y: float) -> float:
    """e**y; 0 below -700, e**700 above 700."""
    if y < -LARGEST_EXPONENT:
        return 0.0
    if y > LARGEST_EXPONENT:
        y = LARGEST_EXPONENT
    n = int(y * LOG2_E + 0.5) if y >= 0.0 else int(y * LOG2_E - 0.5)
    r = (y - n * LN2_HIGH) - n * LN2_LOW
    p = EXP[0]
    for i in range(1, 14):
        p = p * r + EXP[i]
    w = 2.0 if n >= 0 else 0.5
    m = n if n >= 0 else -n
    while m > 0:
        if m & 1:
            p = p * w
        w = w * w
        m = m >> 1
    return p


def ln(a: float) -> float:
    """Natural logarithm of a >= 1e-30."""
    k = 0
    e = 512
    while e > 0:
        w = two_to(e)
        if a >= w:
            a = a / w
            k = k + e
        e = e >> 1
    if a < 1.0:
        e = 512
        while e > 0:
            w = two_to(e)
            if a * w < 2.0:
                a = a * w
                k = k - e
            e = e >> 1
    if a > SQRT2:
        a = a * 0.5
        k = k + 1
    s = (a - 1.0) / (a + 1.0)
    z = s * s
    p = LN[0]
    for i in range(1, 11):
        p = p * z + LN[i]
    return k * LN2_HIGH + (2.0 * s * p + k * LN2_LOW)


def two_to(e: int) -> float:
    """2**e for e a power of two up to 512."""
    w = 2.0
    while e > 1:
        w = w * w
        e = e >> 1
    return w


def power(u: float, exponent: float) -> float:
    """sign(u) * |u|**exponent; 0 where |u| < 1e-30; products for the exponents 1, 2 and 3."""
    a = -u if u < 0.0 else u
    if a < SMALLEST_BASE:
        return 0.0
    if exponent == 1.0:
        p = a
    elif exponent == 2.0:
        p = a * a
    elif exponent == 3.0:
        p = a * a * a
    else:
        p = exp(exponent * ln(a))
    return -p if u < 0.0 else p
