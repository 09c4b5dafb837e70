"""fit: a recording and a specification -> an error model. evaluate: the model's deviations on any recording."""

from __future__ import annotations

import numpy as np

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting.components import evaluate, solved, term_of
from errpipe.fitting.judging import calibrated, judge_all, select
from errpipe.fitting.spec import ComponentSpec, ModelSpec, PriorSpec

__all__ = ["ComponentSpec", "ModelSpec", "PriorSpec", "evaluate", "fit", "term_of"]

NORMAL90 = 1.645  # standard deviations: half of the central 90 % of a normal distribution


def fit(recording: Recording, spec: ModelSpec, *, calibrate: bool = True) -> ErrorModel:
    """Fit every component of `spec` on all rows.

    calibrate: refit without each hold-out group to size the 90 % prediction interval. If the specification requests
    selection, terms that do not improve held-out rows are dropped. Raises DataError if a response or a needed
    column is missing, NotIdentifiable if the rows cannot distinguish parameters.
    """
    mask = np.ones(len(recording), dtype=bool)
    chosen = select(recording, spec, mask) if spec.selection == "held-out" else spec
    model = solved(recording, chosen, mask)
    if not calibrate:
        return model
    try:
        judged = judge_all(recording, spec, mask)
    except DataError as why:
        return without_interval(model, str(why))
    return calibrated(model, judged)


def without_interval(model: ErrorModel, why: str) -> ErrorModel:
    """For a fit without hold-out: the interval is that of the fitted rows, as stated in a note."""
    components = tuple(
        c.model_copy(update={"half_width90": NORMAL90 * c.rms_after, "widening90": NORMAL90 * c.rms_after})
        for c in model.components
    )
    note = f"the prediction interval comes from the fitted rows themselves and is likely too narrow ({why})"
    return model.model_copy(update={"components": components, "notes": (*model.notes, note)})
