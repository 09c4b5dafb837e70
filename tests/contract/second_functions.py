"""EXP, LN and POWER of the compensation table, from section 9 of `schemas/ect-2.md`, in binary64 and in binary32."""

import math
import struct
from typing import Any, Self


class Single(float):
    """A number of binary32: each operation rounds once (section 9)."""

    def __new__(cls, x: Any) -> Self:
        """The nearest number of binary32."""
        try:
            return super().__new__(cls, struct.unpack("<f", struct.pack("<f", x))[0])
        except OverflowError:
            return super().__new__(cls, math.copysign(math.inf, x))

    def __add__(self, other: Any) -> "Single":
        return Single(float(self) + float(Single(other)))

    def __sub__(self, other: Any) -> "Single":
        return Single(float(self) - float(Single(other)))

    def __rsub__(self, other: Any) -> "Single":
        return Single(float(Single(other)) - float(self))

    def __mul__(self, other: Any) -> "Single":
        return Single(float(self) * float(Single(other)))

    def __truediv__(self, other: Any) -> "Single":
        return Single(float(self) / float(Single(other)))

    def __rtruediv__(self, other: Any) -> "Single":
        return Single(float(Single(other)) / float(self))

    def __neg__(self) -> "Single":
        return Single(-float(self))

    def __abs__(self) -> "Single":
        return Single(abs(float(self)))

    __radd__, __rmul__ = __add__, __mul__


def exp(y: float) -> float:
    """Section 9, EXP."""
    single = isinstance(y, Single)
    limit, degree = (80, 7) if single else (700, 13)
    high, low = (0.693359375, -2.12194440e-4) if single else (0.6931471803691238, 1.9082149292705877e-10)
    if y < -limit:
        return type(y)(0)
    y = type(y)(limit) if y > limit else y
    scaled = y * 1.4426950408889634
    n = math.trunc(scaled + 0.5 if y >= 0 else scaled - 0.5)
    r = (y - n * high) - n * type(y)(low)
    p = type(y)(1 / math.factorial(degree))
    for i in range(degree - 1, -1, -1):
        p = p * r + 1 / math.factorial(i)
    w, m = type(y)(2.0 if n >= 0 else 0.5), abs(n)
    while m > 0:
        if m % 2:
            p = p * w
        w, m = w * w, m // 2
    return p


def ln(x: float) -> float:
    """Section 9, LN, for x >= 1e-30."""
    single = isinstance(x, Single)
    steps = [2**i for i in range(6 if single else 9, -1, -1)]
    high, low = (0.693359375, -2.12194440e-4) if single else (0.6931471803691238, 1.9082149292705877e-10)
    k = 0
    for e in steps:
        if x >= 2.0**e:
            x, k = x / 2.0**e, k + e
    if x < 1:
        for e in steps:
            if x * 2.0**e < 2:
                x, k = x * 2.0**e, k - e
    if x > 1.4142135623730951:
        x, k = x * 0.5, k + 1
    s = (x - 1) / (x + 1)
    z = s * s
    degree = 9 if single else 21
    p = type(x)(1 / degree)
    for i in range(degree - 2, 0, -2):
        p = p * z + 1 / i
    whole = type(x)(k)
    return whole * high + ((2 * s) * p + whole * low)


def power(u: float, e: float) -> float:
    """Section 9, POWER."""
    x = abs(u)
    if x < 1e-30:
        return type(x)(0)
    if e == 1:
        p = x
    elif e == 2:
        p = x * x
    elif e == 3:
        p = (x * x) * x
    else:
        p = exp(e * ln(x))
    return -p if u < 0 else p
