"""What terms of several orders of one wave share: parameters, columns, the orders that a recording shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated

import numpy as np

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import is_rotary, position
from errpipe.terms._base import Parameter
from errpipe.terms._lines import (
    FEW_PLACES,
    MULTIPLES,
    at_targets,
    harmonic_series,
    harmonics_of_few_places,
    lines,
    waves,
)
from errpipe.terms._search import Signals
from errpipe.terms._slack import Slack, higher_harmonics, uneven_waves
from errpipe.yamlfile import quantity

TURN, NEARLY = 360.0, 0.95  # deg; share of a turn from which its orders are distinguished,
BENT = 0.5  # and from which the bend of its first order shows


Orders = Annotated[
    tuple[float, ...], quantity("1", "Multiples of a base; the period is that of the first one.", min_length=1)
]


def named(orders: tuple[float, ...], unit: str, typical: tuple[float, float], bound: float) -> tuple[Parameter, ...]:
    """Sine and cosine of each order; those of the first one without a number."""
    out = []
    for k in orders:
        tail, which = ("", "") if k == orders[0] else (f"_{k:g}", f" of order {k:g}")
        for part in ("sine", "cosine"):
            out.append(Parameter(part + tail, unit, typical, (-bound, bound), f"amplitude of the {part} part{which}"))
    return tuple(out)


def columns(x: np.ndarray, period: float, orders: tuple[float, ...]) -> np.ndarray:
    """Sine and cosine of each order, shape (rows, 2 orders); period: of the first one."""
    return np.column_stack([waves(np.asarray(x, dtype=float), k / orders[0] / period) for k in orders])


def total(x: np.ndarray, period: float, orders: tuple[float, ...], parameters: Mapping[str, float]) -> np.ndarray:
    """Sum of all orders, shape of x."""
    gains = [parameters[p.name] for p in named(orders, "um", (0.0, 0.0), np.inf)]
    return columns(x, period, orders) @ np.array(gains)


def log_prior_odds(orders: tuple[float, ...], known: bool) -> float:
    """The strongest of about a hundred waves is chosen; a further order is one of about twenty. known: the period.

    Its first multiples are not chosen: a wave that is no sine has them.
    """
    chosen = sum(k / orders[0] not in MULTIPLES for k in orders[1:])
    return (0.0 if known else -3.0) - 3.0 * chosen - 1.0 * (len(orders) - 1 - chosen)


def slack(base: np.ndarray, x: np.ndarray, period: float, alone: bool) -> Slack:
    """Departures of waves (rows, k) along x; alone: of one order and a searched period, so that others may be seen."""
    yield from uneven_waves(base, x)
    if alone:
        yield from higher_harmonics(x, period)


def lowered(axis: str, period: float, orders: tuple[float, ...], parameters: Mapping[str, float]) -> Lowered:
    """All orders as one profile over the axis that repeats."""
    return Lowered(ONE, axis, lambda x: total(x, period, orders, parameters), period)


def full_turn(recording: Recording, axis: str, share: float = BENT) -> tuple[float, ...]:
    """One turn of a rotary axis that made more than this share of one, after which all repeats."""
    return (TURN,) if is_rotary(recording, axis) and np.ptp(position(recording, axis)) > share * TURN else ()


def visible_orders(
    recording: Recording, axis: str, signals: Signals, known: tuple[float, ...] = ()
) -> Iterator[tuple[float, tuple[float, ...], bool]]:
    """Waves along an axis of which the mismatch shows more than one order: period of the first, orders, is it known?

    The first order is the strongest. known: periods stated; one turn of a rotary axis always is.
    """
    x = at_targets(position(recording, axis)[signals.rows])
    if not signals.values or not np.isfinite(x).all():
        return
    if np.unique(x).size <= FEW_PLACES:
        yield from ((1.0 / f, orders, False) for f, orders in harmonics_of_few_places(x, signals.values[0]))
        return
    span, turned = float(np.ptp(x)), (*known, *full_turn(recording, axis, NEARLY))
    for base, orders, stated in harmonic_series(lines(x, signals.values[0]), span, [1.0 / p for p in turned]):
        yield 1.0 / base / orders[0], orders, stated
