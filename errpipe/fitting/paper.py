"""The component models of the 1997 paper as lists of terms, without the columns that its formulas hold twice.

As printed, E(p, T) = sum a_i p^i + p (s_0 + sum s_k dT_k + sum d_jk dT_j dT_k): a_1 p and s_0 p are one column, and so
are d_jk and d_kj. For four sensors and a quartic profile that makes 25 columns of rank 18. Here the profile keeps its
straight part, s_0 goes, and products are taken for j <= k.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement

from errpipe.terms import Line, Term
from errpipe.terms.chebyshev import Chebyshev
from errpipe.terms.offset import Offset
from errpipe.terms.profile_driver import Factor, ProfileDriver

REFERENCE = 20.0  # degC, ISO 1


def geometric(axis: str, degree: int = 4) -> tuple[Term, ...]:
    """What position alone decides: level and polynomial."""
    return (Offset(), Chebyshev(axis=axis, degree=degree))


def thermal(sensors: Sequence[str], *, products: bool = False, lag: bool = False) -> tuple[Term, ...]:
    """What temperature alone decides: rises over 20 degC, with `products` their products, with `lag` each one late."""
    return (Offset(), *(ProfileDriver(driver=f) for f in _factors(sensors, products, lag)))


def mixed(
    axis: str, degree: int, sensors: Sequence[str], *, products: bool = False, lag: bool = False
) -> tuple[Term, ...]:
    """A profile that stays and a slope that follows temperature: the separation the paper proposes."""
    slopes = (ProfileDriver(axis=axis, profile=Line(), driver=f) for f in _factors(sensors, products, lag))
    return (*geometric(axis, degree), *slopes)


def _factors(sensors: Sequence[str], products: bool, lag: bool) -> list[tuple[Factor, ...]]:
    single = [(Factor(input=s, reference=REFERENCE, lag=lag),) for s in sensors]
    pairs = combinations_with_replacement(sensors, 2) if products else ()
    return single + [tuple(Factor(input=s, reference=REFERENCE) for s in pair) for pair in pairs]
