"""From a mismatch between recording and simulation to a named, located, modelled and proved cause.

thinning    a long log as stretches at its own rate; rare events in all its rows
derived     motion of axes of which positions alone are recorded
prepare     rows that can be judged; sensors filled and smoothed; motion from positions
hypotheses  every effect in every binding as design columns: the textbook form, and columns for departures from it
coloured    noise: white with a slow share, fitted to what an explanation leaves
evidence    marginal likelihood of a hypothesis beside the nuisances, in coloured noise
decompose   the noiseless simulated signal into its own effects (what a recalibration may change)
search      forward, backward and in pairs: what is missing
left_out    how well it predicts held-out rows or held-out sessions
admit       the residual beside the findings: does a shape without a name explain more?
locate      where it acts
model       parameters with intervals, held-out figures
empirical   an equation for what has no name
confidence  calibrated probability that such a finding is right
separate    which rival explains nearly as well, and which measurement separates the two
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from errpipe.domain.diagnosis import Diagnosis, ResponseDiagnosis
from errpipe.domain.recording import Recording
from errpipe.drivers.between_readings import between_readings
from errpipe.drivers.sessions import in_order_of_time
from errpipe.terms import Term

SIDE_BY_SIDE = 2  # responses judged at a time: each holds a table of products, 0.5 GB at
MANY_ROWS = 20_000  # rows, from which they are judged one after the other


@dataclass(frozen=True)
class Rows:
    """A judged response row by row, for figures: mismatch before and after, run, what each finding contributes.

    inputs: values of the columns that drive the findings, and of time, by name. simulated_parts: the effects that the
    simulated signal was found to be a sum of, each as (term, its non-linear parameters).
    """

    before: np.ndarray
    after: np.ndarray
    run: np.ndarray
    contribution: Mapping[str, np.ndarray]
    inputs: Mapping[str, np.ndarray]
    simulated_parts: tuple[tuple[Term, tuple[float, ...]], ...] = ()


def diagnose(
    recording: Recording, progress: Callable[[float, str], None] = lambda share, text: None
) -> tuple[Diagnosis, list[Rows]]:
    """Every response with a simulated twin, judged. Raises DataError where none can be.

    BLAS in one thread: thousands of small matrices gain nothing from more, and results then do not depend on the cores.
    Two responses at a time, each as if it were alone.
    """
    from errpipe.fitting.solve import one_thread

    with one_thread():
        return _diagnose(recording, progress)


def _diagnose(recording: Recording, progress: Callable[[float, str], None]) -> tuple[Diagnosis, list[Rows]]:
    from errpipe.diagnosis import derived, empirical, hypotheses, judge, prepare, report, thinning
    from errpipe.fitting.side_by_side import side_by_side

    progress(0.0, "reading the recording")
    recording, source = derived.with_motion(between_readings(in_order_of_time(recording)))
    recording = (short := thinning.thinned(recording)).recording
    pairs, notes = prepare.pairs(recording)
    conditioned = prepare.condition(recording)
    shares = [0.0] * len(pairs)

    def judged(k: int, pair: prepare.Pair) -> tuple[ResponseDiagnosis, Rows]:
        def done(share: float, text: str) -> None:
            shares[k] = share
            progress(sum(shares) / len(pairs), text)

        case = judge.judge(recording, prepare.followed(recording, conditioned, pair), pair, done)
        done(0.8, f"{pair.component}: proving it on rows that had no say")
        response, contribution, residual = report.response(case)
        response = empirical.with_equation(case, response)
        inputs = report.inputs(case, response)
        held = [p.hypothesis for p in case.decomposition.parts]
        parts = tuple(one for h in held for one in zip(h.terms, h.nonlinear, strict=True))
        shares[k] = 1.0
        if at_once == 1 or any(0.0 < share < 1.0 for share in shares):  # no third table in memory
            turn = case.recording.derived[hypotheses.Library]
            turn.left = None if turn.left is case.library else turn.left
        return response, Rows(case.y, residual, case.run, contribution, inputs, parts)

    at_once = SIDE_BY_SIDE if len(recording) <= MANY_ROWS else 1
    alone = 1e-9 * (len(pairs) % at_once)  # one left over comes first, alone: it then has both cores to itself
    made = side_by_side(judged, range(len(pairs)), pairs, at_once=at_once, worth=alone)
    responses, rows = zip(*made, strict=True)
    diagnosis = Diagnosis(recording=recording.manifest.title, responses=responses, notes=(*short.notes, *notes))
    return derived.named_by_source(diagnosis, source), list(rows)
