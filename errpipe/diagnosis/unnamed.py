"""The finding `unknown`: the probability of a mechanism outside the library, and its sentence."""

from __future__ import annotations

import numpy as np

from errpipe.diagnosis import confidence, holdout, hypotheses, model, plausible
from errpipe.diagnosis.case import Case, residual
from errpipe.diagnosis.coloured import USUAL, autoregression, is_linear_noise, levels_jump
from errpipe.diagnosis.evidence import Scene
from errpipe.diagnosis.own_noise import linear_gain, rounded, rounding
from errpipe.diagnosis.search import BETTER
from errpipe.domain.diagnosis import Finding

HELD_OUT_SHARE = 0.1  # threshold: share of the held-out variance beyond the names that shapes over inputs must predict
NOTICEABLE = 0.04  # and of that without names: right names leave up to 0.027 (first 41201, second 41202 and real axes)
PROVISIONAL = 0.4  # upper limit of the confidence of `unknown` below that threshold,
NOISE = 0.2  # and if the residual is a linear Gaussian process
TEXTBOOK = 0.7  # threshold: share of the names' held-out prediction that their textbook forms provide, and
ALONE = 0.5  # of the first one's log Bayes factor that its textbook form reaches alone; if both are lower, the
# form is another's (chosen on trials/first 9535, 9561, 9801, 12201, 13121, second 9536, 9562, 9802, 13122: of 113 none)
UNSTABLE = -1.0  # a textbook form that harms held-out rows by more than names help was not fitted with the others
DEPARTED = 0.7  # confidence of `unknown` in that case
SMALLER = 0.75  # threshold: rms on held-out rows over that without names, from which names are unconfirmed
UNLIKELY = 0.08  # threshold: confidence of the surest name, below which `unknown` comes first (chosen on first 6103 and
# 6106, second 6104 and 6105)
UNLIKELY_IN_PART = 0.5  # and of partial names, which are many (chosen on first 42103, 43102, second 42101, 42102,
# 42104, 43101, 51101, 51102: false ones have 0.15 to 0.47, right ones 0.66 or more)
WANDERING = 1.5  # threshold: rms of the residual over the noise between neighbours, from which it drifts,
PREDICTED = 0.85  # and rms of its innovations over its own, below which earlier rows predict it (heavy tails do not)
FAR = 2.0  # and from which names that hardly reduce it explain nothing
SLOW_SHARE = 1.2  # rms of noise with its slow share over second differences, which do not include that share
UNREACHED = 0.25  # threshold: share of the variance beyond the noise between neighbours, and beyond that of the names,
# from which `unknown` comes first: drifting noise with an effect of twice its size leaves a fifth


def unknown_probability(case: Case, indicators: list[confidence.Indicators], held: holdout.HeldOut) -> float:
    """Probability of a mechanism outside the library; PROVISIONAL if held-out rows do not confirm it.

    Autocorrelated residuals alone (a drift, heavy tails, steps, coarse resolution) are no mechanism: shapes over inputs
    must predict held-out rows, or the residual must consist of events or a rhythm.
    """
    if rounded(case):
        return 0.0
    if departures_predict_held_out(case, held) or unnamed_structure(case, held):
        return max(confidence.unknown(indicators[0]), DEPARTED)
    if indicators:
        p = confidence.unknown(indicators[0])
    else:
        gain = sum(g for _, g in case.remainder.shapes)
        base = case.search.scene([]).rms()
        drop = 1.0 - (case.remainder.rms / base) ** 2 if base > 0 else 0.0
        p = confidence.unknown_alone(gain, drop, max(held.shape_share(), 0.0))
    if unexplained(case, held) or has_slow_drift(case):
        p = max(p, PROVISIONAL)
    if p < NOISE or shapes_predict_held_out(case, held):
        return p
    return min(p, NOISE if is_noise(case) or is_of_the_signal(case, held) else PROVISIONAL)


def is_of_the_signal(case: Case, held: holdout.HeldOut) -> bool:
    """Does the simulated signal itself account for what names leave, which predict a share of the held-out variance?

    A repeated measurement has noise, its signal is no sum of effects, or its gains are 1: rhythm and drift of both are
    in the mismatch.
    """
    repeated = case.of_a_twin or not case.decomposition.parts or any(n.kind == "noise" for n in case.nuisances)
    predicted = held.named**2 <= (1.0 - UNREACHED) * held.bare**2
    return repeated and predicted and confirmed_by_held_out(case, held)


def with_shapes(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Contribution of the unnamed shapes on the selected rows, and the residual of findings and shapes."""
    columns = case.judged().columns([i for i, _ in case.chosen()], case.remainder.taken)
    b = Scene(case.search.data, case.remainder.active, case.search.noise).coefficients()
    first = b.size - sum(case.free_shapes[k].columns.shape[1] for k in case.remainder.taken)
    return columns[:, first:] @ b[first:], case.y - columns @ b


def is_noise(case: Case) -> bool:
    """Is the residual a linear Gaussian process, from run to run as well as within runs?"""
    left, t = residual(case), case.recording.time()[case.pair.rows]
    return is_linear_noise(left, case.run) and not levels_jump(left, case.run, t)


def shapes_are_noise(case: Case) -> bool:
    """Does a linear process explain as much as the shapes, the strongest of which is one over time or runs?

    Slow inputs then behave as a random walk between held-out rows.
    """
    if not case.remainder.shapes or case.remainder.shapes[0][0].of_inputs:
        return False
    scenes = Scene(case.search.data, case.remainder.active, case.search.noise), case.search.scene(case.chosen())
    freedom = scenes[0].freedom_used() - scenes[1].freedom_used()
    named = autoregression(residual(case), case.run)
    return linear_gain(case, named, with_shapes(case)[1], freedom) < 0.0


def has_slow_drift(case: Case) -> bool:
    """Does the residual drift far beyond the noise between neighbours, by its colour or by an autoregression?"""
    left, own = residual(case), case.library.table.colour
    slow = case.taken_back or (own != USUAL and own.share > 0.5)
    if not slow and not case.explanation.accepted:
        innovations = autoregression(left, case.run).innovations
        slow = innovations.size > 0 and float(np.std(innovations)) < PREDICTED * float(np.std(left))
    return slow and float(np.std(left)) > WANDERING * case.noise_estimate


def unexplained(case: Case, held: holdout.HeldOut) -> bool:
    """Do names leave a large residual that is not noise?

    They hardly reduce held-out rows of the same runs, which lie far beyond the noise between neighbours; or shapes
    over inputs predict held-out rows better; or a large share of the residual consists of events or a rhythm.
    """
    if not case.explanation.accepted:
        return False
    before, after = held.trimmed
    far = after > max(SMALLER * before, FAR * case.noise_estimate) and "whole runs" not in held.scheme
    return far or unnamed_structure(case, held) or _rhythm_remains(case, held)


def _rhythm_remains(case: Case, held: holdout.HeldOut) -> bool:
    """Do names leave a large share of events or of a rhythm, also compared with their own contribution?

    Tools that wear at individual rates leave events, and yet held-out whole runs confirm the name. Real
    noise also contains events, and may be far above that between neighbours.
    """
    if unexplained_share(case) <= UNREACHED or held.predicts_whole_runs() or is_noise(case):
        return False
    blocks = [case.library.block(i, case.recording, case.pair.rows) for i, _ in case.chosen()]
    named = np.column_stack(blocks) @ case.search.scene(case.chosen()).coefficients()[case.recal.shape[1] :]
    return case.sigma**2 > UNREACHED * (case.sigma**2 + float(np.var(named)))


def shapes_predict_held_out(case: Case, held: holdout.HeldOut) -> bool:
    """Do shapes over inputs predict held-out rows beyond the names, and better than for slow noise?"""
    return held.shape_share() >= HELD_OUT_SHARE and not (is_noise(case) and shapes_are_noise(case))


def unnamed_structure(case: Case, held: holdout.HeldOut) -> bool:
    """Are those shapes a mechanism besides the names? On held-out rows alone the names of a fold may have missed it."""
    share, gain = held.shape_share(), sum(g for _, g in case.remainder.shapes)
    again = gain > 0.0 or min(held.agreement, default=0.0) >= holdout.AGAIN
    enough = again and share >= UNREACHED and unexplained_share(case) > UNREACHED
    enough = enough or (share >= HELD_OUT_SHARE and gain >= confidence.MOST_BESIDE)
    enough = enough and held.named**2 - held.shaped**2 >= NOTICEABLE * held.bare**2
    return bool(case.explanation.accepted) and enough and shapes_predict_held_out(case, held)


def unexplained_share(case: Case) -> float:
    """Share of the structured variance in the residual of the names, beyond noise between neighbours and rounding."""
    noise = SLOW_SHARE * max(case.noise_estimate, rounding(case.recording.array(case.pair.error)[case.pair.rows]))
    beyond = case.search.scene([]).rms() ** 2 - noise**2
    return float(np.clip((case.sigma**2 - noise**2) / beyond, 0.0, 1.0)) if beyond > 0 else 0.0


def unlikely(case: Case, findings: list[Finding]) -> bool:
    """Is every name too unlikely to precede `unknown`? Stretches and unions of three or more runs are many.

    So are parts that shapes over inputs exceed.
    """
    if is_a_level(case):
        return True
    masks = [f.hypothesis.mask for f in case.explanation.accepted]
    shaped = any(shape.of_inputs for shape, _ in case.remainder.shapes)
    among_many = all(mask and (shaped or mask[0] == "range" or len(mask[1]) > 2) for mask in masks)
    return max(f.group_confidence() for f in findings) < (UNLIKELY_IN_PART if among_many else UNLIKELY)


def is_a_level(case: Case) -> bool:
    """Is a constant level, or one of each run, likelier than the first name on that part of the rows, odds aside?

    A joint between two scales, a weight on the foundation or a reflector set up anew is a level. Where its inputs
    hardly change, or its own level follows it, an effect resembles one.
    """
    if not case.explanation.accepted or not (mask := case.explanation.accepted[0].hypothesis.mask):
        return False
    first, *others = case.explanation.accepted
    inside = hypotheses.mask_of(mask, case.recording)[case.pair.rows]
    level = case.library.table.add(((inside - inside.mean()) / (inside.std() or 1.0))[:, None])
    each = [k for k, s in enumerate(case.free_shapes) if s.kind == "runs" and mask[0] == "runs"]
    sets = [level, *(case.places[k] for k in each)]
    freedoms = [np.ones(1), *(case.free_shapes[k].freedom for k in each)]
    gains = case.search.scene([(f.index, f.size) for f in others]).gains(sets, freedoms, case.search.rows)
    return bool(gains.max() >= first.gain - case.search.prior[first.index] + BETTER)


def confirmed_by_held_out(case: Case, held: holdout.HeldOut) -> bool:
    """Do names reduce the held-out residual beyond the noise between neighbours, as much as they promise?

    In a long log an effect may be smaller than the noise of a single row. A recalibration alone also reduces it: with
    one, names must improve the log likelihood of held-out rows as their log Bayes factor predicts.
    """
    beyond = [max(rms**2 - case.noise_estimate**2, 0.0) for rms in (held.after, held.before)]
    promised = max((f.gain for f in case.explanation.accepted), default=0.0)
    confirmed = held.confirms(promised, case.search.rows or case.run.size)
    return held.after < held.before and beyond[0] <= SMALLER**2 * beyond[1] and confirmed


def departures_predict_held_out(case: Case, held: holdout.HeldOut) -> bool:
    """Do departures from the textbook forms predict held-out rows as an unnamed shape must?

    Real parts differ from the textbook by a few per cent of the variance; beyond that, the form is that of another
    mechanism. Not counted are the decay of an initial state, any shape of a guideway, and wear rates of single tools.
    """
    first = case.explanation.accepted[0].hypothesis if case.explanation.accepted else None
    if first is None or first.terms[0].form == "any rate":
        return False
    if held.departure_share() < HELD_OUT_SHARE or not UNSTABLE < held.textbook_share() < TEXTBOOK:
        return False
    return textbook_alone(case) < ALONE or plausible.is_insignificant(model.fit_finding(case, 0))


def textbook_alone(case: Case) -> float:
    """Share of the first finding's log Bayes factor that its textbook form reaches without departures.

    Its non-linear parameters are those that fit the textbook form best.
    """
    first, *others = case.explanation.accepted
    if first.hypothesis.terms[0].gain_sd is not None:
        return 1.0
    library, family = case.library, case.library.family(first.index)
    columns = [library.places[i][: library.textbook(i)] for i in family]
    freedoms = [library.freedoms[i][: library.textbook(i)] for i in family]
    scored = case.search.scene([(f.index, f.size) for f in others]).gains(columns, freedoms, case.search.rows)
    return float(np.max(scored + case.search.prior[family]) / max(first.gain, 1e-9))


def finding(case: Case, probability: float) -> Finding:
    """The finding `unknown`: structure that no effect explains, its inputs and its shape."""
    if departures_predict_held_out(case, case.held):  # the inputs of a name are right, but not its form
        h = case.explanation.accepted[0].hypothesis
        says = (
            f"Structure correlates with {' and '.join(h.drivers)} in a form that no effect of the vocabulary has: "
            f"what departs from the textbook form of {h.effect.replace('_', ' ')} predicts "
            f"{case.held.departure_share():.0%} of the held-out variance."
        )
        return _unknown(probability, h.drivers, says, case.search.scene([]).rms() ** 2 - case.sigma**2)
    shapes, clock = case.remainder.shapes, case.recording.name("time") or "row"
    drivers = tuple(dict.fromkeys(d for s, _ in shapes[:2] for d in s.drivers)) or (clock,)
    says = (
        f"Structure remains that no effect of the vocabulary explains; it correlates with {' and '.join(drivers)}. A "
        f"data-driven shape brings it from {case.sigma:.3g} to {case.remainder.rms:.3g} {case.pair.unit} rms."
        if shapes
        else f"On held-out rows, shapes over inputs predict {case.held.shape_share():.0%} of the residual of the names."
        if unnamed_structure(case, case.held)
        else f"The residual, {case.sigma:.3g} {case.pair.unit} rms, drifts and correlates with no input."
    )
    if probability <= PROVISIONAL:
        says += " Held-out rows do not confirm it: a measurement that wanders looks alike."
    return _unknown(probability, drivers, says, case.sigma**2 - case.remainder.rms**2)


def _unknown(probability: float, drivers: tuple[str, ...], says: str, variance: float) -> Finding:
    size, p = float(np.sqrt(max(variance, 0.0))), round(probability, 3)
    return Finding(effect="unknown", confidence=p, drivers=drivers, says=says, rms_um=size, compensable=False)


def capped(f: Finding, most: float) -> Finding:
    """A finding with at most this confidence."""
    of_class = f.confidence_of_class and round(min(f.confidence_of_class, most), 3)
    return f.model_copy(update={"confidence": round(min(f.confidence, most), 3), "confidence_of_class": of_class})
