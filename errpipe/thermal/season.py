"""A thermal model for all seasons: a core of physical causes, and a correction limited to similar starts.

    deviation since the start of the run = clip( share x fade x core + gate x correction )

core         causes of known sign (`thermal.causes`), gains by averaged signed networks (`thermal.network`)
correction   ridge on lagged differences to the room, fitted to the residual of the core, weighted to runs with a
             similar start temperature (`thermal.local`). It improves such runs by micrometres and makes an
             unseen season worse, so `gate` scales it by its improvement on held-out runs with a similar start,
             down to zero where a run starts outside the temperatures seen
share        1 inside; outside it fades to the slope that the core had on environments left out (at most 1)
fade         1 up to the distance tested on left-out seasons, then down to 0.6: if the residual is as large as
             the deviation, 0.6 of the prediction still reduces it, and costs little if the model is right
clip         causes stay within twice the recorded span, the sum within a quarter span beyond the deviations

Every part is an expression of driver operations, so a table gives the same figures. The datum is the start of
the run: temperatures do not show where the probe was zeroed, so each run's first rows are a nuisance of the
fit and the prediction starts at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.error_model import Validity
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.design import response_name
from errpipe.fitting.solve import one_thread
from errpipe.fitting.statistics import rms
from errpipe.fitting.validity import box
from errpipe.thermal import causes, interval, local, network
from errpipe.thermal.arithmetic import centred, inner_groups, limits, no_usable_row, since_start, slope
from errpipe.thermal.interval import Intervals, LeftOut
from errpipe.thermal.model import Part, ThermalModel
from errpipe.thermal.season_options import SeasonOptions

Rows = np.ndarray | None  # a mask or label of each row; None: all, grouped by run
CAUSE_BEYOND = 1.0  # of the recorded span of each cause
CORRECTION_LAGS = (900.0, 3600.0, 14400.0)  # s: of its temperatures
CORRECTION_PENALTY = 3e-3  # ridge strength on columns of unit root mean square
CORRECTION_WIDTH = 0.8  # K: runs whose starts differ by more hardly inform each other
SLOPE_WIDTH = 0.5  # K: width of the kernel over start temperatures in `correction_slope`
SLOPE_PRIOR = 1.0  # um2: regularisation of that ratio; a correction below 1 um on held-out runs counts little
WITNESSES = 2.0  # prior of that ratio, in runs with no improvement: one run is little evidence
SLOPE_STEPS = 16  # intervals of the table over the start temperature
FULL_WITHIN = 3.0  # K, mean over sensors: distance between the starts of two held-out seasons that were predicted well
FADED_AT = 9.0  # K: beyond this only FAR_SHARE of the core is used
FAR_SHARE = 0.6  # of the core that is used far from every recorded start
INNER_FOLDS = 6  # of runs, if many models are fitted for a competition; leave-one-run-out costs three times as much
FEWEST_RUNS = 3  # an environment is held out only if so many runs remain


def fit(
    recording: Recording, component: str, options: SeasonOptions | None = None, rows: np.ndarray | None = None
) -> ThermalModel:
    """Fit on the rows of a mask (default: all). Of other rows only the datum is used.

    Raises DataError if the response is missing or no sensor is on the machine.
    """
    options = options or SeasonOptions()
    with one_thread():
        problem = Problem(recording, component, options, rows)
        problem.choose_signs()
        return problem.model()


@dataclass(frozen=True)
class _Gains:
    """Fit to one set of groups: gains, correction, the range of its starts, and the balance of its days."""

    core: np.ndarray
    correction: local.LocalGains | None
    low: np.ndarray
    high: np.ndarray
    balance: tuple[float, float]


class Problem:
    """Design columns of all rows, and the triangles of the usable groups."""

    def __init__(self, recording: Recording, component: str, options: SeasonOptions, rows: Rows, group: Rows = None):
        self.recording, self.component, self.options = recording, component, options
        self.sensors = causes.sensors(
            recording, room=options.room, spindle=options.spindle, bed=options.bed, use=options.sensors
        )
        self.causes = causes.causes(recording, self.sensors, options.late, options.slow, options.thinning, rows)
        self.further = _correction_drivers(recording, self.sensors, rows) if options.correction else ()
        self.core = causes.columns(recording, [c.driver for c in self.causes])
        self.extra = causes.columns(recording, self.further)
        names = self.sensors.all()
        self.starts = causes.columns(recording, [d.at_start(n) for n in names])
        self.balance = np.nan_to_num(drive(_balance(self.sensors), recording))
        read = np.isfinite(np.column_stack([self.core, self.extra])).all(axis=1)  # a run counts from there on
        deviation = np.where(read, recording.array(response_name(recording, component)), np.nan)
        run = recording.run_codes()
        self.response, self.zero = since_start(deviation, run, options.datum_rows)
        measured = np.isfinite(self.response)
        core = centred(self.core, run, options.datum_rows, measured)
        extra = centred(self.extra, run, options.datum_rows, measured)
        good = np.isfinite(self.response) & np.isfinite(core).all(axis=1) & np.isfinite(extra).all(axis=1)
        if rows is not None:
            good &= rows
        if not good.any():
            raise no_usable_row(recording, component)
        self.rows = good
        self.group = inner_groups(run, good) if group is None else group
        self.groups = [int(g) for g in np.unique(self.group[good])]
        self.count = {g: int(np.count_nonzero(good & (self.group == g))) for g in self.groups}
        design = np.column_stack([core, extra])[good]
        self.triangles = network.triangles(design, self.response[good], self.group[good])
        of_core = [*range(len(self.causes)), -1]
        self.core_triangles = {g: network.stack({0: t[:, of_core]}, [0]) for g, t in self.triangles.items()}
        self.signs = np.array([c.sign for c in self.causes])
        self.rounds = 0  # while gain signs are chosen the weights stay uniform
        self.members = network.networks([c.kind for c in self.causes], [c.start for c in self.causes])
        self.core_centred, self.extra_centred = core, extra

    def restricted(self, groups: Sequence[int]) -> Problem:
        """The same problem with fewer training groups; signs and columns are shared."""
        fewer = copy(self)
        fewer.groups = list(groups)
        fewer.rows = self.rows & np.isin(self.group, fewer.groups)
        return fewer

    def full_core(self) -> np.ndarray:
        """Values of the causes minus the mean of each run's first rows, (rows, causes), K."""
        measured = np.isfinite(self.response)
        return centred(self.core, self.recording.run_codes(), self.options.datum_rows, measured, 1.0)

    def choose_signs(self) -> None:
        """Reverse all signs if held-out runs are then predicted better: the response may have the opposite sign."""
        turned = -self.signs
        errors = []
        for signs in (self.signs, turned):
            self.signs = signs
            core = self.left_out([[g] for g in self.groups], corrected=False)["core"]
            judged = self.rows & np.isfinite(core)
            errors.append(rms((self.response - core)[judged]))
        self.signs = turned if errors[1] < errors[0] else -turned
        self.rounds = self.options.rounds

    def solve(self, groups: Sequence[int], corrected: bool = True) -> _Gains:
        """Gains from some of the groups. corrected: including those of the correction."""
        weight = dict.fromkeys(groups, 1.0)
        core = self._core(weight)
        for _ in range(self.rounds):
            weight = network.reweighted(weight, self.triangles, self.count, core)
            core = self._core(weight)
        correction = self._local(groups, core) if self.further and corrected else None
        mask = self.rows & np.isin(self.group, list(groups))
        low, high = np.nanmin(self.starts[mask], axis=0), np.nanmax(self.starts[mask], axis=0)
        return _Gains(core, correction, low, high, (float(self.balance[mask].min()), float(self.balance[mask].max())))

    def _core(self, weight: dict[int, float]) -> np.ndarray:
        """Gains of the core from some groups with their weights."""
        triangle = network.stack({g: w * self.core_triangles[g] for g, w in weight.items()}, list(weight))
        rows = sum(self.count[g] for g in weight)
        return network.signed_gains(triangle, rows, self.members, self.signs, self.options.penalty)

    def _local(self, groups: Sequence[int], core: np.ndarray) -> local.LocalGains:
        warmth = self.start_temperature()
        warmth_of = {g: float(warmth[self.rows & (self.group == g)][0]) for g in groups}
        parts = {g: self.triangles[g] for g in groups}
        return local.fit(parts, self.count, warmth_of, core, CORRECTION_WIDTH, CORRECTION_PENALTY)

    def start_distance(self, gains: _Gains) -> np.ndarray:
        """Distance of each run's start outside the recorded starts, mean over sensors, K."""
        outside = np.maximum(gains.low - self.starts, 0.0) + np.maximum(self.starts - gains.high, 0.0)
        return np.nan_to_num(outside).mean(axis=1)

    def left_out(self, folds: Sequence[Sequence[int]], corrected: bool = True) -> dict[str, np.ndarray]:
        """Core and gated correction of every used row by gains fitted without its fold."""
        out = {k: np.full(self.rows.size, np.nan) for k in ("core", "correction")}
        warmth = self.start_temperature()
        for fold in folds:
            train = [g for g in self.groups if g not in fold]
            if not train:
                continue
            gains = self.solve(train, corrected)
            rows = self.rows & np.isin(self.group, list(fold))
            away = self.start_distance(gains)[rows]
            out["core"][rows] = self.core_centred[rows] @ gains.core
            gate = np.clip(1.0 - away / self.options.fade, 0.0, 1.0)
            out["correction"][rows] = 0.0
            if gains.correction is not None:
                out["correction"][rows] = gate * gains.correction.values(warmth[rows], self.extra_centred[rows])
        return out

    def temperature_ranges(self, rows: np.ndarray) -> Validity:
        """The temperature ranges of the rows of a mask."""
        return box(self.recording, self.sensors.all(), rows).model_copy(update={"fades": False})

    def _folds(self, count: int) -> list[list[int]]:
        """Groups held out together, in at most `count` folds; neighbours in time are in different folds."""
        return [self.groups[k::count] for k in range(min(count, len(self.groups)))]

    def environments(self) -> list[list[int]]:
        """Groups by environment: the labelled ones, else runs that started cold and runs that started warm."""
        try:
            labels = holdout.labels(self.recording, self.options.environment)
        except DataError:
            labels = np.full(self.rows.size, "")
        per_group = {g: labels[np.flatnonzero(self.rows & (self.group == g))[0]] for g in self.groups}
        kinds = list(dict.fromkeys(per_group.values()))
        by_kind = [[g for g in self.groups if per_group[g] == k] for k in kinds]
        fewest = min(len(self.groups) - len(one) for one in by_kind)
        if len(kinds) > 1 and fewest >= min(FEWEST_RUNS, len(self.groups) - 1):
            return by_kind
        warmth = {g: float(np.nanmean(self.starts[self.rows & (self.group == g)])) for g in self.groups}
        order = sorted(self.groups, key=lambda g: (warmth[g], g))
        half = len(order) // 2
        return [order[:half], order[half:]] if half else []

    def start_temperature(self) -> np.ndarray:
        """Mean start temperature of each row's run, degC."""
        return self.starts.mean(axis=1)

    def correction_slope(self, runs: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Start temperature (grid, degC) -> regularised slope of the residual on the correction over held-out runs."""
        warmth = self.start_temperature()  # of used rows: a log may start before the sensors do
        starts = np.array([warmth[self.rows & (self.group == g)][0] for g in self.groups])
        grid = np.linspace(starts.min(), max(starts.max(), starts.min() + 1e-3), SLOPE_STEPS + 1)
        if not self.further:
            return grid, np.zeros(grid.size)
        residual, gain = self.response - runs["core"], runs["correction"]
        above, below = np.zeros(starts.size), np.zeros(starts.size)
        for k, g in enumerate(self.groups):
            own = self.rows & (self.group == g) & np.isfinite(gain)
            if own.any():
                above[k], below[k] = np.mean(residual[own] * gain[own]), np.mean(gain[own] ** 2) + SLOPE_PRIOR
        if not below.any():  # a single group: nothing could be held out
            return grid, np.zeros(grid.size)
        near = np.exp(-0.5 * ((grid[:, None] - starts) / SLOPE_WIDTH) ** 2)
        return grid, np.clip((near @ above) / (near @ below + WITNESSES * below.mean()), 0.0, 1.0)

    def model(self, alone: bool = True) -> ThermalModel:
        """The final model: gains from all groups, its scales from held-out groups.

        alone: with its figures, its fade and a tight limit. A mixture of families has its own limit, and a
        fade that no fold tests far enough outside let it win where it failed: third seasons of machines 1 and 6
        of seed 9701 (`trials.thermal`) had residuals of 18 and 7 um, 5 and 1 without it.
        """
        y = self.response
        runs = self.left_out(self._folds(len(self.groups) if alone else INNER_FOLDS))
        seen = self.rows & np.isfinite(runs["core"])
        correction_slope = self.correction_slope(runs)
        runs["correction"] *= np.interp(self.start_temperature(), *correction_slope)
        unseen = self.left_out(self.environments(), corrected=False)
        judged = self.rows & np.isfinite(unseen["core"])
        share = self._share(unseen["core"], judged) if judged.any() else 1.0
        gains = self.solve(self.groups)
        intervals = self._intervals(runs["core"] + runs["correction"], unseen["core"])
        limit = limits(y[self.rows], seen_only=alone)  # with wider ones a failed sensor costs more than 1.3 times
        core, correction, known = self._parts(gains, correction_slope)
        held = d.Clip(of=_sum(core), low=limit[0], high=limit[1])
        trusted = (self._fading(gains, share), held) if alone else (held,)
        fading = d.Product(of=trusted) if core else None
        total = _sum(tuple(("", 1.0, node) for node in (fading, correction) if node is not None))
        terms = ((1.0, d.Clip(of=total, low=limit[0], high=limit[1])),)
        parts = core if correction is None else (*core, ("correction where it was learnt", 1.0, correction))
        model = ThermalModel(
            self.component,
            self.options,
            parts,
            terms,
            intervals,
            intervals.factor(known, self._ramp(gains, 1.0 / FAR_SHARE)),
            self.temperature_ranges(self.rows),
            self.options.fade,
            limit,
            self._datum(),
        )
        if not alone:
            return model
        after = y - model.values(self.recording)
        report = {
            "rows": int(np.count_nonzero(self.rows)),
            "groups": len(self.groups),
            "networks": len(self.members),
            "causes": {c.name: float(g) for c, g in zip(self.causes, gains.core, strict=True) if abs(g) > 1e-9},
            "correction_worth": {f"{t:.2f}": float(w) for t, w in zip(*correction_slope, strict=True)},
            "core_share_outside": share,
            "rms_before": rms(y[self.rows]),
            "rms_after": rms(after[self.rows]),
            "rms_runs_left_out": rms((y - runs["core"] - runs["correction"])[seen]) if seen.any() else None,
            "rms_core_runs_left_out": rms((y - runs["core"])[seen]) if seen.any() else None,
            "rms_core_environments_left_out": rms((y - unseen["core"])[judged]) if judged.any() else None,
        }
        return ThermalModel(**(model.__dict__ | {"report": report}))

    def _share(self, core: np.ndarray, rows: np.ndarray) -> float:
        """Slope of the deviation on the core over held-out environments, plus one standard error, 0..1.

        The standard error is a jackknife over groups: rows of one run are correlated.
        """
        whole = slope(self.response, core, rows, 0.0, np.inf)
        each = [slope(self.response, core, rows & (self.group != g), 0.0, np.inf) for g in self.groups]
        spread = float(np.sqrt((len(each) - 1) / len(each) * np.sum((np.array(each) - np.mean(each)) ** 2)))
        return float(np.clip(whole + spread, 0.0, 1.0))

    def _intervals(self, near: np.ndarray, afar: np.ndarray) -> Intervals:
        """From predictions of rows held out with their run, and with their environment; um."""
        runs = interval.independent_runs(self.recording, self.rows)
        left, far = (LeftOut((self.response - p)[self.rows], p[self.rows]) for p in (near, afar))
        return interval.calibrate(left, far, self.group[self.rows], self.options.coverage, runs)

    def _parts(self, gains: _Gains, correction_slope) -> tuple[tuple[Part, ...], d.Driver | None, d.Driver]:
        """The core cause by cause, the gated correction, and how well the season of a run is known (0..1)."""
        values = self.core[self.rows]
        low, high = values.min(axis=0), values.max(axis=0)
        span = CAUSE_BEYOND * (high - low)
        core = tuple(
            (c.name, float(g), d.Clip(of=c.driver, low=float(a), high=float(b)))
            for c, g, a, b in zip(self.causes, gains.core, low - span, high + span, strict=True)
            if abs(g) > 1e-9
        )
        grid, shares = correction_slope
        if gains.correction is None or not shares.any():
            return core, None, d.Constant(value=0.0)
        inside = d.Affine(offset=1.0, weights=(-1.0,), of=(self._outside(gains),))
        names = self.sensors.all()
        warmth = d.Affine(weights=(1.0 / len(names),) * len(names), of=tuple(d.at_start(n) for n in names))
        slope_driver = d.Lookup(
            of=warmth, start=float(grid[0]), step=float(grid[1] - grid[0]), values=tuple(float(w) for w in shares)
        )
        known = d.Product(of=(inside, slope_driver))
        return core, d.Product(of=(known, gains.correction.driver(warmth, self.further))), known

    def _fading(self, gains: _Gains, share: float) -> d.Driver:
        """Factor of the core, from the distance of the run's start and the day's change outside the recorded range."""
        faded = self._ramp(gains, FAR_SHARE)
        if share >= 1.0:
            return faded
        return d.Product(of=(faded, d.Affine(offset=1.0, weights=(share - 1.0,), of=(self._outside(gains),))))

    def _outside(self, gains: _Gains) -> d.Driver:
        """0 if the run started inside the recorded range, 1 from `fade` outside on."""
        away = self._distance_driver(gains)
        return d.Clip(of=d.Affine(weights=(1.0 / self.options.fade,), of=(away,)), low=0.0, high=1.0)

    def _ramp(self, gains: _Gains, end: float) -> d.Lookup:
        """1 up to the tested distance, `end` from FADED_AT on; starts and balance of the day have equal weight, K."""
        low, high = gains.balance
        day = _balance(self.sensors)
        excess = d.Affine(weights=(1.0, -1.0), of=(day, d.Clip(of=day, low=low, high=high)))
        size = d.Power(of=d.Product(of=(excess, excess)), exponent=0.5)
        away = d.Affine(weights=(1.0, 1.0), of=(self._distance_driver(gains), size))
        return d.Lookup(of=away, start=FULL_WITHIN, step=FADED_AT - FULL_WITHIN, values=(1.0, end))

    def _distance_driver(self, gains: _Gains) -> d.Driver:
        most = 1e3
        nodes: list[d.Driver] = []
        for name, low, high in zip(self.sensors.all(), gains.low, gains.high, strict=True):
            start = d.at_start(name)
            nodes.append(d.Clip(of=d.Affine(offset=float(low), weights=(-1.0,), of=(start,)), low=0.0, high=most))
            nodes.append(d.Clip(of=d.Affine(offset=-float(high), weights=(1.0,), of=(start,)), low=0.0, high=most))
        return d.Affine(weights=(1.0 / len(self.sensors.all()),) * len(nodes), of=tuple(nodes))

    def _datum(self) -> tuple[float, float]:
        run = self.recording.run_codes()
        levels = [self.zero[np.flatnonzero(self.rows & (run == r))[0]] for r in np.unique(run[self.rows])]
        return float(np.mean(levels)), float(np.std(levels))


def _balance(sensors: causes.Sensors) -> d.Driver:
    """Rise of the machine, mean over its sensors, minus the rise of the room, K."""
    rises = tuple(d.rise(n) for n in sensors.bodies)
    weights = (1.0 / len(rises),) * len(rises)
    if sensors.room is None:
        return d.Affine(weights=weights, of=rises)
    return d.Affine(weights=(*weights, -1.0), of=(*rises, d.rise(sensors.room)))


def _sum(parts: Sequence[Part]) -> d.Driver:
    if not parts:
        return d.Constant(value=0.0)
    return d.Affine(weights=tuple(g for _, g, _ in parts), of=tuple(node for _, _, node in parts))


def _correction_drivers(recording: Recording, sensors: causes.Sensors, rows: Rows) -> tuple[d.Driver, ...]:
    nodes: list[d.Driver] = [d.rise(n) for n in sensors.all()]
    reference = sensors.room or sensors.bodies[0]
    others = [n for n in sensors.all() if n != reference]
    nodes += [causes.lagged_difference(n, reference, tau) for n in others for tau in CORRECTION_LAGS]
    state = causes.running(recording, sensors, rows)
    if state is not None:
        nodes += [d.lag(state, tau) for tau in CORRECTION_LAGS[:2]]
    return tuple(nodes)
