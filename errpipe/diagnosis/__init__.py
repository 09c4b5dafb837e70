"""From a mismatch between recording and simulation to an identified, located, modelled and validated cause.

thinning    reduce a long log to stretches at its original rate; rare events from all rows
derived     motion of axes for which only positions are recorded
prepare     select usable rows; fill and smooth sensors; derive motion from positions
hypotheses  every effect in every binding as design columns: the textbook form, and departures from it
coloured    noise model: white with a slowly varying share, fitted to the residual
evidence    marginal likelihood of a hypothesis with nuisance parameters, in coloured noise
decompose   split the noiseless simulated signal into its effects (whose gains a recalibration may change)
search      forward, backward and pairwise selection of the missing effects
left_out    prediction of held-out rows or held-out sessions
admit       test of the residual: does an unnamed smooth shape explain more?
locate      where a finding acts
model       parameters with intervals, held-out figures
empirical   an equation for a mismatch that no known effect explains
confidence  calibrated probability that such a finding is right
separate    the rivals that explain nearly as well, and the measurement that separates them
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

SIDE_BY_SIDE = 2  # responses judged at a time: each has a table of products, 0.5 GB at
MANY_ROWS = 20_000  # this number of rows; from here on they are judged one after the other


@dataclass(frozen=True)
class Rows:
    """One judged response, row by row, for figures: mismatch before and after, run, contribution of each finding.

    inputs: values of the columns that drive the findings, and of time, by name. simulated_parts: the effects into which
    the simulated signal was decomposed, each as (term, its non-linear parameters).
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
    """Judge every response that has a simulated counterpart. Raises DataError if there is none.

    BLAS runs in one thread: thousands of small matrices gain nothing from more, and the results are then independent of
    the number of cores. Two responses are judged at a time; neither influences the other.
    """
    from errpipe.fitting.solve import one_thread

    with one_thread():
        return _diagnose(recording, progress)


def _diagnose(recording: Recording, progress: Callable[[float, str], None]) -> tuple[Diagnosis, list[Rows]]:
    from errpipe.diagnosis import derived, empirical, hypotheses, judge, prepare, report, thinning
    from errpipe.fitting.parallel import parallel_map

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

        case = judge.diagnose(recording, prepare.followed(recording, conditioned, pair), pair, done)
        done(0.8, f"{pair.component}: validating on held-out rows")
        response, contribution, residual = report.response(case)
        response = empirical.with_equation(case, response)
        inputs = report.inputs(case, response)
        held = [p.hypothesis for p in case.decomposition.parts]
        parts = tuple(one for h in held for one in zip(h.terms, h.nonlinear, strict=True))
        shares[k] = 1.0
        if at_once == 1 or any(0.0 < share < 1.0 for share in shares):  # a third table would not fit in memory
            turn = case.recording.derived[hypotheses.Library]
            turn.left = None if turn.left is case.library else turn.left
        return response, Rows(case.y, residual, case.run, contribution, inputs, parts)

    at_once = SIDE_BY_SIDE if len(recording) <= MANY_ROWS else 1
    alone = 1e-9 * (len(pairs) % at_once)  # with an odd number the first response runs alone, on both cores
    made = parallel_map(judged, range(len(pairs)), pairs, at_once=at_once, worth=alone)
    responses, rows = zip(*made, strict=True)
    diagnosis = Diagnosis(recording=recording.manifest.title, responses=responses, notes=(*short.notes, *notes))
    return derived.named_by_source(diagnosis, source), list(rows)
