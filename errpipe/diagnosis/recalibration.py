"""Recalibration: datum and gains of what a simulation already holds may be off, and are nuisances of the search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from errpipe.diagnosis import decompose as parts
from errpipe.diagnosis import gains, hypotheses
from errpipe.diagnosis.evidence import Active, Data
from errpipe.diagnosis.search import MISSING, MORE, Explanation, Search, settled

GAIN_SD = 0.10  # how far a simulation's gains are usually off (0..15 %)
OFF = 3.0  # log Bayes factor for a recalibration
OWN_SD = 0.04  # how far the gain of what is not textbook in a part is off beside the gain of the part
PRESENT = -4.0  # log prior odds against an effect that the simulation already holds,
SAME = -12.0  # and again where it would be driven by the same columns
SURE = 15.0  # log Bayes factor from which a part of the simulation is sure to be there
MAX_GAIN_PENALTY = (
    60.0  # log evidence that gains beyond the limits can cost at most: the signal may have been taken apart wrongly
)
CLAMPED_SD = 0.03  # freedom of a gain beyond the limits, while another explanation is looked for


def _worth(search: Search, explanation: Explanation, rows: np.ndarray) -> float:
    """Log evidence less what findings and gains beyond the limits cost."""
    chosen = [(f.index, f.size) for f in explanation.accepted]
    gain_penalty, _ = gains.excess(search.scene(chosen), rows, search.rows)
    return search.evidence(chosen) - MISSING * len(chosen) - min(gain_penalty, MAX_GAIN_PENALTY)


def within_limits(search, explanation, d: parts.Decomposition, names, recal, sizes, noise_estimate):
    """The explanation, or a likelier one without the gains beyond the limits that it needs."""
    labels, rows = gains.totals(names, sizes)
    gain_penalty, beyond = gains.excess(
        search.scene([(f.index, f.size) for f in explanation.accepted]), rows, search.rows
    )
    if gain_penalty < OFF or beyond is None or d.plain:  # a static model of sensors may hold any gains
        return search, explanation
    beyond_limits = {name for name, out in zip(labels, beyond, strict=False) if out}
    prior = _less_surely_held(search, d, {name.split(" on ")[0] for name in beyond_limits})
    kept = _clamped(search, beyond_limits, names, recal, sizes)
    other, clamped = settled(search.library, search.data, kept, prior, noise_estimate, search.rows)
    free, fair = (
        Search(search.library, search.data, search.nuisance, sigma, prior, MISSING, MORE, search.rows)
        for sigma in (other.sigma, search.sigma)
    )
    found = free.accepted(free.tune([(f.index, f.size) for f in clamped.accepted]))
    second, nothing = replace(clamped, accepted=found), replace(clamped, accepted=())
    if not found or _worth(fair, second, rows) <= _worth(fair, explanation, rows) + OFF:
        return search, explanation
    if len(found) == 1:  # it brings what it does for the rows, and what it spares the gains
        spared = _worth(fair, second, rows) + MISSING - _worth(fair, nothing, rows)
        second = replace(second, accepted=(replace(found[0], gain=max(found[0].gain, spared)),))
    return free, second


def _clamped(search: Search, parts_held: set[str], names, recal, sizes) -> Active:
    """The nuisances with little freedom for these parts: the gain of the whole does not reach them either."""
    theirs = [j for j, name in enumerate(names) if name.split(",")[0] in parts_held]
    rest = recal[:, 1] * sizes[1] - recal[:, theirs] @ sizes[theirs]
    size = max(float(np.std(rest)), 1e-12)
    index, sd = search.nuisance.index.copy(), search.nuisance.sd.copy()
    index[1], sd[1] = search.library.add((rest / size)[:, None])[0], GAIN_SD * size
    sd[theirs] = np.minimum(sd[theirs], CLAMPED_SD * sizes[theirs])
    return Active(index, sd)


def _less_surely_held(search: Search, d: parts.Decomposition, effects: set[str]) -> np.ndarray:
    """Log prior odds where parts with gains beyond the limits are not so sure to be in the simulation after all."""
    prior = search.prior.copy()
    held = {(p.hypothesis.effect, p.hypothesis.drivers) for p in d.parts if p.certainty > SURE}
    for i, h in enumerate(search.library.hypotheses):
        if h.effect in effects and (h.effect, h.drivers) in held:
            prior[i] -= SAME
    return prior


TRUST = 0.3  # weight of the evidence from taking the simulation apart: what it leaves over is no noise


def likeliest(alternatives: list[parts.Decomposition], simulated, library, data: Data, noise_estimate: float):
    """The decomposition that makes signal and mismatch likeliest together, with its recalibration."""
    tried = []
    for d in alternatives:
        nuisance, names, columns, sizes = recalibration(simulated, d, library)
        worth = TRUST * d.worth
        if len(alternatives) > 1:
            search, e = settled(library, data, nuisance, log_prior(library, d), noise_estimate)
            worth += _worth(search, e, gains.totals(names, sizes)[1])
        tried.append((worth, (d, (nuisance, names, columns, sizes))))
    return max(tried, key=lambda t: t[0])[1]


def recalibration(
    simulated: np.ndarray, d: parts.Decomposition, library: hypotheses.Library
) -> tuple[Active, list[str], np.ndarray, np.ndarray]:
    """Datum, gain of the whole simulated signal, gain of each of its parts; their names, columns and sizes."""
    columns, sd, names = [simulated - simulated.mean()], [GAIN_SD], ["simulation"]
    whole = together(d.parts)
    least = float(np.sqrt(np.mean([np.var(p.contribution) for p in whole]))) if d.plain else 0.0
    effects = [part.hypothesis.effect for part in whole]
    for part in whole:
        effect = part.hypothesis.effect
        of = effect if effects.count(effect) == 1 else f"{effect} on {' and '.join(part.hypothesis.drivers)}"
        doubts = [(", in doubt", values, GAIN_SD) for values in part.doubt.T]
        for what, values, off in (("", part.contribution, GAIN_SD), (", not textbook", part.slack, OWN_SD), *doubts):
            if np.std(values) > (0.0 if d.plain else 0.02) * np.std(simulated):
                columns.append(values)
                sd.append(off * max(least / float(np.std(values)), 1.0))
                names.append(of + what)
    size = [max(float(np.std(c)), 1e-12) for c in columns]
    block = np.column_stack([c / s for c, s in zip(columns, size, strict=True)])
    index = library.add(block)
    active = Active(np.array([library.datum]), np.array([np.inf]))
    every = np.column_stack([np.ones(simulated.size), block])
    return active.plus(index, np.array(sd) * np.array(size)), ["datum", *names], every, np.r_[1.0, size]


def together(found: tuple[parts.Part, ...]) -> list[parts.Part]:
    """Parts that nearly cancel are one part: their own gains would let anything pass for a recalibration."""
    out: list[parts.Part] = []
    for part in found:
        for k, other in enumerate(out):
            if np.corrcoef(part.contribution, other.contribution)[0, 1] < -0.9:
                out[k] = replace(other, core=other.core + part.core, slack=other.slack + part.slack)
                break
        else:
            out.append(part)
    return out


def log_prior(library: hypotheses.Library, d: parts.Decomposition) -> np.ndarray:
    """Log prior odds: what the simulation already holds is seldom what it lacks."""
    held = np.std(np.sum([p.contribution for p in d.parts], axis=0)) if d.parts else 0.0
    present = {p.hypothesis.effect for p in d.parts if np.std(p.contribution) > 0.05 * held and p.certainty > SURE}
    held_by = {(p.hypothesis.effect, p.hypothesis.drivers) for p in d.parts if p.certainty > SURE}
    prior = np.array([h.prior for h in library.hypotheses])
    for i, h in enumerate(library.hypotheses):
        if h.effect in present:
            prior[i] += PRESENT + (SAME if (h.effect, h.drivers) in held_by else 0.0)
    return prior
