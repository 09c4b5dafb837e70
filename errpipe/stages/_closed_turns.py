"""A model as a table holds it: over an axis that turns on, each curve repeats with every turn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.components import evaluate
from errpipe.stages._inputs import POSITIONS, turning

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel

TURN = 360.0  # deg
SAME_TURN = 1e-6  # of a turn


def evaluate_closed(model: ErrorModel, recording: Recording) -> dict[str, np.ndarray]:
    """Deviations of every component in its unit, shape (rows,), closed as `compile_table` closes them.

    What the two ends of a whole turn differ is spread evenly over it. Where less of a turn was measured, and over
    linear axes, the model stands as it is; positions beyond the first turn are not wrapped.
    """
    values = evaluate(model, recording)
    turning_on = turning(model)
    for name, facts in model.columns.items():
        low, high = model.validity.ranges.get(name, (0.0, 0.0))
        rotary = facts["role"] in POSITIONS and facts["axis"][0] in "ABC" and name in recording.frame
        beyond = high - low - TURN
        if not rotary or beyond < -SAME_TURN * TURN or (beyond > SAME_TURN * TURN and facts["axis"] not in turning_on):
            continue
        at_low, at_high = (
            evaluate(model, Recording(recording.manifest, recording.frame.assign(**{name: end})))
            for end in (low, low + TURN)
        )
        share = np.clip((recording.array(name) - low) / TURN, 0.0, 1.0) - 0.5
        values = {c: v - (at_high[c] - at_low[c]) * share for c, v in values.items()}
    return values


def gaps_of_turns(model: ErrorModel, recording: Recording) -> dict[str, float]:
    """Component -> what the ends of a turn differ in the model, in its unit; 0 where no axis turns on."""
    bare, closed = evaluate(model, recording), evaluate_closed(model, recording)
    return {c: 2.0 * float(np.nanmax(np.abs(closed[c] - bare[c]), initial=0.0)) for c in bare}
