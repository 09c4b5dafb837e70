"""diagnosis.json, version 1: what differs between recording and simulation, named, located, modelled, proved."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from errpipe.domain.recording import Frozen

Verdict = Literal["no_mismatch", "recalibrate", "missing_physics", "unexplained"]


class FoundParameter(Frozen):
    """One parameter of a finding with its 95 % interval, in `unit`."""

    name: str
    value: float
    unit: str
    ci95: tuple[float, float]


class Where(Frozen):
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


class Rival(Frozen):
    """Another effect in the finding's place, and the log Bayes factor by which it lost."""

    effect: str
    lost_by: float


class Finding(Frozen):
    """An effect that the simulation lacks; `unknown` where no effect carries the structure; or `recalibration`."""

    effect: str
    confidence: float = Field(ge=0, le=1)
    drivers: tuple[str, ...] = ()
    where: Where = Where()
    parameters: tuple[FoundParameter, ...] = ()
    indistinguishable_from: tuple[str, ...] = ()
    would_separate: str = ""
    says: str = ""
    rms_um: float = Field(0.0, description="rms of what the finding contributes to the response.")
    rivals: tuple[Rival, ...] = ()
    compensable: bool = True
    term: dict[str, object] | None = Field(None, description="The term, as an error model declares it.")


class HoldOutFigures(Frozen):
    """rms on rows that neither selected nor fitted anything."""

    scheme: str
    rms_before_um: float
    rms_after_um: float


class Regime(Frozen):
    """A part of the recording and the rms of the mismatch there, before and after."""

    what: str
    rows: int
    rms_before_um: float
    rms_after_um: float


class ResponseDiagnosis(Frozen):
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
    says: str = ""


class Diagnosis(Frozen):
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
