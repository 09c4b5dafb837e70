"""Thermal families: entrants, their competition within the fitted rows, and the model that a table compiles."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import Field

from errpipe.domain import components
from errpipe.errors import DataError
from errpipe.models._base import Family, Fitted, Grid, Progress, held_out, no_progress
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    from errpipe.domain import driver as d
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut
    from errpipe.thermal.competition import Entrant, Outcome
    from errpipe.thermal.linear import LinearProblem
    from errpipe.thermal.model import ThermalModel

COMPETITION = "competition.json"
MOST_GROUPS = 4  # columns of one grouping in the figure of the competition
TIE_LEVEL = 0.05  # p over held-out runs
MACHINE = "machine"  # group of a recording
UNLIKE_MACHINES = 1.5  # ratio to the leave-one-run-out residual; above it the fit reports machines (by judgement)


class ThermalFamily(Family):
    """A thermal model of one response: entrants that compete on held-out groups of the fitted rows."""

    component: str = Field(description="Response of the recording, such as E_D or E_Z.")
    environment: str = Field("season", description="Group whose members differ in environment, such as seasons.")
    coverage: float = quantity("1", "Coverage of the prediction interval.", 0.9, gt=0.5, lt=1)
    datum_rows: int = Field(3, ge=1, description="First rows of a run whose mean is its zero.")
    warm_starts: bool = Field(True, description="Also fit starts on a warm machine, from the later part of each run.")
    documents: ClassVar[tuple[str, ...]] = (COMPETITION,)
    competes: ClassVar[bool] = True

    @abstractmethod
    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Settings that compete, on the rows of a problem."""

    @property
    def scheme(self) -> HoldOut:
        """Leave-one-environment-out; `folds` holds runs out if the recording names none."""
        from errpipe.fitting.holdout import HoldOut

        return HoldOut(scheme="leave-one-group-out", of=self.environment)

    def missing_input(self, recording: Recording) -> str:
        """A temperature or a spindle speed is needed."""
        if recording.names("temperature") or recording.name("spindle_speed") is not None:
            return ""
        return (
            f"thermal model of {self.component}: the recording has no temperature and no spindle speed "
            "(`clean` excludes constant sensors: its cleaning.json names them)"
        )

    def folds(self, recording: Recording, scheme: HoldOut | str | None) -> tuple[str, list[Fold]]:
        """Without a scheme: each environment in turn, or each run if the recording names fewer than two.

        A group in which a temperature has no reading is not used for testing; if that leaves one environment, its runs
        are held out. Fewer than three runs, of one environment or two: each half by the other, because no test over two
        runs separates a correction from chance. A block between two fitted ones is interpolated and says little about
        the next run: of 12 simulated days
        (seeds 5101 and 5102 of `trials.thermal`), later days had 1.8 times the residual of such blocks (0.8 times
        that of halves), and their 90 % interval covered 65 % (89 %) of the rows.
        """

        from errpipe.fitting import holdout
        from errpipe.thermal.arithmetic import FEWEST_RUNS, all_known, working_sensors

        known = holdout.measured(recording) & all_known(working_sensors(recording, self.component))
        try:
            name, folds = super().folds(recording, scheme)
        except DataError:
            if scheme is not None:
                raise
            folds = []
        usable = [fold for fold in folds if known[fold.test].any() and known[fold.train].any()]
        runs = np.unique(recording.run_codes()[known if folds else holdout.measured(recording)]).size
        if usable and (scheme is not None or runs >= FEWEST_RUNS):
            return name, usable
        if scheme is None:
            name, folds = super().folds(recording, "auto" if runs >= FEWEST_RUNS else holdout.HALVES)
        return name, [fold for fold in folds if known[fold.test].any() and known[fold.train].any()] or folds

    def train(self, recording: Recording, rows: np.ndarray | None = None) -> ThermalModel:
        """The model of the rows of a mask (default: all); it predicts the deviation since the start of each run."""
        return self._compete(recording, rows)[0]

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit on every row. Raises DataError without a temperature or with only one run."""
        from errpipe.thermal.arithmetic import changes_with_place, few_rows_fitted, held_readings

        fitted, outcome = self._compete(recording, None)
        model = fitted.error_model(recording)
        document = {
            "competition": 2,
            "component": self.component,
            "weights": [{"family": e.family, "setting": e.name, "weight": w} for e, w in outcome.weights],
            "rms_um": {grouping: dict(left) for grouping, left in outcome.left.items()},
            "rms_um_by_group": outcome.by_group,
            "chance": dict(outcome.chance),
            "noise_floor_um": _noise_floor(recording, self, outcome),
        }
        summary = _summary(outcome, components.unit(self.component))
        if left := fitted.report["later_starts"]:
            summary += f"; from later starts on {left[0]:.3g} -> {left[1]:.3g} {components.unit(self.component)}"
        summary += changes_with_place(recording, _left(recording, self, outcome))
        summary += few_rows_fitted(held_readings(recording), self.component, fitted.report["rows"])
        return Fitted(model, {COMPETITION: document}, {self.component: summary})

    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Compete and fit on one side of a fold, validate on the other.

        Deviation and prediction both count from the mean of a run's first rows: the zero of a run is its datum.
        """

        from errpipe.fitting import holdout
        from errpipe.fitting.design import response_name
        from errpipe.fitting.validity import distance
        from errpipe.thermal.arithmetic import all_known, predicted_since_start, since_start, working_sensors

        holdout.check(fold)
        recording = working_sensors(recording, self.component)
        model = self.train(recording, fold.train)
        run, known = recording.run_codes(), all_known(recording)  # a lag continues after its sensor has failed
        read = np.where(known, recording.array(response_name(recording, self.component)), np.nan)
        since, _ = since_start(read, run, self.datum_rows)
        residual = since - predicted_since_start(model.values(recording), run, self.datum_rows, since == since)
        return {self.component: held_out(fold, since, residual, distance(model.validity, recording))}

    def grids(self, documents: Mapping[str, Any]) -> list[Grid]:
        """The competition: rms of every family on held-out groups, with no compensation and the noise floor."""
        from errpipe.thermal.competition import MIXTURE, NOTHING

        document = documents[COMPETITION]
        weights = {w["setting"]: w["weight"] for w in document["weights"]}
        pooled = {n: n if " or " in n else f"every {n.replace('_', ' ')}" for n in document["rms_um"]}
        columns = {pooled[name]: left for name, left in document["rms_um"].items()}
        for left in document["rms_um_by_group"].values():
            columns |= dict(list(left.items())[:MOST_GROUPS])
        first = next(iter(document["rms_um"].values()))
        settings = sorted((s for s in first if s not in (NOTHING, MIXTURE)), key=lambda s: first[s])
        names = [NOTHING, *settings, MIXTURE]
        remarks = [_remark(name, weights, document["chance"]) for name in names]
        values = [[left.get(name) for left in columns.values()] for name in names]
        if document["noise_floor_um"] is not None:
            names, remarks = [*names, "noise floor"], [*remarks, ""]
            values = [*values, [document["noise_floor_um"]] * len(columns)]
        caption = (
            "rms in um of the fitted rows, each predicted by a fit without its group (column); of each family the best "
            "setting. The mixture is exported. It was chosen on these rows; the validation uses others. In a tie "
            f"the mixture's advantage on held-out runs has a p value above {TIE_LEVEL:g}."
        )
        return [Grid("Competition of families", list(columns), names, values, remarks, MIXTURE, caption)]

    def _compete(self, recording: Recording, rows: np.ndarray | None) -> tuple[ThermalModel, Outcome]:
        from errpipe.fitting.solve import one_thread
        from errpipe.thermal import competition
        from errpipe.thermal import linear as thermal_linear
        from errpipe.thermal.arithmetic import working_sensors

        if lacking := self.missing_input(recording):
            raise DataError(lacking)
        recording = working_sensors(recording, self.component)
        with one_thread():
            problem = thermal_linear.problem(recording, self.component, rows, self.datum_rows)
            recording = problem.recording
            groupings = competition.groupings(recording, problem.group, problem.groups, self.environment)
            if problem.blocks and len(problem.groups) > 1:
                groupings = (*groupings, competition.halves(problem.groups))
            entrants, alone = self.entrants(problem), self.one_environment(problem)
            if alone and problem.one_run:
                entrants = [e for e in entrants if e.physical] or entrants
            outcome = competition.compete(
                entrants,
                groupings,
                problem.response,
                problem.rows,
                problem.group,
                problem.one_run,
                alone,
                None if problem.blocks else recording.run_codes(),
            )
            return _model(self, problem, outcome), outcome

    def one_environment(self, problem: LinearProblem) -> bool:
        """Whether all rows are of one labelled environment (season).

        Then nothing shows which gains hold in another one, and gains without a known sign fail first: fitted to
        the winter of a turning centre, lagged gains had 3.7 um on a held-out run and 17 um in spring, 8.7 without.
        So these compete there only if gains of known sign are already worse (`competition.PHYSICAL_REGRET`).
        """

        from errpipe.fitting import holdout

        try:
            return np.unique(holdout.labels(problem.recording, self.environment)[problem.rows].astype(str)).size == 1
        except DataError:
            return False


def _summary(outcome: Outcome, unit: str) -> str:
    """A short text on the outcome: residuals of the mixture on held-out groups, and its components."""
    from errpipe.thermal.competition import HALF, MIXTURE, NOTHING

    way = HALF if HALF in outcome.left else next(iter(outcome.left))
    left = outcome.left[way]
    made_of = " + ".join(f"{w:.2g} {e.name}" for e, w in outcome.weights) or "nothing"
    summary = f"{left[NOTHING]:.3g} -> {left[MIXTURE]:.3g} {unit} on each held-out {way}; {made_of}"
    other = outcome.left.get(MACHINE, left)[MIXTURE]
    if other <= UNLIKE_MACHINES * left[MIXTURE]:
        return summary
    return f"{summary}; {other:.3g} {unit} on each held-out {MACHINE}: machines that differ need one recording each"


def _left(recording: Recording, family: ThermalFamily, outcome: Outcome) -> np.ndarray:
    """Residual of the mixture on held-out groups, um, (rows,); NaN where not validated."""
    from errpipe.fitting.design import response_name
    from errpipe.thermal.arithmetic import since_start

    predicted = next(iter(outcome.predictions.values()))[: len(recording)]
    response = recording.array(response_name(recording, family.component))
    judged = np.where(np.isfinite(predicted), response, np.nan)
    return since_start(judged, recording.run_codes(), family.datum_rows)[0] - predicted


def _noise_floor(recording: Recording, family: ThermalFamily, outcome: Outcome) -> float | None:
    from errpipe.fitting.noise_floor import noise_floor

    residual = _left(recording, family, outcome)
    rows = np.flatnonzero(np.isfinite(residual))
    return noise_floor(recording, rows, residual[rows])


def _remark(name: str, weights: Mapping[str, float], chance: Mapping[str, float]) -> str:
    from errpipe.thermal.competition import MIXTURE

    if name == MIXTURE:
        return "exported"
    if name in weights:
        return f"{weights[name]:.2f} of it"
    return "tie" if chance.get(name, 0.0) > TIE_LEVEL else ""


def linear(family: str, name: str, problem: LinearProblem, gains: Callable[[tuple[int, ...]], np.ndarray]) -> Entrant:
    """An entrant whose parameters are gains (of the first drivers of a problem) from groups."""
    from errpipe.thermal.competition import Entrant

    known = lru_cache(maxsize=None)(gains)

    def predict(groups: tuple[int, ...]) -> np.ndarray:
        coefficients = known(groups)
        return problem.values[:, : coefficients.size] @ coefficients

    def parts(groups: tuple[int, ...]) -> Any:
        return tuple((name, float(g), node) for g, node in zip(known(groups), problem.drivers, strict=False) if g)

    return Entrant(family, name, predict, parts)


def _model(family: ThermalFamily, problem: LinearProblem, outcome: Outcome) -> ThermalModel:
    """The mixture as one sum of gains times drivers, clipped to limits from the fitted deviations."""

    from errpipe.domain import driver as d
    from errpipe.fitting.statistics import rms
    from errpipe.fitting.validity import box
    from errpipe.thermal import calibration, warm_start
    from errpipe.thermal.arithmetic import limits
    from errpipe.thermal.model import ThermalModel
    from errpipe.thermal.season_options import SeasonOptions

    y, rows, groups = problem.response, problem.rows, tuple(problem.groups)
    limit = limits(y[rows])
    total = _sum_of(outcome, groups)
    noise = _noise_floor(problem.recording, family, outcome) or 0.0
    one_environment = family.one_environment(problem)
    factor, intervals = calibration.interval(
        problem, outcome, total, family.coverage, family.environment, one_environment, noise
    )
    parts = [(name, w * g, n) for e, w in outcome.weights for name, g, n in e.parts(groups)]
    warm = warm_start.fitted(problem, outcome, factor, intervals, family.coverage) if family.warm_starts else None
    if warm is not None:
        factor = d.Affine(weights=(1.0, 1.0), of=(factor, warm.wider))
        if warm.added is not None:
            parts.append(("start on a warm machine", 1.0, warm.added))
            total = d.Affine(weights=(1.0, 1.0), of=(total, warm.added))
    roles = ("position", "command") if problem.plain else ("position", "command", "spindle_speed")
    places = {name for role in roles for name in problem.recording.names(role)}
    read = [n for n in d.inputs(total) if n in places]
    validity = box(problem.recording, [*problem.recording.names("temperature"), *read], rows)
    fitted = ThermalModel(
        component=family.component,
        options=SeasonOptions(),
        parts=tuple(parts),
        terms=((1.0, d.Clip(of=total, low=limit[0], high=limit[1])),),
        intervals=intervals,
        factor=factor,
        validity=validity.model_copy(update={"fades": False}),
        fade=1.0,
        limit=limit,
        datum=_zeros(family, problem),
    )
    own = rows & (np.arange(rows.size) < problem.own)
    after = y - fitted.values(problem.recording)
    report = {
        "rows": int(np.count_nonzero(own)),
        "rms_before": rms(y[own]),
        "rms_after": rms(after[own & np.isfinite(after)]),
        "later_starts": warm.left if warm is not None else None,
    }
    return ThermalModel(**(fitted.__dict__ | {"report": report}))


def _sum_of(outcome: Outcome, groups: tuple[int, ...]) -> Any:
    """A mixture as one affine driver, with equal nodes merged."""
    from errpipe.domain import driver as d
    from errpipe.thermal.linear import summed

    merged: dict[str, tuple[float, d.Driver]] = {}
    for entrant, weight in outcome.weights:
        for _, gain, node in entrant.parts(groups):
            key = node.model_dump_json()
            merged[key] = (merged.get(key, (0.0, node))[0] + weight * gain, node)
    parts = list(merged.values()) or [(1.0, d.Constant(value=0.0))]
    return summed([gain for gain, _ in parts], [node for _, node in parts])


def _zeros(family: ThermalFamily, problem: LinearProblem) -> tuple[float, float]:
    """Mean and standard deviation of the runs' zeros, um."""

    from errpipe.fitting.design import response_name

    name = response_name(problem.recording, family.component)
    zero = problem.recording.array(name) - problem.response
    levels = np.array([zero[problem.rows & (problem.group == g)].mean() for g in problem.groups])
    return float(levels.mean()), float(levels.std())
