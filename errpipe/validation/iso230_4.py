"""Circular tests after ISO 230-4: the figures G, G(b), H, F, and errors identified from the plot.

A run is one circle in a plane of two axes in one direction; positions count from the circle's centre (mm), the
reading is the radial deviation E_R (um, actual minus nominal radius). With theta the angle from the first axis
towards the second, s = +1 counter-clockwise, R the radius, v the path speed:

    set-up            r0 + a cos(theta) + b sin(theta)            radius and centre, of each run
    scale mismatch    (k1 - k2) R/2 cos(2 theta)                  equal in both directions; oval along an axis
    squareness        -S R/2 sin(2 theta)                         equal in both directions; oval at 45 degrees
    servo mismatch    s v (t1 - t2)/2 sin(2 theta)                changes sign with the direction; t: delay of each axis
    backlash          -B/2 sign(velocity) cos or sin(theta)       steps at reversals
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.terms.backlash import Backlash
from errpipe.terms.scale_error import ScaleError
from errpipe.terms.servo_mismatch import ServoMismatch
from errpipe.terms.squareness import Squareness

FULL_CIRCLE = 300.0  # deg of arc required for circle figures
NORMAL = {"XY": "C0Y", "XZ": "B0Z", "YZ": "A0Z"}
# Converts "second axis leans to minus the first" to the ISO component: +B turns +Z towards +X.
SQUARENESS_SIGN = {"XY": 1.0, "XZ": -1.0, "YZ": 1.0}


@dataclass(frozen=True)
class Circle:
    """One run. sense: +1 counter-clockwise; angle (n,) rad; deviation (n,) um; radius mm; speed mm/s."""

    label: str
    plane: tuple[str, str]
    sense: int
    angle: np.ndarray
    deviation: np.ndarray
    radius: float
    speed: float | None


@dataclass(frozen=True)
class Figures:
    """ISO 230-4 figures of one plane, um. G by direction; both: G(b); hysteresis H; F: largest, smallest deviation.

    G is the smallest distance of two concentric circles that enclose the path (centre free), F counts from the
    programmed centre and radius.
    """

    plane: str
    circular: dict[str, float]
    both: float | None
    hysteresis: float | None
    radial: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Effect:
    """One identified error: effect id, axis or plane, value with 95 % interval, its part of the plot."""

    effect: str
    where: str
    value: float
    ci95: tuple[float, float]
    unit: str
    peak_to_peak: float
    says: str


@dataclass(frozen=True)
class CircularTest:
    """Figures and identified errors of one plane. noise: rms of the residual, um."""

    figures: Figures
    effects: tuple[Effect, ...]
    noise: float


def circles(recording: Recording) -> tuple[Circle, ...]:
    """The circular runs of a recording. Raises DataError if a run is not a circle of two axes."""
    name = recording.name("error", component="E_R")
    if name is None:
        raise DataError("a circular test needs an error column of component E_R (radial deviation)")
    letters = [str(recording.manifest.columns[n].axis) for n in recording.names("position")]
    columns = {a: recording.array(recording.names("position", axis=a)[0]) for a in letters}
    value, codes, out = recording.array(name), recording.run_codes(), []
    for number, label in enumerate(recording.run_labels()):
        rows = (codes == number) & np.isfinite(value)
        if not rows.any():
            continue
        moving = sorted(a for a in columns if np.ptp(columns[a][rows]) > 1e-3)
        if len(moving) != 2:
            raise DataError(f"run {label}: a circle moves two axes (found {', '.join(moving) or 'none'})")
        first, second = (columns[a][rows] for a in moving)
        out.append(_circle(recording, label, (moving[0], moving[1]), first, second, value[rows], rows))
    return tuple(out)


def _circle(recording, label, plane, first, second, value, rows) -> Circle:
    angle = np.arctan2(second, first)
    turned = np.unwrap(angle)
    sense = 1 if turned[-1] >= turned[0] else -1
    radius = float(np.hypot(first, second).mean())
    feed = recording.name("feed")
    speed = None if feed is None else float(np.nanmean(recording.array(feed)[rows])) / 60.0
    return Circle(label, plane, sense, angle, value, radius, speed)


def evaluate(recording: Recording) -> tuple[CircularTest, ...]:
    """Figures and identified errors of every plane. Raises DataError for runs that are not circles."""
    runs = circles(recording)
    planes = sorted({c.plane for c in runs})
    return tuple(_plane([c for c in runs if c.plane == plane]) for plane in planes)


def _plane(runs: list[Circle]) -> CircularTest:
    name = "".join(runs[0].plane)
    full = [c for c in runs if is_full(c)]
    figures = Figures(
        name,
        {c.label: minimum_zone(c.angle, c.deviation, c.radius) for c in full},
        _bidirectional(full),
        _hysteresis(full),
        {c.label: (float(c.deviation.max()), float(c.deviation.min())) for c in runs},
    )
    effects, noise = read(runs)
    return CircularTest(figures, effects, noise)


def minimum_zone(angle: np.ndarray, deviation: np.ndarray, radius: float) -> float:
    """Circular deviation G: width of the narrowest ring around the path, centre free, um.

    A linear programme in the centre (a, b) and the two radii; exact to second order in centre/radius.
    """
    points = np.column_stack([(radius + deviation * 1e-3) * np.cos(angle), (radius + deviation * 1e-3) * np.sin(angle)])
    centre = np.zeros(2)
    for _ in range(3):
        ray = points - centre
        size = np.linalg.norm(ray, axis=1)
        unit = ray / size[:, None]
        excess = (size - radius) * 1e3
        ones = np.ones(len(excess))
        upper = np.column_stack([-unit, -ones, 0 * ones])
        lower = np.column_stack([unit, 0 * ones, ones])
        solution = linprog(
            [0, 0, 1, -1],
            A_ub=np.vstack([upper, lower]),
            b_ub=np.r_[-excess, excess],
            bounds=[(None, None)] * 4,
            method="highs",
        )
        centre = centre + solution.x[:2] * 1e-3
    size = np.linalg.norm(points - centre, axis=1)
    return float(np.ptp(size) * 1e3)


def _bidirectional(runs: list[Circle]) -> float | None:
    if {c.sense for c in runs} != {1, -1}:
        return None
    angle = np.concatenate([c.angle for c in runs])
    centred = [c.deviation - _centre_fit(c)[1] for c in runs]
    return minimum_zone(angle, np.concatenate(centred), runs[0].radius)


def _centre_fit(circle: Circle) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares centre of a run, and its effect on the deviation, um."""
    design = np.column_stack([np.cos(circle.angle), np.sin(circle.angle), np.ones(len(circle.angle))])
    coefficients, *_ = np.linalg.lstsq(design, circle.deviation, rcond=None)
    return coefficients, design[:, :2] @ coefficients[:2]


def centred(circle: Circle) -> np.ndarray:
    """Radial deviation about the run's own least-squares centre, um; for part of a circle, unchanged."""
    return circle.deviation - _centre_fit(circle)[1] if is_full(circle) else circle.deviation


def is_full(circle: Circle) -> bool:
    """Whether a run covers enough of the circle for circle figures."""
    arc = float(np.degrees(np.ptp(np.unwrap(circle.angle))))
    return arc + 360.0 / max(len(circle.angle), 1) >= FULL_CIRCLE


def _hysteresis(runs: list[Circle]) -> float | None:
    """Largest difference of the two directions at one angle, each about its own centre, um."""
    by_sense = {s: [c for c in runs if c.sense == s] for s in (1, -1)}
    if not by_sense[1] or not by_sense[-1]:
        return None
    grid = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    mean = {}
    for s, circles_of_sense in by_sense.items():
        curves = []
        for c in circles_of_sense:
            order = np.argsort(c.angle)
            curves.append(np.interp(grid, c.angle[order], (c.deviation - _centre_fit(c)[1])[order], period=2 * np.pi))
        mean[s] = np.mean(curves, axis=0)
    return float(np.abs(mean[1] - mean[-1]).max())


def read(runs: list[Circle]) -> tuple[tuple[Effect, ...], float]:
    """Squareness, scale mismatch, backlash of both axes, servo mismatch; largest first; and the residual noise, um."""
    angle = np.concatenate([c.angle for c in runs])
    sense = np.concatenate([np.full(len(c.angle), c.sense) for c in runs])
    radius = np.concatenate([np.full(len(c.angle), c.radius) for c in runs])
    y = np.concatenate([c.deviation for c in runs])
    columns = [
        -radius / 2 * np.sin(2 * angle) * 1e-3,
        radius / 2 * np.cos(2 * angle) * 1e-3,
        0.5 * sense * np.sign(np.sin(angle)) * np.cos(angle),
        -0.5 * sense * np.sign(np.cos(angle)) * np.sin(angle),
    ]
    speeds = [c.speed for c in runs]
    if len({c.sense for c in runs}) == 2:
        v = np.concatenate([np.full(len(c.angle), 1.0 if c.speed is None else c.speed) for c in runs])
        columns.append(0.5 * sense * v * np.sin(2 * angle))
    setup_columns = []
    for c in runs:
        mask = np.concatenate([np.full(len(d.angle), float(d is c)) for d in runs])
        setup_columns += [mask, mask * np.cos(angle), mask * np.sin(angle)]
    design = np.column_stack(columns + setup_columns)
    coefficients, *_ = np.linalg.lstsq(design, y, rcond=None)
    residual = y - design @ coefficients
    noise = float(np.sqrt(residual @ residual / max(1, len(y) - design.shape[1])))
    error = noise * np.sqrt(
        np.maximum(np.diag(np.linalg.pinv(design.T @ design)), 0.0) * _variance_inflation(runs, residual)
    )
    plane, known = runs[0].plane, None not in speeds
    effects = [
        _effect(
            kind, plane, float(coefficients[i]), float(error[i]), float(np.ptp(columns[i] * coefficients[i])), known
        )
        for i, kind in enumerate(("square", "scale", "first", "second", "servo")[: len(columns)])
    ]
    return tuple(sorted(effects, key=lambda e: -e.peak_to_peak)), noise


def _variance_inflation(runs: list[Circle], left: np.ndarray) -> float:
    """Factor on the variance because neighbours on a circle are correlated (first-order autocorrelation)."""
    lagged_product, square, row = 0.0, 1e-300, 0
    for c in runs:
        residual = left[row : row + len(c.angle)]
        lagged_product += float(residual[1:] @ residual[:-1])
        square += float(residual @ residual)
        row += len(c.angle)
    rho = min(max(lagged_product / square, 0.0), 0.98)
    return (1.0 + rho) / (1.0 - rho)


def _effect(kind: str, plane: tuple[str, str], value: float, error: float, size: float, speed_known: bool) -> Effect:
    a, b = plane
    name = a + b
    if kind == "square":
        value *= SQUARENESS_SIGN.get(name, 1.0)
        lean = "minus" if value * SQUARENESS_SIGN.get(name, 1.0) > 0 else "plus"
        sentence = f"{NORMAL.get(name, Squareness.reports_as)} = {value:.1f} urad: +{b} leans towards {lean} {a}"
        effect, where, unit = Squareness.reports_as, NORMAL.get(name, name), "urad"
    elif kind == "scale":
        longer, shorter = (a, b) if value > 0 else (b, a)
        sentence = f"scale of {longer} is {abs(value):.1f} um/m longer than that of {shorter}"
        effect, where, unit = ScaleError.reports_as, f"{a}-{b}", "um/m"
    elif kind in ("first", "second"):
        axis = a if kind == "first" else b
        sentence = f"backlash of {axis} is {value:.1f} um" + ("" if value >= 0 else " (over-compensated)")
        effect, where, unit = Backlash.reports_as, axis, "um"
    else:
        unit = "ms" if speed_known else "um"
        behind = a if value > 0 else b
        sentence = f"{behind} lags the other axis by {abs(value):.2f} {unit}"
        effect, where = ServoMismatch.reports_as, name
    half = 1.96 * error
    return Effect(
        effect, where, value, (value - half, value + half), unit, size, f"{sentence} ({size:.1f} um of the plot)"
    )
