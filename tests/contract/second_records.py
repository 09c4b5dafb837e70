"""The records of the compensation table as the second reader holds them: sections 2 and 3 of `schemas/ect-2.md`."""

from typing import Any, NamedTuple


class Input(NamedTuple):
    """Section 3.1."""

    name: str
    axis: str
    unit: str
    kind: int
    flags: int
    first: int
    count: int
    zero: int
    low: float
    high: float
    max_rate: float
    stale_after: float
    hold: float
    default: float
    offset: float
    valid_low: float
    valid_high: float
    margin: float
    noise: float = 0.0

    @property
    def optional(self) -> bool:
        """Flag 1 of section 3.1."""
        return bool(self.flags & 1)


class Link(NamedTuple):
    """A substitute (3.1) or an operand (3.2): something else, with a weight."""

    target: int
    zero: int
    weight: float


class Node(NamedTuple):
    """Section 3.2."""

    operation: int
    flags: int
    first: int
    count: int
    other: int
    others: int
    zero: int
    a: float
    b: float
    c: float
    d: float

    @property
    def slow(self) -> bool:
        """Flag 1 of section 3.2."""
        return bool(self.flags & 1)


class Profile(NamedTuple):
    """Section 3.3."""

    input: int
    flags: int
    first: int
    count: int
    start: float
    step: float
    per_step: float
    per_period: float
    scale: float
    interpolation: float
    rounding: float

    @property
    def periodic(self) -> bool:
        """Flag 1 of section 3.3."""
        return bool(self.flags & 1)


class Component(NamedTuple):
    """Section 3.4."""

    name: str
    unit: int
    zero: int


class Pair(NamedTuple):
    """Section 3.4."""

    component: int
    profile: int
    node: int
    flags: int


class Output(NamedTuple):
    """Section 3.4."""

    name: str
    axis: str
    units: int
    flags: int
    first: int
    count: int
    factor: float
    magnitude: float
    slew: float
    acceleration: float


class Term(NamedTuple):
    """Section 3.4."""

    component: int
    count: int
    node0: int
    node1: int
    node2: int
    node3: int
    weight: float


class Number(NamedTuple):
    """A lookup value (3.2) or a profile value (3.3)."""

    value: Any


class Table(NamedTuple):
    """A sound file: the header's numbers and the eleven sections (section 2)."""

    version: int
    name: str
    machine: str
    title: str
    compiler: str
    slow_every: int
    position_cycle: float
    thermal_cycle: float
    ramp: float
    fade: float
    inputs: list[Input]
    substitutes: list[Link]
    nodes: list[Node]
    operands: list[Link]
    lookups: list[float]
    profiles: list[Profile]
    values: list[int]
    components: list[Component]
    pairs: list[Pair]
    outputs: list[Output]
    terms: list[Term]
