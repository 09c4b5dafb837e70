"""A settled table written out: a sum of products of curves over one axis each and of unknowns between -1 and 1.

Positions lie within given ranges and every other input within its validity (one without validity stands at its
default). Lags have reached their operand, references are those of a given state, every axis was approached from one
side. Curves are straight between the knots of their axis. An unknown represents an input (centre + half * unknown),
for a side (-1 or 1), or, where its name begins with `~`, for what a straight line misses; each of these is bounded,
so `maximum.largest` of an expansion is a bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from errpipe.domain import table as t
from errpipe.kernels.arithmetic import power
from errpipe.tables.reference import Evaluator

SIDE = "side "  # what the name of an axis' side begins with
MISSED = "~"
INPUT = "input "  # what the name of an input begins with that has knots as an axis has
MAX_CURVED_INPUTS = 2  # inputs that get knots; others are bounded by a straight line and what it misses
BENT_KNOTS = 129  # over a validity: a parabola is within 2e-5 of its height


@dataclass(frozen=True)
class Term:
    """factor x product of curves (axis -> values at the knots of that axis) x product of unknowns (sorted)."""

    factor: float
    curves: Mapping[str, np.ndarray] = field(default_factory=dict)
    unknowns: tuple[str, ...] = ()


Terms = list[Term]


def scaled(terms: Terms, factor: float) -> Terms:
    """factor x sum."""
    return [Term(factor * x.factor, x.curves, x.unknowns) for x in terms] if factor else []


def span(terms: Terms) -> tuple[float, float]:
    """Bounds of a sum, by interval arithmetic."""
    low = high = 0.0
    for x in terms:
        own = (x.factor, x.factor)
        for values in x.curves.values():
            corners = [a * b for a in own for b in (float(values.min()), float(values.max()))]
            own = min(corners), max(corners)
        if x.unknowns:
            size = max(abs(own[0]), abs(own[1]))
            own = -size, size
        low, high = low + own[0], high + own[1]
    return low, high


class Expansion:
    """Expansions of the outputs of a table.

    ranges: axis -> lowest and highest position, mm or deg; more: axis -> further knots, such as those of a controller's
    curve; state: readings in which references are latched; run_up: travel after which an axis has been approached, mm.
    """

    def __init__(
        self,
        ranges: Mapping[str, tuple[float, float]],
        more: Mapping[str, Sequence[np.ndarray]] | None = None,
        tables: Sequence[t.CompensationTable] = (),
        run_up: float = 2.0,
    ):
        self.run_up, self._missed = run_up, 0
        self.knots: dict[str, np.ndarray] = {}
        for axis, (low, high) in ranges.items():
            candidates = list((more or {}).get(axis, ()))
            for table in tables:
                names = {i.name for i in table.inputs if i.kind == "position" and i.axis == axis}
                candidates += _knots_of(table, names, low, high)
            self.knots[axis] = _within(candidates, low, high)
        for table in tables:
            for channel in _curved_inputs(table, self.knots)[:MAX_CURVED_INPUTS]:
                low, high = channel.valid or (channel.default, channel.default)
                candidates = [np.linspace(low, high, BENT_KNOTS), *_knots_of(table, {channel.name}, low, high)]
                self.knots[INPUT + channel.name] = _within(candidates, low, high)

    def curve(self, axis: str, positions: np.ndarray, values: np.ndarray) -> Term:
        """Straight between positions, held beyond them; the positions are knots."""
        return Term(1.0, {axis: np.interp(self.knots[axis], positions, values)})

    def remainder(self, size: float) -> Terms:
        """Anything between -size and size."""
        self._missed += 1
        return [Term(size, {}, (f"{MISSED}{self._missed}",))] if size > 0 else []

    def product(self, a: Terms, b: Terms) -> Terms:
        """Product of two sums; the product of two curves over one axis is straight between knots but for a bound."""
        out: Terms = []
        for x in a:
            for y in b:
                curves, error = {**x.curves, **y.curves}, 0.0
                both = [axis for axis in x.curves if axis in y.curves]
                single = {axis: v for axis, v in curves.items() if axis not in both}
                for axis in both:
                    curves[axis] = x.curves[axis] * y.curves[axis]
                    bend = np.abs(np.diff(x.curves[axis]) * np.diff(y.curves[axis])).max(initial=0.0) / 4
                    error += bend * math.prod(float(np.abs(curves[o]).max()) for o in both if o != axis)
                for weight, unknowns in self._merged(x.unknowns, y.unknowns):
                    factor = weight * x.factor * y.factor
                    out.append(Term(factor, curves, unknowns))
                    for m in self.remainder(error):
                        out.append(Term(m.factor * factor, single, tuple(sorted(m.unknowns + unknowns))))
        return out

    def outputs(self, table: t.CompensationTable, state: Mapping[str, float]) -> dict[str, Terms]:
        """Output name -> its deviation, um or urad. state: readings in which references are latched."""
        nodes = self._nodes(table, state)
        components: dict[str, Terms] = {c.name: [] for c in table.components}
        profiles = [self._profile(table, p) for p in table.profiles]
        for pair in table.pairs:
            components[pair.component] += self.product(profiles[pair.profile], nodes[pair.driver])
        out = {}
        for output in table.outputs:
            total: Terms = []
            for monomial in output.terms:
                part = collected(components[monomial.component])
                for factor in monomial.factors:
                    part = self.product(part, nodes[factor])
                total += scaled(part, monomial.weight)
            out[output.name] = collected(total)
        return out

    def moves(self, channel: t.TableInput) -> bool:
        """Whether an input is the position of an axis with knots."""
        return channel.kind == "position" and channel.axis in self.knots

    def input(self, channel: t.TableInput) -> Terms:
        """A position within its range, a reading within its validity, else the default."""
        if self.moves(channel):
            return [Term(1.0, {channel.axis: self.knots[channel.axis]})]
        if INPUT + channel.name in self.knots:
            return [Term(1.0, {INPUT + channel.name: self.knots[INPUT + channel.name]})]
        low, high = channel.valid or (channel.low, channel.high)
        if channel.valid is None or channel.optional:
            return [Term(min(max(channel.default, low), high))]
        return [Term((low + high) / 2), Term((high - low) / 2, {}, (channel.name,))]

    def _nodes(self, table: t.CompensationTable, state: Mapping[str, float]) -> list[Terms]:
        reference = Evaluator(table)
        reference.cycle(dict(state), dt=0.0)
        latched = reference.nodes()
        channels = {i.name: i for i in table.inputs}
        out: list[Terms] = []
        for number, node in enumerate(table.nodes):
            out.append(collected(self._node(node, [out[o] for o in node.of], channels, latched[number])))
        return out

    def _node(self, node: t.Node, of: list[Terms], channels: Mapping[str, t.TableInput], latched: float) -> Terms:
        match node:
            case t.ConstantNode():
                return [Term(node.value)]
            case t.InputNode():
                return self.input(channels[node.input])
            case t.AffineNode():
                parts = [x for w, o in zip(node.weights, of, strict=True) for x in scaled(o, w)]
                return [Term(node.offset), *parts]
            case t.FirstNode():
                return [Term(latched)]
            case t.LagNode():
                return of[0]
            case t.ProductNode():
                out = of[0]
                for other in of[1:]:
                    out = self.product(out, other)
                return out
            case t.PowerNode():
                return self._bent(of[0], lambda u: power(u, node.exponent), _stationary(node.exponent))
            case t.ClipNode():
                ends = np.array([node.low, node.high])
                return self._bent(of[0], lambda u: min(max(u, node.low), node.high), lambda *_: ends)
            case t.LookupNode():
                at = node.start + node.step * np.arange(len(node.values))
                return self._bent(of[0], lambda u: float(np.interp(u, at, node.values)), lambda *_: at)
            case t.SwitchNode():
                low, high = span(of[0])
                both = [Term(0.5), *self.remainder(0.5)]
                return [Term(1.0)] if low >= node.on else [] if high <= node.off else both
            case t.DirectionNode():
                return self._side(of[0])
            case t.ApproachNode():
                if len(of[1]) == 1 and of[1][0].unknowns[:1] and of[1][0].unknowns[0].startswith(SIDE):
                    # z = side - (side - z0) exp(-way / length) with z0 between -1 and 1, after the way of the run-up
                    left = math.exp(-self.run_up / node.length)
                    return self.product(of[1], [Term(1.0 - left), *self.remainder(left)])
                low, high = span(of[1])
                return [Term((low + high) / 2), *self.remainder((high - low) / 2)]
        raise TypeError(f"unknown node {node!r}")

    def _merged(self, a: tuple[str, ...], b: tuple[str, ...]) -> list[tuple[float, tuple[str, ...]]]:
        """Product of unknowns as a sum: the square of a side is 1, that of another unknown 1/2 + 1/2 of a new one."""
        out = [(1.0, tuple(sorted(set(a) ^ set(b))))]
        for unknown in sorted(set(a) & set(b)):
            if not unknown.startswith(SIDE):
                (new,) = self.remainder(0.5)
                out = [pair for w, u in out for pair in ((w / 2, u), (w / 2, tuple(sorted(u + new.unknowns))))]
        return out

    def _side(self, position: Terms) -> Terms:
        axes = {axis for x in position for axis in x.curves}
        return [Term(1.0, {}, (SIDE + next(iter(axes)),))] if len(axes) == 1 else self.remainder(1.0)

    def _profile(self, table: t.CompensationTable, profile: t.Profile) -> Terms:
        values = profile.scale * np.array(profile.values, dtype=float)
        if profile.input is None:
            return [Term(float(values[0]))]
        channel = next(i for i in table.inputs if i.name == profile.input)
        at = profile.start + profile.step * np.arange(values.size)
        period = at[-1] - at[0] if profile.periodic else None
        reading = self.input(channel)
        for axis in reading[0].curves:
            return [Term(1.0, {axis: np.interp(self.knots[axis], at, values, period=period)})]
        if len(reading) == 1:
            return [Term(float(np.interp(reading[0].factor, at, values, period=period)))]
        if period is not None:
            middle, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
            return [Term(float(middle)), *self.remainder(float(half))]
        return self._bent(reading, lambda u: float(np.interp(u, at, values)), lambda *_: at)

    def _bent(self, of: Terms, value: Callable[[float], float], bends: Callable[[float, float, float], np.ndarray]):
        """A function of a sum: its values at the knots of one axis, or a straight line and what it misses.

        bends(low, high, slope): where the function can be furthest from a straight line of that slope, inside its ends.
        """
        axes = {axis for x in of for axis in x.curves}
        if len(axes) == 1 and not any(x.unknowns for x in of):
            axis = next(iter(axes))
            u = sum(x.factor * x.curves.get(axis, 1.0) for x in of) + np.zeros_like(self.knots[axis])
            v = np.array([value(each) for each in u.tolist()])
            cells = list(zip(u.tolist(), u[1:].tolist(), v.tolist(), v[1:].tolist(), strict=False))
            worst = max((max(map(abs, _departure_from_line(value, bends, *cell))) for cell in cells), default=0.0)
            return [Term(1.0, {axis: v}), *self.remainder(worst)]
        low, high = span(of)
        if high <= low:
            return [Term(value(low))]
        first, last = value(low), value(high)
        slope = (last - first) / (high - low)
        lowest, highest = _departure_from_line(value, bends, low, high, first, last)
        offset = first - slope * low + (lowest + highest) / 2
        return [Term(offset), *scaled(of, slope), *self.remainder((highest - lowest) / 2)]


def collected(terms: Terms) -> Terms:
    """The same sum with one term for all that have the same unknowns and at most one axis in common."""
    plain: dict[tuple[tuple[str, ...], tuple[str, ...]], Term] = {}
    out: Terms = []
    for x in terms:
        key = x.unknowns, tuple(x.curves)
        before = plain.get(key)
        if len(x.curves) > 1:
            out.append(x)
        elif not x.curves:
            plain[key] = Term(x.factor + (before.factor if before else 0.0), {}, x.unknowns)
        else:
            ((axis, values),) = x.curves.items()
            plain[key] = Term(1.0, {axis: x.factor * values + (before.curves[axis] if before else 0.0)}, x.unknowns)
    return [*plain.values(), *out]


def _departure_from_line(value, bends, low: float, high: float, first: float, last: float) -> tuple[float, float]:
    """Lowest and highest value of a function beyond the straight line between two of its points."""
    if low > high:
        low, high, first, last = high, low, last, first
    if high <= low:
        return 0.0, 0.0
    slope = (last - first) / (high - low)
    at = bends(low, high, slope)
    inside = at[(at > low) & (at < high)].tolist()
    off = [0.0, *(value(u) - first - slope * (u - low) for u in inside)]
    return min(off), max(off)


def _stationary(exponent: float) -> Callable[[float, float, float], np.ndarray]:
    """Where sign(u) |u|^exponent has a given slope, and 0."""

    def at(low: float, high: float, slope: float) -> np.ndarray:
        if exponent == 1.0 or slope <= 0:
            return np.array([0.0])
        u = (slope / exponent) ** (1.0 / (exponent - 1.0))
        return np.array([-u, 0.0, u])

    return at


def _curved_inputs(table: t.CompensationTable, axes: Mapping[str, np.ndarray]) -> list[t.TableInput]:
    """Inputs with a validity that stand in a driver or profile which is not straight in them; positions left out."""
    sources: list[set[str]] = []
    bent = {p.input for p in table.profiles}
    for node in table.nodes:
        of = [sources[o] for o in node.of]
        sources.append({node.input} if isinstance(node, t.InputNode) else set().union(*of))
        if isinstance(node, t.PowerNode | t.ClipNode | t.LookupNode):
            bent |= sources[-1]
        if isinstance(node, t.ProductNode):
            bent |= {name for name in sources[-1] if sum(name in names for names in of) > 1}
    known = [i for i in table.inputs if i.valid is not None and i.valid[0] < i.valid[1] and not i.optional]
    return [i for i in known if i.name in bent and not (i.kind == "position" and i.axis in axes)]


def _within(candidates: Sequence[np.ndarray], low: float, high: float) -> np.ndarray:
    every = np.unique(np.concatenate([np.array([low, high]), *candidates]))
    return every[(every >= low) & (every <= high)]


def _knots_of(table: t.CompensationTable, names: set[str], low: float, high: float) -> list[np.ndarray]:
    """Grids of profiles and of lookups of some inputs, and where clips of them begin."""
    knots = []
    for p in table.profiles:
        if p.input in names:
            period = (len(p.values) - 1) * p.step
            turns = range(math.floor((low - p.start) / period), math.ceil((high - p.start) / period))
            grid = p.start + p.step * np.arange(len(p.values))
            knots += [grid + period * turn for turn in (turns if p.periodic else (0,))]
    for node in table.nodes:
        if isinstance(node, t.LookupNode | t.ClipNode):
            of, weight, offset = table.nodes[node.of[0]], 1.0, 0.0
            while isinstance(of, t.AffineNode | t.LagNode) and len(of.of) == 1:
                if isinstance(of, t.AffineNode):  # offset + weight * (own offset + own weight * u)
                    weight, offset = weight * of.weights[0], offset + weight * of.offset
                of = table.nodes[of.of[0]]
            if weight and isinstance(of, t.InputNode) and of.input in names:
                bends = (
                    [node.low, node.high]
                    if isinstance(node, t.ClipNode)
                    else [node.start + node.step * k for k in range(len(node.values))]
                )
                knots.append((np.array(bends) - offset) / weight)
    return knots
