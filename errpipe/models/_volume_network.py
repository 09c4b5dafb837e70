"""The network of `neural_volume` as arrays: trained, selected by held-out groups, and as nodes of a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from sklearn.neural_network import MLPRegressor

from errpipe.domain import driver as d
from errpipe.domain.error_model import ComponentModel, ErrorModel
from errpipe.domain.recording import Recording
from errpipe.drivers.shared import drive_all
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.design import response_name
from errpipe.fitting.parallel import no_warnings
from errpipe.fitting.validity import box
from errpipe.terms import fitted_term
from errpipe.terms.profile_driver import ProfileDriver

PENALTIES = (1e-3, 1e-2, 1e-1, 1.0)  # of squared weights, on standardised columns; selected by held-out groups
MOST_ROWS = 3000  # training rows, evenly thinned
MOST_STEPS = 300  # iterations of L-BFGS
REACH, STEPS = 4.0, 129  # the table of tanh ends at 0.9993; its linear interpolation is within 0.0004
SPAN_BEYOND = 0.25  # share of the span of deviations by which a prediction may exceed them


class Network(NamedTuple):
    """outer @ tanh(inputs / size @ inner + bias) + zero: (columns, units), (units,), (units, components), um."""

    centre: np.ndarray
    size: np.ndarray
    inner: np.ndarray
    bias: np.ndarray
    outer: np.ndarray
    zero: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def values(self, x: np.ndarray) -> np.ndarray:
        """Deviations at inputs (rows, columns), (rows, components), um."""
        hidden = np.tanh((x - self.centre) / self.size @ self.inner + self.bias)
        return np.clip(hidden @ self.outer + self.zero, self.low, self.high)


def data(recording: Recording, components: Sequence[str]) -> tuple[np.ndarray, np.ndarray, list[d.Driver]]:
    """Inputs (rows, columns), deviations (rows, components), um, and the inputs as drivers."""
    places = positions(recording)
    if not places:
        raise DataError("neural_volume: the recording has no column of role position (needed: one for each axis)")
    drivers: list[d.Driver] = [d.Input(name=n) for n in places]
    drivers += [d.rise(n) for n in recording.names("temperature")]
    y = np.column_stack([recording.array(response_name(recording, c)) for c in components])
    return drive_all(drivers, recording), y, drivers


def chosen(
    recording: Recording, x: np.ndarray, y: np.ndarray, rows: np.ndarray, units: int
) -> tuple[Network, float | None]:
    """The network of the rows of a mask and its penalty; None and a zero network if no penalty improves."""
    good = rows & np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    if not good.any():
        raise DataError(
            "neural_volume: no row has a value of every position, temperature and component (give a column that is "
            "mostly empty the role ignore)"
        )
    number = np.flatnonzero(good)
    x, y = x[number], y[number]
    none = _nothing(x, y)
    try:
        folds = holdout.groups(recording.take(number), "auto")
    except DataError:  # a single group: nothing can be validated
        return none, None
    left: dict[float | None, float] = {None: 0.0, **dict.fromkeys(PENALTIES, 0.0)}
    for fold in folds:
        left[None] += float(np.sum(y[fold.test] ** 2))
        for penalty in PENALTIES:
            network = _trained(x[fold.train], y[fold.train], units, penalty)
            left[penalty] += float(np.sum((y[fold.test] - network.values(x[fold.test])) ** 2))
    best = min(left, key=lambda penalty: left[penalty])
    return (none if best is None else _trained(x, y, units, best)), best


def error_model(
    recording: Recording,
    components: Sequence[str],
    network: Network,
    x: np.ndarray,
    y: np.ndarray,
    drivers: Sequence[d.Driver],
) -> ErrorModel:
    """The network as one driver for each component."""
    good = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    left = y - network.values(x)
    units = [_unit(network, drivers, k) for k in range(network.bias.size)]
    parts = []
    for k, component in enumerate(components):
        parts.append(
            ComponentModel(
                component=component,
                terms=(fitted_term(ProfileDriver(driver=(_output(network, units, k),)), [1.0], "um"),),
                rows=int(np.count_nonzero(good)),
                rms_before=float(np.sqrt(np.mean(y[good, k] ** 2))),
                rms_after=float(np.sqrt(np.mean(left[good, k] ** 2))),
                limit=float(max(abs(network.low[k]), abs(network.high[k]))),
            )
        )
    names = columns(recording)
    axes = [n for n, c in recording.manifest.constants.items() if c.role == "axis"]
    return ErrorModel.of(recording.manifest, names, axes, components=tuple(parts), validity=box(recording, names, good))


def positions(recording: Recording) -> list[str]:
    """One column per axis, commanded if available."""
    axes = {recording.manifest.columns[n].axis: n for n in recording.names("position")}
    axes |= {recording.manifest.columns[n].axis: n for n in recording.names("command")}
    return [name for _, name in sorted(axes.items(), key=lambda item: str(item[0]))]


def columns(recording: Recording) -> list[str]:
    """Columns that are inputs of the network."""
    return [*positions(recording), *recording.names("temperature")]


def _limits(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.minimum(y.min(axis=0), 0.0), np.maximum(y.max(axis=0), 0.0)
    return low - SPAN_BEYOND * (high - low), high + SPAN_BEYOND * (high - low)


def _nothing(x: np.ndarray, y: np.ndarray) -> Network:
    """A network whose output is always zero."""
    wide, many = x.shape[1], y.shape[1]
    inner, outer = np.zeros((wide, 1)), np.zeros((1, many))
    return Network(np.zeros(wide), np.ones(wide), inner, np.zeros(1), outer, np.zeros(many), *_limits(y))


def _trained(x: np.ndarray, y: np.ndarray, units: int, penalty: float) -> Network:
    """Penalised least squares; equal data give equal networks."""
    few = slice(None, None, max(1, len(x) // MOST_ROWS))
    centre, size = x.mean(axis=0), x.std(axis=0)
    size = np.where(size > 0, size, 1.0)
    scale = float(np.sqrt(np.mean(y**2))) or 1.0
    net = MLPRegressor(
        hidden_layer_sizes=(units,),
        activation="tanh",
        solver="lbfgs",
        alpha=penalty,
        max_iter=MOST_STEPS,
        random_state=0,
    )
    target = y[few] / scale
    with no_warnings():  # reaching MOST_STEPS is intended
        net.fit((x[few] - centre) / size, target[:, 0] if y.shape[1] == 1 else target)
    outer, zero = net.coefs_[1] * scale, net.intercepts_[1] * scale
    return Network(centre, size, net.coefs_[0], net.intercepts_[0], outer, zero, *_limits(y))


def _unit(network: Network, drivers: Sequence[d.Driver], number: int) -> d.Driver:
    """One hidden unit: a weighted sum of the inputs through a table of tanh, held at its ends."""
    grid = np.linspace(-REACH, REACH, STEPS)
    weights = network.inner[:, number] / network.size
    offset = float(network.bias[number] - network.centre @ weights)
    inside = d.Affine(offset=offset, weights=tuple(map(float, weights)), of=tuple(drivers))
    return d.Lookup(of=inside, start=-REACH, step=float(grid[1] - grid[0]), values=tuple(map(float, np.tanh(grid))))


def _output(network: Network, units: Sequence[d.Driver], number: int) -> d.Driver:
    """One component, within its limits."""
    total = d.Affine(
        offset=float(network.zero[number]), weights=tuple(map(float, network.outer[:, number])), of=tuple(units)
    )
    return d.Clip(of=total, low=float(network.low[number]), high=float(network.high[number]))
