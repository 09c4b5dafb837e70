"""Planar error map from a pattern of holes or balls: the deviation over X and Y with the set-up removed.

    E_X = kx x - s y + EXX(x) + EXY(y) + map_X(x, y)
    E_Y = ky y       + EYX(x) + EYY(y) + map_Y(x, y)          um, x and y in mm from the middle of the pattern

A shift and a rotation per run are nuisance parameters (set-up). kx, ky are scale (um/m), s is the squareness C0Y (urad,
X the datum axis: +1 urad leans +Y motion towards -X). The curves are bending modes of a free beam (no slope),
the map their products (angular motions at a lever arm, and any other smooth part). Size and smoothness of each
are estimated from the readings (`evidence`). With several runs, each may differ from the common map by its own smooth
map, so that an error of one plate is not attributed to the machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.kinematics import evidence
from errpipe.kinematics.basis import beam_modes, wave_numbers

TYPICAL = np.array([10.0, 3.0, 2.0, 1.0, 2.0, 2.0])  # prior: um rms by family; power; noise um
CERTAINTY = np.array([1.0, 1.0, 1.0, 1.0, 0.4, 3.0])  # prior sd of the logarithm of each
SHIFT, TURN = 2000.0, 2000.0  # um, urad: CMM datum against the machine's
OWN_ROUGH = 3.0  # a run's own map includes bends up to this wave number: set-up and temperature are smooth
REWEIGHTINGS = 4  # weights then change by less than the noise of readings (by judgement)
MISTAKE = 6.0  # robust standard deviations (1.48 MAD) about an affine map beyond which a hole is excluded as an outlier
HUBER = 2.5  # Huber threshold, standard deviations, beyond which a hole is down-weighted (a chip, a mispicked hole)


@dataclass(frozen=True)
class Box:
    """Ranges of the measured x and y, mm."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def middle(self) -> tuple[float, float]:
        """Reference point of the linear terms, mm."""
        return (sum(self.x) / 2, sum(self.y) / 2)


@dataclass(frozen=True)
class Functions:
    """Columns of the common map: output (0 X, 1 Y), function of x and of y (0 constant, 1 line, 2.. modes)."""

    box: Box
    modes: int
    output: np.ndarray
    in_x: np.ndarray
    in_y: np.ndarray
    family: np.ndarray
    rough: np.ndarray

    @classmethod
    def of(cls, box: Box, modes: int) -> Functions:
        """All curves and products up to `modes` bends; highest products are left to the curves."""
        rows = []
        wave = np.r_[0.0, 0.5, np.array(wave_numbers(modes)) / wave_numbers(1)[0]]
        for output in (0, 1):
            for i in range(modes + 2):
                for j in range(modes + 2):
                    linear = i + j <= 1
                    if linear or (i >= 1 and j >= 1 and np.hypot(wave[i], wave[j]) > wave[-1]):
                        continue
                    curve = i == 0 or j == 0
                    rows.append((output, i, j, 1 if curve else 2, max(1.0, float(np.hypot(wave[i], wave[j])))))
        columns = [np.array(c) for c in zip(*rows, strict=True)]
        return cls(box, modes, *columns)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Values, shape (n, functions), without regard to output; held at the edge of the box."""
        fx, fy = (self._functions_along(v, r) for v, r in ((x, self.box.x), (y, self.box.y)))
        return fx[:, self.in_x] * fy[:, self.in_y]

    def _functions_along(self, v: np.ndarray, travel: tuple[float, float]) -> np.ndarray:
        t = np.clip((v - travel[0]) / (travel[1] - travel[0]), 0.0, 1.0)
        return np.column_stack([np.ones_like(t), (t - 0.5) * np.sqrt(12.0), beam_modes(t, self.modes)])


@dataclass(frozen=True)
class PlanarModel:
    """A fitted planar map.

    mean, covariance: kx (um/m), ky (um/m), C0Y (urad), then the functions (um). noise: um, per reading.
    setup: shift X, shift Y (um) and rotation (urad) of each run. rows: holes used.
    """

    functions: Functions
    mean: np.ndarray
    covariance: np.ndarray
    noise: float
    power: float
    setup: dict[str, tuple[float, float, float]]
    rows: int

    def design(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """d(E_X, E_Y)/d(parameter), shape (2, n, parameters)."""
        return _common(self.functions, np.asarray(x, dtype=float), np.asarray(y, dtype=float))

    def predict(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Deviation E_X, E_Y in um, shape (n, 2), without any set-up."""
        return (self.design(np.atleast_1d(x), np.atleast_1d(y)) @ self.mean).T

    def figures(self) -> dict[str, dict[str, object]]:
        """Squareness C0Y (urad), scale of X and Y and their difference (um/m), each with its 95 % interval.

        For the whole pattern: the least-squares line through the complete map, not the linear term alone.
        """
        rows = self._lines()
        out: dict[str, dict[str, object]] = {}
        units = {"scale_X": "um/m", "scale_Y": "um/m", "C0Y": "urad", "scale_difference": "um/m"}
        for (name, unit), row in zip(units.items(), (*rows, rows[0] - rows[1]), strict=True):
            value, error = float(row @ self.mean), float(np.sqrt(row @ self.covariance @ row))
            out[name] = {"value": value, "ci95": (value - 1.96 * error, value + 1.96 * error), "unit": unit}
        return out

    def _lines(self) -> np.ndarray:
        """Rows that read scale X, scale Y and squareness off the parameters by least squares over the box."""
        box = self.functions.box
        gx, gy = (v.ravel() for v in np.meshgrid(np.linspace(*box.x, 25), np.linspace(*box.y, 25)))
        x, y = (gx - box.middle[0]) * 1e-3, (gy - box.middle[1]) * 1e-3
        both = self.design(gx, gy)
        one, nil = np.ones_like(x), np.zeros_like(x)
        linear = np.column_stack(
            [np.r_[x, nil], np.r_[nil, y], np.r_[-y, nil], np.r_[one, nil], np.r_[nil, one], np.r_[-y, x]]
        )
        return np.linalg.lstsq(linear, np.vstack([both[0], both[1]]), rcond=None)[0][:3]

    def components(self, count: int = 65) -> dict[str, Any]:
        """The part that single-axis components represent: EXX, EYX over x; EXY, EYY over y (mm, um), and C0Y (urad)."""
        f, box = self.functions, self.functions.box
        out: dict[str, Any] = {"C0Y": float(self.mean[2])}
        for axis, travel, own, other in (("X", box.x, f.in_x, f.in_y), ("Y", box.y, f.in_y, f.in_x)):
            p = np.linspace(*travel, count)
            values = f._functions_along(p, travel)
            for k, d in enumerate("XY"):
                used = (f.output == k) & (other == 0) & (own > 0)
                curve = values[:, own[used]] @ self.mean[3:][used]
                if d == axis:
                    curve = curve + self.mean[k] * (p - sum(travel) / 2) * 1e-3
                out[f"E{d}{axis}"] = (p, curve)
        return out

    def products(self) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """The map as a short sum of curve(x) * curve(y) (singular values), for tables without a plane form.

        Each item: output "E_X" or "E_Y", x, curve over x (um), y, curve over y (no unit); largest first.
        """
        f, out = self.functions, []
        x, y = np.linspace(*f.box.x, 65), np.linspace(*f.box.y, 65)
        fx, fy = f._functions_along(x, f.box.x), f._functions_along(y, f.box.y)
        for k, name in enumerate(("E_X", "E_Y")):
            used = (f.output == k) & (f.in_x > 0) & (f.in_y > 0)
            core = np.zeros((f.modes + 2, f.modes + 2))
            core[f.in_x[used], f.in_y[used]] = self.mean[3:][used]
            u, s, vt = np.linalg.svd(core)
            for i in np.flatnonzero(s > 0.02):
                out.append((name, x, fx @ u[:, i] * s[i], y, fy @ vt[i]))
        return sorted(out, key=lambda item: -float(np.ptp(item[2])))


def fit_plate(recording: Recording, *, rows: np.ndarray | None = None, modes: int = 8) -> PlanarModel:
    """Fit the map to components E_X and E_Y over positions X and Y; every run has its own shift and rotation.

    rows: mask or indices of the holes to use (default: all). Outlying holes have less weight.
    Raises DataError if columns are missing, there are fewer than 12 holes, or they are collinear.
    """
    x, y, run, ex, ey = _columns(recording, rows)
    used = np.unique(run)
    box = Box((float(x.min()), float(x.max())), (float(y.min()), float(y.max())))
    if min(np.ptp(x), np.ptp(y)) <= 0 or np.linalg.svd(np.column_stack([x - x.mean(), y - y.mean()]))[1][1] < 1e-6:
        raise DataError("a planar map needs holes that are not collinear")
    functions = Functions.of(box, min(modes, max(1, int(np.sqrt(len(x) / 4)))))
    design, spreads = _design(functions, x, y, run, used)
    inliers = np.tile(_inliers(x, y, run, used, np.column_stack([ex, ey])), 2)
    mean, cov, hyper = _reweighted(design, spreads, np.r_[ex, ey], inliers, len(used))
    p = 3 + len(functions.output)
    labels = recording.run_labels()
    poses = mean[p : p + 3 * len(used)].reshape(-1, 3)
    setup = {labels[r]: (float(a), float(b), float(c)) for r, (a, b, c) in zip(used, poses, strict=True)}
    return PlanarModel(functions, mean[:p], cov[:p, :p], float(hyper[-1]), float(hyper[-2]), setup, len(x))


def _reweighted(
    design: np.ndarray, spreads: evidence.Spreads, readings: np.ndarray, weight: np.ndarray, runs: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, covariance and prior sizes by iteratively reweighted least squares (Huber's weights)."""
    known, hyper, plausible = np.full(6, np.nan), np.empty(0), weight > 0  # no prior sizes estimated yet
    if runs < 2:
        known[3] = 1e-6
    for _ in range(REWEIGHTINGS):
        moments = evidence.Moments.of(design * weight[:, None], readings * weight)
        hyper = evidence.estimate(spreads, moments, known, hyper if hyper.size else None)
        mean, cov = evidence.solve(spreads, moments, hyper)
        standardised = np.abs(readings - design @ mean) / hyper[-1]
        weight = plausible * np.sqrt(np.minimum(1.0, HUBER / np.maximum(standardised, 1e-12)))
    return mean, cov, hyper


def without_setup(x: np.ndarray, y: np.ndarray, deviation: np.ndarray, fit: np.ndarray | None = None) -> np.ndarray:
    """Deviation (n, 2) minus its own best shift and rotation, um; `fit` masks the rows that determine them."""
    fit = np.ones(len(x), dtype=bool) if fit is None else fit
    one, nil = np.ones_like(x), np.zeros_like(x)
    a = np.stack([np.column_stack([one, nil, -y]), np.column_stack([nil, one, x])])
    pose = np.linalg.lstsq(a[:, fit].reshape(-1, 3), deviation[fit].T.ravel(), rcond=None)[0]
    return deviation - (a @ pose).T


def repeated(recording: Recording, first: str, second: str) -> dict[str, float]:
    """Two measurements of one plate, hole by hole: the noise floor of any model of that plate.

    first, second: run labels. `difference` (um): rms of second minus first after a shift and rotation;
    `floor`: that over sqrt 2, one measurement's share. `smooth`: the floor after removing a smooth drift, too.
    Raises DataError if fewer than 12 holes are common.
    """
    place, difference = _repeats(recording, first, second)
    residual = without_setup(place[:, 0], place[:, 1], difference)
    terms = [place[:, 0] ** i * place[:, 1] ** j for i in range(4) for j in range(4 - i)]
    basis = np.column_stack([t / np.abs(t).max() for t in terms])
    detrended = difference - basis @ np.linalg.lstsq(basis, difference, rcond=None)[0]
    size = [float(np.sqrt(np.mean(v**2))) for v in (residual, detrended)]
    return {"holes": len(place), "difference": size[0], "floor": size[0] / 2**0.5, "smooth": size[1] / 2**0.5}


def _repeats(recording: Recording, first: str, second: str) -> tuple[np.ndarray, np.ndarray]:
    """Places of the holes that two runs share (n, 2), mm, and second minus first there (n, 2), um."""
    labels = recording.run_labels()
    for label in (first, second):
        if label not in labels:
            raise DataError(f"the recording has no run {label!r} (runs: {', '.join(labels)})")
    x, y, run, ex, ey = _columns(recording, None)
    at_first, at_second = (
        {(a, b): (c, d) for a, b, c, d, r in zip(x, y, ex, ey, run, strict=True) if r == labels.index(k)}
        for k in (first, second)
    )
    holes = sorted(at_first.keys() & at_second.keys())
    if len(holes) < 12:
        raise DataError(f"runs {first} and {second} have only {len(holes)} holes in common")
    return np.array(holes), np.array([np.subtract(at_second[h], at_first[h]) for h in holes])


def _columns(recording: Recording, rows: np.ndarray | None):
    names = [recording.name("position", axis=a) for a in "XY"]
    names += [recording.name("error", component=c) for c in ("E_X", "E_Y")]
    for name, what in zip(names, ("position of X", "position of Y", "error E_X", "error E_Y"), strict=True):
        if name is None:
            raise DataError(f"a planar map needs a column of role {what}")
    columns = [recording.array(n) for n in names if n is not None]
    keep = np.zeros(len(recording), dtype=bool)
    keep[slice(None) if rows is None else rows] = True
    keep &= np.isfinite(columns).all(axis=0)
    if keep.sum() < 12:
        raise DataError(f"a planar map needs at least 12 holes with both deviations (found {int(keep.sum())})")
    x, y, ex, ey = (c[keep] for c in columns)
    return x, y, recording.run_codes()[keep], ex, ey


def _inliers(x, y, run, used, deviation: np.ndarray) -> np.ndarray:
    """1.0 for holes within MISTAKE robust standard deviations of their plate's affine map, 0.0 for outliers."""
    out = np.ones(len(x))
    for r in used:
        rows = np.flatnonzero(run == r)
        base = np.column_stack([np.ones(len(rows)), x[rows], y[rows]])
        keep = np.ones(len(rows), dtype=bool)
        for _ in range(5):
            if keep.sum() < 6:
                break
            residual = deviation[rows] - base @ np.linalg.lstsq(base[keep], deviation[rows][keep], rcond=None)[0]
            size = np.abs(residual).max(axis=1)
            limit = MISTAKE * 1.48 * float(np.median(size[keep]))
            within = size <= max(limit, 1e-6)
            if (within == keep).all():
                break
            keep = within
        out[rows] = keep
    return out


def _common(functions: Functions, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    values = functions(x, y)
    dx, dy = (x - functions.box.middle[0]) * 1e-3, (y - functions.box.middle[1]) * 1e-3
    nil = np.zeros_like(dx)
    linear = np.stack([np.column_stack([dx, nil, -dy]), np.column_stack([nil, dy, nil])])
    return np.concatenate([linear, np.stack([values * (functions.output == k) for k in (0, 1)])], axis=2)


def _design(functions: Functions, x, y, run, used) -> tuple[np.ndarray, evidence.Spreads]:
    """Common columns, then three set-up columns per run, then (several runs) each run's own map."""
    common = _common(functions, x, y)
    common = common.reshape(-1, common.shape[2])
    p = common.shape[1]
    mask = np.column_stack([run == r for r in used])
    dx, dy = (x - functions.box.middle[0]) * 1e-3, (y - functions.box.middle[1]) * 1e-3
    one, nil = np.ones_like(dx), np.zeros_like(dx)
    pose = np.vstack([np.column_stack([one, nil, -dy]), np.column_stack([nil, one, dx])])
    in_run = np.vstack([mask, mask])
    blocks = [common] + [pose * in_run[:, [i]] for i in range(len(used))]
    family = [np.r_[0, 0, 0, functions.family], np.full(3 * len(used), -1)]
    # scale and squareness are per metre of half the pattern: a 10 um edge is 10 / half-width um/m
    half = 1e3 / (0.5 * max(np.ptp(x), np.ptp(y)))
    fixed = [np.ones(p), np.tile([SHIFT, SHIFT, TURN], len(used))]
    rough = [np.r_[1.0, 1.0, 1.0, functions.rough], np.ones(3 * len(used))]
    if len(used) > 1:
        smooth_enough = np.r_[True, True, True, functions.rough <= OWN_ROUGH]
        for i in range(len(used)):
            blocks.append(common[:, smooth_enough] * in_run[:, [i]])
            family.append(np.full(smooth_enough.sum(), 3))
            fixed.append(np.ones(smooth_enough.sum()))
            rough.append(np.r_[1.0, 1.0, 1.0, functions.rough][smooth_enough])
    typical = np.r_[TYPICAL[0] * half, TYPICAL[1:]]
    family_of, rough_of, fixed_of = (np.concatenate(parts) for parts in (family, rough, fixed))
    spreads = evidence.Spreads(family_of, rough_of, fixed_of, typical, CERTAINTY)
    return np.hstack(blocks), spreads
