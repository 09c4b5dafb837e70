"""A fitted error model: terms with parameters, intervals, covariance, and where it may be used.

Terms are kept as the plain data they were declared with (`{"term": "backlash", "axis": "X"}`): this
layer names physics, it does not know any.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from errpipe.domain.recording import Frozen


class FittedParameter(Frozen):
    """One parameter: value, standard error and 95 % interval, all in `unit`."""

    name: str
    value: float
    unit: str
    standard_error: float | None = None
    ci95: tuple[float, float] | None = None
    note: str = ""


class FittedTerm(Frozen):
    """A term as declared, and its parameters: the linear ones first, in the term's order, then the non-linear."""

    term: dict[str, Any]
    parameters: tuple[FittedParameter, ...]

    def values(self) -> dict[str, float]:
        """Parameter name -> value."""
        return {p.name: p.value for p in self.parameters}


class ComponentModel(Frozen):
    """The model of one response: deviation = sum of its terms."""

    component: str
    unit: str = "um"
    terms: tuple[FittedTerm, ...]
    nuisance: tuple[FittedTerm, ...] = ()
    parameter_names: tuple[str, ...] = ()
    covariance: tuple[tuple[float, ...], ...] = ()
    rows: int = 0
    rows_effective: float = 0.0
    rms_before: float = 0.0
    rms_after: float = 0.0
    noise_floor: float | None = None
    half_width90: float | None = Field(None, description="Half width of the 90 % prediction interval inside validity.")
    widening90: float = Field(0.0, description="Added half width per unit of distance outside what was seen.")
    limit: float | None = Field(None, description="No prediction beyond this magnitude.")


class Validity(Frozen):
    """The box of what the fit has seen: column -> (lowest, highest); `margin` -> the fade outside it."""

    ranges: dict[str, tuple[float, float]] = {}
    margins: dict[str, float] = {}


class ErrorModel(Frozen):
    """Format version 1 of `error_model.json`."""

    error_model: Literal[1] = 1
    machine: str = ""
    title: str = ""
    version: str = ""
    inputs: dict[str, str] = Field({}, description="Artefact read by the fit -> its fingerprint.")
    columns: dict[str, dict[str, Any]] = Field({}, description="Manifest entry of every column a term reads.")
    constants: dict[str, dict[str, Any]] = {}
    components: tuple[ComponentModel, ...]
    validity: Validity = Validity()
    datum: Literal["absolute", "run_start"] = Field(
        "absolute", description="What zero means: the machine's own zero, or each run's first readings."
    )
    notes: tuple[str, ...] = ()
