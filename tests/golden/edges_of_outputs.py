"""Golden tables of operations, sums and limits, of which each cycle meets a rule exactly (inputs: `edges`)."""

from __future__ import annotations

import numpy as np

from errpipe.domain import table as t
from tests.golden.edges import BAD, HIGH, HOLD, TICK, channel, rows, shown


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


def undone() -> tuple[t.CompensationTable, list[dict]]:
    """Directions and approaches around one bad reading: an axis stands, has gone back a little, moves, turns."""
    nodes = (
        t.InputNode(input="u"),
        t.InputNode(input="k"),
        t.DirectionNode(of=(0,), threshold=1.0),
        t.DirectionNode(of=(0, 1), threshold=1.0, start=-1),
        t.DirectionNode(of=(0,), threshold=0.0, start=-1),
        t.DirectionNode(of=(0, 1), threshold=1.0, slow=True),
        t.ApproachNode(of=(0, 2), length=2.0**-13, threshold=1.0),  # so short that EXP is 0 wherever it moved
        t.ApproachNode(of=(0, 1), length=2.0**-13, threshold=1.0),
        t.ApproachNode(of=(0, 1), length=2.0**-13),
        t.ApproachNode(of=(0, 1), length=2.0**-13, threshold=1.0, slow=True),
    )
    spikes = [12.0, -4.0, 5.0, 5.125, 3.0, 2.875, 1000.5]  # far, exactly the threshold, beside it, out of range
    way = [BAD, 8.0, 14.0, 8.0, 14.0, 8.0, 8.0, 4.0, 4.0]  # the second reading of all
    for spike in spikes:
        way += [spike, 4.0, 4.0, 4.0]
    way += [
        8.0,
        5.0,
        5.0,
        9.0,
        6.125,
        6.125,
        6.125,
        2.0,
        5.125,
        5.125,
        1.0,
        4.0,
        4.0,
    ]  # back to the threshold, beside it
    way += [5.5, 4.5, 4.5, 6.0, 4.875, 4.875, 3.5, 4.5, 4.5, 3.0, 4.125, 4.125]
    way += [10.0, 9.5, 9.5, 12.0, 9.5, 9.5, 9.0, 9.0, 8.875, 8.875]  # gone back by less than the threshold
    way += [4.0, 4.0, 12.0, 4.0, 12.0, 4.0, 4.0, -4.0, 4.0, 12.0, 4.0, 4.0, 12.0, 12.0, 4.0, 4.0, 4.0]  # two, one twice
    way += [0.0, 2.0, 4.0, 6.0, 20.0, 10.0, 12.0, -9.0, 16.0, 18.0, 20.0, 18.0, 16.0, 16.0, 16.0]  # moving, a turn
    way += [16.5, 17.0, 20.0, 17.5, 18.0, 10.0, 18.5, 18.5, 18.75, 18.5, 18.75, 18.5, 18.75, 18.5]  # slow; dithering
    way += [16.0, 18.5, 16.0, 18.5, 18.5, 16.0, 16.0, 18.5, 18.5]  # to and fro, steps of one cycle and of two
    r = np.random.default_rng(10)
    way += [float(v) for v in r.choice((4.0, 4.0, 4.0, 4.0, 4.5, 5.0, 5.125, 3.0, 12.0, -4.0), 240)]
    known = (
        [1.0, 0.0, 0.0, 0.0, 2.0]
        + [0.0] * 55
        + [float(v) for v in r.choice((0.0, 0.0, 0.0, 0.0, 0.0, 2.0, -0.5, BAD), len(way) - 60)]
    )
    way += [4.0] * 9 + [4.0, 4.0, 4.0, 5.0, 5.0, 6.125, 6.125, 5.125, 5.125, 4.0]  # a way told once, alone
    known += [0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 1.0, -1.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    return shown((channel("u"), channel("k", optional=True, default=0.0)), nodes, slow_every=2), rows(u=way, k=known)


def overshoots() -> list[float]:
    """Steps of a goal, um per cycle: one that is followed stops and goes on while the correction is ahead of it."""
    steps: list[float] = []
    for after in (1.5, 2.0, 2.5, 3.0, 3.25, 3.5, 3.875, 4.0, 4.25):
        once = [1.0, 2.0, 3.0, 4.0, 4.0, 1.5, after, after, *[0.0] * 8]
        steps += [*once, *(-v for v in once)]
    fast = [1.0, 2.0, 3.0, 3.5, 3.5, 0.0, 2.0, 2.0, *[0.0] * 8]  # on the goal, but too fast
    return [*[0.0] * 12, *steps, *fast, *(-v for v in fast)]
