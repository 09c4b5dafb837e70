"""Which findings of a diagnosis become terms of the error model, which must not, and why.

Two ways to fit what was accepted:

    whole      a `fit` stage precedes: its terms and the accepted ones together, on the whole deviation
    mismatch   none does: the accepted terms on recorded less simulated, the simulation being used unchanged

Errors of the measurement (air, drift) are fitted together with the accepted terms as nuisance, so that it does not bias
them, and is never compensated. A simulation whose own gains are off biases them too: where its values are plainly the
sum of a few terms, these terms join the mismatch, and the table contains the errors of their gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from errpipe.errors import NotIdentifiable
from errpipe.yamlfile import Options, quantity

if TYPE_CHECKING:
    from errpipe.domain.diagnosis import Diagnosis, Finding, ResponseDiagnosis
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.fitting.spec import ModelSpec
    from errpipe.terms import Term

FORCES = "it is a drive force, not a deviation of the tool: for the drive's friction feed-forward, not for a table"
RECALIBRATION = "the simulation itself must be recalibrated: a table, as a plain sum of terms, cannot represent that"
REFITTED_NOTE = "the terms of the previous model are refitted together with the accepted findings"
UNKNOWN = "no known effect explains it, so it need not recur"


class Accept(Options):
    """When a finding becomes a term of the error model."""

    confidence: float = quantity(
        "1",
        "Lowest confidence of a finding, or of it and those the data cannot distinguish it from together.",
        0.8,
        ge=0,
        le=1,
    )
    despite_artefact: bool = Field(
        False, description="Also where the data cannot distinguish the finding from an artefact of measuring."
    )


@dataclass(frozen=True)
class Decision:
    """What becomes of one finding. terms: its physics bound to columns; reason: why it is refused, '' where accepted.

    as_nuisance: refused, and fitted as nuisance so that it does not bias the accepted terms.
    """

    component: str
    finding: Finding
    terms: tuple[Term, ...] = ()
    reason: str = ""
    as_nuisance: bool = False

    @property
    def accepted(self) -> bool:
        """Whether the finding becomes a term."""
        return not self.reason

    @property
    def of_simulation(self) -> bool:
        """Whether it is the simulation's own gains that are off."""
        return self.finding.effect == "recalibration"

    def refused(self, reason: str) -> Decision:
        """The same finding, refused; what was refused before keeps its own reason."""
        return self if self.reason else replace(self, reason=reason)

    def plain(self) -> dict[str, Any]:
        """Plain data for `acceptance.json`."""
        document = {"component": self.component, "effect": self.finding.effect, "confidence": self.finding.confidence}
        return document | ({"reason": self.reason} if self.reason else {"says": self.finding.says})


def decide(diagnosis: Diagnosis, recording: Recording, accept: Accept, whole: bool = False) -> list[Decision]:
    """One decision per finding, responses and findings in the diagnosis' order. whole: a model precedes."""
    made = []
    for response in diagnosis.responses:
        decided = [_decide(f, response, accept) for f in response.findings]
        named = any(d.accepted and not d.of_simulation for d in decided)
        made += [_recalibration(d, recording, whole, named) if d.of_simulation else d for d in decided]
    return made


def _recalibration(d: Decision, recording: Recording, whole: bool, named: bool) -> Decision:
    """The simulation's own gains: terms of the mismatch where they are plain; alone they are for the simulation."""
    if whole:
        return replace(d, reason=REFITTED_NOTE)
    if d.reason:
        return d
    terms = parts(recording, d.component) if named else ()
    return replace(d, terms=terms, reason="" if terms else RECALIBRATION)


def _decide(f: Finding, response: ResponseDiagnosis, accept: Accept) -> Decision:
    decision = Decision(response.component, f)
    if f.effect == "unknown":
        return decision.refused(UNKNOWN)
    confident = f.group_confidence() >= accept.confidence
    holdout = response.holdout
    worse = holdout.rms_after_um >= holdout.rms_before_um
    if f.effect == "recalibration":
        return decision if confident and not worse else decision.refused(RECALIBRATION)
    from errpipe.diagnosis.applied import terms_of
    from errpipe.terms import TERMS

    terms = terms_of(f)
    artefacts = {kind.reports_as: kind.artefact for kind in TERMS if kind.artefact}  # not the machine's fault
    if f.effect in artefacts or any(not t.compensable for t in terms):
        reason = artefacts.get(f.effect, FORCES if response.unit == "N" else "it is not a deviation of the tool")
        as_nuisance = confident and bool(terms) and all(t.nuisance for t in terms)
        return replace(decision, terms=terms, reason=reason, as_nuisance=as_nuisance)
    if not confident:
        return decision.refused(f"its confidence of {f.group_confidence():.2f} is below {accept.confidence:.2f}")
    if worse:
        detail = f"{holdout.rms_before_um:.3g} -> {holdout.rms_after_um:.3g} {response.unit}"
        return decision.refused(f"held-out rows are no better explained with it ({detail})")
    if not terms:
        return decision.refused("it names no term")
    if f.where.runs:
        return decision.refused(f"it acted in some runs only ({', '.join(f.where.runs)}): a table acts always")
    similar_artefacts = [other for other in f.indistinguishable_from if other in artefacts]
    if similar_artefacts and not accept.despite_artefact:
        detail = f"; {f.would_separate}" if f.would_separate else ""
        return decision.refused(
            f"cannot be distinguished from {similar_artefacts[0]}, which is not the machine's{detail}"
        )
    values = {p.name: p.value for p in f.parameters}
    if not f.compensable or any(not t.lower(_complete(t, values)) for t in terms):
        return decision.refused("a controller cannot compensate it: it has no compiled form")
    return replace(decision, terms=terms)


def _complete(term: Term, values: dict[str, float]) -> dict[str, float]:
    middle = {p.name: float(np.mean(p.typical)) for p in (*term.linear(), *term.nonlinear())}
    return middle | {name: value for name, value in values.items() if name in middle} | dict(term.fixed)


PLAIN = 1e-4  # share of a simulated signal's variance that its plain parts may leave (a simulation has no noise)
MAX_PARTS = 3  # terms that a simulated signal may be the sum of


def parts(recording: Recording, component: str) -> tuple[Term, ...]:
    """The terms without inner parameters whose sum a simulated signal is, or () where it is no such sum."""
    from errpipe.terms import TERMS

    twin = recording.name("simulated", component=component)
    if twin is None:
        return ()
    simulated = recording.array(twin)
    bound = [t for kind in TERMS if kind.reports_as and kind.compensable for t in kind.bind(recording, component)]
    bound = [t for t in bound if not t.nonlinear()]
    columns = [(t, t.basis(recording)) for t in bound]
    known = np.isfinite(simulated)
    columns = [(t, c) for t, c in columns if np.isfinite(c[known]).mean() > 0.9]
    chosen: list[Term] = []
    design = np.ones((simulated.size, 1))
    while len(chosen) < MAX_PARTS and columns:
        unexplained = [(_unexplained_share(np.hstack([design, c]), simulated), k) for k, (_, c) in enumerate(columns)]
        lowest, k = min(unexplained)
        term, column = columns.pop(k)
        chosen.append(term)
        design = np.hstack([design, column])
        if lowest < PLAIN:
            return tuple(chosen)
    return ()


def _unexplained_share(design: np.ndarray, values: np.ndarray) -> float:
    """Share of the variance that a least-squares fit of the columns leaves unexplained."""
    rows = np.isfinite(values) & np.isfinite(design).all(axis=1)
    if rows.sum() <= design.shape[1] + 1 or np.var(values[rows]) == 0:
        return 1.0
    fitted = design[rows] @ np.linalg.lstsq(design[rows], values[rows], rcond=None)[0]
    return float(np.var(values[rows] - fitted) / np.var(values[rows]))


# ---------------------------------------------------------------- what to fit


def specification_with(decisions: Sequence[Decision], diagnosis: Diagnosis, existing: ModelSpec | None) -> ModelSpec:
    """The specification with every accepted term; with an existing one, its terms too."""
    from errpipe.fitting.spec import ComponentSpec, ModelSpec
    from errpipe.terms.offset import Offset

    components = {c.component: c for c in existing.components} if existing is not None else {}
    for response in diagnosis.responses:
        old = components.get(response.component)
        terms = list(old.terms) if old is not None else []
        new = [t for d in decisions if d.accepted and d.component == response.component for t in d.terms]
        terms += [Offset()] if old is None and new else []
        for term in new:
            if _without_fixed(term) not in map(_without_fixed, terms):
                terms.append(term)
        spec = old or ComponentSpec(component=response.component)
        components[response.component] = spec.model_copy(update={"terms": tuple(terms)})
    # a nuisance term is fitted to every response, so it must have been named in each of them
    fitted = {name for name, c in components.items() if c.terms}
    nuisance_terms = [t for d in decisions if d.as_nuisance and {d.component} == fitted for t in d.terms]
    if existing is not None:
        nuisance = (*existing.nuisance, *(t for t in nuisance_terms if t not in existing.nuisance))
        return existing.model_copy(update={"components": tuple(components.values()), "nuisance": nuisance})
    chosen = tuple(c for name, c in components.items() if name in fitted) or tuple(components.values())
    return ModelSpec(components=chosen, nuisance=tuple(nuisance_terms), method="robust")


def _without_fixed(term: Term) -> dict[str, Any]:
    return {k: v for k, v in term.model_dump(mode="json").items() if k != "fixed"}


def fit_accepted(
    decisions: list[Decision], diagnosis: Diagnosis, existing: ModelSpec | None, recording: Recording
) -> tuple[ErrorModel, ModelSpec, list[Decision]]:
    """Fit the accepted findings; one that is not identifiable together with the others is refused.

    Raises NotIdentifiable if the model before can already not be fitted, DataError without twins.
    """
    from errpipe.fitting import model
    from errpipe.models.terms import mismatch

    while True:
        spec = specification_with(decisions, diagnosis, existing)
        source = recording if existing is not None else mismatch(recording, spec)
        try:
            fitted = model.fit(source, spec)
        except NotIdentifiable as why:
            decisions = _with_one_refused(decisions, why)
            continue
        if existing is None:
            note = "deviations are what a simulation leaves out: recorded less simulated, as it stands"
            fitted = fitted.model_copy(update={"notes": (*fitted.notes, note)})
        return fitted, spec, decisions


def _with_one_refused(decisions: list[Decision], why: Exception) -> list[Decision]:
    """Refuse one of them: the simulation's own gains first, then the least confident finding, then the nuisance."""
    accepted = [d for d in decisions if d.accepted]
    if accepted:
        lowest = min(accepted, key=lambda d: (not d.of_simulation, d.finding.confidence))
        reason = f"it cannot be distinguished from the other accepted terms: {str(why).splitlines()[0]}"
        return [d.refused(reason) if d is lowest else d for d in decisions]
    if any(d.as_nuisance for d in decisions):
        return [replace(d, as_nuisance=False) for d in decisions]
    raise why
