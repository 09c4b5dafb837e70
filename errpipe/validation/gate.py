"""Gate of an export: the components that improve held-out runs, at the validated gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from errpipe.domain.error_model import ComponentModel, ErrorModel
from errpipe.errors import GateError
from errpipe.fitting.holdout import HALVES

FEWEST_GROUPS = 3  # held out, of which a single one that is worse stands out (by judgement)
TIE = 1e-6  # of the rms: no compensation at all is not worse than none


@dataclass(frozen=True)
class GatedModel:
    """model: components with the validated gain; left_out: those without one; judged: figures for the report."""

    model: ErrorModel
    left_out: tuple[str, ...]
    judged: tuple[dict[str, Any], ...]


def pass_gate(model: ErrorModel, validations: Sequence[Mapping[str, Any]]) -> GatedModel:
    """The part of a model that is better than no compensation in every validation, each component at its smallest gain.

    validations: documents of `validation.json` of this model. No compensation wins ties. Raises GateError if no
    validation covers the model, or if no component remains.
    """
    if not validations:
        raise not_validated(model)
    kept, left_out, judged = [], [], []
    for component in model.components:
        figures = [c for v in validations for c in v["components"] if c["component"] == component.component]
        gain = min((c["gain"] for c in figures), default=0.0)
        judged += [_summary(c) for c in figures]
        if gain > 0.0:
            kept.append(_at_gain(component, gain, figures))
        else:
            left_out.append(component.component)
    if not kept:
        halves = any(v.get("scheme") == HALVES for v in validations)
        reasons = "; ".join(_reason(one, halves) for one in judged) or "no component was judged"
        more = " One run is not enough to predict the next one: measure further days, each as a run." if halves else ""
        more = more or _single_worse_run([c for v in validations for c in v["components"]])
        raise GateError(
            f"export: not better than no compensation on held-out rows ({reasons}). Nothing was exported.{more}"
        )
    return GatedModel(model.model_copy(update={"components": tuple(kept)}), tuple(left_out), tuple(judged))


def _single_worse_run(components: Sequence[Mapping[str, Any]]) -> str:
    """A sentence on the only group that is worse than without the model, of at least three; else ""."""
    for component in components:
        groups = component.get("groups", ())
        worse = [g for g in groups if g["rms_after"] > g["rms_before"] * (1.0 + TIE)]
        if len(worse) == 1 and len(groups) >= FEWEST_GROUPS:
            (run,) = worse
            change = f"{run['rms_before']:.3g} -> {run['rms_after']:.3g} {component['unit']}"
            return (
                f" {component['component']} is worse in {run['label']} alone ({change}): compare its columns, sign and "
                "zero with those of the others."
            )
    return ""


def not_validated(model: ErrorModel) -> GateError:
    """The error to raise for a model without validation."""
    names = ", ".join(c.component for c in model.components)
    return GateError(
        f"export: this model ({names}) was not validated on held-out rows (add a `validate` stage after the fit, or "
        "set `ungated: true` to export it anyway)"
    )


def _at_gain(component: ComponentModel, gain: float, figures: Sequence[Mapping[str, Any]]) -> ComponentModel:
    if gain == 1.0:
        return component
    half = max(c["half_width90_at_gain"] for c in figures)
    if component.factor90 is not None:  # an interval that depends on inputs was calibrated at full gain
        half = max(half, component.half_width90)
    update = {"gain": component.gain * gain, "half_width90": half}
    return component.model_copy(update=update)


def _summary(figures: Mapping[str, Any]) -> dict[str, Any]:
    names = ("component", "unit", "gain", "rms_before", "rms_after", "rms_at_gain", "p_value", "runs")
    return {name: figures[name] for name in names}


def _reason(judged: Mapping[str, Any], halves: bool) -> str:
    figures = f"{judged['component']} {judged['rms_before']:.3g} -> {judged['rms_after']:.3g} {judged['unit']}"
    evidence = f"halves worth {judged['runs']} independent rows" if halves else f"{judged['runs']} runs"
    return f"{figures}, p = {judged['p_value']:.2g} over {evidence}"
