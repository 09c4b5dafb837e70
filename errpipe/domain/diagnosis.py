"""diagnosis.json, version 1: what differs between recording and simulation, named, located, modelled, proved."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from errpipe.domain.driver import Driver
from errpipe.domain.recording import FrozenModel

Verdict = Literal["no_mismatch", "recalibrate", "missing_physics", "unexplained"]


class FoundParameter(FrozenModel):
    """One parameter of a finding with its 95 % interval, in `unit`."""

    name: str
    value: float
    unit: str
    ci95: tuple[float, float]


class Extent(FrozenModel):
    """What limits an effect: runs, and ranges of columns; empty where it acts everywhere."""

    runs: tuple[str, ...] = ()
    ranges: dict[str, tuple[float, float]] = {}

    def plain(self) -> dict[str, object]:
        """Only what limits."""
        out: dict[str, object] = {}
        if self.runs:
            out["runs"] = list(self.runs)
        if self.ranges:
            out["ranges"] = {k: list(v) for k, v in self.ranges.items()}
        return out


class Rival(FrozenModel):
    """Another effect in the finding's place, and the log Bayes factor by which it lost."""

    CLOSE: ClassVar[float] = 4.0  # below it the data cannot distinguish the two (Kass, Raftery: 3 to 5 is strong)
    effect: str
    lost_by: float


class EmpiricalTerm(FrozenModel):
    """One column of an empirical equation, in words, and its coefficient."""

    column: str
    coefficient: float
    unit: str
    ci95: tuple[float, float]
    rms_um: float = Field(description="rms of what it contributes.")
    driver: Driver | None = Field(
        None, description="The column as operations on recorded columns; missing in older files."
    )


class Empirical(FrozenModel):
    """An equation without a mechanism: the sum of its terms and a constant, in `unit`."""

    terms: tuple[EmpiricalTerm, ...]
    constant: float
    unit: str
    share: float = Field(description="Share of the held-out variance that it predicts.")
    p: float = Field(description="Share of surrogates that are predicted as well.")
    scheme: str
    says: str

    def drivers(self) -> tuple[Driver, ...]:
        """The columns of its terms; empty if it was read from an older file."""
        return tuple(t.driver for t in self.terms if t.driver is not None)


class Finding(FrozenModel):
    """An effect that the simulation lacks; `unknown` if no effect explains the structure; or `recalibration`."""

    effect: str
    confidence: float = Field(ge=0, le=1)
    drivers: tuple[str, ...] = ()
    where: Extent = Extent()
    parameters: tuple[FoundParameter, ...] = ()
    indistinguishable_from: tuple[str, ...] = ()
    confidence_of_class: float | None = Field(
        None, ge=0, le=1, description="Chance that it is this effect or one of those it cannot be distinguished from."
    )
    would_separate: str = ""
    says: str = ""
    rms_um: float = Field(0.0, description="rms of what the finding contributes to the response.")
    rivals: tuple[Rival, ...] = ()
    compensable: bool = True
    term: dict[str, object] | None = Field(None, description="The term, as an error model declares it.")
    more_terms: tuple[dict[str, object], ...] = Field(
        (), description="Further terms of the same finding: an effect on two axes is one term for each."
    )
    empirical: Empirical | None = Field(None, description="Of `unknown`: the equation that predicts held-out rows.")
    p_search: float | None = Field(
        None, description="Share of surrogates without this effect in which the whole search gains as much."
    )

    def group_confidence(self) -> float:
        """Confidence in the effect together with those that the data cannot distinguish it from."""
        return max(self.confidence, self.confidence_of_class or 0.0)

    def all_terms(self) -> tuple[dict[str, object], ...]:
        """Every term of the finding, as an error model declares them."""
        return (() if self.term is None else (self.term,)) + self.more_terms


class HoldOutFigures(FrozenModel):
    """rms on rows that neither selected nor fitted anything."""

    scheme: str
    rms_before_um: float
    rms_after_um: float


class Regime(FrozenModel):
    """A part of the recording and the rms of the mismatch there, before and after."""

    what: str
    rows: int
    rms_before_um: float
    rms_after_um: float
    share: float | None = Field(
        None, description="Share of the mismatch's energy beyond the noise that lies in this part (recalibrated)."
    )


class ChangePoint(FrozenModel):
    """Where the mismatch, datum and gains set right, changes its level or size for good. `at`: value of `column`."""

    column: str
    at: float
    what: Literal["level", "size"]
    before_um: float
    after_um: float


class WhitenessTest(FrozenModel):
    """Test whether the residual correlates with an input. statistic: F with `dof` columns, or Ljung-Box's Q."""

    against: str
    how: str
    statistic: float
    dof: int
    p: float


class Whiteness(FrozenModel):
    """All tests of the residual of the best explanation; p: adjusted for all; slow_share: of the noise, estimated."""

    p: float
    slow_share: float
    tests: tuple[WhitenessTest, ...]
    says: str


class Significance(FrozenModel):
    """The search's best gain, and that on surrogates without an effect. gain, limit95: log Bayes factors."""

    p: float
    gain: float
    limit95: float
    scheme: str
    effective_rows: float
    rows: int


class ResponseDiagnosis(FrozenModel):
    """One response. Fields ending in `_um` are in `unit` where that is not um."""

    component: str
    unit: str = "um"
    verdict: Verdict
    rms_before_um: float
    rms_after_um: float
    noise_floor_um: float
    holdout: HoldOutFigures
    findings: tuple[Finding, ...] = ()
    regimes: tuple[Regime, ...] = ()
    changes: tuple[ChangePoint, ...] = ()
    between_runs: float | None = Field(
        None, description="Share of the mismatch's energy beyond the noise that is one offset per run (recalibrated)."
    )
    whiteness: Whiteness | None = None
    significance: Significance | None = None
    says: str = ""


class Diagnosis(FrozenModel):
    """The whole document."""

    diagnosis: Literal[1] = 1
    recording: str = ""
    responses: tuple[ResponseDiagnosis, ...]
    notes: tuple[str, ...] = ()

    def document(self) -> dict[str, object]:
        """Plain data for diagnosis.json: limits of `where` only where there are any."""
        out = self.model_dump(mode="json")
        for response, plain in zip(self.responses, out["responses"], strict=True):
            for finding, entry in zip(response.findings, plain["findings"], strict=True):
                entry["where"] = finding.where.plain()
        return out
