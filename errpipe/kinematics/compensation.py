"""A machine's errors in the form a controller runs: component profiles and a synthesis, or a lattice of points.

The synthesis has a constant cost per cycle for any curves, and tool length and offset remain inputs.
The lattice is for controllers without other formats; its error bound is valid everywhere inside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.synthesis import MonomialSource, OutputSource
from errpipe.drivers.lowered import Lowered
from errpipe.kinematics import polynomials, synthesis
from errpipe.kinematics.chain import Chain, combinations
from errpipe.kinematics.errors import MachineErrors

PARALLEL = 1e-9  # of a cosine
SINE_STEP = 0.5  # deg; linear interpolation is then within 1e-5 of the sine: 0.01 um of a 1 mm deviation


def outputs(
    chain: Chain, used: tuple[str, ...] | None = None, axes: tuple[str, ...] | None = None
) -> tuple[OutputSource, ...]:
    """One output per linear axis: the deviation that this axis can correct (correction = minus it).

    Of parallel axes (Z and W) each corrects its own components whole, and the first all others: a curve over the axis
    alone holds no half of them. used: components to keep; axes: those that correct, default all. Its drivers read axes
    by their letters and the tool's dimensions, in the machine file's coordinates, from the spindle nose, mm.
    """
    terms_by_axis: dict[str, list[MonomialSource]] = {}
    machine = chain.machine
    correcting = machine.correcting_axes() if axes is None else axes
    for (axis, component), letters in polynomials.jacobian(chain, "axes").items():
        same = [a for a in machine.correcting_axes() if _parallel(chain, a, axis)]
        own = [a for a in same if a in correcting]
        drive = int(chain.drives[chain.index(component)])
        if len(same) > 1 and own:
            if axis != (chain.axes[drive] if drive >= 0 and chain.axes[drive] in own else own[0]):
                continue
            # The jacobian divides a correction among all parallel axes.
            letters = polynomials.Polynomial({key: len(same) * v for key, v in letters.items()})
        if axis in correcting and (used is None or component in used):
            terms_by_axis.setdefault(axis, []).append(_term(chain, component, letters))
    return tuple(OutputSource(f"E_{axis}", tuple(t), axis) for axis, t in terms_by_axis.items())


def _parallel(chain: Chain, one: str, other: str) -> bool:
    """Whether two axes, which no rotary axis turns, move the tool in one direction."""
    return abs(np.dot(chain.machine.direction(one), chain.machine.direction(other))) > 1 - PARALLEL


def _term(chain: Chain, component: str, letters: polynomials.Polynomial) -> MonomialSource:
    if list(letters) == [()]:
        return MonomialSource(letters[()], component)
    moving = {key: v for key, v in letters.items() if key}
    if len(letters) == 1:
        ((key, weight),) = moving.items()
        return MonomialSource(weight, component, (_product(chain, key),))
    of = tuple(_product(chain, key) for key in moving)
    arm = d.Affine(offset=letters.get((), 0.0), weights=tuple(moving.values()), of=of)
    return MonomialSource(1.0, component, (arm,))


def _product(chain: Chain, key: tuple[str, ...]) -> d.Driver:
    parts = tuple(_variable(chain, n) for n in key)
    return parts[0] if len(parts) == 1 else d.Product(of=parts)


def _variable(chain: Chain, name: str) -> d.Driver:
    function, axis = polynomials.function_of(name)
    if not function:
        return d.Input(name=name)
    low, high = chain.machine.axes[axis].travel
    count = max(2, int(np.ceil((high - low) / SINE_STEP)) + 1)
    angle = np.radians(np.linspace(low, high, count))
    values = np.sin(angle) if function == "sin" else np.cos(angle)
    step = (high - low) / (count - 1)
    return d.Lookup(of=d.Input(name=axis), start=low, step=step, values=tuple(map(float, values)))


def lowered(
    errors: MachineErrors, reversals: Mapping[str, tuple[float, float, float]] | None = None
) -> dict[str, tuple[Lowered, ...]]:
    """Component -> its compiled pairs (one profile each, driver 1), for components that are not zero everywhere.

    reversals: component -> up minus down at the middle (um, urad), its change per metre, the middle: a second pair
    of that component whose driver is the direction of its axis.
    """
    chain = errors.chain
    out: dict[str, tuple[Lowered, ...]] = {}
    for c, name in enumerate(chain.components):
        if chain.drives[c] < 0:
            size = float(errors.constants[c])
            if size != 0.0:
                out[name] = (Lowered(d.ONE, None, partial(_constant_profile, size)),)
            continue
        grid, values = errors.curve(name)
        if values.any():
            out[name] = (Lowered(d.ONE, chain.axes[chain.drives[c]], partial(_interpolated, grid, values)),)
    for name, (value, slope, middle) in (reversals or {}).items():
        axis = chain.axes[chain.drives[chain.index(name)]]
        half = partial(_half_reversal, value, slope, middle)
        if value != 0.0 or slope != 0.0:
            out[name] = (*out.get(name, ()), Lowered(d.Direction(axis=axis), axis, half))
    return out


def _constant_profile(size: float, x: np.ndarray) -> np.ndarray:
    return np.full(np.shape(x), size)


def _interpolated(grid: np.ndarray, values: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.interp(x, grid, values)


def _half_reversal(value: float, slope: float, middle: float, x: np.ndarray) -> np.ndarray:
    """Half of up minus down at positions x: the driver is +1 in one direction and -1 in the other."""
    return 0.5 * (value + slope * (np.asarray(x) - middle) * 1e-3)


@dataclass(frozen=True)
class Lattice:
    """Deviation on a lattice over the linear axes for one tool.

    axes: names; grids: mm per axis; values (n1, n2, n3, 3): um along E_X E_Y E_Z; bound: no deviation inside is
    further than this from straight-line interpolation, um; largest_seen: of 4000 random places, um.
    """

    axes: tuple[str, ...]
    grids: tuple[np.ndarray, ...]
    values: np.ndarray
    bound: float
    largest_seen: float


def profile_bound(chain: Chain, gridding: Mapping[str, float], tip: np.ndarray | None = None) -> float:
    """Upper bound of the gridding error of the tool-point deviation from profiles, um.

    gridding: component -> error bound of its profile (um, urad). Each is weighted by its largest arm in the volume;
    arms are linear in each linear coordinate, so the largest is at a corner. Rotary axes are sampled in steps.
    """
    ends = [t if n in chain.linear else np.linspace(t[0], t[1], 9) for n, t in enumerate(chain.travel)]
    corners = combinations(ends)
    arms = np.abs(synthesis.jacobian(chain, corners, tip)[:, :3]).max(axis=0)
    off = np.array([gridding.get(n, 0.0) for n in chain.components])
    return float(np.linalg.norm(arms @ off))


def lattice(errors: MachineErrors, counts: tuple[int, ...], tip: np.ndarray | None = None) -> Lattice:
    """Sample the first-order deviation on a lattice over all axes. Raises ValueError for rotary axes."""
    chain = errors.chain
    if chain.machine.rotary_axes():
        raise ValueError("a lattice over rotary axes would have to turn with them; use the synthesis")
    if len(counts) != len(chain.axes) or min(counts) < 2:
        raise ValueError(f"counts needs a number of at least 2 for each of {', '.join(chain.axes)}")
    grids = tuple(np.linspace(t[0], t[1], n) for t, n in zip(chain.travel, counts, strict=True))
    q = combinations(grids)
    values = synthesis.first_order(chain, q, errors.at(q), tip)[:, :3].reshape(*counts, 3)
    rng = np.random.default_rng(0)
    places = rng.uniform(chain.travel[:, 0], chain.travel[:, 1], (4000, len(chain.axes)))
    true = synthesis.first_order(chain, places, errors.at(places), tip)[:, :3]
    seen = np.linalg.norm(true - interpolate(grids, values, places), axis=1).max()
    return Lattice(chain.axes, grids, values, _lattice_bound(errors, grids, tip), float(seen))


def interpolate(grids: tuple[np.ndarray, ...], values: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Multilinear interpolation as a controller does it, shape (n, 3)."""
    out = np.zeros((len(q), values.shape[-1]))
    index, share = [], []
    for a, g in enumerate(grids):
        s = np.clip((q[:, a] - g[0]) / (g[1] - g[0]), 0, len(g) - 1)
        i = np.minimum(s.astype(int), len(g) - 2)
        index.append(i)
        share.append(s - i)
    for corner in np.ndindex(*(2,) * len(grids)):
        weight = np.prod([f if c else 1 - f for c, f in zip(corner, share, strict=True)], axis=0)
        out += weight[:, None] * values[tuple(i + c for i, c in zip(index, corner, strict=True))]
    return out


def _lattice_bound(errors: MachineErrors, grids: tuple[np.ndarray, ...], tip: np.ndarray | None) -> float:
    """Sum over components of the largest gap between curve and chord times its largest arm.

    Arms are linear in each coordinate, and an axis' own coordinate is in its own arm only if the point that the error
    is defined at does not stand at the tool (on the guideway of an axis that moves the tool, on the carriage of one
    that moves the workpiece); the product is then bent by at most gap x arm + h^2/4 x slope.
    """
    chain = errors.chain
    corners = combinations(chain.travel)
    arms = np.abs(synthesis.jacobian(chain, corners, tip)[:, :3]).max(axis=0)
    total = np.zeros(3)
    for c, name in enumerate(chain.components):
        a = int(chain.drives[c])
        if a < 0:
            continue
        grid, values = errors.curve(name)
        fine = np.union1d(grid, grids[a])
        curve = np.interp(fine, grid, values)
        chord = np.interp(fine, grids[a], np.interp(grids[a], grid, values))
        total += np.abs(curve - chord).max() * arms[:, c]
        axis = chain.axes[a]
        apart = chain.machine.axes[axis].errors_travel == (chain.machine.side_moved_by(axis) == "workpiece")
        if chain.angular[c] and apart:
            step = grids[a][1] - grids[a][0]
            slope = np.abs(np.diff(values)).max() / (grid[1] - grid[0])
            total += 1e-3 * step**2 / 4 * slope
    return float(np.linalg.norm(total))
