"""Specification of a fit, as written in a pipeline file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from errpipe.domain.recording import FrozenModel
from errpipe.fitting.holdout import HoldOut
from errpipe.terms import TERMS, Term, plain
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    AnyTerm = Term
else:
    AnyTerm = TERMS


class PriorSpec(FrozenModel):
    """Gaussian prior of a parameter with mean `value` and standard deviation `spread`."""

    term: str = Field(description="Id of the term.")
    where: dict[str, Any] = Field(
        {}, description="Fields of the term, as {sensor: T_nut}, where the response has several of this id."
    )
    parameter: str = Field(description="Name of one of its linear parameters.")
    value: float = quantity("of the parameter", "Expected value.")
    spread: float = quantity("of the parameter", "One standard deviation.", gt=0)

    def applies_to(self, term: Term) -> bool:
        """Whether it is this term's parameter that is known."""
        fields = plain(term)
        return self.term == term.term and all(fields.get(key) == value for key, value in self.where.items())


class ComponentSpec(FrozenModel):
    """The terms that one response is fitted with."""

    component: str = Field(description="Response of the recording, such as EXX or E_Z.")
    terms: tuple[AnyTerm, ...] = Field((), description="Terms whose sum is the deviation; none: no compensation.")
    priors: tuple[PriorSpec, ...] = Field((), description="Priors of parameters.")

    @model_validator(mode="after")
    def _each_prior_has_one_term(self) -> ComponentSpec:
        for prior in self.priors:
            terms = [t for t in self.terms if prior.applies_to(t)]
            if len(terms) != 1:
                allowed = ", ".join(dict.fromkeys(t.term for t in self.terms)) or "none"
                hint = "select one by `where`" if terms else f"allowed: {allowed}"
                raise ValueError(f"priors of {self.component}: {len(terms)} terms {prior.term} ({hint})")
            names = [p.name for p in terms[0].linear() if p.name not in terms[0].fixed]
            if prior.parameter not in names:
                allowed = ", ".join(names) or "none"
                raise ValueError(
                    f"priors of {self.component}: no linear parameter {prior.parameter} of {prior.term}"
                    f" (allowed: {allowed})"
                )
        return self


class ModelSpec(FrozenModel):
    """A model to fit: one response or several, what is nuisance, and how to solve."""

    components: tuple[ComponentSpec, ...] = Field(min_length=1, description="Responses and their terms.")
    nuisance: tuple[AnyTerm, ...] = Field((), description="Terms of the measuring set-up: fitted, never compensated.")
    method: Literal["linear", "ridge", "robust"] = Field(
        "linear", description="Least squares; ridge for collinear sensors; robust against outliers."
    )
    loss: Literal["huber", "tukey"] = Field(
        "tukey", description="How the robust method weighs large residuals; huber, too, where runs repeat them."
    )
    datum: Literal["absolute", "run_start"] = Field(
        "absolute", description="Datum of the deviation: the machine's own zero, or each run's first row."
    )
    holdout: HoldOut = Field(HoldOut(), description="Rows held out to size intervals, ridge and selection.")
    selection: Literal["none", "held-out"] = Field(
        "none", description="held-out: backward elimination of terms that do not improve held-out rows."
    )
    most_inflation: float = quantity(
        "1", "Refuse a parameter whose variance the other columns inflate by more than this.", 200.0, gt=1
    )

    also_valid: dict[str, tuple[float, float]] = quantity(
        "of the column",
        "Column -> validity range of an earlier model of this machine: a table does not fade there either.",
        {},
    )

    @model_validator(mode="after")
    def _each_once(self) -> ModelSpec:
        names = [c.component for c in self.components]
        repeated = sorted({n for n in names if names.count(n) > 1})
        if repeated:
            raise ValueError(f"component {repeated[0]} is listed twice")
        for term in self.nuisance:
            if term.compensable:
                allowed = ", ".join(tag for tag in TERMS.tags if not TERMS[tag].compensable)
                raise ValueError(f"{term.term} cannot be nuisance: it is the machine's (allowed: {allowed})")
        return self
