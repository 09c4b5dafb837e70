"""From an error model to the smallest equivalent set of pairs of profile and driver.

Grids, integers and files are made by the compiler of tables.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.error_model import ComponentModel, ErrorModel
from errpipe.drivers.lowered import Lowered
from errpipe.fitting.components import term_of


def lower(model: ErrorModel) -> dict[str, list[Lowered]]:
    """Component -> pairs whose sum is the component's deviation, in its unit; nuisance is not among them.

    Profiles over the same axis with the same driver are added (all static ones become one curve), pairs without a
    profile become one affine driver. With datum `run_start` the pairs give the deviation before it is zeroed. Readings
    of the deviation come as an input of their own.
    """
    return {c.component: merge(_pairs(c)) for c in model.components}


def _scaled(pair: Lowered, gain: float) -> Lowered:
    if gain == 1.0:
        return pair
    return replace(pair, driver=d.Affine(weights=(gain,), of=(pair.driver,)))


def uncompensated_terms(model: ErrorModel) -> dict[str, list[str]]:
    """Component -> ids of fitted terms that a controller cannot or must not compensate, and that `lower` omits."""
    return {c.component: [f.term["term"] for f in c.terms if not _lowered(f)] for c in model.components}


def compensable(model: ErrorModel) -> ErrorModel:
    """The model with only the terms that `lower` keeps, and without the limits of a table's outputs."""
    parts = (
        c.model_copy(update={"terms": tuple(f for f in c.terms if _lowered(f)), "limit": None})
        for c in model.components
    )
    return model.model_copy(update={"components": tuple(parts)})


def _lowered(fitted) -> tuple[Lowered, ...]:
    term = term_of(fitted)
    return (term.lower(fitted.values()) or ()) if term.compensable else ()


def _pairs(component: ComponentModel) -> list[Lowered]:
    pairs = [_scaled(pair, component.gain) for fitted in component.terms for pair in _lowered(fitted)]
    if component.readings is None or not pairs:
        return pairs
    return [*pairs, _scaled(Lowered(d.Input(name=component.datum_input)), component.readings.share)]


def merge(pairs: Sequence[Lowered]) -> list[Lowered]:
    """The same sum with fewer pairs: curves with a driver first, in order of first use, then pairs without a curve."""
    curves: dict[tuple[str, str, float | None], list[Lowered]] = {}
    levels: list[Lowered] = []
    for pair in pairs:
        unit, gain = _unit(pair.driver)
        if pair.axis is None:
            levels.append(pair)
            continue
        key = (unit.model_dump_json(), pair.axis, pair.period)
        curves.setdefault(key, []).append(replace(pair, driver=unit, profile=_times(pair.profile, gain)))
    merged = [
        Lowered(g[0].driver, g[0].axis, _total([p.profile for p in g if p.profile]), g[0].period, common_nodes(g))
        for g in curves.values()
    ]
    return merged + _sum_of_levels(levels)


def common_nodes(pairs: Sequence[Lowered]) -> tuple[float, ...]:
    """The nodes between which a sum of profiles is linear; () if they differ."""
    return pairs[0].nodes if len({p.nodes for p in pairs}) == 1 else ()


def _unit(driver: d.Driver) -> tuple[d.Driver, float]:
    """A driver as a unit driver times a gain, so that equal drivers with different gains are merged."""
    if isinstance(driver, d.Constant):
        return d.ONE, driver.value
    if isinstance(driver, d.Affine) and driver.offset == 0.0 and len(driver.of) == 1 and driver.weights[0] != 0.0:
        inner, gain = _unit(driver.of[0])
        return inner, gain * driver.weights[0]
    return driver, 1.0


def _times(profile: Callable[[np.ndarray], np.ndarray] | None, gain: float) -> Callable[[np.ndarray], np.ndarray]:
    if profile is None:
        return lambda x: np.full(np.shape(x), gain)
    return profile if gain == 1.0 else lambda x: gain * np.asarray(profile(x))


def _total(profiles: Sequence[Callable[[np.ndarray], np.ndarray]]) -> Callable[[np.ndarray], np.ndarray]:
    if len(profiles) == 1:
        return profiles[0]
    return lambda x: np.sum([np.asarray(p(x)) for p in profiles], axis=0)


def _sum_of_levels(levels: Sequence[Lowered]) -> list[Lowered]:
    """Pairs without a curve as one affine driver of profile 1."""
    gains: dict[str, tuple[d.Driver, float]] = {}
    offset = 0.0
    for pair in levels:
        unit, gain = _unit(pair.driver)
        if pair.profile is not None:
            gain *= float(np.asarray(pair.profile(np.zeros(1))).ravel()[0])
        if unit == d.ONE:
            offset += gain
            continue
        key = unit.model_dump_json()
        gains[key] = (unit, gains.get(key, (unit, 0.0))[1] + gain)
    if not gains:
        return [Lowered(d.Constant(value=offset))] if levels else []
    weights, of = tuple(g for _, g in gains.values()), tuple(u for u, _ in gains.values())
    return [Lowered(d.Affine(offset=offset, weights=weights, of=of))]
