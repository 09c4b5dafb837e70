"""Noise model fitted to the residual of a response, and the search repeated in that noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from errpipe.diagnosis import admit, coloured
from errpipe.diagnosis.case import Case, SetUp, residual, residual_of_chosen
from errpipe.diagnosis.evidence import Data, Scene
from errpipe.diagnosis.hypotheses import Block, Hypothesis, columns_of, scaled
from errpipe.diagnosis.search import MISSING, Explanation, Search, converged
from errpipe.fitting.noise_floor import rounding, with_steps
from errpipe.terms import search_of

DEPENDENT = 1.8  # rows per independent row of the residual, above which rows are treated as correlated
CERTAIN = 150.0  # log Bayes factor above which no drifting noise could explain as much
COLOUR_PRICE = 6.0  # log of the number of colours tried
ROUNDED = 1.15  # threshold: rms over that of rounding (includes noise of a sixth of a step)
MOST_STEPS = 6  # steps of a gauge that jumps occasionally,
JUMPS = 10.0  # and log Bayes factor by which they must improve on names that only follow them
EXPLAINED = 20.0  # log Bayes factor by which another noise model must be likelier if names leave white noise
CLOSE_RIVAL = 0.05  # share of the log Bayes factor of a finding up to which a rival that loses it may do so by its grid


def needs_noise_model(made: SetUp, search: Search, explanation: Explanation) -> bool:
    """Is the residual autocorrelated, or a finding weak?"""
    weak = min((f.gain for f in explanation.accepted), default=np.inf) <= CERTAIN
    return weak or _dependence(made, search, explanation) > DEPENDENT


def _dependence(made: SetUp, search: Search, explanation: Explanation) -> float:
    """Rows per independent row of the residual."""
    return coloured.correlation_time(search.scene(explanation.chosen()).residual(), made.run)


def with_noise_model(made: SetUp, search: Search, explanation: Explanation) -> tuple[Search, Explanation]:
    """If the residual is autocorrelated or a finding weak: noise and explanation of the largest joint likelihood.

    The colour of the noise is fitted to the residual with and without the explanation, and the search repeated in it:
    a slow drift is then no evidence for a slow effect, and a step in it becomes significant.
    """
    made.in_own_noise = True
    if not needs_noise_model(made, search, explanation):
        return search, explanation
    dependent = _dependence(made, search, explanation) > DEPENDENT
    library, handicap = made.library, 0.0 if dependent else EXPLAINED
    shaped, unnamed = _shaped(made, search)
    best = max(likelihood(search, explanation.chosen()), shaped) + handicap, library.table.colour, search, explanation
    wandering = -np.inf  # log evidence of noise alone
    left = [residual_of_chosen(made, search, chosen) for chosen in ([], explanation.chosen())]
    for colour in dict.fromkeys(coloured.fitted(rest, made.run) for rest in (*left, unnamed)):
        library.recolour(colour)
        made.data = Data(library.table, made.y)
        found, names = refined(made, *converged(library, made.data, made.nuisance, made.prior, made.noise_estimate))
        wandering = max(wandering, likelihood(found, []))
        worth = max(likelihood(found, names.chosen()), _shaped(made, found)[0])
        best = max(best, (worth, colour, found, names), key=lambda t: t[0])
    _, colour, search, explanation = best
    if colour != library.table.colour:
        library.recolour(colour)
        search.data = Data(library.table, made.y)
    made.over_noise = likelihood(search, explanation.chosen()) - wandering
    made.data, search.prior = search.data, made.prior
    return search, explanation


def _shaped(made: SetUp, search: Search) -> tuple[float, np.ndarray]:
    """Log evidence of shapes over inputs instead of names, which count as one finding, and what they leave.

    A slow mechanism without a name is not noise: noise of its colour would hide it.
    """
    r = admit.remainder(search, [], made.free_shapes, made.places, inputs=True)
    left = made.y - made.judged().columns([], r.taken) @ Scene(search.data, r.active, search.noise).coefficients()
    return likelihood(search, []) + sum(gain for _, gain in r.shapes) - MISSING, left


def likelihood(search: Search, chosen: list[tuple[int, float]]) -> float:
    """Log evidence of hypotheses in noise of its colour, minus the cost of findings and of an unusual colour."""
    table = search.library.table
    gain = search.joint(chosen) if chosen else 0.0
    price = 0.0 if table.colour == coloured.USUAL else COLOUR_PRICE
    return search.evidence([]) + gain - price - coloured.scale(table.colour, table.run)


def refined(made: SetUp, search: Search, explanation: Explanation) -> tuple[Search, Explanation]:
    """The explanation with non-linear parameters between the grid points, which are added to the library.

    Otherwise the residual of a grid value would be mistaken for a second effect, or for slow noise, and a rival that
    explains as much would lose by that of its own.
    """
    search.prior, places = made.prior, [f.index for f in explanation.accepted]
    for k, f in enumerate(explanation.accepted):  # a rival is compared at its own best point
        places += [i for _, lost, i in search.rivals(explanation.accepted, k) if lost < CLOSE_RIVAL * f.gain]
    fresh = [(i, *near) for i in dict.fromkeys(places) for near in _neighbours(made, i)]
    if not fresh:
        return search, explanation
    made.library.extend([near[1:] for near in fresh])
    search.prior = made.prior = np.r_[made.prior, made.prior[[near[0] for near in fresh]]]
    chosen = search.tune(explanation.chosen())
    search.sigma = max(search.scene(chosen).rms(), 1e-9)
    alone = search.score([]).gain + search.prior
    return search, replace(explanation, accepted=search.accepted(chosen), alone=alone)


def _neighbours(made: SetUp, index: int) -> Iterator[tuple[Hypothesis, Block, int]]:
    """Hypotheses with each non-linear parameter of this one in turn near its value, blocks, numbers of core columns."""
    h, rows = made.library.hypotheses[index], made.pair.rows
    term, known = h.terms[0], {made.library.hypotheses[i].nonlinear for i in made.library.family(index)}
    for j, p in enumerate(term.nonlinear()):
        value, search = h.nonlinear[0][j], search_of(p)
        if p.name in term.fixed or value == 0 or h.mask:
            continue
        for step in search.neighbours(value, term, made.recording):
            if search.bounded and not p.bounds[0] <= step <= p.bounds[1]:
                continue
            near = tuple((*nl[:j], float(step), *nl[j + 1 :]) for nl in h.nonlinear)
            fine = replace(h, nonlinear=near)
            core, slack, freedom = columns_of(fine, made.recording)
            block = scaled(core[rows], slack[rows], freedom)
            if near not in known and block is not None:
                yield fine, block, core.shape[1]


def only_noise(case: Case) -> bool:
    """Is it likelier that nothing is missing, in noise that is a linear process, than what the names state?

    A wave in noise with a spectral peak there, or a bow in a random walk, is no finding. Discrete events,
    such as friction that reverses with the motion, are no linear process, however well neighbouring rows predict them.
    """
    if not case.chosen():
        return False
    bare = coloured.autoregression(residual(case, []), case.run)
    return not bare.has_heavy_tails() and _gain_of_names(case, bare) < 0.0


def _gain_of_names(case: Case, bare: coloured.Autoregression) -> float:
    """Gain of the noise's log evidence with the names, in full or in their textbook forms. bare: without names."""
    used = [case.search.scene(way).freedom_used() for way in (case.chosen(), [])]
    nonlinear = sum(len(f.hypothesis.nonlinear[0]) for f in case.explanation.accepted)
    library, rows = case.library, case.pair.rows
    blocks = [library.block(i, case.recording, rows)[:, : library.cores[i]] for i, _ in case.chosen()]
    columns = np.column_stack([case.recal, *blocks])
    textbook = case.y - columns @ np.linalg.lstsq(columns, case.y, rcond=None)[0]
    ways = (residual(case), used[0] - used[1]), (textbook, columns.shape[1] - case.recal.shape[1])
    return max(linear_gain(case, bare, left, count + nonlinear) for left, count in ways)


def only_steps(case: Case) -> bool:
    """Are a few steps in time (a gauge that jumps), each of own time and size, in such noise as likely as the names?

    A lag between constant speeds resembles a few steps: names that only follow jumps leave steps, true ones do not.
    """
    if not case.chosen() or case.taken_back:
        return False
    names = _gain_of_names(case, coloured.autoregression(residual(case, []), case.run))
    for chosen, least in ([], names), (case.chosen(), JUMPS):
        noise = coloured.autoregression(residual(case, chosen), case.run)
        left = enumerate(with_steps(case.y, case.judged().columns([i for i, _ in chosen]), MOST_STEPS), 1)
        if max(linear_gain(case, noise, rest, 2.0 * count) for count, rest in left) <= least:
            return False
    return True


def rounded(case: Case) -> bool:
    """Is the residual of a recalibration no more than the rounding of the reading to display steps?

    A reading rounded to steps q differs from the true value by q / sqrt(12) rms, along a smooth trend in waves.
    """
    rounded_away = rounding(case.recording.array(case.pair.error)[case.pair.rows])
    return float(np.std(residual(case, []))) < ROUNDED * rounded_away


def linear_gain(case: Case, before: coloured.Autoregression, after: np.ndarray, freedom: float) -> float:
    """Gain of the log evidence of noise as a linear process with an explanation, minus its penalty (BIC).

    before: of the residual without it; after: the residual with it (rows,); freedom: effective number of added
    coefficients.
    """
    grown = coloured.autoregression(after, case.run).evidence - before.evidence
    return grown - 0.5 * freedom * float(np.log(case.y.size))
