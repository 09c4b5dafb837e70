"""A thermal model for unseen seasons: causes of known sign and a gated correction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe.errors import DataError
from errpipe.models._base import Family, Fitted, Progress, Table, held_out, no_progress
from errpipe.thermal.season_options import SeasonOptions

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem
    from errpipe.thermal.model import ThermalModel

CAUSES = "season.json"


class Season(Family):
    """Heat sources with effects of known sign, shrunk towards zero, and a learnt correction that fades out."""

    family: Literal["season"] = Field("season", description="Model family.")
    component: str = Field(description="Response of the recording, such as E_D or E_Z.")
    options: SeasonOptions = Field(
        SeasonOptions(), description="Options of the fit; the defaults are those that were validated."
    )
    documents: ClassVar[tuple[str, ...]] = (CAUSES,)
    seasonal: ClassVar[bool] = True
    competes: ClassVar[bool] = True

    @property
    def scheme(self) -> HoldOut:
        """Leave-one-environment-out (seasons)."""
        from errpipe.fitting.holdout import HoldOut

        return HoldOut(scheme="leave-one-group-out", of=self.options.environment)

    def folds(self, recording: Recording, scheme: HoldOut | str | None) -> tuple[str, list[Fold]]:
        """Without a scheme: each environment in turn, or runs if the recording names fewer than two."""
        try:
            return super().folds(recording, scheme)
        except DataError:
            if scheme is not None or self.options.environment != SeasonOptions().environment:
                raise
            return super().folds(recording, "auto")

    def missing_input(self, recording: Recording) -> str:
        """A temperature is needed."""
        text = f"thermal model of {self.component}: the recording has no temperature"
        return "" if recording.names("temperature") else text

    def train(self, recording: Recording, rows: np.ndarray | None = None) -> ThermalModel:
        """The model of the rows of a mask (default: all); it predicts the deviation since the start of each run."""
        from errpipe.thermal import season
        from errpipe.thermal.arithmetic import working_sensors

        return season.fit(working_sensors(recording, self.component), self.component, self.options, rows)

    @classmethod
    def competitor(cls, shared: Mapping[str, Any]) -> Season:
        """Its options with those common to all competitors."""
        named = {name: value for name, value in shared.items() if name in SeasonOptions.model_fields}
        return cls(component=shared["component"], options=SeasonOptions(**named))

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """One setting, the network with its correction; none if no sensor is on the machine."""

        from errpipe.thermal.arithmetic import predicted_since_start
        from errpipe.thermal.competition import Entrant
        from errpipe.thermal.season import Problem

        recording, run = problem.recording, problem.recording.run_codes()
        try:
            full_problem = Problem(recording, self.component, self.options, problem.rows, problem.group)
        except DataError:
            return ()
        full_problem.choose_signs()

        @cache
        def model(groups: tuple[int, ...]) -> ThermalModel:
            return full_problem.restricted(groups).model(alone=False)

        def predict(groups: tuple[int, ...]) -> np.ndarray:
            left_out = problem.rows & ~np.isin(problem.group, groups)
            rows = np.isin(run, run[left_out])
            out = np.full(run.size, np.nan)
            values = model(groups).values(recording.take(rows))
            measured = np.isfinite(problem.response[rows])
            out[rows] = predicted_since_start(values, run[rows], self.options.datum_rows, measured)
            return out

        def parts(groups: tuple[int, ...]) -> Any:
            return tuple((self.family_name(), gain, node) for gain, node in model(groups).terms)

        def linear(groups: tuple[int, ...]) -> Any:
            gains = full_problem.solve(groups, corrected=False).core
            return tuple((c.name, float(g), c.driver) for c, g in zip(full_problem.causes, gains, strict=True) if g)

        return [Entrant(self.family_name(), "network + correction (season)", predict, parts, True, linear)]

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit on every row. Raises DataError if no sensor is on the machine."""
        fitted = self.train(recording)
        model = fitted.error_model(recording)
        causes = [{"cause": name, "gain": gain} for name, gain, _ in fitted.parts]
        document = {"season": 1, "causes": causes, "report": _plain(fitted.report)}
        left = fitted.report["rms_runs_left_out"]
        remaining = "no run could be held out" if left is None else f"-> {left:.3g} um on each held-out run"
        return Fitted(model, {CAUSES: document}, {self.component: f"{fitted.report['rms_before']:.3g} {remaining}"})

    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Fit on one side of a fold, validate on the other; both count from each run's first reading, as a table."""
        from errpipe.fitting import holdout
        from errpipe.fitting.validity import distance
        from errpipe.thermal.arithmetic import held_readings, predicted_since_start, since_start_of

        holdout.check(fold)
        recording = held_readings(recording)
        model = self.train(recording, fold.train)
        since = since_start_of(recording, self.component)
        residual = since - predicted_since_start(model.values(recording), recording.run_codes(), 1, since == since)
        return {self.component: held_out(fold, since, residual, distance(model.validity, recording))}

    def tables(self, documents: Mapping[str, Any], validation: Mapping[str, Any]) -> list[Table]:
        """Causes with their gains, the largest first."""
        rows = [[c["cause"], c["gain"]] for c in documents[CAUSES]["causes"] if c["gain"]]
        rows.sort(key=lambda row: -abs(row[1]))
        caption = "Gain of each cause, um per K (per hour of running for a state); only physically possible signs."
        return [Table("Causes", ["cause", "gain"], rows, caption)]


def _plain(value: Any) -> Any:
    """Report values as JSON: arrays and tuples as lists, numbers as numbers."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value.tolist() if hasattr(value, "tolist") else value
