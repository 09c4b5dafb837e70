"""Named terms of physics, one sum per response: the family of most pipelines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from errpipe.errors import DataError
from errpipe.fitting.spec import ModelSpec
from errpipe.models._base import BatchFolds, Family, Fitted, Progress, fit_summary, no_progress
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut
    from errpipe.fitting.source import Source

ROWS_IN_MEMORY = 1_000_000  # with ten columns and ten parameters least squares takes 0.6 GB


class Terms(ModelSpec, Family):
    """Fit the terms of every component on all rows of the recording; reject what the rows cannot distinguish."""

    family: Literal["terms"] = Field("terms", description="Model family.")
    less_simulated: bool = Field(
        False, description="Fit what a simulation omits: the deviation is recorded minus simulated."
    )
    rows_in_memory: int | None = quantity(
        "1",
        "A longer recording is fitted and validated batch by batch, and what cannot be (other methods than "
        "linear, free non-linear parameters, nuisance, smooth curves) is refused by name. Default: 1,000,000, and what "
        "cannot be fitted in batches is fitted whole.",
        None,
        ge=1000,
    )

    @classmethod
    def of(cls, spec: ModelSpec, less_simulated: bool = False) -> Terms:
        """The family of a specification."""
        known = {name: getattr(spec, name) for name in ModelSpec.model_fields}
        return cls(**known, less_simulated=less_simulated)

    @property
    def responses(self) -> tuple[str, ...]:
        """Components that it models."""
        return tuple(c.component for c in self.components)

    @property
    def scheme(self) -> HoldOut:
        """Rows held out by default."""
        return self.holdout

    @property
    def method_name(self) -> str:
        """How it is solved."""
        return self.method

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit on every row. Raises DataError, NotIdentifiable."""
        from errpipe.fitting import model

        fitted = model.fit(self._response(_as_read(recording)), self)
        return Fitted(fitted, summary=fit_summary(fitted))

    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Select and fit on one side of a fold, judge on the other."""
        from errpipe.fitting import judging

        return judging.validate_fold(self._response(_as_read(recording)), self, fold)

    def in_batches(self, source: Source) -> bool:
        """Longer than `rows_in_memory`. Raises DataError if that was set and something is not possible in batches."""
        from errpipe.fitting import history

        if source.rows <= (self.rows_in_memory or ROWS_IN_MEMORY):
            return False
        unsupported = history.unsupported_in_batches(self, source.ends)
        if unsupported and self.rows_in_memory is not None:
            raise DataError(
                f"fit: {source.rows} rows are more than rows_in_memory ({self.rows_in_memory}), and in batches there is"
                f" no {', no '.join(unsupported)}. Omit it, or raise rows_in_memory."
            )
        return not unsupported

    def fit_batches(self, source: Source) -> Fitted:
        """`fit` of a recording that is read batch by batch. Raises DataError, NotIdentifiable."""
        from errpipe.fitting import history, multirate

        fitted = history.fitted(multirate.held(source), self, self._response)
        return Fitted(fitted, summary=fit_summary(fitted))

    def validate_batches(self, source: Source, scheme: HoldOut | None) -> BatchFolds:
        """Every fold of a recording that is read batch by batch."""
        from errpipe.fitting import batches, history, holdout, multirate
        from errpipe.fitting.source import survey

        source = multirate.held(source)
        layout = survey(source, self, scheme)
        gathered = batches.gather(source, self, layout, self._response)
        folds = history.leave_one_group_out(gathered, source.manifest)
        worst = history.largest_deviations(source, gathered, folds, self._response)
        names = [h.component for h in gathered]
        return BatchFolds(
            holdout.name(layout.scheme),
            dict(zip(names, folds, strict=True)),
            {h.component: (h.sample(source.manifest), h.rows_of_recording()) for h in gathered},
            dict(zip(names, worst, strict=True)),
        )

    def _response(self, recording: Recording) -> Recording:
        return mismatch(recording, self) if self.less_simulated else recording


def _as_read(recording: Recording) -> Recording:
    """The recording with temperatures that are sampled less often than the rows held, as a table reads them.

    If every tenth row has one, nine of ten rows in production are held values; single empty cells stay empty.
    """
    from errpipe.thermal.arithmetic import sampled_less_often, short_gaps_held

    return short_gaps_held(recording, sampled_less_often(recording, recording.names("temperature")))


def mismatch(recording: Recording, spec: ModelSpec) -> Recording:
    """The recording with recorded minus simulated as its responses. Raises DataError if a simulation is missing."""
    left = {}
    for component in (c.component for c in spec.components):
        error, twin = (recording.name(role, component=component) for role in ("error", "simulated"))
        if error is None or twin is None:
            missing = "error" if error is None else "simulated"
            raise DataError(f"{component}: no column of role {missing} (needed: one of role error, one simulated)")
        left[error] = recording.array(error) - recording.array(twin)
    return recording.with_columns(left, {})
