"""Named terms of physics, one sum per response: the family of most pipelines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from errpipe.fitting.spec import ModelSpec
from errpipe.models._base import Family, Fitted, Progress, fit_summary, silent

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut


class Terms(ModelSpec, Family):
    """Fit the terms of every component on all rows of the recording; refuse what the rows cannot tell apart."""

    family: Literal["terms"] = Field("terms", description="Model family.")
    less_simulated: bool = Field(
        False, description="Fit what a simulation leaves out: recorded less simulated values are the deviation."
    )
    takes_terms: ClassVar[bool] = True

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
        """Who sits out where nothing else is asked for."""
        return self.holdout

    @property
    def method_name(self) -> str:
        """How it is solved."""
        return self.method

    def fit(self, recording: Recording, progress: Progress = silent) -> Fitted:
        """Fit on every row. Raises DataError, NotIdentifiable."""
        from errpipe.fitting import model

        fitted = model.fit(self._response(recording), self)
        return Fitted(fitted, summary=fit_summary(fitted))

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Select and fit on one side of a fold, judge on the other."""
        from errpipe.fitting import judging

        return judging.judge(self._response(recording), self, fold)

    def _response(self, recording: Recording) -> Recording:
        return mismatch(recording, self) if self.less_simulated else recording


def mismatch(recording: Recording, spec: ModelSpec) -> Recording:
    """The recording with recorded less simulated as its responses. Raises DataError where a twin is missing."""
    from errpipe.errors import DataError

    left = {}
    for component in (c.component for c in spec.components):
        error, twin = (recording.name(role, component=component) for role in ("error", "simulated"))
        if error is None or twin is None:
            raise DataError(f"{component}: recorded and simulated values are needed, and one of them is missing")
        left[error] = recording.array(error) - recording.array(twin)
    return recording.with_columns(left, {})
