"""Empirical equation for an unnamed mismatch: sparse regression over columns, their lags, powers and products.

Orthogonal matching pursuit (Pati 1993) over a library of candidate columns (`drivers.library`) of unit length, next to
the recalibration, selects at most three. The selection is repeated without each fold (whole sessions, else blocks of
neighbouring rows: `hypotheses.folds`), and the number of terms is the smallest within one standard error of the best
held-out one (Hastie, Tibshirani and Friedman 2009, 7.10). It is reported only if it predicts `LEAST_SHARE` of the
held-out variance and if none of 99 surrogates is predicted as well: the response shifted circularly by random rows, and
noise of the same spectrum. Time constants, thresholds and exponents of the selected columns are then fitted.
"""

from __future__ import annotations

import numpy as np

from errpipe.diagnosis import unnamed
from errpipe.diagnosis.against import clustered
from errpipe.diagnosis.case import Case, residual
from errpipe.diagnosis.coloured import surrogates
from errpipe.diagnosis.hypotheses import folds
from errpipe.domain import driver as d
from errpipe.domain.diagnosis import Empirical, EmpiricalTerm, Finding, FoundParameter, ResponseDiagnosis
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.library import candidates, unit_over
from errpipe.drivers.sessions import sessions
from errpipe.fitting.pursuit import NuisanceColumns, Pursuit
from errpipe.terms import plain, resolved_times
from errpipe.terms.profile_driver import ProfileDriver

MOST_TERMS = 3  # of an equation: more are not readable and do not predict held-out rows
MOST_ROWS = 6000  # rows used, chosen at random: further rows change the result little
SEED = 0  # seed for these rows and the surrogates: equal input gives an equal equation
LEAST_SHARE = 0.1  # of the held-out variance, as for a shape without a name; and beyond what names predict
ALIKE = 0.985  # correlation with the form of an effect from which they are equivalent: 97 % of its variance
LIKELY = 0.5  # confidence of a name from which no equation replaces it
MOST_LIKELY = 0.9  # upper limit of an equation's confidence; below it the share that it predicts
SURROGATES = 99  # surrogates; the smallest resolvable probability is 0.01


def recalibration_columns(case: Case) -> NuisanceColumns:
    """The recalibration of a case, estimated together with an equation."""
    return NuisanceColumns(case.recal, case.search.noise / np.maximum(case.search.nuisance.sd, 1e-300))


def with_equation(case: Case, response: ResponseDiagnosis) -> ResponseDiagnosis:
    """The response with an empirical equation, if one is significant and no name is likely.

    If it predicts more than the names, it describes the whole mismatch, and `unknown` comes first.
    """
    place = next((k for k, f in enumerate(response.findings) if f.effect == "unknown"), None)
    names = [f for f in response.findings if f.effect not in ("unknown", "recalibration")]
    if place is None and (not names or max(f.confidence for f in names) >= LIKELY):
        return response
    whole = residual(case, [])
    empirical = equation(case.recording, case.pair.rows, case.y, response.unit, recalibration_columns(case))
    named = 1.0 - (case.held.names / float(np.std(whole))) ** 2 if names and case.held else 0.0
    if empirical is not None and empirical.share > named + LEAST_SHARE:
        known = has_a_name(case, empirical, whole)
        p = max(min(empirical.share, MOST_LIKELY), response.findings[place].confidence if place is not None else 0.0)
        if not (known and names):
            return _unknown_first(case, response, min(p, unnamed.PROVISIONAL) if known else p, empirical)
    if place:  # the equation is added to names that predict more
        empirical = equation(case.recording, case.pair.rows, residual(case), response.unit, recalibration_columns(case))
    if place is None or empirical is None:
        return response
    better = _stated(response.findings[place], empirical)
    findings = (*response.findings[:place], better, *response.findings[place + 1 :])
    return response.model_copy(update={"findings": findings})


def has_a_name(case: Case, empirical: Empirical, whole: np.ndarray) -> bool:
    """Is the equation one column in the form of an effect without non-linear parameters, or what the names explain?

    Further terms count if they explain `LEAST_SHARE` more of the mismatch (rows,). The equation is then no mechanism
    outside the library, but those names, or an effect that drifting noise may imitate.
    """
    library, part = case.library, _drawn(whole.size, np.random.default_rng(SEED))
    rows, whole = case.pair.rows[part], whole[part]
    columns = [drive(driver, case.recording)[rows] for driver in empirical.drivers()]
    held = [(f.index, library.cores[f.index]) for f in case.explanation.accepted]
    if names := [library.block(i, case.recording, rows)[:, :cores] for i, cores in held]:
        explained = np.sum([t.coefficient * c for t, c in zip(empirical.terms, columns, strict=True)], axis=0)
        known = np.column_stack([case.recal[part], *names])
        if np.var(explained - known @ np.linalg.lstsq(known, explained, rcond=None)[0]) < (1.0 - ALIKE**2) * np.var(
            explained
        ):
            return True
    alone = np.column_stack([np.ones(part.size), case.simulated[part], columns[0]])  # whose gain may have imitated it
    left = whole - alone @ np.linalg.lstsq(alone, whole, rcond=None)[0]
    if len(empirical.terms) > 1 and 1.0 - np.var(left) / np.var(whole) < empirical.share - LEAST_SHARE:
        return False
    named = {f.hypothesis.effect for f in case.explanation.accepted}
    single = [i for i, h in enumerate(library.hypotheses) if not any(h.nonlinear) or h.effect in named]
    single = [i for i in single if library.cores[i] == 1 and not library.hypotheses[i].mask]
    cores = (library.block(i, case.recording, rows)[:, 0] for i in single)
    return any(abs(np.corrcoef(core, columns[0])[0, 1]) > ALIKE for core in cores if np.std(core) > 0)


def _unknown_first(case: Case, response: ResponseDiagnosis, p: float, empirical: Empirical) -> ResponseDiagnosis:
    """The response with the equation first; names share the remaining probability."""
    first = _stated(unnamed.finding(case, p), empirical)
    others = [g if g.effect == "recalibration" else unnamed.capped(g, min(p, 1.0 - p)) for g in response.findings]
    findings = (first, *(g for g in others if g.effect != "unknown"))
    return response.model_copy(update={"findings": findings, "verdict": "unexplained"})


def _stated(f: Finding, empirical: Empirical) -> Finding:
    """The finding with its equation, whose terms error models, patches and later checks can use."""
    first, *more = [plain(ProfileDriver(driver=(driver,))) for driver in empirical.drivers()]
    sizes = [FoundParameter(name="gain", value=t.coefficient, unit=t.unit, ci95=t.ci95) for t in empirical.terms]
    inputs = tuple(dict.fromkeys(name for driver in empirical.drivers() for name in d.inputs(driver)))
    known = {"empirical": empirical, "term": first, "more_terms": tuple(more), "parameters": tuple(sizes)}
    return f.model_copy(update=known | {"says": f"{f.says} {empirical.says}", "drivers": inputs or f.drivers})


def _drawn(size: int, rng: np.random.Generator) -> np.ndarray:
    """Sorted indices of the rows used: all, or `MOST_ROWS` of them."""
    return np.arange(size) if size <= MOST_ROWS else np.sort(rng.choice(size, MOST_ROWS, replace=False))


def equation(
    recording: Recording, rows: np.ndarray, y: np.ndarray, unit: str, known: NuisanceColumns | None = None
) -> Empirical | None:
    """The equation of a mismatch y on some rows of a recording, or None if none is significant.

    recording: conditioned (columns without gaps); y: shape (rows,), in `unit`. Equal input gives an equal equation.
    """
    rng = np.random.default_rng(SEED)
    part = _drawn(rows.size, rng)
    library = candidates(recording, rows[part], resolved_times(recording)[1])
    if len(library) < 2 or part.size < 60:
        return None
    session = sessions(recording)[rows[part]]
    fold, scheme = folds(recording.run_codes()[rows[part]], session)
    known = known or NuisanceColumns(np.ones((rows.size, 1)), np.zeros(1))
    search = Pursuit(library, fold, NuisanceColumns(known.columns[part], known.penalty))
    target = search.projected(y[part])[: part.size]
    shares, spread = search.held_out(target, MOST_TERMS)
    best = int(np.argmax(shares))
    count = next(k for k in range(MOST_TERMS + 1) if shares[k] >= shares[best] - spread[best])
    if count == 0 or shares[count] < LEAST_SHARE:
        return None
    far = target.size // 10, target.size - target.size // 10
    for k in range(SURROGATES):
        shifted = np.roll(target, int(rng.integers(*far))) * rng.choice([-1.0, 1.0])
        surrogate = shifted if k % 2 else surrogates(target, 1, rng)[0]
        if search.held_out(surrogate, MOST_TERMS)[0].max() >= shares[count]:
            return None
    chosen = search.refined(target, count)
    columns = search.projected(np.column_stack([c.values for c in chosen]))[: part.size]
    b = np.linalg.lstsq(columns, target, rcond=None)[0]
    tangents = search.projected(search.tangents(chosen))[: part.size]
    _, sd, _ = clustered(np.column_stack([columns, tangents]), target, session)
    reach = 2.02 * sd  # t with 39 degrees of freedom; the fitted parameters are as uncertain
    terms = tuple(
        EmpiricalTerm(
            column=c.name,
            coefficient=float(b[k]),
            unit=unit_over(unit, c.unit),
            ci95=(float(b[k] - reach[k]), float(b[k] + reach[k])),
            rms_um=float(np.std(b[k] * c.values)),
            driver=c.driver,
        )
        for k, c in enumerate(chosen)
    )
    constant = float(np.mean(y[part] - np.column_stack([c.values for c in chosen]) @ b))
    share, p = float(shares[count]), 1 / (SURROGATES + 1)
    text = " + ".join(f"{t.coefficient:.3g} {t.unit} * {t.column}" for t in terms).replace("+ -", "- ")
    says = (
        f"Empirical, no mechanism: {text} (plus a constant) predicts {share:.0%} of the held-out variance "
        f"(p = {p:.2g} by {SURROGATES} surrogates)."
    )
    return Empirical(terms=terms, constant=constant, unit=unit, share=share, p=p, scheme=scheme, says=says)
