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
    """Rates with a noise, exactly at their bounds and beside them, before and after the first reading is believed."""
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


def operations() -> tuple[t.CompensationTable, list[dict]]:
    """Each operation at its bounds, fast and slow; what is not finite, EXP beyond -700, POWER near 0 and by 1, 2, 3."""
    of, side = (0,), (1,)
    nodes = (
        t.InputNode(input="u"),
        t.InputNode(input="k"),
        t.SwitchNode(of=of, on=8.0, off=0.0),
        t.SwitchNode(of=of, on=8.0, off=8.0),
        t.ClipNode(of=of, low=0.0, high=8.0),
        t.DirectionNode(of=of, threshold=0.0),
        t.DirectionNode(of=of, threshold=8.0, start=-1),
        t.DirectionNode(of=(0, 1), threshold=8.0),
        t.DirectionNode(of=(0, 1), threshold=8.0, start=-1, slow=True),
        t.ApproachNode(of=(0, 5), length=4.0),
        t.ApproachNode(of=(0, 1), length=2.0**-10),
        t.LagNode(of=of, tau_up=8 * TICK, tau_down=2 * TICK),
        t.LagNode(of=of, tau_up=2 * TICK, tau_down=8 * TICK, start="zero"),
        t.LagNode(of=of, tau_up=0.125, tau_down=0.5, slow=True),
        t.LagNode(of=side, tau_up=TICK, tau_down=TICK, start="zero", slow=True),
        t.LookupNode(of=of, start=-2.0, step=4.0, values=(-1.0, 5.0, 4.0)),
        t.FirstNode(of=side, slow=True),
        t.PowerNode(of=of, exponent=1.0),
        t.PowerNode(of=of, exponent=2.0),
        t.PowerNode(of=of, exponent=3.0),
        t.PowerNode(of=of, exponent=0.0625),
        t.PowerNode(of=of, exponent=0.5, slow=True),
        t.PowerNode(of=side, exponent=16.0),
        t.AffineNode(of=side, offset=0.0, weights=(1e15,)),
        t.ProductNode(of=(23, 23)),
        t.ProductNode(of=(23, 23), slow=True),
        t.AffineNode(of=(24, 0), offset=1.0, weights=(1.0, 1.0)),
        t.LagNode(of=(24,), tau_up=TICK, tau_down=TICK),
    )
    way = [
        None,
        BAD,
        4.0,
        4.0,
        12.0,
        4.0,
        4.0,
        3.875,
        0.0,
        -0.125,
        0.0,
        8.0,
        7.875,
        8.0,
        8.125,
        0.0,
        -0.0,
        -4.0,
        4.0,
        4.125,
        -3.875,
        -4.0,
        1e-30,
        2.0**-100,
        -1e-30,
        -(2.0**-100),
        1e-28,
        2.0**-95,
        -(2.0**-95),
        0.25,
        -0.25,
        2.0,
        -3.0,
        512.0,
        -512.0,
        5.0,
        5.0,
        -3.0,
        5.0,
        -3.125,
        5.0,
        13.0,
        5.0,
        13.5,
        5.5,
        5.25,
        1.0,
        6.0,
        6.0,
        -2.0,
        10.0,
        -2.125,
        10.25,
        6.0,
    ]
    way += [1.0, 2.0, 2.0, 2.5, 2.5, 3.0, 3.0, 3.25, 3.25, 1.4142135623730951, 0.5]  # approach where nothing moved
    way += [9.0, 9.68359375, 9.68359375, 5.0, 5.68408203125, 5.0]  # 700 and 700.5 lengths
    way += [10.484375]  # a logarithm in which the last term of the series shows
    known = [
        None,
        None,
        None,
        BAD,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        1.0,
        -1.0,
        -1.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.5,
        2.0**-64,
        0.0,
        2.0**-65,
        -(2.0**-64),
        0.0,
        2.0,
        2.0,
        0.0,
        0.0,
        2.0,
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
        0.0,
        0.0,
        0.0,
        -1.0,
        0.0,
        0.0,
        0.0,
        0.0,
        3.0,
        3.0,
        -3.0,
        900.0,
        900.0,
        1.0,
        -900.0,
        0.0,
        0.0,
        *[0.0] * 11,
        1.0,
        0.0,
        1.0,
        1.0,
        0.0,
        0.0,
    ]
    return shown((channel("u"), channel("k", default=0.0)), nodes, slow_every=2), rows(u=way, k=known)


def sums() -> tuple[t.CompensationTable, list[dict]]:
    """A deviation that is not finite, one of exactly 1e30; profiles at their ends, periodic ones on their seams."""
    inputs = (channel("x"), channel("y"))
    nodes = (
        t.ConstantNode(value=1.0),
        t.InputNode(input="y"),
        t.AffineNode(of=(1,), offset=0.0, weights=(1e15,)),
        t.ProductNode(of=(2, 2)),
    )
    profiles = (
        t.Profile(input="x", start=0.0, step=4.0, values=(0, 1000, -600, 250), scale=2.0**-7),
        t.Profile(input="x", start=-2.0, step=4.0, values=(100, 300, -200, 100), scale=2.0**-7, periodic=True),
        t.Profile(values=(1,), scale=1.0),
    )
    parts = {"A": (0, 0), "P": (1, 0), "Q": (1, 1), "B": (2, 3)}
    terms = {
        "A": (t.Monomial(weight=-2.0, component="A"),),
        "P": (t.Monomial(weight=1.0, component="P"),),
        "PQ": (t.Monomial(weight=1.0, component="P", factors=(1,)), t.Monomial(weight=0.5, component="Q")),
        "B": (t.Monomial(weight=1.0, component="B"),),
        "-B": (t.Monomial(weight=-1.0, component="B"),),
        "BB": (t.Monomial(weight=1.0, component="P"), t.Monomial(weight=1.0, component="B", factors=(2, 2, 2, 2))),
    }
    table = t.CompensationTable(
        position_cycle_s=TICK,
        slow_every=1,
        ramp_s=0.0,
        fade_s=0.0,
        inputs=inputs,
        nodes=nodes,
        profiles=profiles,
        components=tuple(t.Component(name=name) for name in parts),
        pairs=tuple(t.Pair(component=name, profile=p, driver=n) for name, (p, n) in parts.items()),
        outputs=tuple(t.Output(name=name, correction_unit="um", terms=own) for name, own in terms.items()),
    )
    x = [
        0.0,
        12.0,
        -0.125,
        12.125,
        4.0,
        8.0,
        2.0,
        10.0,
        -2.0,
        -6.0,
        -14.0,
        -14.125,
        -13.875,
        22.0,
        21.875,
        34.0,
        -26.0,
        HIGH,
        -HIGH,
        11.875,
        -0.0,
        6.5,
    ]
    y = [0.0, 1.0, -1.0, 0.5, 2.0, -2.0, 0.0, 1.0, 0.0]
    return table, rows(x=x, y=y)


def motion() -> tuple[t.CompensationTable, list[dict], list[int]]:
    """Slew 4 um, acceleration 1 um per cycle, magnitude 20 um: arrivals exactly at them, moving goals, ramps, holds."""
    limits = [
        {"slew": s, "acceleration": a, "magnitude": m}
        for s in (None, 4.0 / TICK)
        for a in (None, 1.0 / TICK**2)
        for m in (None, 20.0)
    ]
    limits += [{"acceleration": 4.0 / TICK**2}, {"slew": 1.0 / TICK, "acceleration": 0.25 / TICK**2}]
    limits += [{"magnitude": 0.5}, {"magnitude": 0.5, "acceleration": 0.125 / TICK**2}]
    table = t.CompensationTable(
        position_cycle_s=TICK,
        slow_every=1,
        ramp_s=8 * TICK,
        fade_s=0.0,
        inputs=(channel("a"),),
        nodes=(t.InputNode(input="a"),),
        profiles=(t.Profile(values=(1,), scale=1.0),),
        components=(t.Component(name="C"),),
        pairs=(t.Pair(component="C", profile=0, driver=0),),
        outputs=tuple(
            t.Output(name=f"O{n}", correction_unit="um", terms=(t.Monomial(weight=1.0, component="C"),), **more)
            for n, more in enumerate(limits)
        ),
    )
    way = [*[0.0] * 9, 1.0, 3.0, 6.0, 10.0, 14.0, 18.0, 21.0, 23.0, 24.0, 24.0, 20.0, 16.0, *[-30.0] * 25]
    way += [*range(-30, 0, 3), *range(0, 24, 4), *range(24, -24, -2), *[5.0] * 20, 20.0, 20.125, -20.0, -20.125]
    r = np.random.default_rng(3)
    walk = np.cumsum(r.integers(-20, 21, 60)) / 8.0
    jumps = np.repeat(r.integers(-160, 161, 24) / 8.0, r.integers(1, 9, 24))
    slopes = np.cumsum(np.repeat(r.integers(-40, 41, 16), r.integers(1, 8, 16))) / 8.0
    way += np.cumsum(overshoots()).tolist()
    way += [*map(float, walk), *map(float, jumps), *map(float, slopes)]
    retreat = [*[0.0] * 12, 1.0, 3.0, 6.0, 10.0, 14.0, 18.0, *[-10.0] * 20, *[0.0] * 12]  # too fast to stop at 20
    way += [*retreat, *(-v for v in retreat)]
    way += [*[0.0] * 9, 0.125, 0.375, *[-0.25] * 6, *[0.0] * 6, -0.125, -0.375, *[0.25] * 6]
    enable = [1] * len(way)
    enable[100:104], enable[-60:-45] = [0] * 4, [0] * 15
    for at, cycles in ((14, 3), (40, 2), (101, 2), (150, 5), (300, 1), (330, 9)):
        enable[at : at + cycles] = [HOLD] * cycles
    return table, rows(a=[float(v) for v in way]), enable


def bounded() -> tuple[t.CompensationTable, list[dict]]:
    """One output that is on its way too fast to stop before its magnitude when the goal turns back: it stops at it."""
    table, _, _ = motion()
    one = table.outputs[0].model_copy(update={"magnitude": 0.75, "acceleration": 0.125 / TICK**2, "slew": None})
    table = t.CompensationTable.model_validate(table.model_dump() | {"ramp_s": 0.0, "outputs": (one.model_dump(),)})
    way = [*[0.0] * 4, -0.125, -0.375, -0.6875, *[0.5] * 12, *[0.0] * 8]
    return table, rows(a=[*way, *(-v for v in way), *[0.75] * 12, *[-0.75] * 16])


def overshoots() -> list[float]:
    """Steps of a goal, um per cycle: one that is followed stops and goes on while the correction is ahead of it."""
    steps: list[float] = []
    for after in (1.5, 2.0, 2.5, 3.0, 3.25, 3.5, 3.875, 4.0, 4.25):
        once = [1.0, 2.0, 3.0, 4.0, 4.0, 1.5, after, after, *[0.0] * 8]
        steps += [*once, *(-v for v in once)]
    fast = [1.0, 2.0, 3.0, 3.5, 3.5, 0.0, 2.0, 2.0, *[0.0] * 8]  # on the goal, but too fast
    return [*[0.0] * 12, *steps, *fast, *(-v for v in fast)]
