"""Base of model families: options, a fit, its refit on the rows of a fold, and its parts of a report.

A family is a pydantic model of its options. The stage `fit` reads them from the pipeline file (`family: NAME`
chooses one), writes them beside the error model, and validation reads them back to repeat the fit without a held-out
group. Every family returns an error model, so one compiler lowers all of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from errpipe.domain.recording import FrozenModel

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.fitting import history
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut
    from errpipe.fitting.source import Source
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem

Progress = Callable[[float, str], None]


def no_progress(share: float, text: str) -> None:
    """Progress callback that ignores its arguments."""


class Table(NamedTuple):
    """A table of the report: heading, column names, rows, and a sentence below it."""

    heading: str
    columns: list[str]
    rows: list[list[Any]]
    caption: str


class Grid(NamedTuple):
    """Figures of rows by columns for the report, the first row without compensation.

    values: None is printed as a dash. remarks: a remark after each row. best: name of the row that is used.
    """

    heading: str
    columns: list[str]
    rows: list[str]
    values: list[list[float | None]]
    remarks: list[str]
    best: str
    caption: str


@dataclass(frozen=True)
class BatchFolds:
    """Folds of a recording read batch by batch. scheme: name of the hold-out; by component: folds; rows of the
    sample with the row of the recording of each, (rows,); largest deviation before and after in each fold, (folds, 2).
    """

    scheme: str
    folds: Mapping[str, list[history.Fold]]
    sample: Mapping[str, tuple[Recording, np.ndarray]]
    worst: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Fitted:
    """model: the fitted model; documents: further JSON files by name; summary: a short text per component."""

    model: ErrorModel
    documents: Mapping[str, Any] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)


class Family(FrozenModel, ABC):
    """Base of every model family; the fields of a subclass are its options, `family` is its name.

    documents: names of the JSON files that its fit adds. seasonal: whether `train` returns a predictor of the deviation
    since the start of each run. competes: whether it has entrants for a competition of thermal families.
    nonlinear: whether its relations are non-linear, so that one run cannot validate them for another. one_map: whether
    its responses are one map, whose significance is tested over all of them together. default_scheme: of the hold-out.
    solved_by: the solution method, if not evident from its name.
    """

    documents: ClassVar[tuple[str, ...]] = ()
    seasonal: ClassVar[bool] = False
    competes: ClassVar[bool] = False
    nonlinear: ClassVar[bool] = False
    one_map: ClassVar[bool] = False
    default_scheme: ClassVar[str] = "auto"
    solved_by: ClassVar[str] = ""

    @classmethod
    def family_name(cls) -> str:
        """The family's name in pipeline files."""
        return str(cls.model_fields["family"].default)

    @property
    def responses(self) -> tuple[str, ...]:
        """The components that it models: its `component` or `components`."""
        own: Any = self
        return (own.component,) if "component" in type(self).model_fields else own.components

    @property
    def scheme(self) -> HoldOut:
        """Hold-out scheme by default."""
        from errpipe.fitting.holdout import HoldOut

        return HoldOut.model_validate({"scheme": self.default_scheme})

    @property
    def method_name(self) -> str:
        """The solution method, for `validation.json`."""
        return self.solved_by or self.family_name().replace("_", " ")

    def missing_input(self, recording: Recording) -> str:
        """The missing columns that the family needs of a recording (its header is enough), as a sentence; or ''."""
        return ""

    @abstractmethod
    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit on every row of the recording. Raises DataError, NotIdentifiable."""

    def folds(self, recording: Recording, scheme: HoldOut | str | None) -> tuple[str, list[Fold]]:
        """The scheme's name and its folds; without a scheme, the family's own."""
        from errpipe.fitting import holdout

        chosen = holdout.resolved(recording, self.scheme if scheme is None else scheme)
        return holdout.name(chosen), holdout.groups(recording, chosen)

    @abstractmethod
    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Fit on the training rows of a fold, validate on its test rows; component -> held-out residuals."""

    def in_batches(self, source: Source) -> bool:
        """Whether a recording is too long to be fitted in memory. Raises DataError if batches are impossible, too."""
        return False

    def fit_batches(self, source: Source) -> Fitted:
        """`fit` of a recording that is read batch by batch."""
        raise TypeError(f"{self.family_name()} is not fitted in batches")

    def validate_batches(self, source: Source, scheme: HoldOut | None) -> BatchFolds:
        """Every fold of a recording read batch by batch; without a scheme, the family's own."""
        raise TypeError(f"{self.family_name()} is not judged in batches")

    @classmethod
    def competitor(cls, shared: Mapping[str, Any]) -> Family:
        """The family as a competitor: default settings, and the options common to all competitors (component, ...)."""
        return cls(**{name: value for name, value in shared.items() if name in cls.model_fields})

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Settings that compete, on the rows of a problem."""
        return ()

    def tables(self, documents: Mapping[str, Any], validation: Mapping[str, Any]) -> list[Table]:
        """Tables of the report, from the documents of the fit and `validation.json`."""
        return []

    def grids(self, documents: Mapping[str, Any]) -> list[Grid]:
        """Grids of figures of the report, from the documents of the fit."""
        return []


def held_out(fold: Fold, before: np.ndarray, after: np.ndarray, outside: np.ndarray, used: float = 0.0) -> HeldOut:
    """The test rows of a fold with a value before and after, um; arrays over all rows, (rows,)."""

    from errpipe.fitting.judging import HeldOut, NothingJudged

    rows = np.flatnonzero(fold.test & np.isfinite(before) & np.isfinite(after))
    if rows.size == 0:
        raise NothingJudged(f"hold-out {fold.label}: no judged row has a value in every column that the model reads")
    return HeldOut(fold.label, rows, before[rows], after[rows], outside[rows], used)


def fit_summary(model: ErrorModel) -> dict[str, str]:
    """Component -> rms before and after on the fitted rows."""
    return {
        c.component: f"{c.rms_before:.3g} -> {c.rms_after:.3g} {c.unit} on the fitted rows" for c in model.components
    }
