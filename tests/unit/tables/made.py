"""Tables to test with: random ones that use everything, and machines one can check by hand."""

from __future__ import annotations

import random

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.kernels import table_cycle
from errpipe.kernels.table_codes import HOLD, OFF, ON
from errpipe.tables import ComponentSource, compile_table, pack


def position(name="x", axis="X", low=-500.0, high=1500.0, **more):
    return t.TableInput(name=name, kind="position", axis=axis, unit="mm", low=low, high=high, default=0.0, **more)


def sensor(name, low=-20.0, high=120.0, default=20.0, **more):
    return t.TableInput(name=name, kind="sensor", unit="degC", low=low, high=high, default=default, **more)


def ten_um_too_long(**more):
    """A machine whose X axis travels 10 um too far at the +X end (x = 1000 mm)."""
    source = ComponentSource("EXX", "um", (Lowered(d.ONE, "X", lambda x: 0.01 * x),))
    return compile_table([source], inputs=[position()], travel={"X": (0.0, 1000.0)}, ramp_s=0.0, **more)


def everything(seed: int, version: int = 2) -> t.CompensationTable:
    """A random table with every kind of input, node, profile, pair and limit, of a format version."""
    r = random.Random(seed)
    inputs = tuple(_input(r, n) for n in range(r.randint(1, 7)))
    inputs = tuple(_with_substitute(r, i, inputs) for i in inputs)
    if version > 1:
        inputs = tuple(_with_noise(i, n) for n, i in enumerate(inputs))
    nodes: list[t.Node] = []
    for _ in range(r.randint(1, 30)):
        nodes.append(_node(r, nodes, inputs))
    if version > 1:
        nodes = [_with_threshold(node, n) for n, node in enumerate(nodes)]
    profiles = tuple(_profile(r, inputs) for _ in range(r.randint(1, 8)))
    components = tuple(t.Component(name=f"C{n}", unit=r.choice(("um", "urad"))) for n in range(r.randint(1, 5)))
    pairs = tuple(
        t.Pair(
            component=r.choice(components).name,
            profile=r.randrange(len(profiles)),
            driver=r.randrange(len(nodes)),
            keep=r.random() < 0.5,
        )
        for _ in range(r.randint(1, 12))
    )
    return t.CompensationTable(
        table=version,
        machine=f"machine {seed} ü",
        title="everything",
        version="0",
        fingerprint="ab" * 32 if r.random() < 0.5 else "",
        position_cycle_s=r.choice((0.001, 0.000125, 0.004)),
        slow_every=r.choice((1, 2, 7, 50)),
        ramp_s=r.choice((0.0, 0.01, 0.05)),
        fade_s=r.choice((0.0, 0.02)),
        inputs=inputs,
        nodes=tuple(nodes),
        profiles=profiles,
        components=components,
        pairs=pairs,
        outputs=tuple(_output(r, n, components, nodes) for n in range(r.randint(1, 4))),
    )


def stimulus(table: t.CompensationTable, cycles: int, seed: int):
    """(readings, fresh, mode): smooth motion with jumps, failed readings, frozen and missing ones."""
    rng = np.random.default_rng(seed)
    n = len(table.inputs)
    low = np.array([i.low for i in table.inputs])
    high = np.array([i.high for i in table.inputs])
    phase = rng.uniform(0, 6.28, n)
    speed = rng.uniform(0.001, 0.05, n)
    wave = 0.5 + 0.62 * np.sin(phase + speed * np.arange(cycles)[:, None])
    readings = low + (high - low) * wave + rng.normal(0, 1e-4, (cycles, n)) * (high - low)
    jumps = rng.random((cycles, n)) < 0.01
    readings = np.where(jumps, rng.uniform(low - 10, high + 10, (cycles, n)), readings)
    odd = rng.choice([np.nan, np.inf, -np.inf, 1e300, 0.0, -0.0], (cycles, n))
    readings = np.where(rng.random((cycles, n)) < 0.01, odd, readings)
    for column in range(n):  # a sensor lost for a while, and one that comes late
        if rng.random() < 0.4:
            begin = rng.integers(0, cycles)
            readings[begin : begin + cycles // 4, column] = np.nan
        if rng.random() < 0.2:
            readings[: cycles // 10, column] = np.nan
    fresh = (rng.random((cycles, n)) > rng.choice([0.0, 0.02, 0.6], n)).astype(np.uint8)
    mode = np.ones(cycles, dtype=np.uint8)
    mode[cycles // 2 : cycles // 2 + cycles // 10] = OFF
    mode[cycles // 3 : cycles // 3 + cycles // 12] = mode[-cycles // 7 : -cycles // 9] = HOLD
    return readings, fresh, mode


def modes(mode: int) -> dict[str, bool]:
    """A mode as the reference evaluator takes it."""
    return {"enable": mode == ON, "hold": mode == HOLD}


def _with_threshold(node: t.Node, n: int) -> t.Node:
    """An approach with the threshold that version 2 gives it."""
    more = {"threshold": (0.0, 0.01, 3.0)[n % 3]} if isinstance(node, t.ApproachNode) else {}
    return node.model_copy(update=more)


def _with_noise(i: t.TableInput, n: int) -> t.TableInput:
    """Every other input that has a rate has a noise too, slower rates among them."""
    if i.max_rate is None or n % 3 == 0:
        return i
    slower = 0.01 if n % 3 == 1 else 1.0
    return i.model_copy(update={"max_rate": i.max_rate * slower, "noise": 0.02 * (i.high - i.low)})


def _input(r: random.Random, n: int) -> t.TableInput:
    low = r.uniform(-1000, 100)
    high = low + r.uniform(1, 2000)
    span = high - low
    valid = margin = None
    if r.random() < 0.4:
        valid, margin = (low + 0.2 * span, low + r.uniform(0.2, 0.8) * span), r.uniform(0.05, 0.3) * span
    return t.TableInput(
        name=f"in{n}",
        kind=r.choice(("position", "position", "sensor", "sensor", "speed", "force", "velocity", "direction", "tool")),
        axis=r.choice(("", "X", "Y")),
        unit="mm",
        low=low,
        high=high,
        max_rate=r.choice((None, None, span * r.uniform(1, 100))),
        stale_after_s=r.choice((None, None, r.uniform(0.001, 0.1))),
        hold_s=r.choice((None, 0.0, r.uniform(0.001, 0.2))),
        default=r.uniform(low, high),
        optional=r.random() < 0.1,
        fade_on_default=r.random() < 0.5,
        valid=valid,
        margin=margin,
    )


def _with_substitute(r: random.Random, channel: t.TableInput, inputs: tuple[t.TableInput, ...]) -> t.TableInput:
    sources = [i.name for i in inputs if not i.optional and i.name != channel.name]
    if r.random() < 0.6 or not sources:
        return channel
    chosen = r.sample(sources, r.randint(1, min(2, len(sources))))
    parts = tuple(t.Substitute(input=name, weight=r.uniform(-1, 1)) for name in chosen)
    return channel.model_copy(update={"substitute": parts, "substitute_offset": r.uniform(-5, 5)})


def _node(r: random.Random, nodes: list[t.Node], inputs: tuple[t.TableInput, ...]) -> t.Node:
    number = len(nodes)
    slow = r.random() < 0.5
    of = tuple(r.randrange(number) for _ in range(r.randint(1, 4))) if number else ()
    kinds = ["constant", "input", "input"]
    if number:
        kinds += ["affine", "affine", "first", "lag", "lag", "product", "power", "clip", "switch", "direction"]
        kinds += ["approach", "lookup"]
    match r.choice(kinds):
        case "constant":
            return t.ConstantNode(value=r.uniform(-5, 5), slow=slow)
        case "input":
            return t.InputNode(input=r.choice(inputs).name, slow=slow)
        case "affine":
            weights = tuple(r.uniform(-0.5, 0.5) for _ in of)
            return t.AffineNode(of=of, offset=r.uniform(-3, 3), weights=weights, slow=slow)
        case "first":
            return t.FirstNode(of=of[:1], slow=slow)
        case "lag":
            start = r.choice(("input", "zero"))
            up, down = r.uniform(0.001, 1), r.uniform(0.001, 1)
            return t.LagNode(of=of[:1], tau_up=up, tau_down=down, start=start, slow=slow)
        case "product":
            return t.ProductNode(of=of, slow=slow)
        case "power":
            return t.PowerNode(of=of[:1], exponent=r.choice((1.0, 2.0, 3.0, r.uniform(0.2, 2.5))), slow=slow)
        case "clip":
            low = r.uniform(-10, 10)
            return t.ClipNode(of=of[:1], low=low, high=low + r.uniform(0, 20), slow=slow)
        case "switch":
            off = r.uniform(-50, 50)
            return t.SwitchNode(of=of[:1], on=off + r.uniform(0, 20), off=off, slow=slow)
        case "direction":
            return t.DirectionNode(of=of[:2], threshold=r.choice((0.0, 0.01, 3.0)), start=r.choice((-1, 1)), slow=slow)
        case "approach":
            return t.ApproachNode(of=(of[0], of[-1]), length=r.uniform(0.01, 20), slow=slow)
    values = tuple(r.uniform(-3, 3) for _ in range(r.randint(2, 9)))
    return t.LookupNode(of=of[:1], start=r.uniform(-50, 50), step=r.uniform(0.1, 20), values=values, slow=slow)


def _profile(r: random.Random, inputs: tuple[t.TableInput, ...]) -> t.Profile:
    channel = r.choice(inputs)
    count = r.choice((1, 2, 3, 5, 20))
    largest = r.choice((10, 30000, t.LARGEST_VALUE))
    values = [r.randint(-largest, largest) for _ in range(count)]
    if count == 1:
        return t.Profile(values=tuple(values), scale=r.choice((1e-3, 0.37)))
    periodic = count > 2 and r.random() < 0.4
    if periodic:
        values[-1] = values[0]
    step = (channel.high - channel.low) / r.uniform(0.7, 3) / count / (10 if periodic else 1)
    return t.Profile(
        input=channel.name,
        start=channel.low + r.uniform(-0.1, 0.3) * (channel.high - channel.low),
        step=step,
        scale=1e-3 if largest < 1e6 else 1e-8,
        periodic=periodic,
        values=tuple(values),
        interpolation_error=r.choice((0.0, 0.003)),
        rounding_error=0.0005,
    )


def _output(r: random.Random, n: int, components: tuple[t.Component, ...], nodes: list[t.Node]) -> t.Output:
    unit = r.choice(("um", "urad"))
    terms = tuple(
        t.Monomial(
            weight=r.uniform(-1, 1),
            component=r.choice(components).name,
            factors=tuple(r.randrange(len(nodes)) for _ in range(r.randint(0, 4) if r.random() < 0.3 else 0)),
        )
        for _ in range(r.randint(1, 5))
    )
    return t.Output(
        name=f"O{n}",
        axis="X",
        unit=unit,
        correction_unit=r.choice(("mm", "um")) if unit == "um" else r.choice(("urad", "deg", "rad")),
        magnitude=r.choice((None, r.uniform(1, 200))),
        slew=r.choice((None, r.uniform(10, 10000))),
        acceleration=r.choice((None, r.uniform(1000, 1000000))),
        terms=terms,
    )


def follower(magnitude: float | None, slew: float | None = 1000.0) -> t.CompensationTable:
    """A correction of 1 mm per mm of X, without a profile; its only limits: magnitude, um, and slew, um/s."""
    x = t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-1e5, high=1e5, default=0)
    driver = d.Affine(weights=(1e3,), of=(d.Input(name="x"),))
    made = compile_table([ComponentSource("EXX", "um", (Lowered(driver),))], inputs=[x], ramp_s=0.0)
    (only,) = made.outputs
    return made.model_copy(update={"outputs": (only.model_copy(update={"magnitude": magnitude, "slew": slew}),)})


def numba_stream(table, readings, fresh, enable):
    """Deviation, correction (cycles, outputs) and status of the Numba cycle."""
    program = pack.program(table)
    state = pack.state(program)
    shape = (len(readings), len(table.outputs))
    deviation, correction, status = np.empty(shape), np.empty(shape), np.empty(shape[0], dtype=np.int64)
    table_cycle.stream(program, state, readings, fresh, enable, deviation, correction, status)
    return deviation, correction, status
