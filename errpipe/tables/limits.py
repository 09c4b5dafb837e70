"""How fast corrections may move by default: as fast as the axes' own motion asks of them, and never at a step.

A correction that follows a profile moves with the slope of the profile times the speed of the axis; one that turns with
the direction has to have turned soon after the axis has. What is slower than both cannot follow, what is faster only
lets a failure through faster.
"""

from __future__ import annotations

from collections.abc import Mapping

from errpipe.domain import table as t
from errpipe.tables import bounds
from errpipe.tables.compile import Limits, with_limits

MAX_DEFAULT_SLEW = 1000.0  # um/s (urad/s): 1 um/ms, below a following-error alarm or a mark on the surface
MAX_MAGNITUDE = 10_000.0  # um (urad): more than any machine tool is wrong by; the same as ECT_MOST in ect.h
MAX_RATE = 10_000.0  # um/s (urad/s): ten times the fastest default; beyond it a failure is a jump; ECT_MOST, too
MIN_DEFAULT_SLEW = 100.0  # um/s (urad/s): a ramp of 100 um takes a second
FASTER = 10.0  # times the fastest motion recorded: machines cut and position faster than they are measured
TURNING_S = 0.01  # s in which a reversal has to be through: at 1 m/min the axis has moved 0.17 mm
RISE_S = 0.01  # s in which a correction reaches its slew: no step of its rate either


def without_limits(table: t.CompensationTable) -> str:
    """The first output without magnitude or slew, or with one above its maximum; empty if there is none."""
    for o in table.outputs:
        if o.magnitude is None or o.slew is None or o.magnitude > MAX_MAGNITUDE or o.slew > MAX_RATE:
            return o.name
    return ""


def limited(
    table: t.CompensationTable,
    speeds: Mapping[str, float] | None = None,
    stated: Mapping[str, Limits] | None = None,
    of_axes: Limits | None = None,
) -> t.CompensationTable:
    """The table with magnitude, slew and acceleration for every output: what is stated, else defaults.

    speeds: axis -> largest speed of the recording, mm/s or deg/s; an axis without one counts as fast. Without a
    magnitude: largest value of the table. of_axes: limits of each axis' whole correction, which its outputs
    share. Raises GateError for limits of outputs the table does not have.
    """
    needed = slews(table, speeds or {})
    stated = _shared(table, of_axes or Limits(), needed) | dict(stated or {})
    limits = {}
    for output in table.outputs:
        own = stated[output.name]
        slew = own.slew or needed[output.name]
        limits[output.name] = Limits(own.magnitude, slew, own.acceleration or slew / RISE_S)
    unknown = {name: own for name, own in stated.items() if name not in limits}
    return with_limits(table, limits | unknown)


def _shared(table: t.CompensationTable, whole: Limits, needed: Mapping[str, float]) -> dict[str, Limits]:
    """Output -> its part of an axis' limits: of the magnitude as it reaches, of the rates as it moves."""
    far = _parts(table, {r.name: r.deviation + r.gridding for r in bounds.outputs(table)})
    fast = _parts(table, needed)
    return {
        name: Limits(
            whole.magnitude and whole.magnitude * far[name],
            whole.slew and whole.slew * fast[name],
            whole.acceleration and whole.acceleration * fast[name],
        )
        for name in far
    }


def _parts(table: t.CompensationTable, sizes: Mapping[str, float]) -> dict[str, float]:
    """Output -> its part of what all outputs of its axis add up to, 0..1: a controller adds them."""
    whole: dict[str, float] = {}
    for output in table.outputs:
        key = output.axis or output.name
        whole[key] = whole.get(key, 0.0) + sizes[output.name]
    return {o.name: sizes[o.name] / (whole[o.axis or o.name] or 1.0) for o in table.outputs}


def slews(table: t.CompensationTable, speeds: Mapping[str, float]) -> dict[str, float]:
    """Output -> default slew, um/s or urad/s: of the outputs of one axis together at most `MAX_DEFAULT_SLEW`."""
    spans = bounds.node_spans(table.nodes, table.inputs, table.table)
    reach = {c.name: c.deviation for c in bounds.components(table)}
    rates = dict.fromkeys(reach, 0.0)
    for pair in table.pairs:
        profile = table.profiles[pair.profile]
        largest = profile.scale * max(abs(v) for v in profile.values)
        if _turns(table, pair.driver):
            rates[pair.component] += 2.0 * largest * bounds.largest(spans[pair.driver]) / TURNING_S
        rates[pair.component] += _slope(profile) * _speed(table, profile, speeds) * bounds.largest(spans[pair.driver])
    out = {}
    for output in table.outputs:
        total = 0.0
        for term in output.terms:
            sizes = [bounds.largest(spans[n]) for n in term.factors]
            rate = rates[term.component]
            for size in sizes:
                rate *= size
            total += abs(term.weight) * rate
            if sizes and reach[term.component] > 0:  # an arm moves too, at a speed the table does not know
                total = MAX_DEFAULT_SLEW
        out[output.name] = min(max(total, MIN_DEFAULT_SLEW), MAX_DEFAULT_SLEW)
    parts = _parts(table, out)
    return {name: min(slew, MAX_DEFAULT_SLEW * parts[name]) for name, slew in out.items()}


def _slope(profile: t.Profile) -> float:
    """Steepest part of a profile, its unit per unit of the position."""
    steps = (abs(b - a) for a, b in zip(profile.values, profile.values[1:], strict=False))
    return max(steps, default=0) * profile.scale / profile.step


def _speed(table: t.CompensationTable, profile: t.Profile, speeds: Mapping[str, float]) -> float:
    """Largest speed along a profile in production; infinite if not stated."""
    if profile.input is None:
        return 0.0
    channel = table.inputs[table.input_index(profile.input)]
    if not channel.fast:
        return channel.max_rate or 0.0
    return FASTER * speeds[channel.axis] if channel.axis in speeds else MAX_DEFAULT_SLEW / max(_slope(profile), 1e-12)


def _turns(table: t.CompensationTable, number: int) -> bool:
    """Whether a node follows the direction of travel."""
    below = {number}
    for n in range(number, -1, -1):
        if n in below:
            if isinstance(table.nodes[n], t.DirectionNode | t.ApproachNode):
                return True
            below.update(table.nodes[n].of)
    return False
