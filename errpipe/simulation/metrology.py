"""Measuring protocols on a simulated machine: true by full transforms, with set-up errors and noise.

A machine's errors are smooth random functions (sums of cosines of random frequency and phase), in the
conventions of `kinematics.chain` but outside every basis that identification fits. Each protocol is a list of
`Run`s; `simulate_runs` simulates it and returns the recording a measuring system would write.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from errpipe.domain.components import is_at_tool, parse
from errpipe.domain.recording import Column, Constant, Recording
from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain, combinations
from errpipe.simulation.folder import of_one_table

# Range of the linear part over the travel, in units of the wavy part's rms: a scale error of some 35 um over a
# travel, angles of some 70 urad (5.8), beside waves of 4 um and 12 urad.
SLOPE = {"positioning": 8.7, "radial": 2.6, "axial": 2.6}
DISPLACEMENT_RMS, ANGLE_RMS = 4.0, 12.0  # um, urad: the wavy part of an error motion of an ordinary machine
CORRELATION = 0.35  # of the travel: length over which an error motion changes
WARM = 20e-6  # mm/mm: a part cut some 2 K away from 20 degC
CUTTER = 60.0  # um: excess of a part's cutter diameter over its nominal value
RUN_OUT = 4.0  # um: ball in the spindle, averaged over two spindle orientations half a turn apart

SIZES = (20.0, 40.0, 40.0, 30.0)  # mm: diameter of a bore, side of a face, by turn
TURN_NOISE = 1e3  # urad um-1 mm: of a normal, divided by the side of its face
ANGLES = np.arange(36) * np.pi / 18  # rad: 36 points of each bore
Cut = Callable[[np.ndarray, np.ndarray], np.ndarray]
Values = Mapping[str, Callable[[np.ndarray], np.ndarray] | float]


@dataclass(frozen=True)
class Run:
    """One uninterrupted run: poses q (n, axes), tool, and points fixed to the workpiece."""

    label: str
    q: np.ndarray
    length: float
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    socket: np.ndarray | None = None
    beam: np.ndarray | None = None
    centre: np.ndarray | None = None


def smooth_machine(chain: Chain, seed: int) -> dict[str, Callable[[np.ndarray], np.ndarray] | float]:
    """Random errors of every component, sizes of ordinary machines (see `identify.TYPICAL`)."""
    rng = np.random.default_rng(seed)
    values: dict[str, Callable[[np.ndarray], np.ndarray] | float] = {}
    for c, name in enumerate(chain.components):
        a = int(chain.drives[c])
        if a < 0:
            values[name] = float(rng.normal(0.0, 50.0 if chain.angular[c] else 30.0))
            continue
        size = (ANGLE_RMS if chain.angular[c] else DISPLACEMENT_RMS) * np.exp(rng.normal(0.0, 0.3))
        values[name] = _smooth(rng, chain, a, name, size)
    return values


def _smooth(rng, chain: Chain, a: int, name: str, size: float):
    low, high = chain.travel[a]
    span = high - low
    axis = chain.machine.axes[chain.axes[a]]
    closed = axis.kind == "rotary" and span > 359.0
    terms = 24
    fading = np.ones(terms)
    if closed:
        harmonic = rng.integers(1, 6, terms)
        wave, fading = harmonic * 2 * np.pi * span / 360.0, 1.5 / harmonic**2
    else:
        wave = rng.normal(0.0, 1.0 / CORRELATION, terms)
    phase = rng.uniform(0, 2 * np.pi, terms)
    gain = size * np.sqrt(2.0 / terms) * fading * rng.normal(size=terms)
    slope = 0.0 if closed else size * rng.normal() * SLOPE.get(parse(name).kind, 5.8)

    def raw(p: np.ndarray) -> np.ndarray:
        t = (np.clip(np.asarray(p, dtype=float), low, high) - low) / span
        return np.cos(t[..., None] * wave + phase) @ gain + slope * (t - 0.5)

    grid = np.linspace(low, high, 2001)
    component = parse(name)
    if component.kind in ("positioning", "angular positioning") and not closed:
        zero = float(raw(np.array([axis.zero]))[0])
        return lambda p: raw(p) - zero
    if component.is_straightness:
        line = np.polyfit(grid, raw(grid), 1)
        return lambda p: raw(p) - np.polyval(line, np.clip(p, low, high))
    mean = float(raw(grid).mean())
    return lambda p: raw(p) - mean


def components_at(chain: Chain, values: Values, q: np.ndarray) -> np.ndarray:
    """True components at q, shape (n, components), from the functions themselves."""
    out = np.zeros((len(q), len(chain.components)))
    for c, name in enumerate(chain.components):
        value = values.get(name, 0.0)
        out[:, c] = value(q[:, chain.drives[c]]) if callable(value) else value
    return out


def simulate_runs(
    chain: Chain,
    values: Values,
    protocol: str,
    runs: Sequence[Run],
    seed: int,
    *,
    noise: float = 0.5,
    setup: float = 100.0,
) -> Recording:
    """Simulate the runs. noise (um) on each reading; setup: typical size of set-up errors, um (and urad of a pose)."""
    rng = np.random.default_rng(seed)
    frames, constants = [], {"protocol": Constant(value=protocol)}
    for run in runs:
        frames.append(_simulated_rows(chain, values, run, rng, noise, setup, protocol))
        constants |= _constants(chain, run)
    frame = pd.concat(frames, ignore_index=True)
    columns = {"run": Column(role="run")}
    for a in chain.axes:
        columns[a.lower()] = Column(role="position", axis=a, unit=chain.axis_unit(a))
    for name in frame.columns:
        if is_at_tool(name):
            columns[name] = Column(role="error", component=name, unit=parse(name).unit)
        elif name.startswith("u_"):
            component = f"E_{name[2:]}"
            columns[name] = Column(role="uncertainty", component=component, unit=parse(component).unit)
        elif name == "size":
            columns[name] = Column(role="size", unit="mm")
    title = f"{protocol.replace('_', ' ')} on a simulated machine"
    return of_one_table(title, chain.machine.name, columns, frame, constants)


def _simulated_rows(chain, values, run: Run, rng, noise, setup, protocol) -> pd.DataFrame:
    tip = chain.tip(run.length, run.offset)
    comps = components_at(chain, values, run.q)
    ideal = synthesis.ideal_pose(chain, run.q, tip)
    actual = synthesis.actual_pose(chain, run.q, comps, tip)
    rotary = chain.machine.rotary_axes()
    point = actual[:, 0] + (np.einsum("k,nkj->nj", rng.normal(0, RUN_OUT * 1e-3, 3), actual[:, 1:]) if rotary else 0.0)
    shown = run.q - (0.0 if run.centre is None else run.centre)
    out = {"run": np.full(len(run.q), run.label, dtype=object)}
    out |= {a.lower(): shown[:, i] for i, a in enumerate(chain.axes)}
    if run.socket is not None:
        nominal = np.linalg.norm(ideal[:, 0] - run.socket, axis=1)
        true = np.linalg.norm(point - run.socket - rng.normal(0, setup * 1e-3, 3), axis=1)
        out["E_R"] = (true - nominal) * 1e3 + rng.normal(0, setup * 0.1) + rng.normal(0, noise, len(run.q))
    elif run.beam is not None:
        unit = run.beam / np.linalg.norm(run.beam)
        real = unit + np.cross(rng.normal(0, setup * 1e-6, 3), unit)
        out["E_R"] = (point @ real / np.linalg.norm(real) - ideal[:, 0] @ unit) * 1e3 + rng.normal(0, noise, len(run.q))
    elif protocol == "level":
        turn = synthesis.exact(chain, run.q, comps, tip)[:, 3:]
        for i, d in enumerate("ABC"):
            out[f"E_{d}"] = turn[:, i] + rng.normal(0, setup) + rng.normal(0, noise, len(run.q))
    elif protocol == "part":
        out |= _part(chain, values, run, rng, noise, setup)
    else:
        middle = ideal[:, 0].mean(axis=0)
        turn = rng.normal(0, setup * 1e-6, 3) if protocol != "r_test" else np.zeros(3)
        moved = point + np.cross(turn, point - middle) + rng.normal(0, setup * 1e-3, 3)
        for d in "XYZ":
            i = "XYZ".index(d)
            out[f"E_{d}"] = (moved - ideal[:, 0])[:, i] * 1e3 + rng.normal(0, noise, len(run.q))
    return pd.DataFrame(out)


def _part(chain: Chain, values: Values, run: Run, rng: np.random.Generator, noise: float, setup: float):
    """Readings of a part's features: rotated by `setup` urad on the CMM, and cut warm, some 20 um/m."""
    tip = chain.tip(run.length, run.offset)
    linear = chain.linear
    middle = synthesis.ideal_pose(chain, run.q, tip)[:, 0].mean(axis=0)
    turn, shift = rng.normal(0, setup * 1e-6, 3), rng.normal(0, setup * 1e-3, 3)
    warm, cutter = (rng.normal(0, size) if setup else 0.0 for size in (WARM, CUTTER))

    def cut(feature: np.ndarray, steps: np.ndarray) -> np.ndarray:
        q = run.q[feature].astype(float)
        ways = synthesis.linear_motion(chain, q, tip)
        q[:, linear] += np.linalg.solve(ways, steps[..., None])[..., 0]
        ideal = synthesis.ideal_pose(chain, q, tip)[:, 0]
        point = synthesis.actual_pose(chain, q, components_at(chain, values, q), tip)[:, 0]
        moved = point + np.cross(turn, point - middle) + warm * (point - middle) + shift
        return (moved - ideal) * 1e3

    return read_features(len(run.q), cut, rng, noise, cutter)


def read_features(count: int, cut: Cut, rng: np.random.Generator, noise: float, cutter: float) -> dict[str, np.ndarray]:
    """What a CMM reads on `count` features of a part, by circles and planes fitted to the paths of the tool.

    Features take turns: a drilled bore (centre), a face (offset and normal), a milled bore (centre and diameter), a
    face. Columns: size (mm), readings (um, urad), and u_ columns of their standard uncertainties.

    cut: rows (m,) and steps (m, 3) mm from their middles -> deviation of the surface there (m, 3), um. noise: standard
    uncertainty of an ordinary centre, um; features differ by a factor of 1 to 4. cutter: how much
    larger the cutter is than it was taken to be, um.
    """
    turn = np.arange(count) % 4
    out = {n: np.full(count, np.nan) for n in ("E_X", "E_Y", "E_Z", "E_A", "E_B", "E_D")}
    size = np.array(SIZES)[turn]
    rough = noise * 2.0 ** rng.integers(0, 3, count)
    uncertain = {n: rough.copy() for n in out}
    for name in ("E_A", "E_B"):
        uncertain[name] = rough * TURN_NOISE * np.sqrt(12.0) / size
    uncertain["E_D"] = 2.0 * rough
    drilled = np.flatnonzero(turn == 0)
    out["E_X"][drilled], out["E_Y"][drilled] = cut(drilled, np.zeros((len(drilled), 3)))[:, :2].T
    for feature in np.flatnonzero(turn == 2):
        rays = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
        steps = 0.5 * size[feature] * np.column_stack([rays, np.zeros(len(rays))])
        radial = np.sum(cut(np.full(len(rays), feature), steps)[:, :2] * rays, axis=1)
        radius, x, y = np.linalg.lstsq(np.column_stack([np.ones(len(rays)), rays]), radial, rcond=None)[0]
        out["E_X"][feature], out["E_Y"][feature], out["E_D"][feature] = x, y, 2.0 * radius + cutter
    for feature in np.flatnonzero(turn % 2 == 1):
        line = np.linspace(-0.5, 0.5, 9) * size[feature]
        x, y = (g.ravel() for g in np.meshgrid(line, line))
        height = cut(np.full(len(x), feature), np.column_stack([x, y, np.zeros(len(x))]))[:, 2]
        design = np.column_stack([np.ones(len(x)), y * 1e-3, -x * 1e-3])  # turns about X and Y lift a face so
        out["E_Z"][feature], out["E_A"][feature], out["E_B"][feature] = np.linalg.lstsq(design, height, rcond=None)[0]
    for name, value in out.items():
        value += uncertain[name] * rng.normal(size=count)
    return {"size": size} | out | {f"u_{n[-1]}": np.where(np.isfinite(out[n]), u, np.nan) for n, u in uncertain.items()}


def _constants(chain: Chain, run: Run) -> dict[str, Constant]:
    constants: dict[str, tuple[float, str | None]] = {"tool_length": (run.length, "mm")}
    constants |= {f"tool_offset_{d}": (v, "mm") for d, v in zip("XYZ", run.offset, strict=True)}
    if run.socket is not None:
        constants |= {f"socket_{d}": (v, "mm") for d, v in zip("XYZ", run.socket, strict=True)}
    if run.beam is not None:
        constants |= {f"beam_{d}": (v, None) for d, v in zip("XYZ", run.beam, strict=True)}
    if run.centre is not None:
        constants |= {f"centre_{a}": (v, chain.axis_unit(a)) for a, v in zip(chain.axes, run.centre, strict=True)}
    return {f"{n}@{run.label}": Constant(value=float(v), unit=u) for n, (v, u) in constants.items()}


def circles(
    chain: Chain, centre: np.ndarray, radius: float, length: float, count: int = 72, label: str = ""
) -> list[Run]:
    """Ball-bar circles in the planes of each pair of linear axes about a centre, both senses (ISO 230-4)."""
    linear = chain.linear
    angle = np.arange(count) * 2 * np.pi / count
    socket = synthesis.ideal_pose(chain, centre, chain.tip(length))[0, 0]
    runs = []
    for first, second in [(i, j) for i in linear for j in linear if i < j]:
        for sense in (1, -1):
            q = np.tile(np.asarray(centre, dtype=float), (count, 1))
            q[:, first] += radius * np.cos(sense * angle)
            q[:, second] += radius * np.sin(sense * angle)
            name = f"{label}{chain.axes[first]}{chain.axes[second]} {'ccw' if sense > 0 else 'cw'}"
            runs.append(Run(name, q, length, socket=socket, centre=np.asarray(centre, dtype=float)))
    return runs


def sockets(chain: Chain, spread: float = 0.35) -> list[np.ndarray]:
    """Four positions on the workpiece side, below and outside the volume, for bars or tracker stations, mm."""
    corners = synthesis.ideal_pose(chain, combinations(list(chain.travel)))[:, 0]
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, size = (low + high) / 2, high - low
    shifts = np.array([[-1, -1, -1.3], [1, -1, -1.2], [0, 1, -1.1], [1.2, 1.1, 0.6]]) * 0.5
    return [middle + size * s * (1 + spread) for s in shifts]


def diagonals(chain: Chain, length: float, steps: int = 20, step_diagonal: bool = False) -> list[Run]:
    """The four body diagonals (ISO 230-6), straight or one axis after the other at each step."""
    linear = chain.linear
    low, high = chain.travel.T
    runs = []
    for number, signs in enumerate(((1, 1, 1), (-1, 1, 1), (1, -1, 1), (-1, -1, 1))):
        start, stop = (low + high) / 2, (low + high) / 2
        for i, s in zip(linear, signs, strict=False):
            start[i], stop[i] = (low[i], high[i]) if s > 0 else (high[i], low[i])
        t = np.linspace(0, 1, steps + 1)[:, None]
        q = start + (stop - start) * t
        if step_diagonal:
            rows = [q[0]]
            for k in range(steps):
                for i in linear:
                    rows.append(rows[-1].copy())
                    rows[-1][i] = q[k + 1, i]
            q = np.array(rows)
        ends = synthesis.ideal_pose(chain, q[[0, -1]], chain.tip(length))[:, 0]
        runs.append(Run(f"diagonal {number + 1}", q, length, beam=ends[1] - ends[0]))
    return runs


def follow(chain: Chain, turning: np.ndarray, ball: np.ndarray, length: float) -> np.ndarray:
    """Poses that keep the tool on a ball fixed to the table while rotary axes move (R-test), shape (n, axes).

    turning (n, axes): rotary positions (linear columns are starting values); ball: mm, workpiece frame.
    """
    q = np.asarray(turning, dtype=float).copy()
    linear = chain.linear
    tip = chain.tip(length)
    for _ in range(4):
        gap = synthesis.ideal_pose(chain, q, tip)[:, 0] - ball
        jac = synthesis.linear_motion(chain, q, tip)
        q[:, linear] -= np.linalg.solve(jac, gap[..., None])[..., 0]
    return q
