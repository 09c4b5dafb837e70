"""One response from mismatch to verdict: the steps of this package in their order."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from errpipe.diagnosis import admit, gains, hypotheses, partial
from errpipe.diagnosis import decompose as parts
from errpipe.diagnosis.evidence import Active, Data, Scene, correlation_time
from errpipe.diagnosis.left_out import LeftOut, datums, predicts_held_out, supported_by_held_out
from errpipe.diagnosis.prepare import Pair
from errpipe.diagnosis.search import MOST, Explanation, Search
from errpipe.diagnosis.shapes import Shape, shapes
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.terms import NEVER

GAIN_SD = 0.10  # how far a simulation's gains are usually off (0..15 %)
MISSING = 10.0  # log Bayes factor for the first finding
MORE = 10.0  # and for each further one
OFF = 3.0  # log Bayes factor for a recalibration
OWN_SD = 0.04  # how far the gain of what is not textbook in a part is off beside the gain of the part
PRESENT = -4.0  # log prior odds against an effect that the simulation already holds,
SAME = -12.0  # and again where it would be driven by the same columns
SURE = 15.0  # log Bayes factor from which a part of the simulation is sure to be there

Progress = Callable[[float, str], None]


@dataclass
class Case:
    """All that is known about one response while it is judged."""

    recording: Recording  # conditioned
    pair: Pair
    library: hypotheses.Library
    decomposition: parts.Decomposition
    simulated: np.ndarray
    y: np.ndarray
    run: np.ndarray
    nuisance: Active
    names: list[str]
    recal: np.ndarray  # the nuisances' columns before whitening
    sizes: np.ndarray  # rms of what each of them stands for: its coefficient over this is a gain less 1
    search: Search
    explanation: Explanation
    sigma: float
    remainder: admit.Remainder
    noise_estimate: float  # noise from second differences
    free_shapes: list[Shape]  # shapes without a name
    places: list[np.ndarray]  # their columns in the library's table
    session: np.ndarray | None = None  # of each row, where each session has its own datum

    def chosen(self) -> list[tuple[int, float]]:
        """Accepted hypotheses with their sizes."""
        return [(f.index, f.size) for f in self.explanation.accepted]


WIDE = 5.0  # a simulation fitted without the missing effect may have gains this much further off
DEPENDENT = 1.8  # rows per independent row of what is left, from which rows count for less
WIDE_PRICE = 10.0  # log Bayes factor it takes to believe so


def _settled(library, data, nuisance, prior, noise_estimate, rows=None, most=MOST) -> tuple[Search, Explanation]:
    """Search until the noise level agrees with what the explanation leaves."""
    sigma = noise_estimate
    for _ in range(4):
        search = Search(library, data, nuisance, sigma, prior, MISSING, MORE, rows)
        search.most = most
        explanation = search.explain()
        left = search.scene([(f.index, f.size) for f in explanation.accepted]).rms()
        if abs(left / sigma - 1) < 0.03:
            break
        sigma = max(left, 1e-9)
    return search, explanation


def _with_parts(search: Search, explanation: Explanation, conditioned, rows) -> Explanation:
    """The explanation once effects that act in part have joined the library."""
    if not partial.add_parts(search, conditioned, rows, explanation.alone):
        return explanation
    in_part = search.explain()
    if not in_part.accepted:
        return explanation
    search.sigma = max(search.scene([(f.index, f.size) for f in in_part.accepted]).rms(), 1e-9)
    return in_part


def _reached(search: Search, explanation: Explanation, noise_estimate: float, share: float = 0.88) -> bool:
    """Does the explanation reach this share of the variance that is neither noise nor recalibration?"""
    noise, base = 1.2 * noise_estimate, search.scene([]).rms()
    left = search.scene([(f.index, f.size) for f in explanation.accepted]).rms()
    return bool(explanation.accepted) and left**2 - noise**2 < (1 - share) * (base**2 - noise**2)


MIN_SIZE = (0.15, 0.4)  # rms where it acts, in noise rms, below which a first or a further finding is not named


MIN_SHARE_OF_PART = (
    0.2  # size beside the simulation's own part of that name and driver, below which a finding mends its form
)


def worth_naming(search: Search, explanation: Explanation, conditioned, rows, held: parts.Decomposition) -> Explanation:
    """The explanation without findings too small to be physics of their own: they mend the form of something else."""
    own = {
        (p.hypothesis.effect, p.hypothesis.drivers): MIN_SHARE_OF_PART * float(np.std(p.contribution))
        for p in held.parts
    }
    kept = list(explanation.accepted)
    while kept:
        scene = search.scene([(f.index, f.size) for f in kept])
        b, first = scene.coefficients(), search.nuisance.index.size
        sizes = []
        for f in kept:
            block = search.library.block(f.index, conditioned, rows)
            contribution = block @ b[first : first + block.shape[1]]
            first += block.shape[1]
            acting = np.abs(contribution) > 0.1 * np.abs(contribution).max()
            size = float(np.sqrt(np.mean(contribution[acting] ** 2)))
            mends = size < own.get((f.hypothesis.effect, f.hypothesis.drivers), 0.0)
            sizes.append(0.0 if mends else size / search.sigma)
        too_small = [k for k, size in enumerate(sizes) if size < MIN_SIZE[min(k, 1)]]
        if not too_small:
            break
        del kept[too_small[-1]]
    return replace(explanation, accepted=tuple(kept))


OUTLIER = 4.5  # a lone row further than this from the explanation, in robust noise rms, is an outlier


def judge(raw: Recording, conditioned: Recording, pair: Pair, progress: Progress = lambda share, text: None) -> Case:
    """Explain one response; outliers that only the explanation shows are set aside, and it is explained again."""
    case = _judge(raw, conditioned, pair, progress)
    outlying = _isolated(residual(case))
    if not outlying.any() or outlying.mean() > 0.03:
        return case
    kept = replace(
        pair,
        rows=pair.rows[~outlying],
        mismatch=pair.mismatch[~outlying],
        outliers=np.sort(np.r_[pair.outliers, pair.rows[outlying]]),
    )
    del case  # or two tables of products are held at once
    return _judge(raw, conditioned, kept, progress)


def _isolated(left: np.ndarray) -> np.ndarray:
    """Rows far out whose neighbours are not."""
    size = np.abs(left) / (1.4826 * np.median(np.abs(left)) + 1e-300)
    out = size > OUTLIER
    beside = np.r_[0.0, size[:-1]] + np.r_[size[1:], 0.0]
    return out & (beside < size)


def _judge(raw: Recording, conditioned: Recording, pair: Pair, progress: Progress) -> Case:
    rows = pair.rows
    progress(0.1, f"{pair.component}: listing what may be missing")
    simulated = conditioned.array(pair.simulated)[rows]
    library = hypotheses.build(conditioned, pair.component, rows, raw, (pair.mismatch, simulated))
    progress(0.3, f"{pair.component}: taking the simulation apart")
    run = conditioned.run_codes()[rows]
    noise_estimate = first_noise(pair.mismatch, run)
    data = Data(library.table, pair.mismatch)
    plain = parts.static(simulated, library, raw, conditioned, rows)
    alternatives = [plain] if plain else parts.decompose(simulated, library, conditioned, rows, noise_estimate)
    progress(0.5, f"{pair.component}: looking for what is missing")
    decomposition, (nuisance, names, recal, sizes) = _likeliest(alternatives, simulated, library, data, noise_estimate)
    prior = log_prior(library, decomposition)
    session = sessions(conditioned)[rows]
    each_datum = datums(conditioned, rows, session, library, pair.mismatch)
    if each_datum is not None and favours_session_datums(
        each_datum[0], nuisance, library, data, prior, noise_estimate, run
    ):
        nuisance = nuisance.plus(each_datum[0].index, each_datum[0].sd)
        recal, names = np.column_stack([recal, each_datum[1]]), [*names, *each_datum[2]]
        sizes = np.r_[sizes, np.ones(len(each_datum[2]))]
    else:
        session = None
    free_shapes: list[Shape] = shapes(conditioned, pair.component, rows)
    every = library.add(np.column_stack([s.columns for s in free_shapes]))
    edges = np.cumsum([0, *[s.columns.shape[1] for s in free_shapes]])
    places = [every[a:b] for a, b in itertools.pairwise(edges)]
    search, explanation = _settled(library, data, nuisance, prior, noise_estimate)
    explanation = _with_parts(search, explanation, conditioned, rows)
    left = search.scene([(f.index, f.size) for f in explanation.accepted]).residual()
    time = correlation_time(left, run)
    if time > DEPENDENT:
        # the best that can be said leaves rows that go together: they count for less, and gains may be far off
        # (how much less, the best single effect tells: what two reach together may have been bent to the rows)
        worth = max(run.size / time, 30.0)
        single, one = _settled(library, data, nuisance, search.prior, noise_estimate, worth, most=1)
        left = single.scene([(f.index, f.size) for f in one.accepted]).residual()
        if not (_reached(search, explanation, noise_estimate) and not _reached(single, one, noise_estimate, 0.75)):
            worth = max(run.size / max(time, correlation_time(left, run)), 30.0)
            search, explanation = _settled(library, data, nuisance, search.prior, noise_estimate, worth)
        wide = Active(nuisance.index, nuisance.sd * np.where([n.startswith("datum") for n in names], 1.0, WIDE))
        other, wide_gains = _settled(library, data, wide, search.prior, noise_estimate, worth)
        chosen = [[(f.index, f.size) for f in e.accepted] for e in (explanation, wide_gains)]
        if search.rows and other.evidence(chosen[1]) > search.evidence(chosen[0]) + WIDE_PRICE:
            search, explanation, nuisance = other, wide_gains, wide
    if search.rows is None:  # else the simulation lacks so much that its gains may be anything
        search, explanation = _within_limits(search, explanation, decomposition, names, recal, sizes, noise_estimate)
    explanation = worth_naming(search, explanation, conditioned, rows, decomposition)
    judged = LeftOut(library, conditioned, rows, pair.mismatch, recal, session, free_shapes)
    kept = supported_by_held_out(search, [(f.index, f.size) for f in explanation.accepted], judged)
    if len(kept) < len(explanation.accepted):
        explanation = replace(explanation, accepted=search.accepted(kept))
    sigma = max(search.scene([(f.index, f.size) for f in explanation.accepted]).rms(), 1e-9)
    search.sigma = sigma
    chosen = [(f.index, f.size) for f in explanation.accepted]
    rest = admit.remainder(search, library, chosen, free_shapes, places)
    if session is not None and not predicts_held_out(search, chosen, rest, judged):
        rest = admit.remainder(search, library, chosen, [], [])
    return Case(
        conditioned,
        pair,
        library,
        decomposition,
        simulated,
        pair.mismatch,
        run,
        nuisance,
        names,
        recal,
        sizes,
        search,
        explanation,
        sigma,
        rest,
        noise_estimate,
        free_shapes,
        places,
        session,
    )


SESSION_DATUM_PRICE = 10.0  # log Bayes factor from which it is believed


def favours_session_datums(
    each_datum: Active, nuisance: Active, library, data: Data, prior, noise_estimate: float, run: np.ndarray
) -> bool:
    """Is the best explanation likelier with a datum for each session than the best one with a single datum?

    Each datum pays for its freedom. Rows count for less where what is left beside all datums still goes together.
    """
    tried = [nuisance.plus(each_datum.index, each_datum.sd), nuisance]
    settled = [_settled(library, data, n, prior, noise_estimate) for n in tried]
    left = [s.scene([(f.index, f.size) for f in e.accepted]) for s, e in settled]
    worth = max(run.size / correlation_time(left[0].residual(), run), 30.0)
    with_each, with_one = (
        scene.evidence(worth) + sum(float(prior[f.index]) - MORE for f in e.accepted)
        for scene, (_, e) in zip(left, settled, strict=True)
    )
    return with_each > with_one + SESSION_DATUM_PRICE


MAX_GAIN_PENALTY = (
    60.0  # log evidence that gains beyond the limits can cost at most: the signal may have been taken apart wrongly
)
CLAMPED_SD = 0.03  # freedom of a gain beyond the limits, while another explanation is looked for


def _worth(search: Search, explanation: Explanation, rows: np.ndarray) -> float:
    """Log evidence less what findings and gains beyond the limits cost."""
    chosen = [(f.index, f.size) for f in explanation.accepted]
    gain_penalty, _ = gains.excess(search.scene(chosen), rows, search.rows)
    return search.evidence(chosen) - MISSING * len(chosen) - min(gain_penalty, MAX_GAIN_PENALTY)


def _within_limits(search, explanation, d: parts.Decomposition, names, recal, sizes, noise_estimate):
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
    other, clamped = _settled(search.library, search.data, kept, prior, noise_estimate, search.rows)
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


def _likeliest(alternatives: list[parts.Decomposition], simulated, library, data: Data, noise_estimate: float):
    """The decomposition that makes signal and mismatch likeliest together, with its recalibration."""
    tried = []
    for d in alternatives:
        nuisance, *told = recalibration(simulated, d, library)
        worth = TRUST * d.worth
        if len(alternatives) > 1:
            search, e = _settled(library, data, nuisance, log_prior(library, d), noise_estimate)
            worth += _worth(search, e, gains.totals(told[0], told[2])[1])
        tried.append((worth, (d, (nuisance, *told))))
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
        if not h.terms[0].missing:
            prior[i] = NEVER
    return prior


def first_noise(y: np.ndarray, run: np.ndarray) -> float:
    """Noise from second differences between neighbours, robust; an upper bound where the mismatch is noise_estimate."""
    same = (run[2:] == run[1:-1]) & (run[1:-1] == run[:-2])
    bend = (y[2:] - 2 * y[1:-1] + y[:-2])[same]
    if bend.size < 10:
        return float(np.std(y)) or 1e-9
    return float(max(1.4826 * np.median(np.abs(bend)) / np.sqrt(6.0), 1e-6 * np.std(y), 1e-12))


def residual(case: Case, chosen: list[tuple[int, float]] | None = None) -> np.ndarray:
    """What the explanation leaves, on the judged rows."""
    chosen = case.chosen() if chosen is None else chosen
    scene = case.search.scene(chosen)
    blocks = [case.library.block(i, case.recording, case.pair.rows) for i, _ in chosen]
    return case.y - np.column_stack([case.recal, *blocks]) @ scene.coefficients()


def own_datums(case: Case, chosen: list[tuple[int, float]]) -> np.ndarray | None:
    """What the datums of single runs carry beside these hypotheses, on the judged rows; None where one is for all."""
    own = [j for j, name in enumerate(case.names) if name.startswith("datum of")]
    if not own:
        return None
    return case.recal[:, own] @ case.search.scene(chosen).coefficients()[own]


def needs_recalibration(case: Case) -> bool:
    """Are datum or gains off beyond doubt?"""
    full = case.search.active(case.chosen())
    m = case.nuisance.index.size
    without = Active(full.index[m:], full.sd[m:])
    scene = Scene(case.search.data, without, case.sigma)
    own = np.array([name.startswith("datum") for name in case.names])
    datum, gains = case.nuisance.index[own], case.nuisance.index[~own]
    sets = [datum, gains[:1], np.r_[datum, gains[:1]], np.r_[datum, gains]]
    sets += [np.r_[datum, g] for g in gains[1:]]
    scored = scene.score(sets, [np.ones(s.size) for s in sets])
    return max(s.gain for s in scored) > OFF + np.log(len(sets))  # the best of so many
