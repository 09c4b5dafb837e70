"""Recalibration: datum and gains of the effects in a simulation may be off, and are nuisances of the search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from errpipe.diagnosis import decompose as parts
from errpipe.diagnosis import gains, hypotheses
from errpipe.diagnosis.coloured import whiten
from errpipe.diagnosis.evidence import ActiveSet, Data
from errpipe.diagnosis.gains import DATUM, WHOLE, Nuisance
from errpipe.diagnosis.left_out import LeftOut
from errpipe.diagnosis.search import MISSING, Explanation, Search, converged
from errpipe.terms import NEVER

GAIN_SD = 0.10  # prior standard deviation of a simulation's gain - 1 (usual: 0..15 %)
OFF = 3.0  # threshold: log Bayes factor for a recalibration
OWN_SD = 0.04  # prior standard deviation of the gain of a part's departures, relative to the part's gain
# For the share of an expansion due to its reference temperature, which may be the simulation's lead error. With
# more, a missing lead error of a third of it is mistaken for that gain (trials/second 81261, tests of slopes).
REFERENCE_SD = 0.03
PRESENT = -4.0  # log prior odds against an effect that the simulation already contains,
SAME = -12.0  # and in addition if it would be driven by the same columns
KNOWN = 0.02  # residual rms of a decomposition, over the signal's, up to which it identifies the simulation's inputs
SURE = 15.0  # log Bayes factor from which a part is certainly in the simulation
MAX_GAIN_PENALTY = 60.0  # largest penalty, in log evidence, for gains beyond the limits: the decomposition may be wrong
ALL_ONE = 6.0  # threshold: log odds that the gains of all parts but one are 1 rather than off as usual
TRUST = 0.3  # weight of the decomposition's evidence: its residual is misfit, not noise
EXACT_SD = 0.001  # prior standard deviation of such gains, relative to the usual: 0.01 % of a signal is below its noise
AS_WELL = 1.02  # threshold: rms on held-out rows over that with gains, up to which a name is as good as its gain
TWIN = 20.0  # threshold: log Bayes factor of an effect missing in a repeated measurement, beyond that of a finding


def missing_beyond_gains(
    search: Search, explanation: Explanation, judged: LeftOut, d: parts.Decomposition, nuisances, sizes, noise: float
) -> tuple[Search, Explanation, bool] | None:
    """What is missing where a recalibration may be that, if it is likelier; None elsewhere. And: only if gains are 1?

    A simulation that holds every effect but one exactly lacks, or has too much of, that one: the gains of the others
    are known to be 1 by log odds of `ALL_ONE` (Savage-Dickey ratio). Its name is the same signal as its gain: it need
    not be likelier, only as good on held-out rows. All gains are known to be 1 where it is a twin, measured itself (it
    holds every effect, so another drift is no less likely), or by the same odds where nothing is named: departures of
    the parts then have no reason. Where nothing is named, and gains are off, one effect is compared with them by the
    marginal likelihoods (spike and slab), with the same log odds against gains that are all 1: gains of collinear parts
    imitate one effect. Otherwise a part with a gain beyond the limits may imitate another effect: without that gain
    something is missing, and held-out rows confirm it.
    """
    held, rows = gains.totals(nuisances, sizes)
    scene = search.scene(now := explanation.chosen())
    at = rows @ scene.coefficients()[: rows.shape[1]]
    variance = np.diag(rows @ scene.covariance()[: rows.shape[1], : rows.shape[1]] @ rows.T)
    odds = 0.5 * (np.log1p(GAIN_SD**2 / variance) - at**2 / variance + at**2 / (GAIN_SD**2 + variance))
    off = int(np.argmin(odds))
    one = odds[off] <= -OFF and odds.sum() - odds[off] >= ALL_ONE
    every = any(n.kind == "noise" for n in nuisances)
    every = every or (not explanation.accepted and odds.min() > 0 and odds.sum() >= ALL_ONE)
    far = gains.penalty(scene, rows)[1]
    if not (every or one or far.any() or explanation.accepted) and search.weighed:
        other, named = _with_exact(search, [n.is_gain for n in nuisances], search.prior, noise)
        likelier = other.evidence(named.chosen()) > search.evidence([]) + ALL_ONE
        if named.accepted and likelier and other.joint(named.chosen()) > TWIN:
            return other, named, True
    suspect = [held[off]] if one else [n for n, beyond in zip(held, far, strict=False) if beyond]
    suspect = held if every else suspect
    if not (every or (len(held) > 1 and suspect)) or not (one or search.weighed):  # held-out rows confirmed wide gains
        return None
    effects, labels = {n.effect for n in suspect}, {n.part for n in suspect}
    parts_of = {(p.hypothesis.effect, p.hypothesis.drivers) for p in d.parts if p.hypothesis.effect in effects}
    listed = search.library.hypotheses
    own = np.array([h.effect in effects if every else (h.effect, h.drivers) in parts_of for h in listed])
    own &= search.prior > 0.5 * NEVER
    prior = np.where(own, [h.prior for h in listed], search.prior)
    exactly = [n.is_gain and (one or every or n.part in labels) for n in nuisances]
    other, named = _with_exact(search, exactly, prior, noise)
    before = {f.hypothesis.effect for f in explanation.accepted}
    if named.accepted and other.evidence(named.chosen()) > search.evidence(now):
        again = {f.hypothesis.effect for f in named.accepted} <= before
        if every:
            return (other, named, not again) if other.joint(named.chosen()) > TWIN else None
        as_good = one or judged.of_explanation(other, named.chosen()) < judged.of_explanation(search, now)
        return (other, named, False) if as_good else None
    if not one or before:
        return None
    other, named = _with_exact(search, exactly, np.where(own, prior, NEVER), noise)
    left = judged.of_explanation(other, named.chosen()), judged.of_explanation(search, now)
    return (other, named, True) if named.accepted and left[0] < AS_WELL * left[1] else None


def _with_exact(search: Search, exactly: list[bool], prior: np.ndarray, noise: float) -> tuple[Search, Explanation]:
    """The search with some gains known to be exactly 1."""
    exact = ActiveSet(search.nuisance.index, search.nuisance.sd * np.where(exactly, EXACT_SD, 1.0))
    return converged(search.library, search.data, exact, prior, noise, search.rows)


def most_likely(
    alternatives: list[parts.Decomposition], holding: parts.Held | None, simulated, library, data: Data, noise: float
):
    """The decomposition that maximises the joint likelihood of signal and mismatch, with its recalibration.

    What seems to be missing may be in the simulation under another name, with another gain: a decomposition that
    contains it is tried, too.
    """

    def scored(d: parts.Decomposition):
        nuisance, kinds, columns, sizes = recalibration(simulated, d, library)
        search, e = converged(library, data, nuisance, log_prior(library, d), noise)
        too_far = gains.penalty(search.scene(e.chosen()), gains.totals(kinds, sizes)[1], search.rows)[0]
        cost = MISSING * len(e.accepted) + min(too_far, MAX_GAIN_PENALTY)
        return TRUST * d.worth + search.evidence(e.chosen()) - cost, (d, (nuisance, kinds, columns, sizes)), e.accepted

    if holding is None and len(alternatives) == 1:
        return alternatives[0], recalibration(simulated, alternatives[0], library)
    best = max(map(scored, alternatives), key=lambda t: t[0])
    if holding is not None:
        for finding in best[2]:
            others = map(scored, holding(best[1][0], finding.index))
            best = max([best, *others], key=lambda t: t[0])
    return best[1]


def recalibration(
    simulated: np.ndarray, d: parts.Decomposition, library: hypotheses.Library
) -> tuple[ActiveSet, list[Nuisance], np.ndarray, np.ndarray]:
    """Datum, gain of the whole simulated signal, gain of each of its parts; their meanings, columns and sizes."""
    columns, sd, kinds = [simulated - simulated.mean()], [GAIN_SD], [DATUM, WHOLE]
    whole = merge_cancelling(d.parts)
    least = float(np.sqrt(np.mean([np.var(p.contribution) for p in whole]))) if d.plain else 0.0
    effects = [part.hypothesis.effect for part in whole]
    for part in whole:
        effect = part.hypothesis.effect
        of = effect if effects.count(effect) == 1 else f"{effect} on {' and '.join(part.hypothesis.drivers)}"
        doubts = [(", in doubt", values, GAIN_SD) for values in part.doubt.T]
        own = [("", part.contribution, GAIN_SD), (", not textbook", part.slack, OWN_SD)]
        own.append((", its reference", part.reference, REFERENCE_SD))
        for what, values, off in (*own, *doubts):
            if np.std(values) > (0.0 if d.plain else 0.02) * np.std(simulated):
                columns.append(values)
                sd.append(off * max(least / float(np.std(values)), 1.0))
                kinds.append(Nuisance("departure" if what else "part", of + what, effect, of))
    size = [max(float(np.std(c)), 1e-12) for c in columns]
    block = np.column_stack([c / s for c, s in zip(columns, size, strict=True)])
    index = library.table.add(block)
    active = ActiveSet(np.array([library.datum]), np.array([np.inf]))
    every = np.column_stack([np.ones(simulated.size), block])
    return active.plus(index, np.array(sd) * np.array(size)), kinds, every, np.r_[1.0, size]


def merge_cancelling(separate: tuple[parts.Part, ...]) -> list[parts.Part]:
    """Merge parts that nearly cancel: with separate gains they could reproduce almost anything."""
    out: list[parts.Part] = []
    for part in separate:
        for k, other in enumerate(out):
            if np.corrcoef(part.contribution, other.contribution)[0, 1] < -0.9:
                sums = {name: getattr(other, name) + getattr(part, name) for name in ("core", "slack")}
                out[k] = replace(other, **sums, doubt=part.doubt[:, :0])  # what one gains, the other loses
                break
        else:
            out.append(part)
    return out


def log_prior(library: hypotheses.Library, d: parts.Decomposition) -> np.ndarray:
    """Log prior odds: lower for effects in the simulation, and for errors of sensors that nothing in it follows."""
    held = np.std(np.sum([p.contribution for p in d.parts], axis=0)) if d.parts else 0.0
    present = {p.hypothesis.effect for p in d.parts if np.std(p.contribution) > 0.05 * held and p.certainty > SURE}
    same: dict[tuple, list[np.ndarray]] = {}
    for p in d.parts:
        if p.certainty > SURE:
            same.setdefault((p.hypothesis.effect, p.hypothesis.drivers), []).append(p.contribution)
    prior = np.array([h.prior for h in library.hypotheses])
    sensors = {h.drivers[0] for h in library.hypotheses if h.terms[0].one_sensor}
    read = {name for p in d.parts for name in p.hypothesis.drivers}
    known = bool(d.parts) and d.leftover < KNOWN
    for i, h in enumerate(library.hypotheses):
        if known and h.terms[0].misread and not read & set(h.drivers):
            prior[i] += SAME if read & sensors else NEVER
        if h.effect in present:
            own = same.get((h.effect, h.drivers))
            prior[i] += (
                PRESENT if own is None else (PRESENT + SAME) * max(share_in_simulation(library, i, p) for p in own)
            )
    return prior


def share_in_simulation(library: hypotheses.Library, i: int, held: np.ndarray) -> float:
    """Share of a part of the simulation that a hypothesis' textbook form explains: another wave, or a bump elsewhere,
    is another effect of the same name."""
    table = library.table
    form, signal = table.whitened[:, library.places[i][: library.cores[i]]], whiten(held, table.run, table.colour)
    rest = signal - form @ np.linalg.lstsq(form, signal, rcond=None)[0]
    return float(np.clip(1.0 - rest @ rest / (signal @ signal), 0.0, 1.0))
