"""The plain-Python evaluator: what a compensation table means, one cycle at a time.

The order of every operation here is the definition (`schemas/ect-2.md` says the same in words); the Numba
kernel, the C runtime and the function block repeat it and give the same bits.

One cycle: readings are conditioned (every result lies within its input's validity); nodes run in
order, slow ones only in thermal cycles (the first cycle and every `slow_every`-th after it); profiles, pairs,
synthesis; then limits. A state (first, lag, direction, approach) follows its operand until every required
input below it has had an accepted reading, and starts there. Tables of format version 1 run by the rules of their
version (`schemas/ect-1.md`).

Two ways to call it: at the controller's fixed rate (dt None), or over a recording (dt given: time since the
row before). Over a recording every node runs in every row, and ramp, fade time, slew and acceleration,
which belong to a fixed rate, do nothing, nor is one reading alone between two that agree undone.

This is the cycle, its nodes, profiles and synthesis; readings and limits are `reference_readings` and
`reference_limits`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from errpipe.domain import table as t
from errpipe.kernels.arithmetic import exp, power
from errpipe.kernels.motion import moved_side, on_lines, towards
from errpipe.tables.reference_limits import Limits
from errpipe.tables.reference_readings import Readings


@dataclass(frozen=True)
class Cycle:
    """What one cycle gives. deviation: um or urad by output; correction: in the output's correction_unit."""

    deviation: dict[str, float]
    correction: dict[str, float]
    components: dict[str, float]
    status: int
    heartbeat: int
    faults: dict[str, str]
    sources: dict[str, str]
    rejected: dict[str, int]

    def status_names(self) -> tuple[str, ...]:
        """Names of the status bits that are set."""
        return tuple(name for name, bit in t.STATUS_BIT.items() if self.status & bit)


@dataclass
class _Recall:
    """State of a direction or approach besides value and memory: two readings, and both before the last of them."""

    last: float
    before: float
    value: float = 0.0
    memory: float = 0.0
    steady: bool = True
    departed: bool = False
    stated: int = 0
    changed: bool = False


class Evaluator:
    """Runs one table. Holds the states; `reset` starts a new run."""

    def __init__(self, table: t.CompensationTable):
        self.table = table
        self._component = {c.name: n for n, c in enumerate(table.components)}
        self._inverse_step = [1.0 / p.step for p in table.profiles]
        self._inverse_turn = [1.0 / (len(p.values) - 1) if p.periodic else 0.0 for p in table.profiles]
        self._alphas = [self._lag_factors(n) for n in table.nodes]
        self._rules_of_2 = table.table > 1
        self._limits = Limits(table)
        self.reset()

    def continue_from(self, before: Evaluator) -> None:
        """Start from the state of another table's evaluator: its corrections and its ramp.

        Raises ValueError if the outputs are not the same ones.
        """
        theirs, ours = ([(o.name, o.unit, o.correction_unit) for o in e.table.outputs] for e in (before, self))
        if theirs != ours:
            raise ValueError("the tables have other outputs: a correction would jump")
        self._limits.continue_from(before._limits)

    def reset(self) -> None:
        """The next cycle is the first of a run; corrections stay where they are, and continue from there."""
        nodes = len(self.table.nodes)
        self._readings = Readings(self.table)
        self._node = [0.0] * nodes
        self._ready = [False] * nodes
        self._a = [0.0] * nodes
        self._recalls: dict[int, _Recall] = {}
        self._fade = -1.0
        self._limits.reset()
        self._until_slow = 0
        self._heartbeat = 0
        self._status = 0

    def cycle(
        self, inputs: Mapping[str, float], dt: float | None = None, enable: bool = True, hold: bool = False
    ) -> Cycle:
        """One cycle. inputs: new readings by name (NaN: a failed one; absent: none since the last cycle).

        dt: None at the controller's rate, else s since the row before; enable: corrections are wanted (else they go
        to 0); hold: they are frozen, regardless of `enable`. Raises KeyError for an unknown input.
        """
        self._status = t.STATUS_BIT["running"]
        replay = dt is not None
        step = self.table.position_cycle_s if dt is None else dt
        slow = replay or self._until_slow == 0
        self._until_slow = (self.table.slow_every if slow else self._until_slow) - 1
        readings = self._readings
        faults, sources, lost = readings.condition(inputs, step, replay)
        self._status |= readings.status
        for n, channel in enumerate(self.table.inputs):
            if slow or channel.fast or not self._rules_of_2:
                readings.show(n, channel)
        self._run_nodes(slow, dt)
        self._move_fade(self._fade_target(lost), step, replay)
        components = self._components()
        deviation = self._synthesis(components)
        correction = self._limits.limited(deviation, step, replay, enable, hold)
        self._status |= self._limits.status
        self._heartbeat = (self._heartbeat + 1) % (1 << 32)
        names = [o.name for o in self.table.outputs]
        return Cycle(
            dict(zip(names, deviation, strict=True)),
            dict(zip(names, correction, strict=True)),
            dict(zip(self._component, components, strict=True)),
            self._status,
            self._heartbeat,
            {i.name: t.FAULTS[f] for i, f in zip(self.table.inputs, faults, strict=True)},
            {i.name: t.SOURCES[s] for i, s in zip(self.table.inputs, sources, strict=True)},
            {i.name: r for i, r in zip(self.table.inputs, readings.rejected, strict=True)},
        )

    def nodes(self) -> tuple[float, ...]:
        """Values of all nodes after the last cycle."""
        return tuple(self._node)

    def profiles(self) -> tuple[float, ...]:
        """Values of all profiles at the last cycle's inputs."""
        return tuple(self._profile(n, p) for n, p in enumerate(self.table.profiles))

    def validity_share(self, names: set[str]) -> float:
        """Share of the table that applies by the validity of some inputs, 0..1, at the last cycle's values."""
        return self._fade_target(False, names)

    # nodes ------------------------------------------------------------------------------------------

    def _lag_factors(self, node: t.Node) -> tuple[float, float]:
        if not isinstance(node, t.LagNode):
            return 0.0, 0.0
        dt = self.table.thermal_cycle_s if node.slow else self.table.position_cycle_s
        return exp(-(dt / node.tau_up)), exp(-(dt / node.tau_down))

    def _run_nodes(self, slow: bool, dt: float | None) -> None:
        waiting = False
        for n, node in enumerate(self.table.nodes):
            if node.slow and not slow:
                waiting = waiting or not self._ready[n]
                continue
            started = self._ready[n]
            if not started:
                self._ready[n] = self._is_ready(node)
                waiting = waiting or not self._ready[n]
            value = self._run_node(n, node, started, dt)
            if not -t.LARGEST_RESULT <= value <= t.LARGEST_RESULT:
                value = 0.0
                self._status |= t.STATUS_BIT["not_finite"]
            self._node[n] = value
        if waiting:
            self._status |= t.STATUS_BIT["waiting"]

    def _is_ready(self, node: t.Node) -> bool:
        if isinstance(node, t.InputNode):
            return self._readings.usable[self._readings.number[node.input]]
        return all(self._ready[operand] for operand in node.of)

    def _run_node(self, n: int, node: t.Node, started: bool, dt: float | None) -> float:
        values = self._node
        match node:
            case t.ConstantNode():
                return node.value
            case t.InputNode():
                return self._readings.value[self._readings.number[node.input]]
            case t.AffineNode():
                total = node.offset
                for weight, operand in zip(node.weights, node.of, strict=True):
                    total = total + weight * values[operand]
                return total
            case t.FirstNode():
                return values[n] if started else values[node.of[0]]
            case t.LagNode():
                return self._lag(n, node, values[node.of[0]], started, dt)
            case t.ProductNode():
                total = values[node.of[0]]
                for operand in node.of[1:]:
                    total = total * values[operand]
                return total
            case t.PowerNode():
                return power(values[node.of[0]], node.exponent)
            case t.ClipNode():
                u = values[node.of[0]]
                return node.low if u < node.low else node.high if u > node.high else u
            case t.SwitchNode():
                u = values[node.of[0]]
                return 1.0 if u >= node.on else 0.0 if u <= node.off else values[n]
            case t.DirectionNode():
                known = values[node.of[1]] if len(node.of) > 1 else 0.0
                return self._direction(n, node, values[node.of[0]], known, started, dt is not None)
            case t.ApproachNode():
                return self._approach(n, node, values[node.of[0]], values[node.of[1]], started, dt is not None)
            case t.LookupNode():
                return on_lines(
                    node.values, 0, len(node.values) - 1, (values[node.of[0]] - node.start) * (1.0 / node.step)
                )
        raise TypeError(f"unknown node {node!r}")

    def _lag(self, n: int, node: t.LagNode, u: float, started: bool, dt: float | None) -> float:
        before, y = self._a[n], self._node[n]
        self._a[n] = u
        if not started:
            return u if node.start == "input" else 0.0
        if dt is None:
            up, down = self._alphas[n]
            alpha = up if before >= y else down
        else:
            tau = node.tau_up if before >= y else node.tau_down
            alpha = exp(-(dt / tau))
        return before + (y - before) * alpha

    def _recall(self, n: int, x: float, way: int, threshold: float, started: bool, replay: bool) -> None:
        """Undo the effect of the last reading if it is a single outlier between two that agree, or a single direction.

        One reading away from the axis position, and back: at a fixed cycle time no axis does that, a bad sample does.
        """
        if replay or not self._rules_of_2:
            return
        own = self._recalls.setdefault(n, _Recall(x, x))
        if not started:
            own.last = own.before = x
        moved, away = x - own.last, x - own.before
        far = moved > threshold or -moved > threshold
        agrees = not (away > threshold or -away > threshold)
        if started and agrees and (own.changed or (own.departed and far)):
            self._node[n], self._a[n] = own.value, own.memory
            far = False
        own.value, own.memory = self._node[n], self._a[n]
        own.departed = own.steady and far
        own.steady = not far
        own.changed = way not in (0, own.stated)
        own.stated = way
        own.before, own.last = own.last, x

    def _direction(self, n: int, node: t.DirectionNode, x: float, known: float, started: bool, replay: bool) -> float:
        if not started:
            self._node[n] = float(node.start)
            self._a[n] = x
        self._recall(n, x, (known > 0.0) - (known < 0.0), node.threshold, started, replay)
        side, self._a[n] = moved_side(x, known, self._node[n], self._a[n], node.threshold)
        return side

    def _approach(self, n: int, node: t.ApproachNode, x: float, side: float, started: bool, replay: bool) -> float:
        self._recall(n, x, 0, node.threshold, started, replay)
        way = x - self._a[n]
        self._a[n] = x
        if not started:
            return side
        if way < 0.0:
            way = -way
        z = self._node[n]
        return side - (side - z) * exp(-(way / node.length)) if way > 0.0 else z

    # profiles, synthesis ---------------------------------------------------------------------------

    def _fade_target(self, lost: bool, names: set[str] | None = None) -> float:
        if lost:
            return 0.0
        target = 1.0
        for n, channel in enumerate(self.table.inputs):
            if (names is None or channel.name in names) and self._readings.left[n] < target:
                target = self._readings.left[n]
        return target if target > 0.0 else 0.0

    def _move_fade(self, target: float, dt: float, replay: bool) -> None:
        self._fade = towards(self._fade, target, dt, 0.0 if replay or self._fade < 0.0 else self.table.fade_s)
        if self._fade < 1.0:
            self._status |= t.STATUS_BIT["fading"]
        if self._fade <= 0.0:
            self._status |= t.STATUS_BIT["faded"]

    def _components(self) -> list[float]:
        profiles = [self._profile(n, p) for n, p in enumerate(self.table.profiles)]
        sums = [0.0] * len(self.table.components)
        for pair in self.table.pairs:
            part = profiles[pair.profile] * self._node[pair.driver]
            if not pair.keep:
                part = part * self._fade
            sums[self._component[pair.component]] += part
        return sums

    def _profile(self, n: int, profile: t.Profile) -> float:
        if profile.input is None:
            return profile.values[0] * profile.scale
        last = len(profile.values) - 1
        s = (self._readings.value[self._readings.number[profile.input]] - profile.start) * self._inverse_step[n]
        if profile.periodic:
            turns = s * self._inverse_turn[n]
            whole = int(turns)
            if turns < whole:
                whole -= 1
            s = s - float(whole) * last
        elif s < 0.0 or s > last:
            self._status |= t.STATUS_BIT["beyond_profile"]
        return on_lines(profile.values, 0, last, s) * profile.scale

    def _synthesis(self, components: list[float]) -> list[float]:
        out = []
        for output in self.table.outputs:
            total = 0.0
            for term in output.terms:
                part = term.weight * components[self._component[term.component]]
                for factor in term.factors:
                    part = part * self._node[factor]
                total = total + part
            if not -t.LARGEST_RESULT <= total <= t.LARGEST_RESULT:
                total = 0.0
                self._status |= t.STATUS_BIT["not_finite"]
            out.append(total)
        return out
