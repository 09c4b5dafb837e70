"""Golden tables of which each cycle meets a rule exactly: ties, ends, signs and what a random table rarely reaches.

Their cycle is 2^-10 s and their numbers are short in binary, so that a tie is one in single precision too.
"""

from __future__ import annotations

import math

import numpy as np

from errpipe.domain import table as t

TICK = 2.0**-10
HOLD = 2  # mode of a cycle in which corrections stay
HIGH = 1000.0  # where every channel ends that says nothing else
BAD = math.nan


def channel(name: str, **more) -> t.TableInput:
    """An input without a unit of its own, -1000 to 1000, read anew in every cycle."""
    return t.TableInput(name=name, **({"kind": "force", "low": -HIGH, "high": HIGH, "default": 3.0} | more))


def shown(inputs, nodes, faded=(), **more) -> t.CompensationTable:
    """Each node is an output of its own, 1 um for 1; `faded`: nodes shown once more, faded."""
    which = [*((n, True) for n in range(len(nodes))), *((n, False) for n in faded)]
    names = [f"N{n}" if keep else f"F{n}" for n, keep in which]
    return t.CompensationTable(
        position_cycle_s=TICK,
        ramp_s=0.0,
        inputs=inputs,
        nodes=nodes,
        profiles=(t.Profile(values=(1,), scale=1.0),),
        components=tuple(t.Component(name=name) for name in names),
        pairs=tuple(
            t.Pair(component=name, profile=0, driver=n, keep=keep) for name, (n, keep) in zip(names, which, strict=True)
        ),
        outputs=tuple(
            t.Output(name=name, correction_unit="um", terms=(t.Monomial(weight=1.0, component=name),)) for name in names
        ),
        **({"slow_every": 2, "fade_s": 4 * TICK} | more),
    )


def rows(**columns) -> list[dict]:
    """One dictionary per cycle; None: no new reading. The last value of a shorter column stays, with new readings."""
    cycles = max(len(c) for c in columns.values())
    full = {n: [*c, *[c[-1]] * (cycles - len(c))] for n, c in columns.items()}
    return [{n: c[k] for n, c in full.items() if c[k] is not None} for k in range(cycles)]


def readings() -> tuple[t.CompensationTable, list[dict]]:
    """Stale, range, rate and hold at and beside their bounds; a substitute clamped to low and high; optional inputs."""
    inputs = (
        channel("stale", stale_after_s=3 * TICK, hold_s=0.0, fade_on_default=False),
        channel("rate", max_rate=8 / TICK, hold_s=4 * TICK, fade_on_default=False),
        channel("range", low=0.0, high=8.0, hold_s=0.0, fade_on_default=False),
        channel("clamped", low=-4.0, high=4.0, substitute=({"input": "spare", "weight": 2.0},), substitute_offset=-1.0),
        channel("spare", substitute=({"input": "stale", "weight": 1.0}, {"input": "rate", "weight": -0.5})),
        channel("known", optional=True, default=-2.0),
        channel("kept"),
        channel("helped", hold_s=2 * TICK, substitute=({"input": "spare", "weight": 1.0},), fade_on_default=False),
    )
    nodes = tuple(t.InputNode(input=i.name) for i in inputs)
    first = tuple(t.FirstNode(of=(n,)) for n in range(len(nodes)))  # starts with the first reading that counts
    table = shown(inputs, (*nodes, *first, t.InputNode(input="stale", slow=True)))
    gone = [None] * 3
    given = rows(
        stale=[
            1.0,
            None,
            None,
            None,
            2.0,
            *gone,
            None,
            None,
            3.0,
            *gone,
            *gone,
            *gone,
            4.0,
            5.0,
            6.0,
            *gone,
            None,
            7.0,
            8.0,
        ],
        rate=[
            BAD,
            0.0,
            8.0,
            16.0,
            25.0,
            32.0,
            32.0,
            23.875,
            24.0,
            40.0,
            100.0,
            101.0,
            102.0,
            103.0,
            104.0,
            105.0,
            106.0,
            None,
            107.0,
            BAD,
            115.0,
            140.0,
            139.0,
            132.0,
            BAD,
            BAD,
            BAD,
            BAD,
            130.0,
        ],
        range=[
            None,
            0.0,
            8.0,
            -0.125,
            8.125,
            4.0,
            2e30,
            1e30,
            -1e30,
            -2e30,
            1e300,
            math.inf,
            -math.inf,
            -0.0,
            BAD,
            8.0,
        ],
        clamped=[BAD, BAD, 3.0, 4.0, -4.0, 4.125, 9.0, -9.0, BAD, 1.0, 2.0, BAD, BAD, -4.5, BAD, BAD, BAD, 0.5, BAD],
        spare=[
            None,
            BAD,
            2.0,
            2.5,
            2.625,
            2.5,
            3.0,
            -1.5,
            -1.625,
            -2.0,
            BAD,
            BAD,
            0.75,
            BAD,
            BAD,
            1.25,
            BAD,
            BAD,
            BAD,
            1.5,
        ],
        known=[None, BAD, 5.0, BAD, 1.0, 2000.0, 2.0],
        kept=[BAD, 1.0, 2.0, *[BAD] * 20, 3.0],
        helped=[
            BAD,
            BAD,
            BAD,
            5.0,
            BAD,
            BAD,
            6.0,
            BAD,
            BAD,
            BAD,
            BAD,
            BAD,
            BAD,
            7.0,
            BAD,
            BAD,
            8.0,
            BAD,
            BAD,
            BAD,
            BAD,
        ],
    )
    return table, given


def doubts() -> tuple[t.CompensationTable, list[dict]]:
    """Rates with a noise, exactly at their bounds and beside them, before and after the first reading is accepted."""
    inputs = (
        channel("a", max_rate=4 / TICK, noise=8.0, hold_s=6 * TICK, fade_on_default=False),
        channel("b", max_rate=2 / TICK, noise=1.0, stale_after_s=2 * TICK, fade_on_default=False),
        channel("c", max_rate=1 / TICK, optional=True, default=-7.0),
        channel("d", max_rate=4 / TICK, noise=8.0, substitute=({"input": "a", "weight": 1.0},)),
    )
    nodes = tuple(t.InputNode(input=i.name) for i in inputs)
    first = tuple(t.FirstNode(of=(n,)) for n in range(len(nodes)))
    table = shown(inputs, (*nodes, *first), slow_every=6)
    start = [0.0, 12.125, 12.125, 0.0, 12.0, 20.0, 8.0, 8.0, 8.0, 20.0, 20.125, 20.0, 32.0, 24.0, 12.0, -0.125, 0.0]
    a = [*start, 12.0, 24.0, 24.125, BAD, 24.0, 80.0, 80.0, 79.875, 80.0, None, 80.0, None, None, 60.0, 36.0]
    b = [5.0, None, 5.0, 8.0, 5.0, 5.0, 5.0, 8.0, 8.0, 5.0, 2.0, None, None, None, 2.0, -1.0, -4.0, -4.125, 30.0, 0.0]
    c = [1.0, 1.0, 1.0, 1.0, 2.0, 3.0, 4.125, 5.0, 6.0, 6.0, 4.0, 3.0, 2.0, 1.0, BAD, BAD, -1.0]
    r = np.random.default_rng(8)
    walk = [float(v) for v in np.cumsum(r.integers(-28, 29, 120)) / 2.0]
    jumps = [float(v) for v in np.cumsum(r.choice((-12.0, -4.0, -0.5, 0.0, 0.5, 4.0, 12.0, 12.125, -12.125), 120))]
    d = [None if v == 0.5 else v for v in jumps]
    return table, rows(a=a + walk, b=b + [v / 4 for v in walk], c=c + [v / 16 for v in walk], d=d)


def slowly() -> tuple[t.CompensationTable, list[dict]]:
    """Inputs shown in thermal cycles only, within their validity: a profile, nodes and the fade see the same."""
    inputs = (
        channel("a", kind="sensor", valid=(-1.0, 1.0), margin=8.0, hold_s=2 * TICK, default=3.0),
        channel(
            "b", kind="position", valid=(0.0, 4.0), margin=16.0, hold_s=2 * TICK, default=0.0, fade_on_default=False
        ),
        channel("c", kind="other", max_rate=2 / TICK, noise=1.0, hold_s=4 * TICK, fade_on_default=False),
    )
    nodes = (*(t.InputNode(input=i.name, slow=slow) for i in inputs for slow in (False, True)), t.FirstNode(of=(0,)))
    table = shown(inputs, nodes, faded=(0, 3), slow_every=3, fade_s=8 * TICK)
    profiles = (*table.profiles, t.Profile(input="a", start=-2.0, step=1.0, values=(0, 8, 16, -8, 4, 64), scale=0.125))
    pairs = (*table.pairs, t.Pair(component="N0", profile=1, driver=0, keep=True))
    table = t.CompensationTable.model_validate(table.model_dump() | {"profiles": profiles, "pairs": pairs})
    r = np.random.default_rng(9)
    a = [0.5, 9.0, 1.0, 1.0, -1.0, 9.0, 5.0, BAD, BAD, BAD, BAD, 1.125, 0.0, 0.0, -9.0, -9.0, -5.0, -1.125, -1.0, 0.0]
    a += [float(v) for v in r.choice((-13.0, -9.0, -2.0, -1.0, 0.0, 0.5, 1.0, 1.25, 5.0, 9.0, 10.0, BAD), 100)]
    b = [float(v) for v in r.choice((-16.0, -8.0, -0.5, 0.0, 2.0, 4.0, 4.25, 8.0, 20.0, 21.0, BAD), 120)]
    c = [None if v == 0 else float(v) for v in np.cumsum(r.integers(-4, 5, 120)) / 2.0]
    return table, rows(a=a, b=b, c=c)


def fading() -> tuple[t.CompensationTable, list[dict]]:
    """Validity: outside it from the first cycle, exactly on its bounds, of two inputs, of a value that stands in."""
    inputs = (
        channel("a", valid=(-1.0, 1.0), margin=8.0),
        channel("b", valid=(0.0, 2.0), margin=4.0, hold_s=2 * TICK, default=4.0, fade_on_default=False),
        channel("c", valid=(0.0, 0.0), margin=16.0, optional=True, default=4.0),
        channel("d", hold_s=2 * TICK, default=0.0),
        channel("e", substitute=({"input": "a", "weight": 1.0},), valid=(-5.0, 5.0), margin=2.0),
    )
    table = shown(inputs, (t.ConstantNode(value=1.0), t.InputNode(input="a")), faded=(0, 1), fade_s=8 * TICK)
    calm = [0.0] * 8
    given = rows(
        a=[
            5.0,
            5.0,
            3.0,
            1.0,
            *calm,
            9.0,
            9.0,
            9.0,
            -9.0,
            1.0,
            1.0,
            1.125,
            -1.125,
            1.0,
            -1.0,
            *calm,
            BAD,
            BAD,
            6.0,
            6.0,
            6.0,
            *calm,
            1.5,
            2.0,
            2.5,
            2.5,
            *calm,
            *calm,
            7.0,
            *calm,
        ],
        b=[
            2.0,
            *[2.0] * 24,
            2.5,
            3.0,
            3.5,
            3.5,
            BAD,
            BAD,
            BAD,
            BAD,
            BAD,
            2.0,
            1.0,
            2.0,
            -0.0,
            -1.0,
            -1.0,
            0.0,
            1.0,
            *[1.0] * 8,
            BAD,
            BAD,
            BAD,
            BAD,
            1.0,
        ],
        c=[0.0, *[0.0] * 8, -1.0, 2.0, 0.0, *[0.0] * 32, BAD, None, BAD, 0.0],
        d=[0.0, *[0.0] * 45, BAD, BAD, BAD, BAD, BAD, 1.0, 1.0],
        e=[0.0, *[0.0] * 28, BAD, BAD, BAD, BAD, 0.0, *[0.0] * 26, BAD, BAD, 0.0],
    )
    return table, given
