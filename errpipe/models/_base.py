"""What a model family is: options, a fit, its refit on the rows of a fold, and what a report shows of it.

A family is a pydantic model of its options. The stage `fit` reads them from the pipeline file (`family: NAME`
chooses one), writes them beside the error model, and validation reads them back to repeat the fit without a held-out
group. Every family gives an error model, so one compiler lowers all of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from errpipe.domain.recording import Frozen

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.fitting import history
    from errpipe.fitting.batches import Source
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem

Progress = Callable[[float, str], None]


def no_progress(share: float, text: str) -> None:
    """Progress callback that does nothing."""


class Table(NamedTuple):
    """A table for the report: heading, names of the columns, rows, and a sentence below it."""

    heading: str
    columns: list[str]
    rows: list[list[Any]]
    caption: str


class Grid(NamedTuple):
    """Figures of rows by columns for the report, the first row without compensation.

    values: None is a dash. remarks: a remark behind each row. best: name of the row that is used.
    """

    heading: str
    columns: list[str]
    rows: list[str]
    values: list[list[float | None]]
    remarks: list[str]
    best: str
    caption: str


@dataclass(frozen=True)
class Judged:
    """Folds of a recording read batch by batch. scheme: short form of the hold-out; by component: folds; rows of the
    sample with the row of the recording each is, (rows,); largest deviation before and after of each fold, (folds, 2).
    """

    scheme: str
    folds: Mapping[str, list[history.Fold]]
    sample: Mapping[str, tuple[Recording, np.ndarray]]
    worst: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Fitted:
    """model: what was fitted; documents: further JSON files by name; summary: a few words per component."""

    model: ErrorModel
    documents: Mapping[str, Any] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)


class Family(Frozen, ABC):
    """Base of every model family; the fields of a subclass are its options, `family` is its name.

    documents: names of the JSON files that its fit adds. seasonal: whether `train` gives a predictor of the deviation
    since the start of each run. competes: whether it has entrants for a competition of thermal families.
    nonlinear: whether it is fitted to curved relations, which one run does not prove for another. default_scheme: of
    the hold-out. solved_by: how it is solved, where its name does not show it.
    """

    documents: ClassVar[tuple[str, ...]] = ()
    seasonal: ClassVar[bool] = False
    competes: ClassVar[bool] = False
    nonlinear: ClassVar[bool] = False
    default_scheme: ClassVar[str] = "auto"
    solved_by: ClassVar[str] = ""

    @classmethod
    def family_name(cls) -> str:
        """The family's name in pipeline files."""
        return str(cls.model_fields["family"].default)

    @property
    def responses(self) -> tuple[str, ...]:
        """Components that it models: its `component` or `components`."""
        own: Any = self
        return (own.component,) if "component" in type(self).model_fields else own.components

    @property
    def scheme(self) -> HoldOut:
        """Hold-out scheme by default."""
        from errpipe.fitting.holdout import HoldOut

        return HoldOut.model_validate({"scheme": self.default_scheme})

    @property
    def method_name(self) -> str:
        """How it is solved, for `validation.json`."""
        return self.solved_by or self.family_name().replace("_", " ")

    def missing_input(self, recording: Recording) -> str:
        """What columns the family needs of a recording (its header is enough) and does not find, in words; or ''."""
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
    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """Fit on the training rows of a fold, judge on its test rows; component -> held-out residuals."""

    def in_batches(self, source: Source) -> bool:
        """Whether a recording is too long to be fitted whole. Raises DataError where it is and cannot be otherwise."""
        return False

    def fit_batches(self, source: Source) -> Fitted:
        """`fit` of a recording that is read batch by batch."""
        raise TypeError(f"{self.family_name()} is not fitted in batches")

    def judge_batches(self, source: Source, scheme: HoldOut | None) -> Judged:
        """Every fold of a recording that is read batch by batch; without a scheme, the family's own."""
        raise TypeError(f"{self.family_name()} is not judged in batches")

    @classmethod
    def competitor(cls, shared: Mapping[str, Any]) -> Family:
        """The family as it competes: default settings, and what all competitors share by name (component, ...)."""
        return cls(**{name: value for name, value in shared.items() if name in cls.model_fields})

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Settings that compete, on the rows of a problem."""
        return ()

    def tables(self, documents: Mapping[str, Any], validation: Mapping[str, Any]) -> list[Table]:
        """What the report adds, from the documents of the fit and `validation.json`."""
        return []

    def grids(self, documents: Mapping[str, Any]) -> list[Grid]:
        """What the report draws as a grid of figures, from the documents of the fit."""
        return []


def held_out(fold: Fold, before: np.ndarray, after: np.ndarray, outside: np.ndarray, used: float = 0.0) -> HeldOut:
    """The judged rows of a fold that have a value before and after, um; arrays over all rows, (rows,)."""

    from errpipe.fitting.judging import HeldOut, NothingJudged

    rows = np.flatnonzero(fold.test & np.isfinite(before) & np.isfinite(after))
    if rows.size == 0:
        raise NothingJudged(f"hold-out {fold.label}: no judged row has a value in every column that the model reads")
    return HeldOut(fold.label, rows, before[rows], after[rows], outside[rows], used)


def fit_summary(model: ErrorModel) -> dict[str, str]:
    """Component -> rms before and after on the rows that fitted."""
    return {
        c.component: f"{c.rms_before:.3g} -> {c.rms_after:.3g} {c.unit} on the rows that fitted"
        for c in model.components
    }
