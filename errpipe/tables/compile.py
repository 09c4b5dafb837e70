"""Error components as sums of profile(position) x driver(state), compiled into one table.

Equal drivers become one node, in order of first use, so equal input gives an equal table. Pairs of the same
component, axis and driver are added into one profile (a periodic one only to another of its period). A rotary axis that
turns on repeats its curve with every turn, closed where the turn ends.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np

from errpipe.domain import components as iso
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.domain.synthesis import MonomialSource, OutputSource
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.lowering import Nodes
from errpipe.errors import GateError
from errpipe.tables import bounds, turn
from errpipe.tables.gridding import grid, interpolation_error, quantise

# Up to this many intervals all profiles of an axis take the finest grid among them: 2 KB each buys one place on
# the grid for all of them (half the cycle of a machine of 21 components).
COMMON_GRID_INTERVALS = 512
GridKey = tuple[str | None, bool, float, float]  # input, periodic, start, span


@dataclass(frozen=True)
class ComponentSource:
    """One component to compile: the sum of its pairs, in um or urad. keep: None lets the drivers decide."""

    name: str
    unit: str
    pairs: tuple[Lowered, ...]
    keep: bool | None = None


@dataclass(frozen=True)
class Limits:
    """Limits of one output, in um or urad and s; None: the largest deviation the table can reach, no rate limit."""

    magnitude: float | None = None
    slew: float | None = None
    acceleration: float | None = None


class Stated(TypedDict, total=False):
    """Fields of the table that are taken as they are; machine and title are shortened to what it holds."""

    machine: str
    title: str
    version: str
    fingerprint: str
    ramp_s: float
    fade_s: float


def compile_table(
    components: Sequence[ComponentSource],
    *,
    inputs: Sequence[t.TableInput],
    outputs: Sequence[OutputSource] | None = None,
    travel: Mapping[str, tuple[float, float]] | None = None,
    turning: Collection[str] = (),
    limited: Collection[str] = (),
    error_bound: float = 0.01,
    position_cycle_s: float = 0.001,
    thermal_cycle_s: float = 1.0,
    **stated: Unpack[Stated],
) -> t.CompensationTable:
    """Compile components into a table.

    inputs: every input that drivers and profiles read (positions by axis; unused inputs are left out);
    outputs: None gives one output per component; travel: axis -> range of its profiles (default: the position
    input's validity, else its plausible range); turning: rotary axes that turn on, besides those whose travel is one
    turn, within the error of an axis; limited: those that do not; error_bound: largest interpolation error of each pair
    at its driver's largest value, um or urad; stated: what the table states. Raises GateError if a component cannot be
    compiled.
    """
    slow_every = _cycles(thermal_cycle_s, position_cycle_s)
    build = Nodes({i.name: i for i in inputs}, slow_every * position_cycle_s)
    groups = [_groups(build, c) for c in components]
    monomials = [_monomials(build, o) for o in (outputs_of(components) if outputs is None else outputs)]
    spans = bounds.node_spans(build.nodes, inputs)
    flat = [g for own_groups in groups for g in own_groups]
    seen, turns = _turns(inputs, travel or {}, turning)
    turns -= {*limited}
    flat = [g.closed_periodic(*seen[g.axis]) if g.axis in turns and g.period is None else g for g in flat]
    made = [g.profile(build, spans, seen, error_bound) for g in flat]
    made = _on_common_grids(flat, made)
    used = {n.input for n in build.nodes if isinstance(n, t.InputNode)} | {p.input for p in made}
    made += _travels([i for i in inputs if i.name in used], travel or {}, turns, made)
    profiles = {p: n for n, p in enumerate(sorted(dict.fromkeys(made), key=_grid_order(made)))}
    pairs = _pairs(build, components, groups, [profiles[p] for p in made])
    used |= {s.input for i in inputs if i.name in used for s in i.substitute}
    stated["machine"], stated["title"] = _short(stated.get("machine", ""), 63), _short(stated.get("title", ""), 127)
    table = t.CompensationTable(
        **stated,
        position_cycle_s=position_cycle_s,
        slow_every=slow_every,
        inputs=tuple(i for i in inputs if i.name in used),
        nodes=tuple(build.nodes),
        profiles=tuple(profiles),
        components=tuple(t.Component(name=c.name, unit=c.unit) for c in components),
        pairs=tuple(pairs),
        outputs=tuple(monomials),
    )
    return with_limits(table, {})


def _pairs(
    build: Nodes, components: Sequence[ComponentSource], groups: Sequence[Sequence[_Group]], profiles: Sequence[int]
) -> list[t.Pair]:
    """profiles: numbers, in the order of all groups."""
    pairs: list[t.Pair] = []
    for component, own_groups in zip(components, groups, strict=True):
        for group in own_groups:
            keep = component.keep
            if keep is None:  # kept where no validity box limits its driver
                keep = all(build.inputs[name].valid is None for name in build.reads(group.driver))
            number = profiles[len(pairs)]
            pairs.append(t.Pair(component=component.name, profile=number, driver=group.driver, keep=keep))
    return pairs


def _turns(
    inputs: Sequence[t.TableInput], travel: Mapping[str, bounds.Span], turning: Collection[str]
) -> tuple[dict[str, bounds.Span], set[str]]:
    """Axis -> range of its curves, and the axes that turn on."""
    seen = {i.axis: i.valid or (i.low, i.high) for i in inputs if i.kind == "position"} | dict(travel)
    return seen, {
        axis
        for axis, ends in seen.items()
        if axis and iso.is_rotary(axis) and (axis in turning or turn.is_whole(*ends))
    }


def _travels(
    inputs: Sequence[t.TableInput], travel: Mapping[str, bounds.Span], turns: set[str], made: Sequence[t.Profile]
) -> list[t.Profile]:
    """A zero profile over the travel of each axis without a profile, to state its travel."""
    out = []
    for channel in inputs:
        if channel.kind == "position" and channel.axis in travel:
            low, high = travel[channel.axis]
            low, high = (turn.start(low), turn.start(low) + turn.TURN) if channel.axis in turns else (low, high)
            reach = [p.step * (len(p.values) - 1) for p in made if p.input == channel.name]
            if max(reach, default=0.0) < (1 - turn.SAME_STEP) * (high - low):
                out.append(t.Profile(input=channel.name, start=low, step=high - low, values=(0, 0)))
    return out


def _cycles(thermal_cycle_s: float, position_cycle_s: float) -> int:
    """Position cycles of one thermal cycle. Raises GateError beyond what a table can count."""
    cycles = max(1, round(thermal_cycle_s / position_cycle_s))
    if cycles > t.MAX_SLOW_EVERY:
        raise GateError(
            f"a thermal cycle of {thermal_cycle_s:g} s is {cycles} position cycles (at most {t.MAX_SLOW_EVERY})"
        )
    return cycles


@dataclass
class _Group:
    """Pairs that share component, axis, driver and period: their profiles add up."""

    driver: int
    axis: str | None
    period: float | None
    pairs: list[Lowered]
    start: float = 0.0  # of a period
    closing: float = 0.0  # largest change of the curve by which its turn was closed, in its unit

    def curve(self, x: np.ndarray) -> np.ndarray:
        total = np.zeros(np.shape(x))
        for pair in self.pairs:
            total = total + (1.0 if pair.profile is None else np.asarray(pair.profile(x), dtype=float))
        return total

    def nodes(self) -> tuple[float, ...]:
        """Between which all of its curves are straight; none where they differ."""
        return self.pairs[0].nodes if len({p.nodes for p in self.pairs}) == 1 else ()

    def own_grid(self) -> tuple[float, float, int]:
        """Start, end and intervals of the nodes of its curves where they are equidistant; no intervals elsewhere."""
        nodes = np.array(self.nodes())
        if nodes.size < 2 or np.ptp(np.diff(nodes)) > turn.SAME_STEP * (nodes[-1] - nodes[0]):
            return 0.0, 0.0, 0
        return float(nodes[0]), float(nodes[-1]), nodes.size - 1

    def closed_periodic(self, low: float, high: float) -> _Group:
        """Over an axis that turns on, measured from low to high: with a curve that repeats with every turn."""
        one = turn.close(self.curve, str(self.axis), low, high, self.nodes())
        whole = Lowered(d.ONE, self.axis, one.curve, turn.TURN, one.nodes)
        return _Group(self.driver, self.axis, turn.TURN, [whole], one.start, one.change)

    def profile(
        self, build: Nodes, spans: list[bounds.Span], travel: Mapping[str, bounds.Span], bound: float
    ) -> t.Profile:
        if self.axis is None:
            return _constant(float(self.curve(np.zeros(1))[0]))
        channel = build.position(self.axis)
        low, high = travel[self.axis]
        factor = max(bounds.largest(spans[self.driver]), 1e-9)
        unit = _unit(0.001 / max(1.0, factor))
        start, end, intervals = self.own_grid()
        error = interpolation_error(self.curve, start, end, intervals) if intervals else np.inf
        if error <= bound / factor:
            made = quantise(self.curve, start, end, intervals, error, unit, periodic=self.period is not None)
        else:
            if self.period is not None:
                low, high = self.start, self.start + self.period
            what, periodic = f"profile over {self.axis}", self.period is not None
            made = grid(self.curve, low, high, bound=bound / factor, unit=unit, periodic=periodic, what=what)
        if len(set(made.values)) == 1 and not self.closing:
            return _constant(made.values[0] * made.scale)
        return self.quantised_profile(made, channel.name)

    def quantised_profile(self, made: t.Profile, channel: str) -> t.Profile:
        """The profile over its input; its error includes every difference from its curve."""
        error = made.interpolation_error + self.closing
        return t.Profile.model_validate(made.model_dump() | {"input": channel, "interpolation_error": error})


def _groups(build: Nodes, component: ComponentSource) -> list[_Group]:
    by_key: dict[tuple[int, str | None, float | None], _Group] = {}
    for pair in component.pairs or (Lowered(d.Constant(value=0.0)),):
        driver = build.compile(pair.driver)
        axis = pair.axis if pair.profile is not None else None
        key = (driver, axis, pair.period if axis else None)
        by_key.setdefault(key, _Group(driver, axis, key[2], [])).pairs.append(pair)
    return list(by_key.values())


def _on_common_grids(groups: list[_Group], made: list[t.Profile]) -> list[t.Profile]:
    """Profiles of one axis and range on the finest of their grids: neighbours then share their place on it."""
    finest: dict[GridKey, int] = {}
    for p in made:
        finest[_range(p)] = max(finest.get(_range(p), 0), len(p.values) - 1)
    out = []
    for group, p in zip(groups, made, strict=True):
        intervals = finest[_range(p)]
        if p.input is not None and len(p.values) - 1 < intervals <= COMMON_GRID_INTERVALS and not group.own_grid()[2]:
            error = interpolation_error(group.curve, p.start, p.end, intervals)
            finer = quantise(group.curve, p.start, p.end, intervals, error, p.scale, p.periodic)
            p = group.quantised_profile(finer, p.input)
        out.append(p)
    return out


def _range(p: t.Profile) -> GridKey:
    return p.input, p.periodic, p.start, round(p.step * (len(p.values) - 1), 9)


def _grid_order(made: list[t.Profile]) -> Callable[[t.Profile], int]:
    """Profiles of one grid side by side, grids in order of first use."""
    grids: dict[tuple[str | None, bool, float, float, int], int] = {}
    for p in made:
        grids.setdefault((p.input, p.periodic, p.start, p.step, len(p.values)), len(grids))
    return lambda p: grids[p.input, p.periodic, p.start, p.step, len(p.values)]


def _constant(value: float) -> t.Profile:
    if value == 0.0:
        return t.Profile(values=(0,))
    return t.Profile(values=(1 if value > 0 else -1,), scale=abs(value))


def _unit(largest: float) -> float:
    """The largest power of ten not above a number (1e-3 stays 1e-3)."""
    exponent = -3
    while float(f"1e{exponent}") > largest:
        exponent -= 1
    return float(f"1e{exponent}")


def outputs_of(
    components: Sequence[ComponentSource], acts_on: Mapping[str, tuple[str, float]] | None = None
) -> list[OutputSource]:
    """One output per component: positioning moves the axis that is wrong, in mm or deg; all else the axis along it.

    acts_on: component -> (axis that corrects it, deviation of that axis per deviation of the component), for those
    that have no axis of their own, such as a diameter. Raises GateError for an angle, which moves no linear axis.
    """
    out = []
    for c in components:
        parsed = iso.parse(c.name)
        turns = parsed.kind == "angular positioning"
        along = turns or (c.unit == "um" and parsed.direction not in "RD")
        own = str(parsed.axis) if turns or parsed.kind == "positioning" else parsed.direction  # EXU moves U, not X
        axis, factor = own if along else "", 1.0
        if acts_on and c.name in acts_on:
            axis, factor = acts_on[c.name]
            if c.unit != "um" and not (turns and axis == own):
                raise GateError(f"{c.name} is in {c.unit}: it cannot act on axis {axis} in mm")
            if c.unit == "um" and iso.is_rotary(axis):
                raise GateError(f"{c.name} is in um: it cannot act on axis {axis} in deg")
        unit = "mm" if c.unit == "um" else "deg" if turns else "urad"
        out.append(OutputSource(c.name, (MonomialSource(factor, c.name),), axis, c.unit, unit))
    return out


def by_component(table: t.CompensationTable) -> t.CompensationTable:
    """The table with one output per component, without limits: its curves rather than its dynamic behaviour."""
    outputs = tuple(
        t.Output(name=c.name, unit=c.unit, correction_unit=c.unit, terms=(t.Monomial(weight=1.0, component=c.name),))
        for c in table.components
    )
    return table.model_copy(update={"outputs": outputs})


def _monomials(build: Nodes, output: OutputSource) -> t.Output:
    terms = tuple(
        t.Monomial(weight=m.weight, component=m.component, factors=tuple(build.compile(f) for f in m.factors))
        for m in output.terms
    )
    return t.Output(
        name=output.name, axis=output.axis, unit=output.unit, correction_unit=output.correction_unit, terms=terms
    )


def with_limits(table: t.CompensationTable, limits: Mapping[str, Limits]) -> t.CompensationTable:
    """The table with limits per output; default magnitude: its largest value, rounded up."""
    unknown = set(limits) - {o.name for o in table.outputs}
    if unknown:
        raise GateError(f"limits for outputs the table does not have: {', '.join(sorted(unknown))}")
    outputs = []
    for output, reach in zip(table.outputs, bounds.outputs(table), strict=True):
        own = limits.get(output.name, Limits())
        magnitude = own.magnitude or _rounded_up(reach.deviation + reach.gridding)
        changed = {"magnitude": magnitude, "slew": own.slew, "acceleration": own.acceleration}
        outputs.append(t.Output.model_validate(output.model_dump() | changed))
    return t.CompensationTable.model_validate(table.model_dump() | {"outputs": [o.model_dump() for o in outputs]})


def _rounded_up(value: float) -> float | None:
    if not 0.0 < value < t.LARGEST_NUMBER / 10:
        return None
    exponent = int(np.floor(np.log10(value))) - 1
    return float(f"{np.ceil(value / 10.0**exponent):.0f}e{exponent}")


def _short(text: str, longest: int) -> str:
    """A title on one line without control characters, at most `longest` bytes."""
    text = " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
    data = text.encode()
    if len(data) <= longest:
        return text
    return data[: longest - 3].decode(errors="ignore") + "…"
