"""A simulated machine measured component by component: laser and level along each axis, in both directions, with the
errors of such a set-up. Rotations are exact, air and beam errors are simulated and not corrected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from errpipe.domain.components import parse
from errpipe.domain.laser import Laser
from errpipe.domain.recording import Column, Constant, Recording
from errpipe.kinematics import direct
from errpipe.kinematics.chain import LETTERS, Chain
from errpipe.simulation.folder import of_one_table
from errpipe.simulation.metrology import Values

AIR = (-0.93e-6, 0.27e-6)  # change of the refractive index per K and per hPa
STEP = 20.0  # s from target to target
ZERO, LAY = 30.0, 300.0  # um or urad of a zero; urad of misalignment of a straightedge or square: typical sizes


@dataclass(frozen=True)
class SetUp:
    """Errors of a measuring set-up. reversal: up minus down of each positioning, um (its spread); squares: urad.

    warming: final rise of the air at the beam during an axis' test, K.
    """

    targets: int = 17
    cycles: int = 3
    noise: float = 0.3
    angle_noise: float = 0.5
    reversal: float = 4.0
    warming: float = 1.5
    beams: Mapping[str, Laser] = field(default_factory=dict)
    squares: Mapping[str, float] = field(default_factory=dict)


def record(chain: Chain, values: Values, setup: SetUp, seed: int) -> Recording:
    """Every linear and rotary axis measured in all six components, `cycles` times up and down."""
    rng = np.random.default_rng(seed)
    turns = {n: float(rng.normal(0, LAY)) for n in chain.components if n[1] == "0" and n[0] in "ABC"}
    test = _Test(chain, values, setup, turns)
    frame = pd.concat([test.of_axis(axis, rng) for axis in chain.axes], ignore_index=True)
    columns: dict[str, Column] = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    constants: dict[str, Constant] = {}
    for a in chain.axes:
        kind = chain.machine.axes[a].kind
        unit = chain.axis_unit(a)
        columns[a.lower()] = Column(role="position", axis=a, unit=unit)
        columns[f"dir_{a.lower()}"] = Column(role="direction", axis=a)
        constants[a] = Constant(role="axis", kind=kind, travel=chain.machine.axes[a].travel, unit=unit)
    columns["T_air"] = Column(role="temperature", unit="degC", location="air beside the beam")
    columns["p_air"] = Column(role="pressure", unit="hPa")
    for a in chain.axes:
        columns |= {n: Column(role="error", component=n, unit=parse(n).unit) for n in chain.of_axis(a)}
    title = "laser and level along each axis of a simulated machine"
    return of_one_table(title, chain.machine.name, columns, frame[list(columns)], constants)


@dataclass(frozen=True)
class _Air:
    """At the beam, in each row: degC and hPa."""

    warm: np.ndarray
    pressure: np.ndarray


@dataclass(frozen=True)
class _Test:
    """A machine and the set-up that measures it. turns: squareness -> misalignment of its square, urad."""

    chain: Chain
    values: Values
    setup: SetUp
    turns: Mapping[str, float]

    def of_axis(self, axis: str, rng: np.random.Generator) -> pd.DataFrame:
        """The rows of one axis, every component of it."""
        chain, setup, start = self.chain, self.setup, self.chain.axes.index(axis)
        low, high = chain.travel[start]
        up = np.linspace(low, high, setup.targets)
        p = np.tile(np.r_[up, up[::-1]], setup.cycles)
        side = np.tile(np.repeat([1.0, -1.0], setup.targets), setup.cycles)
        t = STEP * np.arange(len(p))
        warm = 20.0 + setup.warming * (1 - np.exp(-t / 2400.0)) + 0.4 * start
        air = _Air(warm, 1013.0 + 3.0 * np.sin(t / 4000.0 + start))
        columns = {
            "run": np.repeat([f"{axis} {n + 1}" for n in range(setup.cycles)], 2 * setup.targets).astype(object),
            "t": t,
            axis.lower(): p,
            f"dir_{axis.lower()}": side,
            "T_air": air.warm,
            "p_air": air.pressure,
        }
        # a constant has no curve over its axis
        true = {n: np.asarray(f(p)) if callable(f := self.values[n]) else np.zeros(len(p)) for n in chain.of_axis(axis)}
        own = next((n for n in chain.of_axis(axis) if parse(n).kind in ("positioning", "angular positioning")), None)
        if own is not None:
            true[own] = true[own] + 0.5 * side * setup.reversal * rng.normal()
        if chain.machine.axes[axis].errors_of == "carriage" and chain.machine.side_moved_by(axis) == "workpiece":
            true = {n: -1.0 * value for n, value in true.items()}
        for n in chain.of_axis(axis):
            noise = setup.noise if parse(n).unit == "um" else setup.angle_noise
            shown = self.shown(n, axis, p, true, air)
            columns[n] = shown + ZERO * rng.normal() + noise * rng.normal(size=len(p))
        return pd.DataFrame(columns)

    def shown(self, name: str, axis: str, p: np.ndarray, true: Mapping[str, np.ndarray], air: _Air) -> np.ndarray:
        """The display of the instrument for one component, um or urad, before zero and noise."""
        from scipy.spatial.transform import Rotation

        component, beam = parse(name), self.setup.beams.get(name, Laser())
        if component.unit == "urad":
            return true[name]
        along = np.asarray(self.chain.machine.direction(axis))
        reads = along if component.kind == "positioning" else np.asarray(LETTERS[component.direction])
        arm = direct.arms(self.chain, axis, beam, p)
        own = true[name] * (float(reads @ LETTERS[component.direction]) if component.kind == "positioning" else 1.0)
        turn = Rotation.from_rotvec(np.column_stack([true[f"E{d}{axis}"] for d in "ABC"]) * 1e-6)  # from urad
        moved = own + (turn.apply(arm) - arm) @ reads * 1e3
        if component.is_straightness:
            return moved + self.slope(name, axis, reads, along) * p * 1e-3
        if component.kind != "positioning":
            return moved
        path = (p - p[0]) + (moved - moved[0]) * 1e-3  # mm since the laser was reset
        index = AIR[0] * (air.warm - air.warm[0]) + AIR[1] * (air.pressure - air.pressure[0])
        seen = path * np.cos(beam.misalignment * 1e-6) * (1.0 if beam.wavelength_corrected else 1.0 + index)
        return (seen + beam.dead_path * index - (p - p[0])) * 1e3

    def slope(self, name: str, axis: str, reads: np.ndarray, along: np.ndarray) -> float:
        """Slope of a straightness record, um/m: the axis leans by its squareness, and the square is misaligned."""
        total = 0.0
        for square in self.turns:
            about = LETTERS["XYZ"["ABC".index(square[0])]]
            lean = float(np.cross(about, along) @ reads)
            if abs(lean) < 1e-9:
                continue
            second = square[2:] == axis
            if second:
                size = self.values.get(square, 0.0)
                total += 0.0 if callable(size) else lean * size
            linear = self.chain.machine.linear_axes()  # a straightness of the axis that the squareness refers to?
            if second or (name[2:] != square[2:] and name[2:] in linear and name[1] == square[2:]):
                total -= lean * (self.turns[square] + (self.setup.squares.get(square, 0.0) if second else 0.0))
        return total
