"""A second evaluator of the compensation table, written from the text of `schemas/ect-2.md`, sections 4 to 8 and 11."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from tests.contract.second_functions import exp, power
from tests.contract.second_records import Input, Node, Output, Profile, Table

BIG = 1e30
RUNNING, ACTIVE, RAMPING, SUBSTITUTED, HELD, DEFAULTED, FADING = 1, 2, 4, 8, 16, 32, 64
FADED, AT_MAGNITUDE, AT_RATE, BEYOND, WAITING, NOT_FINITE, HOLDING = 128, 256, 512, 1024, 2048, 4096, 8192


def is_sane(x: float) -> bool:
    """Section 1."""
    return -BIG <= x <= BIG


class Cycle(NamedTuple):
    """What a cycle gives (section 4)."""

    deviations: list[float]
    corrections: list[float]
    status: int
    heartbeat: int
    sources: list[int]
    faults: list[int]
    rejected: list[int]


class InputState:
    """Section 4, first paragraph, and section 5: what is remembered of an input."""

    def __init__(self, optional: bool) -> None:
        self.age = self.wait = self.good = self.now = self.value = 0.0
        self.anchor, self.left = 1e31, 1.0
        self.rejected = 0
        self.raw = math.nan
        self.seen = False
        self.usable = optional
        self.fault = self.source = 0


class NodeState:
    """Section 6: what is remembered of a node."""

    def __init__(self) -> None:
        self.y = self.m = 0.0
        self.ready = self.started = False
        self.x1 = self.x2 = self.y0 = self.m0 = self.rest = 0.0
        self.v = 0
        self.stands = self.doubt = self.news = False


class OutputState:
    """Section 8: what is remembered of an output."""

    def __init__(self) -> None:
        self.c = self.r = self.g = 0.0


class Evaluator:
    """Section 4: a table and its state; `number` is the kind of number it computes with (section 9)."""

    def __init__(self, table: Table, number: type[float] = float) -> None:
        self.number, self.single = number, number is not float
        self.table: Table = self._rounded(table)
        self.outputs = [OutputState() for _ in self.table.outputs]
        self.rho = 0.0
        self.reset()

    def _rounded(self, thing: Any) -> Any:
        """Section 9: every parameter is rounded once, when the table is loaded."""
        if isinstance(thing, float):
            return self.number(thing)
        if isinstance(thing, tuple):
            return type(thing)(*map(self._rounded, thing))
        return [self._rounded(x) for x in thing] if isinstance(thing, list) else thing

    def reset(self) -> None:
        """Section 4, first paragraphs."""
        self.inputs = [InputState(r.optional) for r in self.table.inputs]
        self.nodes = [NodeState() for _ in self.table.nodes]
        self.phi = -1.0
        for s in self.outputs:
            s.c = s.c if self.table.version > 1 else 0.0
            s.r, s.g = 0.0, s.c
        self.rho = self.rho if self.table.version > 1 else 0.0
        self.count = self.heartbeat = self.status = 0

    def cycle(self, mode: int, readings: Sequence[float | None]) -> Cycle:
        """Section 4: one cycle; a reading that is not fresh is None."""
        first, thermal = self.count == 0, self.count % self.table.slow_every == 0
        self.count += 1
        self.status = RUNNING
        lost = self._read(readings)
        for r, s in zip(self.table.inputs, self.inputs, strict=True):
            if thermal or r.kind < 4 or self.table.version == 1:
                self._take_over(r, s)
        for node, state in zip(self.table.nodes, self.nodes, strict=True):
            if thermal or not node.slow:
                self._run(node, state)
        if not all(state.ready for state in self.nodes):
            self.status |= WAITING
        self._fade(first, lost)
        deviations = self._sums([self._profile(p) for p in self.table.profiles])
        self._ramp(mode)
        limited = zip(self.table.outputs, self.outputs, deviations, strict=True)
        corrections = [self._limit(o, s, d, mode) for o, s, d in limited]
        self.heartbeat = (self.heartbeat + 1) % 2**32
        sources, faults = [s.source for s in self.inputs], [s.fault for s in self.inputs]
        rejected = [s.rejected for s in self.inputs]
        return Cycle(deviations, corrections, self.status, self.heartbeat, sources, faults, rejected)

    # ---- section 5 ----

    def _read(self, readings: Sequence[float | None]) -> bool:
        """Section 5, all of it; `lost`."""
        for r, s, reading in zip(self.table.inputs, self.inputs, readings, strict=True):
            self._judge(r, s, reading)
        for r, s in zip(self.table.inputs, self.inputs, strict=True):
            self._replace(r, s)
        both = zip(self.table.inputs, self.inputs, strict=True)
        return any(s.source == 3 and not r.optional and r.flags & 2 for r, s in both)

    def _judge(self, r: Input, s: InputState, reading: float | None) -> None:
        """Section 5, the fault of an input."""
        dt = self.table.position_cycle
        s.age, s.wait = s.age + dt, s.wait + dt
        if reading is not None:
            s.raw, s.wait = self.number(reading), 0.0
        if not is_sane(s.raw):
            s.fault = 1
        elif r.flags & 16 and s.wait > r.stale_after:
            s.fault = 2
        elif s.raw < r.low or s.raw > r.high:
            s.fault = 3
        elif r.flags & 8 and not self._rate(r, s, reading is not None):
            s.fault = 4
        else:
            s.fault, s.source, s.age = 0, 0, 0.0
            s.good = s.now = s.raw
            s.seen = s.usable = True

    def _rate(self, r: Input, s: InputState, fresh: bool) -> bool:
        """Section 5, RATE; section 11."""
        if not s.seen and self.table.version == 1:
            s.anchor = s.raw
            return True
        reach, t = r.max_rate * s.age, abs(s.raw - s.anchor)
        if t > reach + r.noise:
            if not s.seen:
                s.anchor, s.age = s.raw, self.number(0.0)
            elif fresh:
                s.rejected += 1
            return False
        if not s.seen and s.age < self.number(0.5) * self.table.thermal_cycle:
            return False
        if t > reach:
            s.anchor = s.anchor + reach if s.raw - s.anchor > reach else s.anchor - reach
        else:
            s.anchor = s.raw
        return True

    def _replace(self, r: Input, s: InputState) -> None:
        """Section 5, the value of an input that has a fault."""
        if not s.fault:
            return
        links = self.table.substitutes[r.first : r.first + r.count]
        if r.optional:
            s.now, s.source = r.default, 3
        elif links and not any(self.inputs[link.target].fault for link in links):
            value = r.offset
            for link in links:
                value = value + link.weight * self.inputs[link.target].good
            s.now, s.source, s.usable = (r.low if value < r.low else r.high if value > r.high else value), 1, True
            self.status |= SUBSTITUTED
        elif s.seen and (not r.flags & 32 or s.age < r.hold):
            s.now, s.source = s.good, 2
            self.status |= HELD
        else:
            s.now, s.source = r.default, 3
            self.status |= DEFAULTED

    def _take_over(self, r: Input, s: InputState) -> None:
        """Section 5, last paragraph; section 11."""
        s.value, s.left = s.now, self.number(1.0)
        if r.flags & 4:
            below = s.now < r.valid_low
            over = r.valid_low - s.now if below else s.now - r.valid_high
            if over > 0:
                s.left = 1 - over / r.margin
                if self.table.version > 1:
                    s.value = r.valid_low if below else r.valid_high

    # ---- section 6 ----

    def _run(self, node: Node, s: NodeState) -> None:
        """Section 6: one run of a node."""
        operands = self.table.operands[node.first : node.first + node.count]
        s.started = s.ready
        if not s.ready and node.operation == 2:
            s.ready = self.inputs[node.other].usable
        elif not s.ready:
            s.ready = all(self.nodes[o.target].ready for o in operands)
        y = self._operation(node, s, [self.nodes[o.target].y for o in operands], [o.weight for o in operands])
        if not is_sane(y):
            y = 0.0
            self.status |= NOT_FINITE
        s.y = y

    def _operation(self, node: Node, s: NodeState, u: list[float], weights: list[float]) -> float:
        """Section 6, the table of operations."""
        match node.operation:
            case 1:
                return node.a
            case 2:
                return self.inputs[node.other].value
            case 3:
                total = node.a
                for weight, x in zip(weights, u, strict=True):
                    total = total + weight * x
                return total
            case 4:
                return s.y if s.started else u[0]
            case 5:
                return self._lag(node, s, u[0])
            case 6:
                total = u[0]
                for x in u[1:]:
                    total = total * x
                return total
            case 7:
                return power(u[0], node.a)
            case 8:
                return node.a if u[0] < node.a else node.b if u[0] > node.b else u[0]
            case 9:
                return 1.0 if u[0] >= node.a else 0.0 if u[0] <= node.b else s.y
            case 10:
                return self._direction(node, s, u[0], u[1] if len(u) > 1 else 0.0)
            case 11:
                return self._approach(node, s, u[0], u[1])
            case _:
                values = self.table.lookups[node.other : node.other + node.others]
                return _between(values, (u[0] - node.a) * node.c)

    def _lag(self, node: Node, s: NodeState, u: float) -> float:
        """Section 6, lag."""
        before, s.m = s.m, u
        if self.single:
            y = self._creep(node, s, before)
            if y is not None:
                return y
        if not s.started:
            return 0.0 if node.flags & 2 else u
        alpha = node.c if before >= s.y else node.d
        return before + (s.y - before) * alpha

    def _creep(self, node: Node, s: NodeState, before: float) -> float | None:
        """Section 9: a slow lag in binary32; None where it starts, or is fast."""
        if not s.started:
            s.rest = 0.0
            return None
        cycle = self.table.thermal_cycle if node.slow else self.table.position_cycle
        x = cycle / (node.a if before >= s.y else node.b)
        if x >= 0.0625:
            return None
        step = s.rest + (before - s.y - s.rest) * (x * (1 - x * 0.5 * (1 - x / 3 * (1 - x * 0.25))))
        y = s.y + step
        s.rest = step - (y - s.y)
        return y

    def _direction(self, node: Node, s: NodeState, u: float, k: float) -> float:
        """Section 6, direction."""
        if not s.started:
            s.y, s.m = node.b, u
        self._recall(s, u, (k > 0) - (k < 0), node.a)
        y = s.y
        if k != 0:
            s.m = u
            return 1.0 if k > 0 else -1.0
        onward, back = (u >= s.m, s.m - u) if y > 0 else (u <= s.m, u - s.m)
        if onward:
            s.m = u
        elif back > node.a:
            s.m = u
            return -1.0 if y > 0 else 1.0
        return y

    def _recall(self, s: NodeState, u: float, w: int, h: float) -> None:
        """Section 6, RECALL; section 11."""
        if self.table.version == 1:
            return
        if not s.started:
            s.x1 = s.x2 = u
        far = abs(u - s.x1) > h
        if s.started and abs(u - s.x2) <= h and (s.news or (s.doubt and far)):
            s.y, s.m, far = s.y0, s.m0, False
        s.y0, s.m0 = s.y, s.m
        s.doubt, s.stands = s.stands and far, not far
        s.news, s.v = w != 0 and w != s.v, w
        s.x2, s.x1 = s.x1, u

    def _approach(self, node: Node, s: NodeState, u: float, k: float) -> float:
        """Section 6, approach."""
        self._recall(s, u, 0, node.b)
        w, s.m = abs(u - s.m), u
        if not s.started:
            return k
        return k - (k - s.y) * exp(-(w / node.a)) if w > 0 else s.y

    # ---- section 7 ----

    def _fade(self, first: bool, lost: bool) -> None:
        """Section 7, phi."""
        target = 1.0
        for s in self.inputs:
            target = min(target, s.left)
        target = 0.0 if lost else max(target, 0.0)
        self.phi = target if first else self._move(self.phi, target, self.table.fade)
        if self.phi < 1:
            self.status |= FADING
        if self.phi <= 0:
            self.status |= FADED

    def _move(self, x: float, goal: float, whole: float) -> float:
        """Section 7, MOVE."""
        if whole == 0:
            return goal
        step = self.table.position_cycle / whole
        return x + step if goal > x + step else x - step if goal < x - step else goal

    def _profile(self, p: Profile) -> float:
        """Section 7, each profile."""
        values = self.table.values[p.first : p.first + p.count]
        if p.input < 0:
            return values[0] * p.scale
        n = p.count - 1
        s = (self.inputs[p.input].value - p.start) * p.per_step
        if p.periodic:
            t = s * p.per_period
            k = math.trunc(t)
            if t < k:
                k = k - 1
            s = s - self.number(k) * n
        elif s < 0 or s > n:
            self.status |= BEYOND
        return _between(values, s) * p.scale

    def _sums(self, profiles: list[float]) -> list[float]:
        """Section 7, components and outputs: the deviations."""
        components = [0.0] * len(self.table.components)
        for pair in self.table.pairs:
            p = profiles[pair.profile] * self.nodes[pair.node].y
            if not pair.flags & 1:
                p = p * self.phi
            components[pair.component] = components[pair.component] + p
        return [self._deviation(o, components) for o in self.table.outputs]

    def _deviation(self, output: Output, components: list[float]) -> float:
        """Section 7, one output."""
        d = 0.0
        for term in self.table.terms[output.first : output.first + output.count]:
            p = term.weight * components[term.component]
            for node in term[2 : 2 + term.count]:
                p = p * self.nodes[node].y
            d = d + p
        if is_sane(d):
            return d
        self.status |= NOT_FINITE
        return 0.0

    # ---- section 8 ----

    def _ramp(self, mode: int) -> None:
        """Section 8, rho."""
        if mode == 2:
            self.status |= HOLDING
        else:
            self.rho = self._move(self.rho, 1.0 if mode == 1 else 0.0, self.table.ramp)
        self.status |= ACTIVE if self.rho >= 1 else RAMPING if self.rho > 0 else 0

    def _limit(self, output: Output, s: OutputState, d: float, mode: int) -> float:
        """Section 8: the correction of an output."""
        dt = self.table.position_cycle
        goal = -d * self.rho
        if output.flags & 1 and abs(goal) > output.magnitude:
            goal = output.magnitude if goal > 0 else -output.magnitude
            self.status |= AT_MAGNITUDE
        if mode == 2:
            s.r, s.g = self.number(0.0), goal
            return s.c * output.factor
        if not output.flags & 6:
            s.c = goal
            return s.c * output.factor
        way, drift, s.g = goal - s.c, goal - s.g, goal
        hi, lo, a = BIG, -BIG, 0.0
        if output.flags & 2:
            hi = output.slew * dt
            lo = -hi
        if output.flags & 4:
            a = output.acceleration * dt * dt
            hi, lo = min(hi, s.r + a), max(lo, s.r - a)
        if lo <= way <= hi and (a == 0 or -a <= way - drift <= a):
            s.r, s.c = way, goal
        else:
            self.status |= AT_RATE
            s.r = _closing(way, drift, s.r, hi, lo, a)
            b, s.c = s.c, s.c + s.r
            most = max(output.magnitude, abs(b))
            if self.table.version > 1 and output.flags & 1 and abs(s.c) > most:
                self.status |= AT_MAGNITUDE
                s.c = most if s.c > 0 else -most
                s.r = s.c - b
        return s.c * output.factor


def _between(values: Sequence[float], s: float) -> float:
    """Section 7: straight between two values, the end values held (also section 6, lookup)."""
    n = len(values) - 1
    s = 0.0 if s < 0 else type(s)(n) if s > n else s
    j = min(math.trunc(s), n - 1)
    return values[j] + (s - j) * (values[j + 1] - values[j])


def _closing(way: float, drift: float, r: float, hi: float, lo: float, a: float) -> float:
    """Section 8, CLOSING."""
    keep = hi if r > hi else r
    keep = lo if keep < lo else keep
    forward, away, sign = (hi, lo, 1) if way > 0 else (lo, hi, -1)

    def stops(x: float) -> bool:
        q = sign * (x - drift)
        return q <= 0 or q * (q - a) <= 2 * a * (sign * (way - x))

    if a == 0 or stops(forward):
        return forward
    if sign * (keep - drift) > 0 and stops(keep):
        return keep
    if sign * (away - drift) > 0:
        return away
    h = drift + 0.5 * (way - drift)
    return lo if h < lo else hi if h > hi else h
