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

from errpipe.domain.diagnosis import Diagnosis
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import in_order_of_time
from errpipe.terms import Term


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

    One thread: thousands of small matrices gain nothing from more, and results then do not depend on the cores.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"):
        return _diagnose(recording, progress)


def _diagnose(recording: Recording, progress: Callable[[float, str], None]) -> tuple[Diagnosis, list[Rows]]:
    from errpipe.diagnosis import derived, empirical, judge, prepare, report, thinning

    progress(0.0, "reading the recording")
    title = recording.manifest.title
    recording, source = derived.with_motion(in_order_of_time(recording))
    short = thinning.thinned(recording)
    recording = short.recording
    pairs, notes = prepare.pairs(recording)
    conditioned = prepare.condition(recording)
    responses, rows = [], []
    for k, pair in enumerate(pairs):
        done = lambda share, text, k=k: progress((k + share) / len(pairs), text)  # noqa: E731
        case = judge.judge(recording, prepare.followed(recording, conditioned, pair), pair, done)
        progress((k + 0.8) / len(pairs), f"{pair.component}: proving it on rows that had no say")
        response, contribution, residual = report.response(case)
        response = empirical.with_equation(case, response)
        responses.append(response)
        inputs = report.inputs(case, response)
        held = [p.hypothesis for p in case.decomposition.parts]
        parts = tuple(one for h in held for one in zip(h.terms, h.nonlinear, strict=True))
        rows.append(Rows(case.y, residual, case.run, contribution, inputs, parts))
        del case  # frees one table of products before the next is built
    diagnosis = Diagnosis(recording=title, responses=tuple(responses), notes=(*short.notes, *notes))
    return derived.named_by_source(diagnosis, source), rows
