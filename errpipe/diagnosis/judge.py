"""One response from mismatch to verdict: the steps of this package in order."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
from scipy.special import ndtr, ndtri

from errpipe.diagnosis import admit, gains, holdout, hypotheses, model, partial, plausible, recalibration, unnamed
from errpipe.diagnosis import decompose as parts
from errpipe.diagnosis.case import Case, SetUp, residual
from errpipe.diagnosis.coloured import USUAL, correlation_time
from errpipe.diagnosis.evidence import ActiveSet, Data
from errpipe.diagnosis.left_out import datums, predicts_held_out, supported_by_held_out, zeroed_at_starts
from errpipe.diagnosis.own_noise import DEPENDENT, needs_noise_model, only_noise, refined, rounded, with_noise_model
from errpipe.diagnosis.prepare import Pair
from errpipe.diagnosis.search import MISSING, MORE, Explanation, Search, converged
from errpipe.diagnosis.shapes import Shape, shapes
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.fitting.noise_floor import noise_of_twin
from errpipe.terms import MANY_STARTS, NEVER

Progress = Callable[[float, str], None]
WIDE = 5.0  # factor on the gain limits for a simulation fitted without the missing effect
PROVED = 0.7  # mean square on held-out rows, over that without wide gains, from which they are accepted at any cost
WIDE_PRICE = 10.0  # log Bayes factor required for gains that far off, and MORE for each: each counts as a finding
MIN_SIZE = (0.15, 0.4)  # rms where it acts, in noise rms, below which a first or a further finding is not named
MIN_SHARE_OF_PART = 0.2  # of the simulation's part of that name and driver; a smaller finding only corrects its form
OUTLIER = 4.5  # an isolated row further than this from the explanation, in robust noise rms, is an outlier
OUTLIER_ROWS = 1000  # with more rows the limit rises, so that normal noise exceeds it equally rarely
HARMFUL = 1.02  # threshold: rms on held-out rows, over that without findings
PROVES = 0.3  # threshold: the same ratio, below which the findings are not slow noise (nine tenths of the variance)
NEARLY = 5.0  # log Bayes factor that an explanation with significant sizes may lose against one without
UNSTABLE = 20.0  # likewise for the findings of most folds against two names that few folds select
RETRIES = 4  # further searches, each without the findings ruled out before
WEAK = 50.0  # threshold: log Bayes factor of the strongest name, below which folds must confirm one of the names
SESSION_DATUM_PRICE = 10.0  # threshold: log Bayes factor for a datum of each session


def _with_parts(search: Search, explanation: Explanation, conditioned, rows) -> Explanation:
    """The explanation with partial effects added to the library."""
    if partial.add_parts(search, conditioned, rows, explanation.alone) and (in_part := search.explain()).accepted:
        search.sigma = max(search.scene(in_part.chosen()).rms(), 1e-9)
        return in_part
    return explanation


def _explains_share(search: Search, explanation: Explanation, noise_estimate: float, share: float = 0.88) -> bool:
    """Does the explanation reach this share of the variance that is neither noise nor recalibration?"""
    noise, base = 1.2 * noise_estimate, search.scene([]).rms()
    residual_rms = search.scene(explanation.chosen()).rms()
    return bool(explanation.accepted) and residual_rms**2 - noise**2 < (1 - share) * (base**2 - noise**2)


def large_enough(search: Search, explanation: Explanation, conditioned, rows, held: parts.Decomposition) -> Explanation:
    """The explanation without findings below the size thresholds, which only correct the form of another effect."""
    kept = list(explanation.accepted)
    while kept:
        b, first = search.scene([(f.index, f.size) for f in kept]).coefficients(), search.nuisance.index.size
        sizes = []
        for f in kept:
            block = search.library.block(f.index, conditioned, rows)
            contribution = block @ b[first : first + block.shape[1]]
            first += block.shape[1]
            active = np.abs(contribution) >= 0.1 * np.abs(contribution).max()
            size = float(np.sqrt(np.mean(contribution[active] ** 2)))
            sizes.append(0.0 if size < _least_size(search.library, f.index, held) else size / search.sigma)
        too_small = [k for k, size in enumerate(sizes) if size < MIN_SIZE[min(k, 1)]]
        if not too_small:
            break
        del kept[too_small[-1]]
    return replace(explanation, accepted=tuple(kept))


def _least_size(library, i: int, held: parts.Decomposition) -> float:
    """The rms below which a hypothesis only corrects the simulation's own part of the same form, not of another
    wave or of a bump elsewhere."""
    h = library.hypotheses[i]
    same = [p for p in held.parts if (p.hypothesis.effect, p.hypothesis.drivers) == (h.effect, h.drivers)]
    sizes = [
        float(np.std(p.contribution)) * recalibration.share_in_simulation(library, i, p.contribution) for p in same
    ]
    return MIN_SHARE_OF_PART * max(sizes, default=0.0)


def diagnose(raw: Recording, conditioned: Recording, pair: Pair, progress: Progress = lambda share, text: None) -> Case:
    """Explain one response; its outliers are then removed, and it is explained again."""
    case = _judge(raw, conditioned, pair, progress)
    outlying = _isolated_outliers(residual(case))
    if not outlying.any() or outlying.mean() > 0.03:
        return case
    aside = np.sort(np.r_[pair.outliers, pair.rows[outlying]])
    kept = replace(pair, rows=pair.rows[~outlying], mismatch=pair.mismatch[~outlying], outliers=aside)
    del case  # frees one table of products before the next is built
    return _judge(raw, conditioned, kept, progress)


def _judge(raw: Recording, conditioned: Recording, pair: Pair, progress: Progress) -> Case:
    """The explanation in fitted noise, or that in noise of the default colour if held-out rows prefer it."""
    made = _set_up(raw, conditioned, pair, progress)
    progress(0.5, f"{pair.component}: looking for what is missing")
    library = made.library
    search, first = _converged_search(made)
    in_part = _with_parts(search, first, conditioned, pair.rows)
    made.prior = search.prior.copy()
    plain = _best_plausible(replace(made, prior=search.prior.copy(), plain=True), copy.copy(search), in_part)
    if plain.explanation.accepted and needs_noise_model(plain, plain.search, plain.explanation):
        _held_out(plain)
    count, width = len(library.hypotheses), library.table.width
    case = _best_plausible(made, search, *([first] if in_part is first else [first, in_part]))
    usual_noise = library.table.colour == USUAL
    if plain.held is None or (usual_noise and not case.explanation.accepted):
        return case
    own = _held_out(case)
    if usual_noise and own.after <= HARMFUL * own.before:
        return case
    if not _speaks_for_usual_noise(own, plain.held):
        return case
    library.truncate(count, width)
    library.recolour(USUAL)
    plain.data = plain.search.data = Data(library.table, plain.y)
    return plain


def _speaks_for_usual_noise(own: holdout.HeldOut, usual: holdout.HeldOut) -> bool:
    """Do held-out rows prefer the explanation in noise of the default colour?

    Neighbouring held-out rows share the slow noise of the fitted rows: there the plain explanation replaces
    one that does harm, or wins if its names predict nearly all (shapes over time learn their neighbours' noise).
    Whole runs share none: there the better one wins, even if the other names nothing.
    """
    if "whole runs" in own.scheme:
        return usual.after < holdout.BETTER * min(own.after, usual.before)
    better = usual.names < holdout.BETTER * min(own.names, usual.before)
    return better and (own.after > HARMFUL * own.before or usual.names < PROVES * usual.before)


def _isolated_outliers(left: np.ndarray) -> np.ndarray:
    """Isolated outliers: rows beyond the threshold whose neighbours are not."""
    size = np.abs(left) / (1.4826 * np.median(np.abs(left)) + 1e-300)
    out = size > -ndtri(ndtr(-OUTLIER) * min(OUTLIER_ROWS / left.size, 1.0))
    return out & (np.r_[0.0, size[:-1]] + np.r_[size[1:], 0.0] < size)


def _best_plausible(made: SetUp, search: Search, *explanations: Explanation) -> Case:
    """The best of the search's explanations of a response, without implausible findings."""
    case = _found_by_folds(made, _without_impossible(made, search, *explanations))
    made.taken_back = (
        rounded(case) or (only_noise(case) and not _held_out(case).predicts_whole_runs()) or not _found_again(case)
    )
    return _best_among(made, False) if made.taken_back else case


def _found_by_folds(made: SetUp, case: Case) -> Case:
    """The case, or the effect that most folds select instead of two names that few select, if nearly as likely.

    Two look-alikes may fit all rows better than the single true effect if the folds select it in its own form.
    """
    if made.plain or len(case.chosen()) < 2 or max(_held_out(case).agreement) >= holdout.AGAIN or not case.held.often:
        return case
    one = _best_among(made, np.array([h.effect in case.held.often for h in made.library.hypotheses]))
    case.search.prior = np.r_[case.search.prior, made.prior[case.search.prior.size :]]
    close = one.chosen() and case.search.joint(case.chosen()) - one.search.joint(one.chosen()) <= UNSTABLE
    return one if close and not unnamed.departures_predict_held_out(one, _held_out(one)) else case


def _best_among(made: SetUp, among: np.ndarray | bool) -> Case:
    """The best explanation among some hypotheses, shape (hypotheses,); the others remain in the library."""
    prior, made.prior = made.prior, np.where(among, made.prior, NEVER)
    case = _best_explanation(made, *_converged_search(made))
    case.search.prior = made.prior = np.r_[prior, made.prior[prior.size :]]  # grid points may have been added
    return case


def _held_out(case: Case) -> holdout.HeldOut:
    case.held = case.held or holdout.held_out(case)
    return case.held


def _found_again(case: Case) -> bool:
    """Do folds select weak or partial names again, or do names improve held-out rows as much as they should?"""
    gain = max((f.gain for f in case.explanation.accepted), default=np.inf)
    strong = gain > WEAK and not any(f.hypothesis.mask for f in case.explanation.accepted)
    return not case.chosen() or strong or _held_out(case).confirms(gain, case.search.rows or case.run.size)


def _without_impossible(made: SetUp, search: Search, *explanations: Explanation) -> Case:
    """The best explanation without implausible findings, and without insignificant ones if one is nearly as likely."""
    case = _best_explanation(made, search, *explanations)
    for _ in range(RETRIES):
        out = plausible.impossible(case)
        if not out:
            break
        case = _best_without(made, out[-1])  # the weakest: the others may be implausible only because of it
    else:
        case = _best_among(made, False)  # no effect is accepted in their place either
    for m in plausible.doubtful(case)[:1]:
        prior = made.prior
        other = _best_without(made, m)
        joint = [c.search.joint(c.chosen()) for c in (other, case)]
        whole = [c.search.evidence(c.chosen()) - MISSING * len(c.chosen()) for c in (other, case)]
        close = joint[0] > joint[1] - NEARLY and whole[0] > whole[1] - NEARLY
        if other.chosen() and close and not plausible.doubtful(other) and not plausible.impossible(other):
            return other
        made.prior = np.r_[prior, made.prior[prior.size :]]  # grid points may have been added to the library
        case.search.prior = np.r_[case.search.prior, made.prior[case.search.prior.size :]]
    return case


def _best_without(made: SetUp, m: model.FittedFinding) -> Case:
    """The best explanation without a finding, at any value of its non-linear parameters."""
    own = [(h.effect, h.drivers) == (m.hypothesis.effect, m.hypothesis.drivers) for h in made.library.hypotheses]
    made.prior = np.where(own, NEVER, made.prior)  # earlier searches keep their own
    return _best_explanation(made, *_converged_search(made))


def _converged_search(made: SetUp) -> tuple[Search, Explanation]:
    return converged(made.library, made.data, made.nuisance, made.prior, made.noise_estimate)


def _set_up(raw: Recording, conditioned: Recording, pair: Pair, progress: Progress) -> SetUp:
    """Hypotheses, the simulated signal's parts, nuisances and shapes of one response."""
    rows = pair.rows
    progress(0.1, f"{pair.component}: listing what may be missing")
    simulated = pair.twin(conditioned)
    library = hypotheses.build(conditioned, pair.component, rows, raw, (pair.mismatch, simulated))
    progress(0.3, f"{pair.component}: taking the simulation apart")
    run = conditioned.run_codes()[rows]
    noise_estimate = first_noise(pair.mismatch, run)
    data = Data(library.table, pair.mismatch)
    plain = parts.static(simulated, library, raw, conditioned, rows)
    held = ([plain], None) if plain else parts.decompose(simulated, library, conditioned, rows, noise_estimate)
    decomposition, (nuisance, kinds, recal, sizes) = recalibration.most_likely(
        *held, simulated, library, data, noise_estimate
    )
    noise = noise_of_twin(simulated, pair.mismatch, run)
    if noise is not None:
        size = float(np.std(noise))
        nuisance = nuisance.plus(library.table.add(noise[:, None] / size), np.array([size]))
        recal, kinds, sizes = np.column_stack([recal, noise / size]), [*kinds, gains.NOISE], np.r_[sizes, size]
    prior = recalibration.log_prior(library, decomposition)
    of_row = sessions(conditioned)[rows]
    session: np.ndarray | None = None
    zeroed = raw.name("time") is not None and zeroed_at_starts(raw.array(pair.error)[rows], of_row)
    each = datums(conditioned, rows, of_row, library, pair.mismatch, zeroed)
    if each is not None and (
        zeroed or favours_session_datums(each[0], nuisance, library, data, prior, noise_estimate, run)
    ):
        nuisance = nuisance.plus(each[0].index, each[0].sd)
        recal, kinds = np.column_stack([recal, each[1]]), [*kinds, *each[2]]
        sizes = np.r_[sizes, np.ones(len(each[2]))]
        session = of_row if len(each[2]) >= MANY_STARTS else None  # with fewer, whole sessions are not held out
    free_shapes: list[Shape] = shapes(conditioned, pair.component, rows)
    places = [library.table.add(s.columns) for s in free_shapes]
    return SetUp(
        conditioned, pair, library, decomposition, simulated, pair.mismatch, run, data, prior, nuisance, kinds, recal,
        sizes, noise_estimate, free_shapes, places, session,
    )  # fmt: skip


def _best_explanation(made: SetUp, search: Search, *explanations: Explanation) -> Case:
    """The best explanation found by the search, in the noise that suits it, and the remainder test."""
    nuisance, rows = made.nuisance, made.pair.rows
    explanation = explanations[-1]
    if not made.plain:
        tried = [refined(made, copy.copy(search), e) for e in explanations]
        for one, _ in tried:
            one.prior = made.prior
        search, explanation = max(tried, key=lambda t: t[0].joint(t[1].chosen()))
    if not made.in_own_noise and not made.plain:
        search, explanation = with_noise_model(made, search, explanation)
    search, explanation, nuisance = _with_dependent_rows(made, search, explanation)
    held = made.decomposition
    judged, known = made.judged(), (made.nuisances, made.sizes, made.noise_estimate)
    exact = recalibration.missing_beyond_gains(search, explanation, judged, held, *known)
    if exact:
        (search, explanation, _), nuisance, held = exact, exact[0].nuisance, replace(held, parts=())
    most, explanation = len(explanation.accepted), large_enough(search, explanation, made.recording, rows, held)
    if 0 < len(explanation.accepted) < most:  # another name may be likelier on its own
        explanation = replace(explanation, accepted=search.accepted(search.exchanged(explanation.chosen())))
    kept = supported_by_held_out(search, explanation.chosen(), judged)
    if len(kept) < len(explanation.accepted):
        explanation = replace(explanation, accepted=search.accepted(kept))
    explanation = replace(explanation, accepted=search.prefer_simpler(explanation.accepted))
    chosen = explanation.chosen()
    search.sigma = sigma = max(search.scene(chosen).rms(), 1e-9)
    remainder = admit.remainder(search, chosen, made.free_shapes, made.places)
    if made.session is not None and not predicts_held_out(search, chosen, remainder, judged):
        remainder = admit.remainder(search, chosen, [], [])
    whole = {f.name: getattr(made, f.name) for f in fields(SetUp)} | {"nuisance": nuisance}
    whole["of_a_twin"] = bool(exact and exact[2])
    return Case(**whole, search=search, explanation=explanation, sigma=sigma, remainder=remainder)


def _with_dependent_rows(
    made: SetUp, search: Search, explanation: Explanation
) -> tuple[Search, Explanation, ActiveSet]:
    """If the residual is autocorrelated: an effective number of rows, and a wider prior on the gains.

    The effective number comes from the best single effect's residual: two effects may overfit.
    """
    library, nuisance, run, noise = made.library, made.nuisance, made.run, made.noise_estimate
    time = correlation_time(search.scene(explanation.chosen()).residual(), run)
    if time <= DEPENDENT:
        return search, explanation, nuisance
    worth = max(run.size / time, 30.0)
    single, one = converged(library, made.data, nuisance, search.prior, noise, worth, most=1)
    left = single.scene(one.chosen()).residual()
    if not (_explains_share(search, explanation, noise) and not _explains_share(single, one, noise, 0.75)):
        worth = max(run.size / max(time, correlation_time(left, run)), 30.0)
        search, explanation = converged(library, made.data, nuisance, search.prior, noise, worth)
    wide = ActiveSet(nuisance.index, nuisance.sd * np.where([n.is_gain for n in made.nuisances], WIDE, 1.0))
    other, wide_gains = converged(library, made.data, wide, search.prior, noise, worth, weighed=False)
    chosen = [e.chosen() for e in (explanation, wide_gains)]
    if search.rows:
        narrow, proved = (made.judged().of_explanation(*way) for way in ((search, chosen[0]), (other, chosen[1])))
        price = WIDE_PRICE + MORE * gains.count_distant_gains(other.scene(chosen[1]), made.nuisances, made.sizes)
        likelier = other.evidence(chosen[1]) > search.evidence(chosen[0]) + price
        if proved < PROVED * narrow or (likelier and proved < narrow):
            return other, wide_gains, wide
    return search, explanation, nuisance


def favours_session_datums(
    each_datum: ActiveSet, nuisance: ActiveSet, library, data: Data, prior, noise_estimate: float, run: np.ndarray
) -> bool:
    """Is the best explanation likelier with a datum for each session than the best one with a single datum?

    The evidence penalises each datum. The effective number of rows comes from the residual with all datums fitted.
    """
    nuisances = [nuisance.plus(each_datum.index, each_datum.sd), nuisance]
    both = [converged(library, data, n, prior, noise_estimate) for n in nuisances]
    scenes = [s.scene(e.chosen()) for s, e in both]
    worth = max(run.size / correlation_time(scenes[0].residual(), run), 30.0)
    with_each, with_one = (
        scene.evidence(worth) + sum(float(prior[f.index]) - MORE for f in e.accepted)
        for scene, (_, e) in zip(scenes, both, strict=True)
    )
    return with_each > with_one + SESSION_DATUM_PRICE


def first_noise(y: np.ndarray, run: np.ndarray) -> float:
    """Noise from second differences between neighbours, robust; an upper bound if the mismatch is noise itself."""
    same = (run[2:] == run[1:-1]) & (run[1:-1] == run[:-2])
    bend = (y[2:] - 2 * y[1:-1] + y[:-2])[same]
    if bend.size < 10:
        return float(np.std(y)) or 1e-9
    return float(max(1.4826 * np.median(np.abs(bend)) / np.sqrt(6.0), 1e-6 * np.std(y), 1e-12))
