"""Which findings of a diagnosis become terms of the error model, which must not, and why.

Two ways to fit what was accepted:

    whole      a `fit` stage stands before: its terms and the accepted ones together, on the whole deviation
    mismatch   none does: the accepted terms on recorded less simulated; the model then holds what the simulation lacks

What belongs to the measurement (air, drift, clocks) is fitted beside the accepted terms as nuisance, so that it does
not bend them, and is never compensated. Where the simulation's own gain is off, it is fitted too and left out: that is
for whoever owns the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field, TypeAdapter

from errpipe.yamlfile import Options

if TYPE_CHECKING:
    from errpipe.domain.diagnosis import Diagnosis, Finding, ResponseDiagnosis
    from errpipe.domain.error_model import ComponentModel, ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.fitting.spec import ModelSpec
    from errpipe.terms._base import Term

ARTEFACTS = {
    "air_refraction": "it is the air in the beam of the measuring laser, not the machine: correct the reading",
    "sensor_drift": "it is the instrument that drifts, not the machine: correct the reading",
    "clock_offset": "the clocks of recording and simulation differ: set them right",
    "sensor_fault": "a sensor failed while it was recorded: repair it; the machine itself is not at fault",
}
FORCES = "it is a drive force, not a deviation of the tool: for the drive's friction feed-forward, not for a table"
RECALIBRATION = "the simulation itself is to be set right; nothing is missing that a table could hold"
UNKNOWN = "no effect carries it, so nothing says that it will come back"


class Accept(Options):
    """When a finding becomes a term of the error model."""

    confidence: float = Field(0.8, ge=0, le=1, description="Lowest confidence of a finding.")
    despite_artefact: bool = Field(
        False, description="Also where the data cannot tell the finding from an artefact of measuring."
    )


@dataclass(frozen=True)
class Decision:
    """What becomes of one finding. terms: its physics bound to columns; reason: why it is refused, '' where accepted.

    beside: refused, but fitted as nuisance so that it does not bend the accepted terms.
    """

    component: str
    finding: Finding
    terms: tuple[Term, ...] = ()
    reason: str = ""
    beside: bool = False

    @property
    def accepted(self) -> bool:
        """Whether the finding becomes a term."""
        return not self.reason

    def refused(self, reason: str) -> Decision:
        """The same finding, refused; what was refused before keeps its own reason."""
        return self if self.reason else replace(self, reason=reason)

    def plain(self) -> dict[str, Any]:
        """Plain data for `acceptance.json`."""
        told = {"component": self.component, "effect": self.finding.effect, "confidence": self.finding.confidence}
        return told | ({"reason": self.reason} if self.reason else {"says": self.finding.says})


@dataclass(frozen=True)
class Asked:
    """What is fitted. recalibrated: responses whose simulated gain is fitted beside (mismatch only)."""

    spec: ModelSpec
    recalibrated: tuple[str, ...] = field(default=())


def decide(diagnosis: Diagnosis, recording: Recording, accept: Accept) -> list[Decision]:
    """One decision per finding, responses and findings in the diagnosis' order."""
    return [_decide(f, r, recording, accept) for r in diagnosis.responses for f in r.findings]


def _decide(f: Finding, response: ResponseDiagnosis, recording: Recording, accept: Accept) -> Decision:
    refuse = Decision(response.component, f)
    if f.effect in ("recalibration", "unknown"):
        return replace(refuse, reason=RECALIBRATION if f.effect == "recalibration" else UNKNOWN)
    terms = terms_of(f, response.component, recording)
    sure = f.confidence >= accept.confidence
    if any(not t.compensable for t in terms):
        reason = ARTEFACTS.get(f.effect, FORCES if response.unit == "N" else "it is not a deviation of the tool")
        return replace(refuse, terms=terms, reason=reason, beside=sure and f.effect != "clock_offset")
    if not sure:
        return replace(refuse, reason=f"its confidence of {f.confidence:.2f} is below {accept.confidence:.2f}")
    if not terms:
        return replace(refuse, reason="it names no term")
    if f.where.runs:
        return replace(refuse, reason=f"it acted in some runs only ({', '.join(f.where.runs)}): a table acts always")
    artefacts = [other for other in f.indistinguishable_from if other in ARTEFACTS]
    if artefacts and not accept.despite_artefact:
        told = f"; {f.would_separate}" if f.would_separate else ""
        return replace(refuse, reason=f"the data cannot tell it from {artefacts[0]}, which is not the machine's{told}")
    values = {p.name: p.value for p in f.parameters}
    if not f.compensable or any(not t.lower(_complete(t, values)) for t in terms):
        return replace(refuse, reason="a controller cannot compensate it: it has no compiled form")
    return replace(refuse, terms=terms)


def _complete(term: Term, values: dict[str, float]) -> dict[str, float]:
    middle = {p.name: float(np.mean(p.typical)) for p in (*term.linear(), *term.nonlinear())}
    return middle | {name: value for name, value in values.items() if name in middle} | dict(term.fixed)


def terms_of(f: Finding, component: str, recording: Recording) -> tuple[Term, ...]:
    """The terms behind a finding: the one that it states, or one per axis where its parameters speak of several."""
    from errpipe.fitting.spec import AnyTerm

    if f.term is None:
        return ()
    term = TypeAdapter(AnyTerm).validate_python(f.term)
    first = term.linear()[0].name if term.linear() else ""
    if sum(p.name == first for p in f.parameters) < 2:
        return (term,)
    bound = [t for t in type(term).bind(recording, component) if set(t.drivers(recording)) <= set(f.drivers)]
    return tuple(bound) or (term,)


# ---------------------------------------------------------------- what to fit


def ask(decisions: Sequence[Decision], diagnosis: Diagnosis, existing: ModelSpec | None) -> Asked:
    """The specification with every accepted term; with an existing one, its terms too."""
    from errpipe.fitting.spec import ComponentSpec, ModelSpec
    from errpipe.terms import Offset

    components = {c.component: c for c in existing.components} if existing is not None else {}
    for response in diagnosis.responses:
        new = [t for d in decisions if d.accepted and d.component == response.component for t in d.terms]
        old = components.get(response.component)
        if old is None:
            terms = (Offset(), *new) if new else ()
            components[response.component] = ComponentSpec(component=response.component, terms=terms)
        else:
            fresh = [t for t in new if _bare(t) not in map(_bare, old.terms)]
            components[response.component] = old.model_copy(update={"terms": (*old.terms, *fresh)})
    # a nuisance acts on every response that is fitted, so it must be theirs
    fitted = {name for name, c in components.items() if c.terms}
    beside = [t for d in decisions if d.beside and {d.component} == fitted for t in d.terms]
    if existing is not None:
        nuisance = (*existing.nuisance, *(t for t in beside if t not in existing.nuisance))
        return Asked(existing.model_copy(update={"components": tuple(components.values()), "nuisance": nuisance}))
    off = {d.component for d in decisions if d.finding.effect == "recalibration"}
    chosen = tuple(c for name, c in components.items() if name in fitted) or tuple(components.values())
    spec = ModelSpec(components=chosen, nuisance=tuple(beside), method="robust")
    return Asked(spec, tuple(sorted(off & fitted)))


def _bare(term: Term) -> dict[str, Any]:
    return {k: v for k, v in term.model_dump(mode="json").items() if k != "fixed"}


def fit_accepted(
    decisions: list[Decision], diagnosis: Diagnosis, existing: ModelSpec | None, recording: Recording
) -> tuple[ErrorModel, Asked, list[Decision]]:
    """The error model of what was accepted; what the rows cannot tell apart beside the rest is refused after all."""
    from errpipe.errors import NotIdentifiable

    gains = True
    while True:
        asked = ask(decisions, diagnosis, existing)
        asked = asked if gains else replace(asked, recalibrated=())
        try:
            model = fit_whole(recording, asked.spec) if existing is not None else fit_mismatch(recording, asked)
            return model, asked, decisions
        except NotIdentifiable as why:
            if asked.recalibrated:
                gains = False
                continue
            weakest = min((d for d in decisions if d.accepted), key=lambda d: d.finding.confidence, default=None)
            if weakest is None:
                if not any(d.beside for d in decisions):
                    raise
                decisions = [replace(d, beside=False) for d in decisions]
                continue
            told = replace(weakest, reason=f"beside the rest it cannot be told apart: {str(why).splitlines()[0]}")
            decisions = [told if d is weakest else d for d in decisions]


def fit_whole(recording: Recording, spec: ModelSpec) -> ErrorModel:
    """The existing terms and the accepted ones together, on the whole deviation."""
    from errpipe.fitting import model

    return model.fit(recording, spec)


def fit_mismatch(recording: Recording, asked: Asked) -> ErrorModel:
    """The accepted terms on recorded less simulated, the simulation set right first where its gain is off."""
    from errpipe.fitting import model

    every = np.ones(len(recording), dtype=bool)
    left, joint = mismatch(recording, asked, every)
    found = model.fit(left, asked.spec)
    components = tuple(_with_intervals_of(c, joint) for c in found.components)
    note = "deviations are what a simulation leaves out: recorded less simulated"
    return found.model_copy(update={"components": components, "notes": (*found.notes, note)})


def mismatch(recording: Recording, asked: Asked, rows: np.ndarray) -> tuple[Recording, ErrorModel | None]:
    """The recording with recorded less simulated as its responses; simulated gains as the rows of a mask say.

    Also the model that was fitted together with these gains, where there are any. Raises DataError without twins.
    """
    from errpipe.errors import DataError
    from errpipe.fitting.components import solved

    twins = {}
    for component in (c.component for c in asked.spec.components):
        error, twin = (recording.name(role, component=component) for role in ("error", "simulated"))
        if error is None or twin is None:
            raise DataError(f"{component}: recorded and simulated values are needed, and one of them is missing")
        twins[component] = (error, twin)
    left = recording.with_columns({e: recording.array(e) - recording.array(s) for e, s in twins.values()}, {})
    if not asked.recalibrated:
        return left, None
    joint = solved(left, asked.spec.model_copy(update={"components": tuple(
        c.model_copy(update={"terms": (*c.terms, _gain(twins[c.component][1]))})
        for c in asked.spec.components if c.component in asked.recalibrated
    )}), rows)  # fmt: skip
    off = {c.component: c.terms[-1].parameters[0].value for c in joint.components}
    right = {
        error: left.array(error) - off[component] * recording.array(twin)
        for component, (error, twin) in twins.items()
        if component in off
    }
    return left.with_columns(right, {}), joint


def _gain(column: str) -> Term:
    from errpipe.terms import ProfileDriver

    return ProfileDriver.model_validate({"term": "profile_driver", "driver": [{"input": column, "unit": ""}]})


def _with_intervals_of(component: ComponentModel, joint: ErrorModel | None) -> ComponentModel:
    """The component with the intervals of the fit that left the simulation's gain open too."""
    own = [c for c in joint.components if c.component == component.component] if joint is not None else []
    if not own:
        return component
    kept = len(component.parameter_names)
    return component.model_copy(
        update={"terms": own[0].terms[:-1], "covariance": tuple(row[:kept] for row in own[0].covariance[:kept])}
    )
