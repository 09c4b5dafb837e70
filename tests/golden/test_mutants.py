"""The golden vectors tell every evaluator that differs from the format's page in one rule, but for those named here."""

from __future__ import annotations

import pytest

from tests.golden import mutants

# Changes that change no result, by why they do not.
SAME = {
    "both ways lead to the same number where they meet": """
        _between: s < 0 -> s <= 0
        _between: s > n -> s >= n
        _closing: h < lo -> h <= lo
        _closing: h > hi -> h >= hi
        _closing: sign * (away - drift) > 0 -> sign * (away - drift) >= 0
        _replace: value < r.low -> value <= r.low
        _replace: value > r.high -> value >= r.high
        _operation: u[0] < node.a -> u[0] <= node.a
        _operation: u[0] > node.b -> u[0] >= node.b
        _lag: before >= s.y -> before > s.y
        _direction: u >= s.m -> u > s.m
        _direction: u <= s.m -> u < s.m
        _take_over: s.now < r.valid_low -> s.now <= r.valid_low
        _take_over: over > 0 -> over >= 0
        _rate: s.raw - s.anchor > reach -> s.raw - s.anchor >= reach
        _limit: abs(s.c) > most -> abs(s.c) >= most
        _move: goal > x + step -> goal >= x + step
        _move: goal < x - step -> goal <= x - step
        exp: y >= 0 -> y > 0
        exp: n >= 0 -> n > 0
        exp: 0 -> 1 in n >= 0
        ln: x < 1 -> x <= 1
        ln: x < 1 -> True
        ln: 1 -> 2 in x < 1
        ln: x > 1.4142135623730951 -> x >= 1.4142135623730951
        ln: x >= 2.0 ** e -> x > 2.0 ** e
        ln: x * 2.0 ** e < 2 -> x * 2.0 ** e <= 2
        power: u < 0 -> u <= 0
    """,
    "never so: a rate outside lo..hi, k = 0, a side but -1 and 1, a node no longer ready, a flag asked before": """
        _closing: keep = lo if keep < lo else keep -> pass
        _closing: hi if r > hi else r -> r
        _closing: lo if keep < lo else keep -> keep
        _closing: r > hi -> r >= hi
        _closing: r > hi -> False
        _closing: keep < lo -> keep <= lo
        _closing: keep < lo -> False
        _direction: y > 0 -> y >= 0
        _direction: k > 0 -> k >= 0
        _run: not s.ready and node.operation == 2 -> node.operation == 2
        _read: 2 -> 3 in r.flags & 2
        _replace: 32 -> 33 in r.flags & 32
        _limit: goal > 0 -> goal >= 0
        _limit: s.c > 0 -> s.c >= 0
        _limit: 6 -> 7 in output.flags & 6
    """,
    "no vector exchanges tables, without which no correction stands beyond its magnitude (tests/faults)": """
        _limit: abs(b) -> b
        _limit: max(output.magnitude, abs(b)) -> output.magnitude
    """,
    "e^700 is no result either: what it is for is not sane": """
        exp: y = type(y)(limit) if y > limit else y -> pass
        exp: type(y)(limit) if y > limit else y -> y
        exp: y > limit -> y >= limit
        exp: y > limit -> False
    """,
    "below a rounding": """
        ln: degree - 2 -> degree + 2
        ln: degree - 2 -> degree
    """,
    "what is left of an input is 1 at most, and every table of the vectors has one": """
        _fade: 1.0 -> 2.0 in target = 1.0
        _take_over: 1.0 -> 2.0 in self.number(1.0)
    """,
    "numbers of faults, sources and refused readings, and bit 0, are not told apart by a vector": """
        _judge: reading is not None -> True
        _judge: reading is not None -> False
        _rate: s.rejected += 1 -> pass
        _rate: 1 -> 2 in s.rejected += 1
        _judge: 0 -> 1 in (0, 0, 0.0)
        _judge: 1 -> 2 in s.fault = 1
        _judge: 2 -> 3 in s.fault = 2
        _judge: 3 -> 4 in s.fault = 3
        _judge: 4 -> 5 in s.fault = 4
        _replace: 1 -> 2 in (r.low if value < r.low else r.high if value > r.high else value, 1, True)
        _replace: 3 -> 4 in (r.default, 3)
        _ramp: 0 -> 1 in RAMPING if self.rho > 0 else 0
    """,
}


@pytest.mark.slow
def test_every_rule_is_distinguished_from_its_neighbours():
    made, unseen = mutants.unseen()
    same = {line.strip() for lines in SAME.values() for line in lines.splitlines() if line.strip()}
    assert made > 1000
    assert set(unseen) <= same, sorted(set(unseen) - same)
