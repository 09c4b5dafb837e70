"""Findings that cannot be true, whatever their evidence: they are ruled out, and the search is made again.

no size        every linear parameter may as well be nothing, alone and all together
cancelling     a finding far larger than the mismatch, nearly all of which another finding takes away again
at its limit   a scale at the end of what the recording resolves: a lag as long as the whole session is a drift
"""

from __future__ import annotations

import numpy as np

from errpipe.diagnosis import model
from errpipe.diagnosis.case import Case
from errpipe.terms import search_of

TOO_LARGE = 2.0  # rms of a finding over that of the mismatch, from which another one must be cancelling it
RATIO = 1.6  # factor between neighbouring values of a scale: an interval that reaches this far off a limit leaves it
FAR = np.inf
CANCELLING = -0.8  # correlation of two findings from which they cancel


def impossible(case: Case) -> list[model.Modelled]:
    """Accepted findings that cannot be true: at a limit of what the recording resolves, or cancelled by another one."""
    made = [model.modelled(case, k) for k in range(len(case.explanation.accepted))]
    return [m for m in made if at_its_limit(case, m) or not_in_full(m)] or cancelling(case, made)


def doubtful(case: Case) -> list[model.Modelled]:
    """Accepted findings whose size may as well be nothing, or whose scale may as well be at its limit.

    Least certain first.
    """
    made = [model.modelled(case, k) for k in range(len(case.explanation.accepted))]
    return sorted((m for m in made if no_size(m) or at_its_limit(case, m, FAR)), key=lambda m: m.joint)


def cancelling(case: Case, made: list[model.Modelled]) -> list[model.Modelled]:
    """The weaker one of two findings that cancel.

    What gains of the simulation can play does not count: where it was fitted without the missing effect, gain and
    effect are both far larger than the mismatch, and both are true.
    """
    spread, out = float(np.std(case.y)), []
    beyond = [_beyond_gains(case, m.contribution) for m in made]
    for k, m in enumerate(made):
        for one in beyond[:k]:
            sizes = [float(np.std(x)) for x in (one, beyond[k])]
            if max(sizes) > TOO_LARGE * spread and min(sizes) > 0:
                together = np.corrcoef(one, beyond[k])[0, 1]
                out += [m] if together < CANCELLING else []
    return out


def _beyond_gains(case: Case, contribution: np.ndarray) -> np.ndarray:
    """The part of a contribution that datum and gains of the simulation cannot play, shape (rows,)."""
    return contribution - case.recal @ np.linalg.lstsq(case.recal, contribution, rcond=None)[0]


def no_size(m: model.Modelled) -> bool:
    """May every linear parameter be nothing, alone and all together?"""
    return m.joint < model.CHI2_95.get(m.cores, 2.0 * m.cores)


def not_in_full(m: model.Modelled) -> bool:
    """Is it far from 1 where the linear parameter is known to be 1? Half a shift in time is no shift in time."""
    sd = m.hypothesis.terms[0].gain_sd
    return sd is not None and abs(m.estimates[0].value - 1.0) > 3.0 * sd


def at_its_limit(case: Case, m: model.Modelled, far: float = RATIO) -> bool:
    """Does a scale lie at the end of what the recording resolves, and outside of what machines show?

    far: factor from the limit by which the other end of its interval may be off; further off, it has a value.
    """
    term, spans = m.hypothesis.terms[0], {e.name: e for e in m.estimates}
    for p, value in zip(term.nonlinear(), m.hypothesis.nonlinear[0], strict=True):
        if p.name in term.fixed or p.typical[0] <= value <= p.typical[1]:
            continue
        low, high = search_of(p).limits(term, case.recording)
        span = spans[p.name]
        if (value <= 1.001 * low and span.high < far * low) or (value >= 0.999 * high and span.low > high / far):
            return True
    return False
