"""A fitted error model: terms with parameters, intervals, covariance, and where it may be used.

Terms are kept as the plain data they were declared with (`{"term": "backlash", "axis": "X"}`): this
layer names physics, it does not know any.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

from pydantic import Field, field_validator

from errpipe import __version__
from errpipe.domain.recording import FrozenModel, Manifest
from errpipe.errors import DataError, UsageError
from errpipe.yamlfile import quantity


class FittedParameter(FrozenModel):
    """One parameter: value, standard error and 95 % interval, all in `unit`."""

    name: str = Field(description="Name of the parameter, as the term has it.")
    value: float = quantity("of the parameter", "Estimate.")
    unit: str = Field(description="Unit of value, error and interval.")
    standard_error: float | None = quantity("of the parameter", "Standard error; none: not known.", None)
    ci95: tuple[float, float] | None = quantity("of the parameter", "Ends of the 95 % interval.", None)
    note: str = Field("", description="What should be known about the estimate.")


class FittedTerm(FrozenModel):
    """A term as declared, and its parameters: the linear ones first, in the term's order, then the non-linear."""

    term: dict[str, Any] = Field(description="The term as declared.")
    parameters: tuple[FittedParameter, ...] = Field(description="Its parameters.")

    @field_validator("term")
    @classmethod
    def _named(cls, term: dict[str, Any]) -> dict[str, Any]:
        if not isinstance(term.get("term"), str):
            raise ValueError("a declared term has its name under `term`")
        return term

    def values(self) -> dict[str, float]:
        """Parameter name -> value; asking for one that the model does not hold raises DataError."""
        return _Values(self.term.get("term", "?"), {p.name: p.value for p in self.parameters})


class _Values(dict[str, float]):
    """Values of the parameters of one term."""

    def __init__(self, term: str, values: dict[str, float]) -> None:
        super().__init__(values)
        self.term = term

    def __missing__(self, name: str) -> float:
        raise DataError(f"term {self.term}: the model has no parameter {name} (it has: {', '.join(self) or 'none'})")


class DatumReadings(FrozenModel):
    """How readings of the deviation now and then correct a component: by an input `datum_<component>` of the table.

    The input is the last reading minus the model's prediction at that time.
    """

    share: float = quantity("1", "Share of that difference that is applied.", ge=0, le=1)
    hold_s: float = quantity("s", "An older reading counts as none.", gt=0)
    bound: float = quantity("of the deviation", "A reading further from the prediction is rejected.", gt=0)


class ComponentModel(FrozenModel):
    """The model of one response: deviation = gain times the sum of its terms."""

    component: str = Field(description="The response, such as EXX or E_Z.")
    unit: str = Field("um", description="Unit of the deviation.")
    terms: tuple[FittedTerm, ...] = Field(description="Terms whose sum is the deviation.")
    nuisance: tuple[FittedTerm, ...] = Field((), description="Terms of the measuring set-up, never compensated.")
    parameter_names: tuple[str, ...] = Field((), description="Names of the covariance's rows and columns.")
    covariance: tuple[tuple[float, ...], ...] = quantity(
        "of the row's times the column's parameter", "Covariance of the parameters.", ()
    )
    rows: int = Field(0, description="Rows of the fit.")
    rows_effective: float = quantity("1", "What those rows are worth: neighbours in time repeat each other.", 0.0)
    rms_before: float = quantity("of the deviation", "RMS deviation, uncompensated.", 0.0)
    rms_after: float = quantity("of the deviation", "RMS of what the model leaves.", 0.0)
    noise_floor: float | None = quantity("of the deviation", "RMS of what no model of these columns can explain.", None)
    gain: float = quantity(
        "1", "Share of the sum of the terms that is applied: what held-out runs were best with.", 1.0, ge=0.0, le=1.0
    )
    half_width90: float | None = quantity(
        "of the deviation", "Half width of the 90 % prediction interval inside validity.", None
    )
    widening90: float = quantity(
        "of the deviation per unit of distance", "Added half width per unit of distance outside what was seen.", 0.0
    )
    growth90: float = quantity(
        "1 per unit of the deviation", "By which share the half width grows per unit of predicted magnitude.", 0.0
    )
    factor90: dict[str, Any] | None = Field(
        None, description="Driver that the half width is multiplied by, as declared; none: 1."
    )
    limit: float | None = quantity("of the deviation", "No prediction beyond this magnitude.", None)
    readings: DatumReadings | None = Field(None, description="How readings correct it; none: they do not.")

    @property
    def datum_input(self) -> str:
        """Name of the table's input for readings."""
        return f"datum_{self.component}"


class Validity(FrozenModel):
    """The range covered by the fitted rows: column -> (lowest, highest); `margin` -> the fade outside it."""

    ranges: dict[str, tuple[float, float]] = Field(
        {}, description="Column -> lowest and highest value it holds for.", json_schema_extra={"unit": "of the column"}
    )
    seen: dict[str, tuple[float, float]] = Field(
        {},
        description="Column -> lowest and highest value seen, where an earlier model's range is wider.",
        json_schema_extra={"unit": "of the column"},
    )
    margins: dict[str, float] = Field(
        {}, description="Column -> distance outside over which it fades.", json_schema_extra={"unit": "of the column"}
    )
    fades: bool = Field(
        True, description="Whether a table fades outside the box; not where the drivers fade by themselves."
    )


class ErrorModel(FrozenModel):
    """Format version 1 of `error_model.json`."""

    error_model: Literal[1] = 1
    machine: str = Field("", description="Machine it is of.")
    title: str = Field("", description="What it is, for people.")
    version: str = Field("", description="errpipe version that fitted it.")
    inputs: dict[str, str] = Field({}, description="Artefact read by the fit -> its fingerprint.")
    columns: dict[str, dict[str, Any]] = Field({}, description="Manifest entry of every column a term reads.")
    constants: dict[str, dict[str, Any]] = Field({}, description="Constants of the recording's manifest.")
    components: tuple[ComponentModel, ...] = Field(description="One model per response.")
    validity: Validity = Field(Validity(), description="The box of what the fit has seen.")
    datum: Literal["absolute", "run_start"] = Field(
        "absolute", description="What zero means: the machine's own zero, or each run's first readings."
    )
    notes: tuple[str, ...] = Field((), description="What a user should know.")

    @classmethod
    def of(
        cls, manifest: Manifest, columns: Iterable[str], constants: Iterable[str] = (), **further: Any
    ) -> ErrorModel:
        """With machine, title, some columns and some constants from the manifest of the fitted recording."""
        given = ((manifest.columns, columns), (manifest.constants, constants))
        entries = [{n: known[n].model_dump(mode="json", exclude_none=True) for n in names} for known, names in given]
        facts = {"machine": manifest.machine, "title": manifest.title, "columns": entries[0], "constants": entries[1]}
        return cls(version=__version__, **(facts | further))


def joined(models: Sequence[ErrorModel]) -> ErrorModel:
    """One model of the components of several fits of one machine, valid where all of them are.

    Raises UsageError if several have a component, DataError where they do not agree on what all have in common.
    """
    first, *others = models
    if not others:
        return first
    names = [c.component for m in models for c in m.components]
    if twice := sorted({n for n in names if names.count(n) > 1}):
        raise UsageError(f"several fits have {', '.join(twice)}: name the one that counts, from: {{error_model: NAME}}")
    columns = {name: entry for m in models for name, entry in m.columns.items()}
    constants = {name: entry for m in models for name, entry in m.constants.items()}  # a model has those of its axes
    validity = _common([m.validity for m in models])
    for other in others:
        agree = {
            "machine": other.machine == first.machine,
            "zero": other.datum == first.datum,
            "columns": all(columns[name] == entry for m in models for name, entry in m.columns.items()),
            "constants": all(constants[name] == entry for m in models for name, entry in m.constants.items()),
            "fading": other.validity.fades == first.validity.fades,
            "validity": all(low <= high for low, high in validity.ranges.values()),
        }
        if differ := [what for what, same in agree.items() if not same]:
            of = " and ".join(c.component for m in (first, other) for c in m.components)
            raise DataError(f"models of {of} differ in {', '.join(differ)}: no common table; export each by itself")
    return first.model_copy(
        update={
            "inputs": {f"{what} of {m.components[0].component}": f for m in models for what, f in m.inputs.items()},
            "columns": columns,
            "constants": constants,
            "components": tuple(c for m in models for c in m.components),
            "validity": validity,
            "notes": tuple(f"{m.components[0].component}: {note}" for m in models for note in m.notes),
        }
    )


def _common(boxes: Sequence[Validity]) -> Validity:
    """The intersection of boxes; empty (lowest above highest) if there is none."""
    ranges: dict[str, tuple[float, float]] = {}
    seen: dict[str, tuple[float, float]] = {}
    margins: dict[str, float] = {}
    for box in boxes:
        for name, (low, high) in box.seen.items():
            own = seen.get(name, (low, high))
            seen[name] = (max(low, own[0]), min(high, own[1]))
        for name, (low, high) in box.ranges.items():
            own = ranges.get(name, (low, high))
            ranges[name] = (max(low, own[0]), min(high, own[1]))
        for name, margin in box.margins.items():
            margins[name] = min(margin, margins.get(name, margin))
    return boxes[0].model_copy(update={"ranges": ranges, "seen": seen, "margins": margins})
