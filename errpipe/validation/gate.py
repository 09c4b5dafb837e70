"""Gate of an export: the components that improve held-out runs, at the gain that was judged there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from errpipe.domain.error_model import ComponentModel, ErrorModel
from errpipe.errors import GateError
from errpipe.fitting.holdout import HALVES
from errpipe.validation.predict import predict

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

NORMAL90 = 1.645  # half width of a normal distribution's 90 % interval, in standard deviations


@dataclass(frozen=True)
class Passed:
    """model: components with the gain that was judged; left_out: those without one; judged: figures for the reader."""

    model: ErrorModel
    left_out: tuple[str, ...]
    judged: tuple[dict[str, Any], ...]


def pass_gate(
    model: ErrorModel, validations: Sequence[Mapping[str, Any]], recording: Recording | None = None
) -> Passed:
    """The part of a model that every validation of it found better than nothing, each component at its least gain.

    validations: documents of `validation.json` of this very model. recording: what fitted it; where that is fewer than
    three runs, whose halves predicted each other, a component is left out whose standard error in the next run is as
    large as itself: its expected square is then no smaller than without it. Doing nothing wins ties. Raises GateError
    where no validation judged the model, or no component is left.
    """
    if not validations:
        raise GateError(
            "export: nothing has judged this model on held-out rows (add a `validate` stage after the fit, or say "
            "`ungated: true` to export it all the same)"
        )
    few = any(v.get("scheme") == HALVES for v in validations)
    unknown = _unknown(model, recording) if few and recording is not None else {}
    kept, left_out, judged = [], [], []
    for component in model.components:
        figures = [c for v in validations for c in v["components"] if c["component"] == component.component]
        gain = min((c["gain"] for c in figures), default=0.0)
        judged += [_brief(c) for c in figures]
        if gain > 0.0 and component.component not in unknown:
            kept.append(_at_gain(component, gain, figures))
        else:
            left_out.append(component.component)
    if not kept:
        reasons = "; ".join([*map(_reason, judged), *unknown.values()]) or "no component was judged"
        raise GateError(f"export: not better than nothing on held-out rows ({reasons}). Nothing was exported.")
    return Passed(model.model_copy(update={"components": tuple(kept)}), tuple(left_out), tuple(judged))


def _unknown(model: ErrorModel, recording: Recording) -> dict[str, str]:
    """Component -> why it is not known well enough, by its own interval on the rows that fitted.

    Chosen on one-day logs of a gantry in a hall (20, two later weeks judge) and of 12 machines of `trials.thermal`: all
    four that were worse than nothing are found, with 4 of the 28 others. Judged on 24 other gantries: of two that were
    exported and worse than nothing none is left; 10 are exported (16), 0.71 of uncompensated is left (0.63).
    """
    frame, out = predict(model, recording), {}
    for name in (c.component for c in model.components if c.half_width90 is not None):
        column = recording.name("error", component=name) or name
        size = frame[f"{column}_predicted"].to_numpy()
        error = 0.5 * (frame[f"{column}_upper"] - frame[f"{column}_lower"]).to_numpy() / NORMAL90
        known = np.isfinite(error)
        size, error = (float(np.sqrt(np.mean(v[known] ** 2))) if known.any() else 0.0 for v in (size, error))
        if error >= size:
            out[name] = (
                f"{name}: the correction is {size:.3g} rms, its standard error in the next run {error:.3g} as far as "
                "so few runs show: measure further ones"
            )
    return out


def _at_gain(component: ComponentModel, gain: float, figures: Sequence[Mapping[str, Any]]) -> ComponentModel:
    if gain == 1.0:
        return component
    update: dict[str, Any] = {"gain": component.gain * gain}
    if component.factor90 is None:  # an interval that follows the inputs keeps its own calibration
        update["half_width90"] = max(c["half_width90_at_gain"] for c in figures)
    return component.model_copy(update=update)


def _brief(figures: Mapping[str, Any]) -> dict[str, Any]:
    names = ("component", "unit", "gain", "rms_before", "rms_after", "rms_at_gain", "p_value", "runs")
    return {name: figures[name] for name in names}


def _reason(judged: Mapping[str, Any]) -> str:
    figures = f"{judged['component']} {judged['rms_before']:.3g} -> {judged['rms_after']:.3g} {judged['unit']}"
    return f"{figures}, p = {judged['p_value']:.2g} over {judged['runs']} runs"
