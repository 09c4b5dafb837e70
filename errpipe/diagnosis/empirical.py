"""Empirical equation for an unnamed mismatch: sparse regression over columns, their lags, powers and products.

Orthogonal matching pursuit (Pati 1993) over a library of candidate columns of unit length selects at most three. The
selection is repeated without each fold (whole sessions, else blocks of neighbouring rows: `hypotheses.folds`),
and the number of terms is the smallest within one standard error of the best held-out one (Hastie, Tibshirani and
Friedman 2009, 7.10). It is reported only if it predicts `LEAST_SHARE` of the held-out variance and if none of 99
surrogates is predicted as well: the response shifted circularly by random rows, and noise of the same spectrum.

Units are tracked: temperatures enter as rises over their mean and positions as distances from the middle, so that
a power or product means something; a coefficient has the response's unit over that of its column.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis import unnamed
from errpipe.diagnosis.against import clustered
from errpipe.diagnosis.case import Case, residual
from errpipe.diagnosis.coloured import copies
from errpipe.diagnosis.hypotheses import folds
from errpipe.domain.diagnosis import Empirical, EmpiricalTerm, ResponseDiagnosis
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms import resolved_times

MOST_TERMS = 3  # of an equation: more are not readable and do not predict held-out rows
MOST_ROWS = 6000  # rows used, chosen at random: further rows change the result little
SEED = 0  # seed for these rows and the surrogates: equal input gives an equal equation
MOST_BASE = 40  # columns and lags whose products are tried
LEAST_SHARE = 0.1  # of the held-out variance, as for a shape without a name; and beyond what names predict
ALIKE = 0.985  # correlation with the form of an effect from which they are equivalent: 97 % of its variance
LIKELY = 0.5  # confidence of a name from which no equation replaces it
MOST_LIKELY = 0.9  # upper limit of an equation's confidence; below it the share that it predicts
SURROGATES = 99  # surrogates; the smallest resolvable probability is 0.01
LAGS = (1 / 60, 1 / 20, 1 / 6)  # of the longest session: time constants of lagged columns
LAGGED = (
    *("temperature", "pressure", "humidity", "spindle_speed", "feed"),
    *("coolant", "load", "force", "current", "torque"),
)
MEASURED = ("temperature", "pressure", "humidity")  # counted from their mean; driven inputs have a natural zero
MOVING = ("direction", "velocity", "acceleration")
READ = (*LAGGED, *MOVING, "position", "command", "overhang", "depth_of_cut", "cut_length")
UNITS = {"temperature": "K", "direction": "1", "coolant": "1"}
PLAIN, BENT, TWO = 1.0, 0.98, 0.96  # weights of a column, its power, a product: the simplest of collinear ones


@dataclass(frozen=True)
class Candidate:
    """A column of the library: expression, unit as powers of units, values (rows,), weight."""

    name: str
    unit: tuple[tuple[str, int], ...]
    values: np.ndarray
    weight: float


def with_equation(case: Case, response: ResponseDiagnosis) -> ResponseDiagnosis:
    """The response with an empirical equation, if one is significant and no name is likely.

    If it predicts more than the names, it describes the whole mismatch, and `unknown` comes first.
    """
    place = next((k for k, f in enumerate(response.findings) if f.effect == "unknown"), None)
    names = [f for f in response.findings if f.effect not in ("unknown", "recalibration")]
    if place is None and (not names or max(f.confidence for f in names) >= LIKELY):
        return response
    whole = residual(case, [])
    empirical = equation(case.recording, case.pair.rows, whole, response.unit)
    named = 1.0 - (case.held.names / float(np.std(whole))) ** 2 if names and case.held else 0.0
    if empirical is not None and empirical.share > named + LEAST_SHARE:
        known = has_a_name(case, empirical, whole)
        p = max(min(empirical.share, MOST_LIKELY), response.findings[place].confidence if place is not None else 0.0)
        if not (known and names):
            return _unknown_first(case, response, min(p, unnamed.PROVISIONAL) if known else p, empirical)
    if place:  # the equation is added to names that predict more
        empirical = equation(case.recording, case.pair.rows, residual(case), response.unit)
    if place is None or empirical is None:
        return response
    f = response.findings[place]
    better = f.model_copy(update={"empirical": empirical, "says": f"{f.says} {empirical.says}"})
    findings = (*response.findings[:place], better, *response.findings[place + 1 :])
    return response.model_copy(update={"findings": findings})


def has_a_name(case: Case, empirical: Empirical, whole: np.ndarray) -> bool:
    """Is the equation one column in the form of an effect without non-linear parameters, or what the names explain?

    Further terms count if they explain `LEAST_SHARE` more of the mismatch (rows,). The equation is then no mechanism
    outside the library, but those names, or an effect that drifting noise may imitate.
    """
    library, part = case.library, _drawn(whole.size, np.random.default_rng(SEED))
    rows, whole = case.pair.rows[part], whole[part]
    listed = {c.name: c.values for c in candidates(case.recording, rows)}
    held = [(f.index, library.cores[f.index]) for f in case.explanation.accepted]
    if names := [library.block(i, case.recording, rows)[:, :cores] for i, cores in held]:
        explained = np.sum([term.coefficient * listed[term.column] for term in empirical.terms], axis=0)
        known = np.column_stack([case.recal[part], *names])
        if np.var(explained - known @ np.linalg.lstsq(known, explained, rcond=None)[0]) < (1.0 - ALIKE**2) * np.var(
            explained
        ):
            return True
    values = listed[empirical.terms[0].column]
    alone = np.column_stack([np.ones(part.size), case.simulated[part], values])  # whose gain may have imitated it
    left = whole - alone @ np.linalg.lstsq(alone, whole, rcond=None)[0]
    if len(empirical.terms) > 1 and 1.0 - np.var(left) / np.var(whole) < empirical.share - LEAST_SHARE:
        return False
    named = {f.hypothesis.effect for f in case.explanation.accepted}
    single = [i for i, h in enumerate(library.hypotheses) if not any(h.nonlinear) or h.effect in named]
    single = [i for i in single if library.cores[i] == 1 and not library.hypotheses[i].mask]
    cores = (library.block(i, case.recording, rows)[:, 0] for i in single)
    return any(abs(np.corrcoef(core, values)[0, 1]) > ALIKE for core in cores if np.std(core) > 0)


def _unknown_first(case: Case, response: ResponseDiagnosis, p: float, empirical: Empirical) -> ResponseDiagnosis:
    """The response with the equation first; names share the remaining probability."""
    f = unnamed.finding(case, p)
    first = f.model_copy(update={"empirical": empirical, "says": f"{f.says} {empirical.says}"})
    others = [g if g.effect == "recalibration" else unnamed.capped(g, min(p, 1.0 - p)) for g in response.findings]
    findings = (first, *(g for g in others if g.effect != "unknown"))
    return response.model_copy(update={"findings": findings, "verdict": "unexplained"})


def _drawn(size: int, rng: np.random.Generator) -> np.ndarray:
    """Sorted indices of the rows used: all, or `MOST_ROWS` of them."""
    return np.arange(size) if size <= MOST_ROWS else np.sort(rng.choice(size, MOST_ROWS, replace=False))


def equation(recording: Recording, rows: np.ndarray, y: np.ndarray, unit: str) -> Empirical | None:
    """The equation of a residual y on some rows of a recording, or None if none is significant.

    recording: conditioned (columns without gaps); y: shape (rows,), in `unit`. Equal input gives an equal equation.
    """
    rng = np.random.default_rng(SEED)
    part = _drawn(rows.size, rng)
    library = candidates(recording, rows[part])
    if len(library) < 2 or part.size < 60:
        return None
    session = sessions(recording)[rows[part]]
    fold, scheme = folds(recording.run_codes()[rows[part]], session)
    search = _Pursuit(library, fold)
    target = y[part] - y[part].mean()
    shares, spread = search.held_out(target)
    best = int(np.argmax(shares))
    count = next(k for k in range(MOST_TERMS + 1) if shares[k] >= shares[best] - spread[best])
    if count == 0 or shares[count] < LEAST_SHARE:
        return None
    far = target.size // 10, target.size - target.size // 10
    for k in range(SURROGATES):
        shifted = np.roll(target, int(rng.integers(*far))) * rng.choice([-1.0, 1.0])
        surrogate = shifted if k % 2 else copies(target, 1, rng)[0]
        if search.held_out(surrogate)[0].max() >= shares[count]:
            return None
    p = 1 / (SURROGATES + 1)
    chosen = [library[j] for j in search.chosen(target, count)]
    return _fitted(chosen, target, session, unit, float(shares[count]), p, scheme)


class _Pursuit:
    """Products of the library's columns, over all rows and by fold, for repeated pursuits."""

    def __init__(self, library: list[Candidate], fold: np.ndarray):
        columns = np.column_stack([c.values - c.values.mean() for c in library])
        self.weight = np.array([c.weight for c in library])
        self.columns = columns / np.linalg.norm(columns, axis=0) * self.weight
        self.rows = [np.flatnonzero(fold == f) for f in np.unique(fold)]
        products = [self.columns[r].T @ self.columns[r] for r in self.rows]
        self.whole = np.sum(products, axis=0)
        self.grams = [self.whole - part for part in products]

    def chosen(self, y: np.ndarray, count: int, without: int | None = None) -> list[int]:
        """Indices of the selected columns, in the order of the pursuit; without: a fold to hold out."""
        from sklearn.linear_model import orthogonal_mp_gram

        gram, xy = self.whole, self.columns.T @ y
        if without is not None:
            gram = self.grams[without]
            xy = xy - self.columns[self.rows[without]].T @ y[self.rows[without]]
        path = orthogonal_mp_gram(gram, xy, n_nonzero_coefs=count, return_path=True, copy_Gram=True, copy_Xy=True)
        path = np.asarray(path).reshape(len(self.weight), -1)
        order: list[int] = []
        for k in range(path.shape[1]):
            order += [int(j) for j in np.flatnonzero(path[:, k]) if j not in order]
        return order

    def held_out(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Share of the held-out variance predicted with 0 to MOST_TERMS terms, and its standard error over folds."""
        squares = np.zeros((len(self.rows), MOST_TERMS + 1))
        for f, test in enumerate(self.rows):
            train = np.ones(y.size, dtype=bool)
            train[test] = False
            order = self.chosen(y, MOST_TERMS, f)
            for k in range(MOST_TERMS + 1):
                own = np.column_stack([np.ones(y.size), self.columns[:, order[:k]]])
                b = np.linalg.lstsq(own[train], y[train], rcond=None)[0]
                squares[f, k] = float(np.sum((y[test] - own[test] @ b) ** 2))
        gained = (squares[:, :1] - squares) / max(float(squares[:, 0].mean()), 1e-300)
        return gained.mean(axis=0), gained.std(axis=0, ddof=1) / np.sqrt(len(self.rows))


def candidates(recording: Recording, rows: np.ndarray) -> list[Candidate]:
    """The library on some rows of a conditioned recording: columns, lags, magnitudes, squares and products."""
    base = list(_base(recording, rows))[:MOST_BASE]
    out = list(base)
    for c in base:
        if np.unique(c.values).size > 2:
            squared = Candidate(f"({c.name})^2", _times(c.unit, c.unit), c.values**2, BENT)
            out += [squared, Candidate(f"|{c.name}|", c.unit, np.abs(c.values), BENT)]
    for one, other in itertools.combinations(base, 2):
        out.append(Candidate(f"{one.name} {other.name}", _times(one.unit, other.unit), one.values * other.values, TWO))
    spread = [float(c.values.std()) for c in out]
    return [c for c, s in zip(out, spread, strict=True) if s > 1e-9 * (1e-300 + float(np.abs(c.values).max()))]


def _base(recording: Recording, rows: np.ndarray) -> Iterator[Candidate]:
    """Columns about their mean (positions about the middle), and their first-order lags."""
    _, longest = resolved_times(recording)
    session, t = sessions(recording), recording.time()
    for role in READ:
        for name in recording.names(role):
            whole = recording.array(name)
            if not np.isfinite(whole).all() or np.ptp(whole[rows]) == 0:
                continue
            own = UNITS.get(role) or recording.manifest.columns[name].unit or "1"
            unit = () if own == "1" else ((own, 1),)
            sign = role in MOVING
            zero = 0.0 if sign else 0.5 * float(whole[rows].min() + whole[rows].max())
            zero = float(whole[rows].mean()) if role in MEASURED else 0.0 if role in LAGGED else zero
            expression = name if zero == 0 else f"({name} - {zero:.5g})"
            yield Candidate(expression, unit, whole[rows] - zero, PLAIN)
            if role == "velocity":
                yield Candidate(f"sign({name})", (), np.sign(whole[rows]), PLAIN)
            if role in LAGGED and recording.name("time") is not None:
                for share in LAGS:
                    tau = share * longest
                    lagged = responses.lag(session, t, whole, tau, tau, True)[rows]
                    if np.ptp(lagged) > 0:
                        yield Candidate(f"lag({expression.strip('()')}, {tau:.3g} s)", unit, lagged - zero, BENT)


def _times(one: tuple[tuple[str, int], ...], other: tuple[tuple[str, int], ...]) -> tuple[tuple[str, int], ...]:
    """Unit of a product."""
    powers = dict(one)
    for name, power in other:
        powers[name] = powers.get(name, 0) + power
    return tuple(sorted(powers.items()))


def unit_over(response: str, unit: tuple[tuple[str, int], ...]) -> str:
    """Unit of a coefficient: the response's over the column's, such as um/(K2 mm)."""
    below = [f"{name}{power}" if power > 1 else name for name, power in unit]
    below = [f"({b})" if "/" in b and len(below) > 1 else b for b in below]
    if not below:
        return response
    return f"{response}/{below[0]}" if len(below) == 1 and "/" not in below[0] else f"{response}/({' '.join(below)})"


def _fitted(chosen: list[Candidate], y, session, unit: str, share: float, p: float, scheme: str) -> Empirical:
    """The equation on all rows, with cluster-robust 95 % intervals."""
    b, sd, _ = clustered(np.column_stack([*(c.values for c in chosen), np.ones(y.size)]), y, session)
    terms = tuple(
        EmpiricalTerm(
            column=c.name,
            coefficient=float(b[k]),
            unit=unit_over(unit, c.unit),
            ci95=(float(b[k] - 2.02 * sd[k]), float(b[k] + 2.02 * sd[k])),  # t with 39 degrees of freedom
            rms_um=float(np.std(b[k] * c.values)),
        )
        for k, c in enumerate(chosen)
    )
    text = " + ".join(f"{t.coefficient:.3g} {t.unit} * {t.column}" for t in terms).replace("+ -", "- ")
    says = (
        f"Empirical, no mechanism: {text} (plus a constant) predicts {share:.0%} of the held-out variance "
        f"(p = {p:.2g} by {SURROGATES} surrogates)."
    )
    return Empirical(terms=terms, constant=float(b[-1]), unit=unit, share=share, p=p, scheme=scheme, says=says)
