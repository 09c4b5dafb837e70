"""Figures of a machine's geometry: its chain as a sketch, the volumetric error, components, ball-bar plots.

All return inline SVG text, the same bytes for the same data. Space is shown in one isometric view, from the
front right and above; lengths along X, Y and Z have one scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.reporting import svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# One colour per axis letter; with the linear ones differing in lightness, so that they survive a grey printer.
COLOURS = {"X": "#b3261e", "Y": "#2e7d4f", "Z": "#1f5fa8", "A": "#d98277", "B": "#86b894", "C": "#7aa5d6"}
STEEL, WORK, TOOL = "#9aa4ad", "#d9c79a", "#20262c"
_VIEW = np.array([[0.866, 0.5, 0.0], [-0.38, 0.30, 0.87]])  # right and up on paper, of X, Y, Z
_TOWARDS = np.array([0.45, -0.80, 0.40])  # what has more of this is nearer
Block = tuple[np.ndarray, np.ndarray, str]  # centre, half widths, colour
Label = tuple[np.ndarray, str, str]  # place, text, colour
Band = tuple[np.ndarray, np.ndarray, np.ndarray]  # positions, and two values at each
SLICE = 41  # points along each side of a slice


def project(points: np.ndarray) -> np.ndarray:
    """Isometric view of points (..., 3), shape (..., 2)."""
    return np.asarray(points, dtype=float) @ _VIEW.T


_UP = {
    "X": np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]),
    "Y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "Z": np.eye(3),
}


def rotation(chain: Chain) -> np.ndarray:
    """Turn (3, 3) that brings the machine's vertical axis up on paper."""
    return _UP[chain.machine.up]


def machine_sketch(chain: Chain) -> str:
    """The machine drawn from its chain: bed, carriages with their directions and travels, work, spindle, tool."""
    machine = chain.machine
    low, high = _extent(chain)
    size = float(np.max(high - low))
    with svg.figure(6.4, 5.2) as (canvas, axes):
        axes.set_axis_off()
        axes.set_aspect("equal")
        bed = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2] - 0.18 * size])
        blocks = [_block(bed, np.array([0.62 * size, 0.5 * size, 0.05 * size]), STEEL)]
        labels: list[Label] = [(_shift(bed, size, 0, -0.27, -0.06), "bed", svg.INK)]
        for side in ("workpiece", "tool"):
            place = bed
            for name in _from_bed(chain, side):
                at = machine.spindle.position if name == "spindle" else machine.axes[name].reference
                point = rotation(chain) @ np.asarray(at, dtype=float)
                _strut(axes, place, point)
                place = point
                if name == "spindle":
                    blocks.append(_block(point, np.full(3, 0.06 * size), TOOL))
                    labels.append((_shift(point, size, 0.05, 0, 0.06), "spindle", svg.INK))
                    continue
                colour = COLOURS.get(name[0], COLOURS["X"])
                blocks.append(_block(point, np.full(3, 0.085 * size), colour))
                head = _motion(axes, chain, name, point, size, colour)
                labels.append((head, f"{name}'" if side == "workpiece" else name, colour))
            _end(axes, chain, side, place, size, blocks, labels)
        _paint(axes, blocks)
        for anchor, text, colour in labels:
            x, y = anchor if len(anchor) == 2 else project(anchor)
            short = len(text) < 3
            axes.text(
                x, y, text, color=colour, fontsize=11 if short else 9, weight="bold" if short else None, zorder=20
            )
        axes.set_title(machine.title or machine.name, fontsize=10)
        axes.margins(0.06)
        return svg.to_svg(canvas, f"Sketch of the machine {machine.name}: {' - '.join(machine.chain)}")


def _shift(point: np.ndarray, size: float, x: float, y: float, z: float) -> np.ndarray:
    return point + size * np.array([x, y, z])


def _from_bed(chain: Chain, side: str) -> list[str]:
    links = list(chain.machine.chain)
    bed = links.index("bed")
    part = links[1:bed][::-1] if side == "workpiece" else links[bed + 1 : -1]
    return [n.rstrip("'") for n in part]


def _extent(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    machine = chain.machine
    points = [a.reference for a in machine.axes.values()] + [
        machine.spindle.position,
        machine.workpiece,
        tuple(chain.tip()[0]),
    ]
    points = np.array(points, dtype=float) @ rotation(chain).T
    low, high = points.min(axis=0), points.max(axis=0)
    spread = max(float((high - low).max()), 1.0)
    return low - 0.05 * spread, high + 0.05 * spread


def _strut(axes: Axes, start: np.ndarray, stop: np.ndarray) -> None:
    """A structural member: straight up first, then along; drawn under the blocks."""
    corner = np.array([start[0], start[1], stop[2]])
    path = project(np.array([start, corner, stop]))
    axes.plot(path[:, 0], path[:, 1], color=STEEL, linewidth=7, solid_joinstyle="round", zorder=2, alpha=0.75)


def _block(centre: np.ndarray, half: np.ndarray, colour: str) -> tuple[np.ndarray, np.ndarray, str]:
    return np.asarray(centre, dtype=float), np.asarray(half, dtype=float) / 2.0 * 1.2, colour


def _paint(axes: Axes, blocks: Sequence[Block]) -> None:
    """Boxes from far to near, three visible faces each, shaded."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Polygon

    faces = ((np.array([0, 0, 1]), 1.15), (np.array([0, -1, 0]), 0.95), (np.array([1, 0, 0]), 0.78))
    for depth, (centre, half, colour) in enumerate(sorted(blocks, key=lambda b: float(b[0] @ _TOWARDS))):
        for normal, light in faces:
            u, v = np.eye(3)[np.flatnonzero(normal == 0)]
            corners = [centre + half * (normal + a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            shade = np.clip(np.array(to_rgb(colour)) * light, 0, 1)
            axes.add_patch(
                Polygon(
                    project(np.array(corners)),
                    facecolor=shade,
                    edgecolor="white",
                    linewidth=0.6,
                    zorder=5 + 0.01 * depth,
                )
            )


def _motion(axes: Axes, chain: Chain, name: str, point: np.ndarray, size: float, colour: str) -> np.ndarray:
    """An arrow along a linear axis, an arc about a rotary one: how the part moves for +. Returns the label's place."""
    axis = chain.machine.axes[name]
    direction = rotation(chain) @ np.asarray(chain.machine.direction(name))
    if axis.kind == "linear":
        reach = 0.17 * size
        ends = project(np.array([point - reach * direction, point + reach * direction]))
        sign = -1 if chain.machine.side_moved_by(name) == "workpiece" else 1
        start, stop = (ends[0], ends[1]) if sign > 0 else (ends[1], ends[0])
    else:
        u, v = np.linalg.svd(direction[None])[2][1:]
        if np.dot(np.cross(u, v), direction) < 0:
            v = -v
        turn = np.linspace(0.2, 1.6 * np.pi, 40)
        sense = -1 if chain.machine.side_moved_by(name) == "workpiece" else 1
        ring = project(point + 0.11 * size * (np.cos(turn)[:, None] * u + sense * np.sin(turn)[:, None] * v))
        axes.plot(ring[:, 0], ring[:, 1], color=colour, linewidth=1.8, zorder=9)
        start, stop = ring[-3], ring[-1]
    axes.annotate("", xy=stop, xytext=start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8}, zorder=9)
    axes.plot(*np.array([start, stop]).T, color=colour, linewidth=1.8, zorder=9)
    way = (stop - start) / max(float(np.linalg.norm(stop - start)), 1e-9)
    return stop + 0.03 * size * way - np.array([0.012, 0.012]) * size


def _end(
    axes: Axes, chain: Chain, side: str, place: np.ndarray, size: float, blocks: list[Block], labels: list[Label]
) -> None:
    if side == "workpiece":
        work = rotation(chain) @ np.asarray(chain.machine.workpiece, dtype=float)
        _strut(axes, place, work)
        blocks.append(_block(_shift(work, size, 0, 0, 0.05), np.full(3, 0.1 * size), WORK))
        labels.append((_shift(work, size, 0.07, 0, 0.02), "work", svg.INK))
        return
    mount, tip = (rotation(chain) @ np.asarray(v, dtype=float) for v in (chain.machine.mount(), chain.tip()[0]))
    _strut(axes, place, mount)
    path = project(np.array([mount, tip]))
    axes.plot(path[:, 0], path[:, 1], color=TOOL, linewidth=3, zorder=12, solid_capstyle="butt")
    axes.plot(path[1:, 0], path[1:, 1], "o", color=TOOL, markersize=5, zorder=12)
    labels.append((_shift(tip, size, 0.03, 0, -0.03), "tool", svg.INK))


def vectors(chain: Chain, q: np.ndarray, before: np.ndarray, after: np.ndarray | None = None) -> str:
    """Volumetric error as arrows in space. q (n, axes); before, after (n, 3), um; both drawn to one scale.

    after may also be sizes (n,), um, of which no direction is known: drawn as balls of that radius.
    """
    turn = rotation(chain).T
    place = synthesis.ideal_pose(chain, q)[:, 0] @ turn
    rows = svg.thin(len(place), 250)
    largest = max(float(np.linalg.norm(before, axis=1).max()), 1e-9)
    reach = 0.14 * float(np.ptp(place, axis=0).max()) / largest
    panels = [("before", before, svg.BEFORE)] + ([] if after is None else [("after", after, svg.AFTER)])
    with svg.figure(3.7 * len(panels) + 0.2, 3.6, columns=len(panels)) as (canvas, subplots):
        for axes, (name, values, colour) in zip(np.atleast_1d(subplots), panels, strict=True):
            _frame(axes, place, chain)
            size = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
            start = project(place[rows])
            if values.ndim == 1:
                _balls(axes, start, reach * size[rows], colour)
            else:
                stop = project(place[rows] + reach * values[rows] @ turn)
                axes.quiver(
                    *start.T,
                    *(stop - start).T,
                    color=colour,
                    angles="xy",
                    scale_units="xy",
                    scale=1,
                    width=0.004,
                    zorder=4,
                )
            axes.set_title(f"{name}: {_um(np.sqrt(np.mean(size**2)))} um rms, {_um(size.max())} um largest", fontsize=9)
        return svg.to_svg(canvas, f"Volumetric error of {chain.machine.name}; longest arrow {largest:.1f} um")


def _balls(axes: Axes, centre: np.ndarray, radius: np.ndarray, colour: str) -> None:
    from matplotlib.patches import Circle

    for (x, y), r in zip(centre, radius, strict=True):
        axes.add_patch(Circle((x, y), r, facecolor=colour, edgecolor="none", alpha=0.55, zorder=4))


def _frame(axes: Axes, place: np.ndarray, chain: Chain) -> None:
    """Edges of the box of all places, with the three directions named at its lowest corner."""
    axes.set_axis_off()
    axes.set_aspect("equal")
    low, high = place.min(axis=0), place.max(axis=0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    for i, a in enumerate(corners):
        for b in corners[i + 1 :]:
            if np.abs(a - b).sum() == 1:
                line = project(low + (high - low) * np.array([a, b]))
                axes.plot(line[:, 0], line[:, 1], color="#c3c9ce", linewidth=0.8, zorder=1)
    for letter, way in zip("XYZ", rotation(chain).T, strict=True):
        start = np.where(way < 0, high, low)
        end = start + way * (np.abs(way) @ (high - low) + 0.05 * np.ptp(place, axis=0).max())
        across, up = project(end)
        axes.text(across, up, letter, color=COLOURS[letter], ha="center", va="center", fontsize=9, weight="bold")


def slices(chain: Chain, panels: Mapping[str, Callable[[np.ndarray], np.ndarray]]) -> str:
    """Size of the volumetric error on the three middle planes, one column per panel, all in one scale of colours.

    panels: heading -> function of axis positions (n, axes) that gives sizes (n,) in um, such as before and after.
    """
    linear = chain.linear[:3]
    middle = chain.travel.mean(axis=1)
    pairs = [(i, j) for n, i in enumerate(linear) for j in linear[n + 1 :]]
    maps = {}
    for i, j in pairs:
        u, v = (np.linspace(chain.travel[k, 0], chain.travel[k, 1], SLICE) for k in (i, j))
        gu, gv = np.meshgrid(u, v)
        q = np.tile(middle, (gu.size, 1))
        q[:, i], q[:, j] = gu.ravel(), gv.ravel()
        for name, size in panels.items():
            maps[i, j, name] = (u, v, size(q).reshape(gu.shape))
    top = max(float(m[2].max()) for m in maps.values())
    shape = (len(pairs), len(panels))
    levels = _levels(top)
    with svg.figure(3.3 * len(panels) + 0.8, 2.25 * len(pairs), *shape) as (canvas, subplots):
        grid = np.reshape(subplots, shape)
        for (i, j, name), (u, v, sizes) in maps.items():
            axes = grid[pairs.index((i, j)), list(panels).index(name)]
            drawn = axes.contourf(u, v, sizes, levels=levels, cmap="cividis")
            rms = np.sqrt(np.mean(sizes**2))
            third = ", ".join(f"{chain.axes[k]} {middle[k]:g}" for k in linear if k not in (i, j))
            axes.set_xlabel(f"{chain.axes[i]} mm, at {third}" if third else f"{chain.axes[i]} mm", fontsize=8)
            axes.set_ylabel(f"{chain.axes[j]} mm", fontsize=8)
            axes.tick_params(labelsize=7)
            axes.grid(visible=False)
            axes.set_title(f"{name}: {_um(rms)} um rms, {_um(sizes.max())} largest", fontsize=8)
        canvas.colorbar(drawn, ax=grid.ravel().tolist(), label="um", shrink=0.6)
        return svg.to_svg(canvas, f"Volumetric error of {chain.machine.name} on its middle planes")


def _levels(top: float) -> np.ndarray:
    """About ten round steps from 0 to where the largest value lies inside."""
    from matplotlib.ticker import MaxNLocator

    return np.asarray(MaxNLocator(10).tick_values(0.0, max(top, 1e-6)))


def size_of(chain: Chain, errors: MachineErrors) -> Callable[[np.ndarray], np.ndarray]:
    """Size of the first-order deviation of some errors, um, as a function of axis positions."""
    return lambda q: np.linalg.norm(synthesis.first_order(chain, q, errors.at(q))[:, :3], axis=1)


def _um(value: float) -> str:
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"


def components(
    errors: MachineErrors, bands: Mapping[str, Band] | None = None, measured: Mapping[str, Band] | None = None
) -> str:
    """Error motions in the layout of ISO 230-1: one row per axis, translations left, rotations right.

    bands: component -> (position, lowest, highest), such as 95 % intervals. measured: component -> (target, mean
    coming from below, mean coming from above): marks that point the way the axis moved.
    """
    chain, bands, measured = errors.chain, bands or {}, measured or {}
    count = len(chain.axes)
    with svg.figure(7.4, 1.9 * count, count, 2) as (canvas, subplots):
        grid = np.reshape(subplots, (count, 2))
        for row, axis in enumerate(chain.axes):
            for side, (letters, unit) in enumerate((("XYZ", "um"), ("ABC", "urad"))):
                axes = grid[row, side]
                for letter in letters:
                    name = f"E{letter}{axis}"
                    _component(axes, errors, name, bands.get(name), measured.get(name))
                axes.axhline(0.0, color=svg.INK, linewidth=0.6)
                axes.set_ylabel(unit, fontsize=8)
                axes.tick_params(labelsize=7)
                axes.set_xlabel(f"{axis} {chain.axis_unit(axis)}", fontsize=8)
                axes.legend(fontsize=7, ncols=3, loc="upper left", bbox_to_anchor=(0.0, 1.22), borderaxespad=0.0)
        return svg.to_svg(canvas, f"Error motions of {chain.machine.name}")


def _component(axes: Axes, errors: MachineErrors, name: str, band: Band | None, means: Band | None) -> None:
    """The curve of one component, with its band behind it and the means of its targets on it."""
    colour = COLOURS[{"A": "X", "B": "Y", "C": "Z"}.get(name[1], name[1])]
    if band is not None:
        axes.fill_between(*band, color=colour, alpha=0.18, linewidth=0)
    axes.plot(*errors.curve(name), color=colour, linewidth=1.3, label=name)
    if means is not None:
        at, up, down = means
        for mark, mean in ((">", up), ("<", down)):
            axes.plot(at, mean, mark, color=colour, markersize=2.6, linestyle="none")


def ballbar(
    circles: Sequence[tuple[str, np.ndarray, np.ndarray]], radius: float, lines: Sequence[str] = (), title: str = ""
) -> str:
    """Polar plot of a circular test. circles: (label, angle in rad, deviation in um); radius mm; lines: its reading."""
    values = np.concatenate([d for *_, d in circles])
    top = float(np.abs(values).max()) or 1.0
    division = _division(top / 3.0)
    base = division * np.ceil(1.3 * top / division + 2)
    with svg.figure(7.4, 3.9, columns=2) as (canvas, (axes, text)):
        axes.set_aspect("equal")
        axes.set_axis_off()
        text.set_axis_off()
        turn = np.linspace(0, 2 * np.pi, 361)
        for step in range(-3, 4):
            ring = base + step * division
            heavy = step == 0
            axes.plot(
                ring * np.cos(turn),
                ring * np.sin(turn),
                color=svg.INK if heavy else "#d5dade",
                linewidth=0.9 if heavy else 0.6,
            )
        for quarter in range(4):
            x, y = np.cos(quarter * np.pi / 2), np.sin(quarter * np.pi / 2)
            axes.plot([0, x * (base + 3 * division)], [0, y * (base + 3 * division)], color="#d5dade", linewidth=0.6)
        for (label, angle, deviation), colour in zip(
            circles, (svg.AFTER, svg.BEFORE, svg.FLOOR, svg.ALARM) * 8, strict=False
        ):
            r = base + deviation
            axes.plot(r * np.cos(angle), r * np.sin(angle), color=colour, linewidth=1.1, label=label)
        axes.legend(fontsize=7, loc="center", ncols=1)
        heading = {"fontsize": 9, "weight": "bold", "transform": text.transAxes, "va": "top"}
        text.text(0.0, 0.98, title or f"circle of {radius:g} mm", **heading)
        caption = [f"{division:g} um per division, radius {radius:g} mm", *lines]
        spacing = min(0.08, 0.88 / len(caption))
        for i, line in enumerate(caption):
            text.text(0.0, 0.9 - spacing * i, line, fontsize=8, transform=text.transAxes, va="top", wrap=True)
        return svg.to_svg(canvas, f"Ball-bar plot {title}; largest deviation {top:.1f} um")


def _division(value: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten, not below."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= value * (1 - 1e-9)))
