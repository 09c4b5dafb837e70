"""The compensation table: a compiled error model that a controller runs in a fixed-rate cycle.

This model *is* the JSON twin (format version 2; version 1 is read and runs by its own rules); the binary twin `.ect`
contains the same, bit for bit, and `schemas/ect-2.md` states both so that they can be implemented without reading this
code. Every target and every evaluator sees only this.

    conditioned inputs -> nodes (drivers) -> profile(position) x node, summed per component
                       -> synthesis: outputs = sum of weight x component x nodes -> limits -> correction

Units: deviations um and urad, corrections in each output's `correction_unit`. deviation = actual - commanded;
correction = -deviation.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from errpipe.domain.operations import LARGEST_NUMBER, NotNegative, Number, Positive
from errpipe.domain.table_nodes import (  # noqa: F401  # used as names of this module, `t.LagNode`
    AffineNode,
    AnyNode,
    ApproachNode,
    ClipNode,
    ConstantNode,
    DirectionNode,
    FirstNode,
    InputNode,
    LagNode,
    LookupNode,
    Node,
    PowerNode,
    ProductNode,
    SwitchNode,
    check_node,
)
from errpipe.domain.table_text import AXIS, TITLE, Index, Name, Part, text
from errpipe.yamlfile import quantity

MAX_INPUTS = 64  # this and the following: limits of the format (schemas/ect-2.md)
MAX_NODES = 1024
MAX_OPERANDS = 4096
MAX_LOOKUP_VALUES = 65536
MAX_PROFILES = 512
MAX_VALUES = 1 << 22  # of all profiles
MAX_COMPONENTS = 64
MAX_PAIRS = 2048
MAX_OUTPUTS = 64
MAX_MONOMIALS = 4096
MAX_FACTORS = 4
MAX_SLOW_EVERY = 1_000_000  # position cycles in a thermal one
LARGEST_VALUE = (1 << 30) - 1  # of a profile, so that the difference of two values fits 32 bits
LARGEST_RESULT = 1e30  # a node or deviation beyond it, or not a number, counts as 0 and raises `not_finite`

# Bits of the status word, lowest first.
STATUS = (
    *("running", "active", "ramping", "substituted", "held", "defaulted", "fading", "faded"),
    *("at_magnitude", "at_rate", "beyond_profile", "waiting", "not_finite", "holding"),
)
STATUS_BIT = {name: 1 << n for n, name in enumerate(STATUS)}
# Why a reading is rejected, and what replaces it: the codes a controller shows per input.
FAULTS = ("none", "missing", "stale", "range", "rate")
SOURCES = ("reading", "substitute", "held", "default")

# Kinds whose nodes run every position cycle; all others run every thermal cycle.
FAST_KINDS = ("position", "direction", "velocity", "force")

Kind = Literal["position", "direction", "velocity", "force", "sensor", "speed", "coolant", "load", "tool", "other"]
CORRECTION_FACTORS = {
    ("um", "um"): 1.0,
    ("um", "mm"): 0.001,
    ("urad", "urad"): 1.0,
    ("urad", "deg"): 5.729577951308232e-05,
    ("urad", "rad"): 1e-06,
}


class Substitute(Part):
    """One summand of a substitute reading: weight x another input's reading."""

    input: Name = Field(description="Input that helps out.")
    weight: Number = quantity("of this input per unit of the source", "What its reading is multiplied by.")


class TableInput(Part):
    """A channel the controller feeds each cycle, and what happens when its reading is rejected.

    A reading is accepted if it is finite, fresh, within [low, high], and lies within `noise` of where `max_rate` lets
    it be; the first one of a run once it has stayed there for half a thermal cycle. Else: the substitute (if its
    sources are accepted), else the last accepted reading for less than `hold_s`, else `default`. The result is always
    within [low, high], and what the table sees of it within `valid`.
    """

    name: Name = Field(description="Name of the channel.")
    kind: Kind = Field(description="Kind of quantity; motion and force are read every position cycle.")
    axis: Annotated[str, text(7, AXIS)] = Field("", description="Letter of the axis it belongs to.")
    unit: Annotated[str, text(15)] = Field("", description="Unit of the reading.")
    low: Number = quantity("of the input", "Lowest plausible reading.")
    high: Number = quantity("of the input", "Highest plausible reading.")
    max_rate: Positive | None = quantity("of the input per s", "Largest plausible change.", None)
    noise: NotNegative = quantity(
        "of the input", "Change that is no movement: noise and resolution of the reading (with max_rate).", 0.0
    )
    stale_after_s: Positive | None = quantity("s", "A reading older than this is rejected.", None)
    substitute: tuple[Substitute, ...] = Field(
        (), description="Summands of the reading's substitute; none: no substitute."
    )
    substitute_offset: Number = quantity("of the input", "What is added to that sum.", 0.0)
    hold_s: Annotated[float, Field(ge=0, le=LARGEST_NUMBER)] | None = quantity(
        "s", "How long the last accepted reading is held; none: indefinitely.", None
    )
    default: Number = quantity("of the input", "Value used if there is neither reading nor substitute.")
    optional: bool = Field(False, description="Absence is no fault (a direction the controller may know).")
    fade_on_default: bool = Field(True, description="While only the default is left, what is not `keep` fades out.")
    valid: tuple[Number, Number] | None = quantity("of the input", "Validity box: what the fit has seen.", None)
    margin: Positive | None = quantity(
        "of the input", "Distance outside `valid` over which the table fades to zero.", None
    )

    @model_validator(mode="after")
    def _ordered(self) -> TableInput:
        if not self.low < self.high:
            raise ValueError(f"input {self.name}: low {self.low:g} is not below high {self.high:g}")
        if not self.low <= self.default <= self.high:
            raise ValueError(f"input {self.name}: default {self.default:g} lies outside {self.low:g}..{self.high:g}")
        if (self.valid is None) != (self.margin is None):
            raise ValueError(
                f"input {self.name}: valid and margin must be given together (a correction never ends in a step)"
            )
        if self.noise > 0 and self.max_rate is None:
            raise ValueError(f"input {self.name}: noise {self.noise:g} without max_rate says nothing")
        if self.valid is not None and not self.valid[0] <= self.valid[1]:
            raise ValueError(f"input {self.name}: valid range is reversed")
        return self

    @property
    def fast(self) -> bool:
        """Whether nodes that read it run every position cycle."""
        return self.kind in FAST_KINDS


class Profile(Part):
    """A curve over one input on a uniform grid: value = scale x integer, straight between grid points.

    Held beyond both ends; `periodic` repeats with (count - 1) x step, its last value equal to its first.
    One value: a constant (no input). Errors are the largest seen when it was gridded, in the profile's unit.
    """

    input: Name | None = Field(None, description="Input it runs over; none: a constant.")
    start: Number = quantity("of the input", "Input at the first value.", 0.0)
    step: Positive = quantity("of the input", "Distance between two values.", 1.0)
    scale: Positive = quantity("of the profile", "Size of one step of a value.", 0.001)
    periodic: bool = Field(False, description="Repeats beyond its ends, where others hold their end values.")
    values: tuple[Annotated[int, Field(ge=-LARGEST_VALUE, le=LARGEST_VALUE)], ...] = Field(
        min_length=1, description="Whole numbers; times `scale` they are the curve."
    )
    interpolation_error: Annotated[float, Field(ge=0)] = quantity(
        "of the profile", "Largest error of the straight lines between values.", 0.0
    )
    rounding_error: Annotated[float, Field(ge=0)] = quantity(
        "of the profile", "Largest error of rounding to whole numbers.", 0.0
    )

    @property
    def end(self) -> float:
        """Input at the last value."""
        return self.start + self.step * (len(self.values) - 1)

    @model_validator(mode="after")
    def _sound(self) -> Profile:
        if (self.input is None) != (len(self.values) == 1):
            raise ValueError("a profile has an input exactly if it has more than one value")
        if self.periodic and (len(self.values) < 3 or self.values[0] != self.values[-1]):
            raise ValueError("a periodic profile needs three values or more and ends on its first")
        return self


class Component(Part):
    """One ISO 230-1 error component, the sum of its pairs."""

    name: Annotated[str, Field(min_length=1), text(15)] = Field(description="Name by ISO 230-1, such as EXX.")
    unit: Literal["um", "urad"] = Field("um", description="Unit of the deviation.")


class Pair(Part):
    """profile x node, added to a component. keep: not faded outside validity."""

    component: Annotated[str, Field(min_length=1), text(15)] = Field(description="Component it is added to.")
    profile: Index = Field(description="Number of the profile.")
    driver: Index = Field(description="Number of the node it is multiplied by.")
    keep: bool = Field(False, description="Not faded outside validity.")


class Monomial(Part):
    """weight x component x product of nodes, added to an output."""

    weight: Number = quantity(
        "of the output per component and factors", "How much of the component and its factors shows."
    )
    component: Annotated[str, Field(min_length=1), text(15)] = Field(description="Component that shows in the output.")
    factors: tuple[Index, ...] = Field(
        (), max_length=MAX_FACTORS, description="Numbers of the nodes it is multiplied by, such as a coordinate's."
    )


class Output(Part):
    """One correction the controller applies, with its limits (in the deviation's unit; None: no limit)."""

    name: Name = Field(description="Name of the correction.")
    axis: Annotated[str, text(7, AXIS)] = Field("", description="Letter of the axis that applies it.")
    unit: Literal["um", "urad"] = Field("um", description="Unit of the deviation that it corrects.")
    correction_unit: Literal["mm", "um", "urad", "deg", "rad"] = Field(
        "mm", description="Unit in which the controller expects it."
    )
    magnitude: Positive | None = quantity("of the deviation", "Largest correction; none: no limit.", None)
    slew: Positive | None = quantity("of the deviation per s", "Largest rate of the correction.", None)
    acceleration: Positive | None = quantity("of the deviation per s2", "Largest change of that rate.", None)
    terms: tuple[Monomial, ...] = Field(min_length=1, description="Summands of the deviation at the tool.")

    @model_validator(mode="after")
    def _convertible(self) -> Output:
        if (self.unit, self.correction_unit) not in CORRECTION_FACTORS:
            raise ValueError(f"output {self.name}: a deviation in {self.unit} cannot be in {self.correction_unit}")
        return self

    @property
    def factor(self) -> float:
        """correction_unit per unit."""
        return CORRECTION_FACTORS[self.unit, self.correction_unit]


class CompensationTable(Part):
    """Format version 2 of the compensation table (JSON twin); version 1 is read too, and runs by its rules."""

    table: Literal[1, 2] = Field(2, description="Format version: 2, and 1 for tables of older programs.")
    machine: Annotated[str, text(63, TITLE)] = Field("", description="Machine it was made for.")
    title: Annotated[str, text(127, TITLE)] = Field("", description="What it is, for people.")
    version: Annotated[str, text(31, TITLE)] = Field("", description="errpipe version that compiled it.")
    fingerprint: Annotated[str, Field(pattern="^([0-9a-f]{64})?$")] = Field("", description="Of the error model.")
    position_cycle_s: Annotated[float, Field(ge=1e-6, le=10)] = quantity("s", "Time between two corrections.", 0.001)
    slow_every: Annotated[int, Field(ge=1, le=MAX_SLOW_EVERY)] = Field(
        1000, description="Position cycles in a thermal one."
    )
    ramp_s: Annotated[float, Field(ge=0, le=3600)] = quantity("s", "Time to ramp in or out.", 1.0)
    fade_s: Annotated[float, Field(ge=0, le=3600)] = quantity("s", "Shortest time for a whole fade.", 1.0)
    inputs: tuple[TableInput, ...] = Field(max_length=MAX_INPUTS, description="Channels that the controller feeds.")
    nodes: tuple[AnyNode, ...] = Field(
        min_length=1, max_length=MAX_NODES, description="Operations, each on earlier ones."
    )
    profiles: tuple[Profile, ...] = Field(min_length=1, max_length=MAX_PROFILES, description="Curves over one input.")
    components: tuple[Component, ...] = Field(min_length=1, max_length=MAX_COMPONENTS, description="Error components.")
    pairs: tuple[Pair, ...] = Field(
        min_length=1, max_length=MAX_PAIRS, description="Profile times node, summed per component."
    )
    outputs: tuple[Output, ...] = Field(
        min_length=1, max_length=MAX_OUTPUTS, description="Corrections, one per axis that applies one."
    )

    @property
    def thermal_cycle_s(self) -> float:
        """Time between two evaluations of the slow nodes, s."""
        return self.position_cycle_s * self.slow_every

    def input_index(self, name: str) -> int:
        """Number of an input. Raises KeyError."""
        return {i.name: n for n, i in enumerate(self.inputs)}[name]

    @model_validator(mode="after")
    def _consistent(self) -> CompensationTable:
        known = _unique("input", (i.name for i in self.inputs))
        if self.table == 1 and any(i.noise > 0 for i in self.inputs):
            raise ValueError("a table of version 1 knows no noise of its inputs")
        if self.table == 1 and any(isinstance(n, ApproachNode) and n.threshold > 0 for n in self.nodes):
            raise ValueError("a table of version 1 knows no threshold of an approach")
        components = _unique("component", (c.name for c in self.components))
        _unique("output", (o.name for o in self.outputs))
        _check_substitutes(self.inputs)
        for number, node in enumerate(self.nodes):
            check_node(number, node, known)
        for number, profile in enumerate(self.profiles):
            if profile.input is not None and profile.input not in known:
                raise ValueError(f"profile {number}: input {profile.input!r} is not in the table")
            _check_turns(number, profile, self.inputs)
        _check_sums(self, components)
        _check_totals(self)
        return self


def _unique(what: str, names) -> set[str]:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f"{what} {name!r} occurs twice")
        seen.add(name)
    return seen


def _check_substitutes(inputs: tuple[TableInput, ...]) -> None:
    """A substitute is made of other inputs, whose absence is a fault."""
    accepted = {i.name for i in inputs if not i.optional}
    for i in inputs:
        for s in i.substitute:
            if s.input not in accepted or s.input == i.name:
                raise ValueError(f"input {i.name}: {s.input!r} cannot be a source of its substitute")


def _check_sums(table: CompensationTable, components: set[str]) -> None:
    """Pairs and synthesis terms name components, profiles and nodes of the table."""
    for number, pair in enumerate(table.pairs):
        if pair.component not in components:
            raise ValueError(f"pair {number}: component {pair.component!r} is not in the table")
        if pair.profile >= len(table.profiles) or pair.driver >= len(table.nodes):
            raise ValueError(f"pair {number}: no profile {pair.profile} or no node {pair.driver}")
    for output in table.outputs:
        for term in output.terms:
            if term.component not in components or any(f >= len(table.nodes) for f in term.factors):
                raise ValueError(f"output {output.name}: no component {term.component!r} or node {term.factors}")


def _check_turns(number: int, profile: Profile, inputs: tuple[TableInput, ...]) -> None:
    """A periodic profile counts its periods in 32 bits."""
    if not profile.periodic:
        return
    channel = next(i for i in inputs if i.name == profile.input)
    period = (len(profile.values) - 1) * profile.step
    ends = (channel.low, channel.high, *(channel.valid or ()))  # the table sees an input within its validity
    if max(abs(end - profile.start) for end in ends) / period > 1e9:
        raise ValueError(f"profile {number}: more than 1e9 periods within the range of {channel.name}")


def _check_totals(table: CompensationTable) -> None:
    totals = {
        "operands": (sum(len(n.of) for n in table.nodes), MAX_OPERANDS),
        "lookup values": (sum(len(n.values) for n in table.nodes if isinstance(n, LookupNode)), MAX_LOOKUP_VALUES),
        "profile values": (sum(len(p.values) for p in table.profiles), MAX_VALUES),
        "synthesis terms": (sum(len(o.terms) for o in table.outputs), MAX_MONOMIALS),
    }
    for what, (count, allowed) in totals.items():
        if count > allowed:
            raise ValueError(f"{count} {what} (allowed: {allowed})")
