"""The findings as diagnosis.json: verdict, names with confidence, rivals, parameters, the next measurement."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from errpipe.diagnosis import confidence, friction, gains, holdout, locate, model, plausible, significance, unnamed
from errpipe.diagnosis.case import Case, needs_recalibration, own_datums, residual
from errpipe.diagnosis.derived import FAST
from errpipe.diagnosis.gains import WHOLE, Nuisance
from errpipe.diagnosis.hypotheses import Hypothesis
from errpipe.diagnosis.own_noise import only_steps
from errpipe.diagnosis.separate import would_separate
from errpipe.diagnosis.units import rounded
from errpipe.diagnosis.whiteness import whiteness
from errpipe.domain.diagnosis import Finding, FoundParameter, HoldOutFigures, ResponseDiagnosis, Rival, Significance
from errpipe.fitting.statistics import rms

TIED = 1.1  # log Bayes factor (3 as a ratio) below which names share the confidence of their class
ALIKE = 0.97  # or share of the contribution that the rival's textbook form explains, above which it is listed, too
MOSTLY = 0.5  # share of the mismatch that is one offset per run, above which the report states it
MOST_NUMBERS = 4  # parameters in a sentence; of a wave the amplitudes of its strongest orders and the period
REVERSED = (
    " Recorded and simulated values have opposite signs: one of the two columns counts the other way round. That is "
    "recalibrated first; check which of them is actual minus commanded."
)
AS_GOOD_AS_ONE = 0.3  # spread of the runs' datums, in noise rms, below which it is not reported
UNSIZED = 0.6  # upper limit of the confidence of a finding whose size is not significant
PREDICTED = 0.5  # residual share of the held-out mismatch, up to which names predict well (a gantry's bed: 0.14)
UNSURE = 0.75  # and of one with a gain far off (two errors are claimed, and other names may do
# without one of them), with shapes that held-out rows confirm, or selected in fewer than half of the folds
SHAPED = 0.02  # of the whole held-out variance: prediction of shapes beyond names that are then uncertain. Chosen on a
# wind-up named instead of a withheld hysteresis (0.046) and a real gantry's bed, correctly named (at most 0.004)
UNPROVED = 0.45  # upper limit of the confidence of a finding that held-out rows do not confirm, or that may be noise


def response(case: Case) -> tuple[ResponseDiagnosis, dict[str, np.ndarray], np.ndarray]:
    """One response of diagnosis.json, the findings' contributions on the selected rows, and the residual."""
    before, after = case.y + 2.0 * case.simulated if case.pair.reversed else case.y, residual(case)
    case.held = held = case.held or holdout.held_out(case)
    indicators = [indicators_of(case, k, held) for k in range(len(case.explanation.accepted))]
    made = [model.fit_finding(case, k) for k in range(len(indicators))]
    findings = [finding(case, k, made[k], indicators) for k in range(len(indicators))]
    most = _confidence_limits(case, made, indicators, after)
    findings = [unnamed.capped(f, limit) for f, limit in zip(findings, most, strict=True)]
    contribution = {m.hypothesis.effect: m.contribution for m in made}
    p_unknown = unnamed.unknown_probability(case, indicators, held)
    nameless = unnamed.unexplained(case, held)
    if findings and unnamed.confirmed_by_held_out(case, held) and unnamed.unlikely(case, findings):
        p_unknown, nameless = max(p_unknown, unnamed.PROVISIONAL), True
    findings, verdict = _verdict(case, findings, p_unknown, nameless)
    if findings and findings[0].effect == "unknown" and case.remainder.taken:
        contribution["unknown"], after = unnamed.with_shapes(case)
    known = indicators or p_unknown >= unnamed.PROVISIONAL
    floor = float(min(case.sigma, case.noise_estimate) if known else case.sigma)
    recalibrated, datums = residual(case, []), own_datums(case, [])
    chance = significance.surrogate_test(case)
    findings = [f.model_copy(update=_surrogate_test(case, f, chance)) for f in findings]
    if not unnamed.confirmed_by_held_out(case, held):
        findings = [unnamed.capped(f, UNPROVED) if f.p_search else f for f in findings]
    rubs = {friction.PARTS.get(f.effect) for f in findings} & {"dry", "viscous"}
    law = friction.by_direction(case) if rubs else None
    effects_held = {p.hypothesis.effect for p in case.decomposition.parts}
    findings = friction.with_directional_law(findings, law, effects_held) if law else findings
    contribution = {name: values for name, values in contribution.items() if name in {f.effect for f in findings}}
    at_first = rms(before) if case.pair.reversed else held.before
    known_as = {"p": chance.p, "gain": chance.gain, "limit95": chance.limit, "scheme": chance.scheme}
    surrogates = Significance(**known_as, effective_rows=chance.rows, rows=int(case.run.size))
    figures = HoldOutFigures(scheme=held.scheme, rms_before_um=at_first, rms_after_um=held.after)
    out = ResponseDiagnosis(
        component=case.pair.component,
        unit=case.pair.unit,
        verdict=verdict,
        rms_before_um=rms(before),
        rms_after_um=rms(after),
        noise_floor_um=floor,
        holdout=figures,
        findings=tuple(findings),
        regimes=locate.regimes(case.recording, case.pair.rows, before, after, recalibrated, floor),
        changes=locate.changes(case.recording, case.pair.rows, recalibrated),
        between_runs=locate.between_runs(case.run, recalibrated if datums is None else recalibrated + datums, floor),
        whiteness=whiteness(case),
        significance=surrogates,
    )
    says = in_words(out) + (f" {law.sentence()}" if law else "") + _datum_sentence(case)
    says += REVERSED if case.pair.reversed else ""
    return out.model_copy(update={"says": says}), contribution, after


def _confidence_limits(
    case: Case, made: list[model.FittedFinding], indicators: list[confidence.Indicators], after
) -> list[float]:
    """Upper limits of the confidence of names. after: residual of the explanation, shape (rows,).

    Drifting noise, or another name with a far-off gain, is as likely, unless predicted held-out rows contradict.
    """
    slow = case.held.names > PREDICTED * case.held.before
    far = slow and gains.count_distant_gains(case.search.scene(case.chosen()), case.nuisances, case.sizes)
    left = (case.held.names / max(case.held.before, 1e-300)) ** 2
    b, twin = case.search.scene(case.chosen()).coefficients(), any(n.kind == "noise" for n in case.nuisances)
    rows = gains.totals(case.nuisances, case.sizes)[1]  # a repeated measurement has gains of 1, else its noise drifts
    wandering = only_steps(case) or (twin and np.abs(rows @ b[: rows.shape[1]]).max() > gains.FAR_OFF)
    most, shaped = [1.0] * len(made), case.held.shape_share() * min(left, 1.0) >= SHAPED
    for k, (m, s) in enumerate(zip(made, indicators, strict=True)):
        wanders = wandering or case.over_noise < 0.0 or (slow and s.wandering > s.gain)
        beside = made[: k + 1]  # a gain, or a finding with one
        a_gain = case.of_a_twin or any(plausible.gain_of_a_part(case, other) for other in beside)
        if wanders or a_gain or plausible.only_a_wave_in_time(m, after):
            most[k] = UNPROVED
        elif plausible.is_insignificant(m):
            most[k] = UNPROVED if m.hypothesis.mask else UNSIZED  # a part was also searched for
        elif far or shaped or (case.held.again and s.agreement < holdout.AGAIN):
            most[k] = UNSURE
    return most


def _datum_sentence(case: Case) -> str:
    """Sentence on the datums of single runs and their spread; '' if all runs share one, or nearly so."""
    values = own_datums(case, case.chosen())
    if values is None or rms(values) < AS_GOOD_AS_ONE * case.sigma:
        return ""
    return (
        f" Each run has a separate datum, {rms(values):.3g} {case.pair.unit} rms from run to run, as an "
        "instrument has that is zeroed for each run; it is removed first and is not part of the findings."
    )


def inputs(case: Case, r: ResponseDiagnosis) -> dict[str, np.ndarray]:
    """Values, on the selected rows, of the inputs of the findings, the axis positions and time."""
    names = [n for f in r.findings for n in f.drivers]
    names += [n for n in (case.recording.name("time"), *case.recording.names("position")) if n is not None]
    held = [n for n in dict.fromkeys(names) if n in case.recording.frame.columns]
    labels = case.recording.names("run") + case.recording.names("group")
    return {n: case.recording.array(n)[case.pair.rows] for n in held if n not in labels}


def _surrogate_test(case: Case, f: Finding, whole: significance.SurrogateTest) -> dict[str, object]:
    """The surrogate test of a named finding: its p value and sentence."""
    place = [k for k, g in enumerate(case.explanation.accepted) if g.hypothesis.effect == f.effect]
    if not place:
        return {}
    chance = significance.surrogate_test(case, place[0], whole=whole)
    what = "none" if chance.p * (significance.SURROGATES + 1) < 1.5 else f"{chance.p:.0%}"
    says = f" Of {significance.SURROGATES} surrogates without effect, {what} gave such evidence (p = {chance.p:.2g})."
    return {"p_search": chance.p, "says": f.says + says}


def indicators_of(case: Case, k: int, held: holdout.HeldOut) -> confidence.Indicators:
    """Inputs of the confidence of finding k."""
    accepted = case.explanation.accepted
    rivals = case.search.rivals(accepted, k)
    own = {f.hypothesis.effect for f in accepted}
    margin = min((r[1] for r in rivals if r[0] not in own), default=50.0)
    margin = min(margin, max(case.over_noise, 0.0))
    others = [(f.index, f.size) for j, f in enumerate(accepted) if j != k]
    shaped, proved = case.remainder, held.shape_share() >= unnamed.HELD_OUT_SHARE
    noise = not held.predicts_whole_runs()  # may the shapes' contribution be slow noise?
    step = np.diff(case.recording.time()[case.pair.rows])
    return confidence.Indicators(
        gain=accepted[k].gain,
        margin=margin,
        leftover=case.sigma / max(case.noise_estimate, 1e-12) if proved else 1.0,
        share=shaped.share if proved or noise else 0.0,
        shapes=sum(g for _, g in shaped.shapes),
        others=len(accepted) - 1,
        core=case.search.form_share(case.chosen(), k),
        agreement=held.agreement[k],
        rank=k,
        unexplained_share=unnamed.unexplained_share(case) if proved else 0.0,
        fast=int(step.size and np.median(step) < FAST),
        wandering=sum(g for s, g in shaped.shapes if not s.of_inputs) if noise else 0.0,
        beside=0.0 if proved else _best_shape(case, case.chosen(), accepted[k].hypothesis),
        instead=confidence.EARNED if proved else accepted[k].gain - _best_shape(case, others, accepted[k].hypothesis),
    )


def _best_shape(case: Case, chosen: list[tuple[int, float]], name: Hypothesis) -> float:
    """Log Bayes factor of the best shape over an input given these findings; 0 if there is none.

    A curve over the length cut is not a rival of wear: it is the wear curve, which differs from tool to tool.
    """
    own = set(name.drivers) if name.terms[0].form == "any rate" else set()
    inputs = [k for k, s in enumerate(case.free_shapes) if s.of_inputs and not set(s.drivers) <= own]
    if not inputs:
        return 0.0
    sets, freedoms = [case.places[k] for k in inputs], [case.free_shapes[k].freedom for k in inputs]
    return float(case.search.scene(chosen).gains(sets, freedoms, case.search.rows).max())


def finding(case: Case, k: int, made: model.FittedFinding, indicators: list[confidence.Indicators]) -> Finding:
    """One finding, with its rivals and the measurement that would distinguish them."""
    accepted = case.explanation.accepted
    h = accepted[k].hypothesis
    rivals = sorted(case.search.rivals(accepted, k), key=lambda r: r[1])
    own = {(f.hypothesis.effect, f.hypothesis.drivers) for f in accepted}  # the same effect on other columns is a rival
    other = [r for r in rivals if r[0] != h.effect and (r[0], case.library.hypotheses[r[2]].drivers) not in own]
    every = [r for r in other if r[1] < Rival.CLOSE or _fitted_rival(case, made, r[2])[1] < 1 - ALIKE]
    close = every[:4]
    outside = min((r[1] for r in other if r not in every), default=50.0)
    name = confidence.name_probability(indicators[k])
    of_class = max(name, confidence.of_class(replace(indicators[k], margin=max(outside, indicators[k].margin))))
    alike = 1.0 + sum(float(np.exp(-r[1])) for r in other if 0.0 <= r[1] < TIED)
    sentence = ""
    if rivals:
        rival = close[0] if close else rivals[0]
        cores = sum(len(t.linear()) for t in made.hypothesis.terms)
        fitted = (made.hypothesis, np.array([e.value for e in made.estimates[:cores]]))
        sentence = would_separate(
            case.recording, fitted, _fitted_rival(case, made, rival[2])[0], case.sigma, case.pair.unit
        )
    term = made.hypothesis.terms[0]
    values = {e.name: e.value for e in made.estimates}
    values |= zip((p.name for p in term.nonlinear()), made.hypothesis.nonlinear[0], strict=True)
    plain = [t.model_dump(mode="json", exclude_defaults=True) | {"term": t.term} for t in made.hypothesis.terms]
    return Finding(
        effect=h.effect,
        confidence=round(min(name, of_class / alike), 3),
        drivers=h.drivers,
        where=locate.extent_of(h, case.recording, made.hypothesis.nonlinear[0]),
        parameters=tuple(
            FoundParameter(name=e.name, value=e.value, unit=e.unit, ci95=(e.low, e.high)) for e in made.estimates
        ),
        indistinguishable_from=tuple(r[0] for r in close),
        confidence_of_class=round(of_class, 3) if close else None,
        would_separate=sentence,
        says=_sentence(case, h.effect, h.drivers, made),
        rms_um=float(np.std(made.contribution)),
        rivals=tuple(Rival(effect=r[0], lost_by=round(float(r[1]), 2)) for r in rivals[:6]),
        compensable=term.compensable and bool(term.lower(values)) and not h.mask,
        term=plain[0],
        more_terms=tuple(plain[1:]),
    )


def _fitted_rival(case: Case, made: model.FittedFinding, rival: int) -> tuple[tuple, float]:
    """The rival's textbook form fitted to the finding's contribution, and the residual share of its variance."""
    core = case.library.block(rival, case.recording, case.pair.rows)[:, : case.library.cores[rival]]
    columns = np.column_stack([np.ones(core.shape[0]), core])
    b, *_ = np.linalg.lstsq(columns, made.contribution, rcond=None)
    left = float(np.var(made.contribution - columns @ b)) / max(float(np.var(made.contribution)), 1e-300)
    return (case.library.hypotheses[rival], b[1:] / case.library.scales[rival][: core.shape[1]]), left


def _verdict(case: Case, findings: list[Finding], p_unknown: float, nameless: bool) -> tuple[list[Finding], str]:
    """Verdict; `unknown` comes first if an unnamed mechanism is likelier than the names."""
    recalibrated = needs_recalibration(case)
    surest = max((f.confidence for f in findings), default=0.0)
    doubtful = nameless or surest < p_unknown
    may_be_unknown, gains_off = p_unknown >= unnamed.PROVISIONAL, _recalibration(case) if recalibrated else []
    if p_unknown > confidence.UNKNOWN_FIRST or (may_be_unknown and (doubtful or not findings)):
        named = [unnamed.capped(f, min(p_unknown, 1.0 - p_unknown)) for f in findings]  # the first is the likelier
        return [unnamed.finding(case, p_unknown), *named, *gains_off], "unexplained"
    if findings:
        return [*findings, *gains_off], "missing_physics"
    return gains_off, "recalibrate" if recalibrated else "no_mismatch"


def _recalibration(case: Case) -> list[Finding]:
    """The gains and the datum of the simulation, as a separate finding."""
    scene = case.search.scene(case.chosen())
    b, cov = scene.coefficients(), scene.covariance()
    m = case.nuisance.index.size
    parameters = []
    for nuisance, value, sd in _gains(case, b[:m], cov[:m, :m]):
        low, high = value - 2 * sd, value + 2 * sd
        if case.pair.reversed and not nuisance.is_datum:
            value, low, high = -2.0 - value, -2.0 - high, -2.0 - low
        name = nuisance.label if nuisance.is_datum else f"gain of {nuisance.label} less 1"
        unit = case.pair.unit if nuisance.is_datum else "1"
        parameters.append(FoundParameter(name=name, value=value, unit=unit, ci95=(low, high)))
    moved = case.recal @ b[:m]
    rms = float(np.std(moved + 2.0 * case.simulated if case.pair.reversed else moved))
    return [
        Finding(
            effect="recalibration",
            confidence=0.95,
            drivers=(case.pair.simulated,),
            parameters=tuple(parameters),
            says="Datum or gains of the simulation are off; setting them right moves it by "
            f"{rounded(rms)} {case.pair.unit} rms." + (REVERSED if case.pair.reversed else ""),
            rms_um=rms,
            compensable=False,
        )
    ]


def _gains(case: Case, b: np.ndarray, covariance: np.ndarray) -> Iterator[tuple[Nuisance, float, float]]:
    """(which, value, standard deviation) of each datum, and of the gain - 1 of each effect in the simulation.

    An effect's gain is that of the whole plus its own: for a signal of one effect, the two cannot be separated.
    """
    held, rows = gains.totals(case.nuisances, case.sizes)
    own = [j for j, n in enumerate(case.nuisances) if n.is_datum]
    rows = np.concatenate([np.diag(1.0 / case.sizes)[own], rows])
    for nuisance, row in zip([*(case.nuisances[j] for j in own), *(held or [WHOLE])], rows, strict=True):
        yield nuisance, float(row @ b), float(np.sqrt(row @ covariance @ row))


def _sentence(case: Case, effect: str, drivers, made: model.FittedFinding) -> str:
    wave = any(e.name.startswith("amplitude") for e in made.estimates)
    shown = [e for e in made.estimates if not (wave and e.name.startswith(("sine", "cosine"))) and (e.low or e.high)]
    last = shown[-1:] if wave and len(shown) > MOST_NUMBERS else []
    shown = shown[: MOST_NUMBERS - len(last)] + last
    terms = made.hypothesis.terms
    whose = [f" of {getattr(t, 'axis', '')}" for t in terms for _ in t.linear()] if len(terms) > 1 else []
    named = zip(shown, itertools.chain(whose, itertools.repeat("")), strict=False)
    numbers = ", ".join(
        f"{e.name}{axis} = {rounded(e.value)}{'' if e.unit == '1' else f' {e.unit}'} "
        f"({rounded(e.low)} to {rounded(e.high)})"
        for e, axis in named
    )
    artefact = terms[0].family == "measurement"  # of the recording: no simulation has it
    return (
        f"The {'recording contains' if artefact else 'simulation lacks'} {effect.replace('_', ' ')}, driven by "
        f"{', '.join(drivers)}: {numbers}{_atypical_size_sentence(made)}; "
        f"it makes up {rounded(float(np.std(made.contribution)))} {case.pair.unit} rms of the mismatch."
    )


def _atypical_size_sentence(made: model.FittedFinding) -> str:
    """A sentence on lags or lengths far from typical ones: the form may stand for another effect.

    Typical lengths are of linear axes: there is none for an angle.
    """
    names = {(p.name, p.unit): p for t in made.hypothesis.terms for p in t.nonlinear()}
    for e in made.estimates:
        p = names.get((e.name, e.unit))
        if p is not None and p.typical[0] > 0 and not p.typical[0] / 2 <= e.value <= 2 * p.typical[1]:
            return f" (unusual: {e.name} is mostly {rounded(p.typical[0])} to {rounded(p.typical[1])} {p.unit})"
    return ""


def in_words(r: ResponseDiagnosis) -> str:
    unit = r.unit
    if r.verdict == "no_mismatch":
        return (
            f"{r.component}: recording and simulation agree within the noise ({rounded(r.noise_floor_um)} {unit} rms)."
        )
    if r.verdict == "recalibrate":
        return (
            f"{r.component}: nothing is missing; with datum and gains recalibrated {rounded(r.rms_before_um)} becomes "
            f"{rounded(r.rms_after_um)} {unit} rms."
        )
    names = [f.effect.replace("_", " ") for f in r.findings if f.effect != "recalibration"]
    what, one = " and ".join(names[:2]), len(names[:2]) == 1
    s = "" if one else "s"
    before, after = r.holdout.rms_before_um, r.holdout.rms_after_um
    if after >= before:
        verb, them = ("is", "it") if one else ("are", "them")
        each = f" {r.between_runs or 0.0:.0%} of the mismatch is one offset per run, as from a new datum."
        return (
            f"{r.component}: {what} {verb} the best name{s} found, but unproved: held-out rows are no better "
            f"explained with {them} ({rounded(before)} before, {rounded(after)} {unit} rms after)."
            + (each if (r.between_runs or 0.0) >= MOSTLY else "")
        )
    if names[0] == "unknown":
        known = [f.effect.replace("_", " ") for f in r.findings if f.effect not in ("unknown", "recalibration")]
        near = f" (the nearest name would be {known[0]})" if known else ""
        return (
            f"{r.component}: something is missing that no known effect explains{near}; a shape in the data brings the "
            f"mismatch, held out, from {rounded(before)} to {rounded(after)} {unit} rms."
        )
    return (
        f"{r.component}: {what} explain{'s' if one else ''} the mismatch; held out it falls from {rounded(before)} to "
        f"{rounded(after)} {unit} rms."
    )
