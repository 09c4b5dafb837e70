"""Implausible findings: they are ruled out whatever their evidence, and the search is repeated.

no size        no linear parameter differs significantly from 0, alone or jointly
cancelling     a finding far larger than the mismatch that another finding, or the gain of its own part, nearly cancels
no such size   a linear parameter that is a constant of nature, outside its bounds
second shift   a signal is late or early, not both: two shifts of one signal imitate a smoothed one
at its limit   a scale at the end of what the recording resolves: a lag as long as the session is a drift
"""

from __future__ import annotations

import numpy as np

from errpipe.diagnosis import model
from errpipe.diagnosis.case import Case
from errpipe.terms import search_of

TOO_LARGE = 2.0  # rms of a finding over that of the mismatch, from which another one must be cancelling it
RATIO = 1.6  # factor between neighbouring grid values of a scale: an interval that extends further is not at its limit
CANCELLING = -0.8  # correlation from which two findings cancel
ALIKE = 0.97  # share of a variance from which two contributions are equivalent
TWO_GAINS = 0.3  # the difference of two gains, each up to 0.15 off
HALF = 0.5  # of a part: a look-alike that is smaller may be the error of its gain, shared with other parts
BETTER_WAVE = 1.1  # threshold: variance explained by a wave over the rows, over that of the finding


def impossible(case: Case) -> list[model.FittedFinding]:
    """Implausible accepted findings: at a limit of what the recording resolves, or cancelled by another one."""
    made = [model.fit_finding(case, k) for k in range(len(case.explanation.accepted))]
    out = [m for m in made if at_its_limit(case, m) or implausible_size(m)] or cancelling(case, made)
    shifted = [getattr(t, "column", "") for m in made for t in m.hypothesis.terms if t.only_estimated and t.gain_sd]
    return out or (made[1:] if len(set(shifted)) < len(shifted) else [])


def doubtful(case: Case) -> list[model.FittedFinding]:
    """Accepted findings whose size is not significant, or whose scale's interval reaches its limit; weakest first.

    Of an effect of any shape the textbook form is one of many: its size may be zero.
    """
    made = [model.fit_finding(case, k) for k in range(len(case.explanation.accepted))]
    unsized = [is_insignificant(m) and m.hypothesis.terms[0].form != "any shape" for m in made]
    doubted = [m for m, u in zip(made, unsized, strict=True) if u or at_its_limit(case, m, np.inf)]
    return sorted(doubted, key=lambda m: m.joint)


def cancelling(case: Case, made: list[model.FittedFinding]) -> list[model.FittedFinding]:
    """The weaker one of two findings that cancel: both far larger than the mismatch, or equivalent but for gains.

    Both are real if a simulation was fitted without what is missing: if it holds it, its gain cancels another form.
    """
    spread, out = float(np.std(case.y)), []
    every = [m.contribution for m in made]
    projected = [c - case.recal @ np.linalg.lstsq(case.recal, c, rcond=None)[0] for c in every]
    gains = case.recal @ case.search.scene(case.chosen()).coefficients()[: case.recal.shape[1]]
    held = {(p.hypothesis.effect, p.hypothesis.drivers) for p in case.decomposition.parts}
    for k, m in enumerate(made):
        pairs = [(c[j], c[k], f) for c, f in ((every, min), (projected, max)) for j in range(k)]
        pairs += [(gains, every[k], min)] if (m.hypothesis.effect, m.hypothesis.drivers) in held else []
        for one, other, least in pairs:
            sizes = float(np.std(one)), float(np.std(other))
            if least(sizes) > TOO_LARGE * spread and min(sizes) > 0 and np.corrcoef(one, other)[0, 1] < CANCELLING:
                out.append(m)
    return out


def is_insignificant(m: model.FittedFinding) -> bool:
    """Whether no linear parameter differs significantly from 0, alone (the reported intervals) or jointly?

    A wave has an amplitude, too; of the same term on two axes only the difference may be known.
    """
    own = m.estimates[:1] if m.cores == 1 else m.estimates
    spans_zero = (m.cores == 1 or len(m.hypothesis.terms) == 1) and all(e.low <= 0.0 <= e.high for e in own)
    return spans_zero or m.joint < model.CHI2_95.get(m.cores, 2.0 * m.cores)


def implausible_size(m: model.FittedFinding) -> bool:
    """Is a size that must be 1 far from it (a time shift acts fully or not at all), or a natural constant too large?"""
    term, spans = m.hypothesis.terms[0], {e.name: e for e in m.estimates}
    if term.gain_sd is not None and abs(m.estimates[0].value - 1.0) > 3.0 * term.gain_sd:
        return True
    return term.physical_constant and any(
        spans[p.name].low > p.bounds[1] or spans[p.name].high < p.bounds[0] for p in term.linear()
    )


def at_its_limit(case: Case, m: model.FittedFinding, far: float = RATIO) -> bool:
    """Is a scale at the end of what the recording resolves, and outside the typical range of machines?

    far: factor from the limit to the other end of its interval; beyond it, the scale is resolved.
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


def gain_of_a_part(case: Case, m: model.FittedFinding) -> bool:
    """May the finding be the gain of a part of the simulation, or of the share of a part due to its reference?

    A lead error with an expansion, and the same expansion counted from another temperature, are one signal, but have
    two gains or one. The reference is unknown, so the lead error may be as large as the expansion.
    """
    own = m.contribution - m.contribution.mean()
    for p in case.decomposition.parts:
        expansion = float(np.std(p.reference) + np.std(p.core - p.reference))
        for held, most in ((p.contribution, HALF * np.std(p.contribution)), (p.reference, TWO_GAINS * expansion)):
            centred = held - held.mean()
            if np.std(own) < most and (own @ centred) ** 2 > ALIKE * (own @ own) * (centred @ centred):
                return True
    return False


def only_a_wave_in_time(m: model.FittedFinding, left: np.ndarray) -> bool:
    """Does a sine over the order of the rows (aliased mains hum) explain more than the finding?

    left: residual of the whole explanation, shape (rows,).
    """
    beside = left + m.contribution - np.mean(left + m.contribution)
    own = float(beside @ beside) - float(np.sum((left - left.mean()) ** 2))
    power = np.abs(np.fft.rfft(beside, 4 * beside.size))
    turns = int(np.argmax(power)) / (4.0 * beside.size) * 2 * np.pi * np.arange(beside.size)
    wave = np.column_stack([np.cos(turns), np.sin(turns), np.ones(beside.size)])
    rest = beside - wave @ np.linalg.lstsq(wave, beside, rcond=None)[0]
    return float(beside @ beside) - float(rest @ rest) > BETTER_WAVE * max(own, 0.0)
