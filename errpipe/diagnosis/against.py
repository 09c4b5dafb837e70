"""Earlier findings checked on a later recording: is each effect still present, and has its size changed?

Each finding, with its earlier parameters, is one column on the rows of the later recording. Its factor k is estimated
there, jointly for all findings of a response and a datum:

        recorded - simulated = datum + sum of k_i * contribution_i + residual       k = 1: unchanged, 0: gone

Ordinary least squares; the variance of k is cluster-robust (Liang and Zeger 1986) over whole sessions if
there are at least `MIN_CLUSTERS`, else over blocks of neighbouring rows, so that correlated rows are not counted as
independent. `changed` is a t test of k = 1 that includes the variance of the earlier estimate, at 5 % over all
findings (Bonferroni). An effect of several coefficients (sine and cosine of a wave) may have changed phase instead: a
Wald test of all its columns in addition to their common factor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.special import fdtrc

from errpipe.diagnosis import units
from errpipe.diagnosis.applied import GAIN, block_of, causal, session_datums, terms_of
from errpipe.domain.diagnosis import Diagnosis, Finding, FoundParameter, ResponseDiagnosis
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import in_order_of_time, sessions
from errpipe.errors import DataError
from errpipe.fitting.statistics import student_quantile, student_tail

LEVEL = 0.05  # family-wise probability that an unchanged effect is called changed
MIN_CLUSTERS, BLOCKS = 8, 40  # with fewer sessions the variance between them is badly estimated
MOVED = 0.3  # rms explained by an effect's own columns beyond its factor, over its earlier rms (17 degrees of a wave)
MORE_LEFT = 1.5  # residual rms over that of the earlier recording from which it is reported
UNDECIDED = 0.5  # half width of the interval of k from which the state is `undecided`
NEVER_ACTS = "its driver never changes in this recording"

State = Literal["unchanged", "larger", "smaller", "gone", "reversed", "moved", "undecided", "not judged"]
CHANGED: tuple[State, ...] = ("larger", "smaller", "gone", "reversed", "moved")


@dataclass(frozen=True)
class FindingComparison:
    """One earlier finding on the later recording. k: present over earlier size, with 95 % interval; p: of the test k=1.

    parameters: name, unit, earlier value and interval, present value (k times the earlier); empty if it moved.
    left, left_then: residual rms with all factors of the response fitted, in its unit; that of the earlier recording.
    """

    component: str
    effect: str
    state: State
    says: str
    k: float | None = None
    ci95: tuple[float, float] | None = None
    p: float | None = None
    parameters: tuple[dict[str, Any], ...] = ()
    left: float | None = None
    left_then: float | None = None
    unit: str = ""

    @property
    def changed(self) -> bool:
        """Does the factor k differ from 1 significantly?"""
        return self.state in CHANGED

    def plain(self) -> dict[str, Any]:
        """Plain data for against.json."""
        head = {"component": self.component, "effect": self.effect, "state": self.state, "size_now_over_then": self.k}
        sizes = {"ci95": self.ci95, "p": self.p, "parameters": list(self.parameters)}
        return head | sizes | {"rms_left_um": self.left, "rms_left_then_um": self.left_then, "says": self.says}


def against(recording: Recording, earlier: Diagnosis) -> list[FindingComparison]:
    """Every named finding of an earlier diagnosis, tested on a later recording of the same responses.

    Raises DataError if there is no named finding, or if the recording has none of the responses with its simulation.
    """
    named = {r.component: _looked_for(r) for r in earlier.responses}
    count = sum(map(len, named.values()))
    if not count:
        raise DataError("against: the earlier diagnosis names no effect: there is nothing to look for")
    read = causal(in_order_of_time(recording))
    out: list[FindingComparison] = []
    for r in earlier.responses:
        if named[r.component]:
            out += _response(read, r, named[r.component], LEVEL / count)
    if all(h.state == "not judged" for h in out):
        raise DataError("against: no earlier finding can be judged\n" + "\n".join(f"  {h.says}" for h in out))
    return out


def _looked_for(r: ResponseDiagnosis) -> list[Finding]:
    """Findings that have a term; of an empirical equation of the whole mismatch not the names that it replaces."""
    alone = bool(r.findings) and r.findings[0].empirical is not None and bool(terms_of(r.findings[0]))
    return [f for f in (r.findings[:1] if alone else r.findings) if terms_of(f)]


def _response(read: Recording, r: ResponseDiagnosis, findings: list[Finding], level: float) -> list[FindingComparison]:
    error, twin = read.name("error", component=r.component), read.name("simulated", component=r.component)
    if error is None or twin is None:
        return [_not_judged(r, f, "the recording has no recorded or no simulated column for it") for f in findings]
    if read.manifest.columns[error].unit != r.unit:
        return [_not_judged(r, f, f"recorded in {read.manifest.columns[error].unit}, then {r.unit}") for f in findings]
    mismatch = read.array(error) - read.array(twin)
    done: dict[int, FindingComparison] = {}
    columns: dict[int, np.ndarray] = {}
    for k, f in enumerate(findings):
        try:
            columns[k] = contribution(f, read, r.unit)
        except (LookupError, DataError) as err:
            done[k] = _not_judged(r, f, str(err).splitlines()[0].strip("'"))
    rows = np.flatnonzero(np.isfinite(mismatch) & np.all([np.isfinite(c) for c in columns.values()], axis=0))
    for k in list(columns):
        if rows.size and np.std(columns[k][rows]) <= 1e-3 * max(findings[k].rms_um, 1e-12):
            done[k] = _not_judged(r, findings[k], NEVER_ACTS)
            del columns[k]
    if rows.size < 30 + 3 * len(columns):
        unjudged = [k for k in columns if k not in done]
        done |= {k: _not_judged(r, findings[k], f"only {rows.size} rows hold what it reads") for k in unjudged}
        columns = {}
    if columns:
        design = np.column_stack([columns[k][rows] for k in columns])
        if any(f.effect == GAIN for f in r.findings):  # the simulation's gain was off: fit it too
            design = np.column_stack([design, read.array(twin)[rows]])
        session = sessions(read)[rows]
        whole = np.column_stack([design, session_datums(design, mismatch[rows], session)])
        k_now, sd, degrees = clustered(whole, mismatch[rows], session)
        left = float(np.sqrt(np.mean((mismatch[rows] - whole @ k_now) ** 2)))
        for j, k in enumerate(columns):
            own = block_of(findings[k], read, r.unit).columns(read)[rows]
            beside = contribution_rms(own, whole, mismatch[rows], session, level)
            moved = beside > MOVED * float(np.std(columns[k][rows]))
            held = _judged(r, findings[k], float(k_now[j]), float(sd[j]), degrees, level)
            held = replace(held, state="moved", parameters=()) if moved else held
            done[k] = replace(held, left=left, left_then=r.rms_after_um, unit=r.unit)
            done[k] = replace(done[k], says=_sentence(done[k]))
    return [done[k] for k in range(len(findings))]


def contribution_rms(own: np.ndarray, whole: np.ndarray, y: np.ndarray, session: np.ndarray, level: float) -> float:
    """rms explained by an effect's own columns (rows, k) beyond a design that contains their sum; 0 if not significant.

    Wald test of all columns, with the cluster-robust variance.
    """
    scaled = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(scaled - whole @ np.linalg.lstsq(whole, scaled, rcond=None)[0], full_matrices=False)
    u = u[:, s > 1e-6]
    count = u.shape[1]
    if own.shape[1] < 2 or not count:
        return 0.0
    b, spread, degrees = sandwich(np.column_stack([u, whole]), y, session)
    free = degrees - count + 1
    if free < 1:
        return 0.0
    wald = float(b[:count] @ np.linalg.pinv(spread[:count, :count]) @ b[:count])
    p = float(fdtrc(count, free, wald / count * free / degrees))
    return float(np.std(u @ b[:count])) if p < level else 0.0


def contribution(f: Finding, read: Recording, unit: str) -> np.ndarray:
    """A finding's contribution, with its earlier parameters, on every row of another recording, shape (rows,).

    Raises LookupError or DataError if the recording lacks a column that the finding needs.
    """
    block = block_of(f, read, unit)
    remaining, gains = list(f.parameters), []
    for term in block.terms:
        rotary = units.on_rotary_axis(term, read)
        for p in term.linear():
            at = next(i for i, q in enumerate(remaining) if q.name == p.name)
            gains.append(remaining.pop(at).value / units.reported(p.unit, unit, rotary)[1])
    return block.columns(read) @ np.array(gains)


def clustered(design: np.ndarray, y: np.ndarray, session: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Least squares: coefficients, their cluster-robust standard deviations, degrees of freedom of the t test."""
    b, spread, degrees = sandwich(design, y, session)
    return b, np.sqrt(np.maximum(np.diag(spread), 0.0)), degrees


def sandwich(design: np.ndarray, y: np.ndarray, session: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Least squares: coefficients, their cluster-robust covariance (k, k), degrees of freedom."""
    codes, cluster = np.unique(session, return_inverse=True)
    if codes.size < MIN_CLUSTERS:
        cluster = np.arange(y.size) * min(BLOCKS, max(y.size // 4, 2)) // y.size
    count = int(cluster.max()) + 1
    size = np.linalg.norm(design, axis=0)
    size = np.where(size > 0, size, 1.0)
    scaled = design / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10)
    b = inverse @ scaled.T @ y
    scores = np.zeros((count, design.shape[1]))
    np.add.at(scores, cluster, scaled * (y - scaled @ b)[:, None])
    spread = inverse @ scores.T @ scores @ inverse * count / (count - 1) * (y.size - 1) / (y.size - design.shape[1])
    return b / size, spread / np.outer(size, size), count - 1


def _judged(r: ResponseDiagnosis, f: Finding, k: float, sd: float, degrees: int, level: float) -> FindingComparison:
    """State of one finding from its factor, the factor's standard deviation, and its earlier interval."""
    reach = student_quantile(0.975, degrees) * sd
    then = earlier_spread(f)
    p = 2.0 * student_tail(abs(k - 1.0) / max(float(np.hypot(sd, then)), 1e-12), degrees)
    if p >= level:
        state: State = "undecided" if reach > UNDECIDED or k - reach <= 0 else "unchanged"
    elif k - reach <= 0 <= k + reach:
        state = "gone"
    else:
        state = "reversed" if k < 0 else "larger" if k > 1 else "smaller"
    sizes: list[dict[str, Any]] = []
    for q in _sizes(f):
        now = {"now": k * q.value, "now_ci95": sorted(((k - reach) * q.value, (k + reach) * q.value))}
        sizes.append({"name": q.name, "unit": q.unit, "then": q.value, "then_ci95": q.ci95} | now)
    return FindingComparison(r.component, f.effect, state, "", k, (k - reach, k + reach), p, tuple(sizes))


def earlier_spread(f: Finding) -> float:
    """Relative standard deviation of a finding's earlier size, from the interval of its largest linear parameter.

    Of an equation, whose coefficients have different units: that of the term of the largest rms.
    """
    sizes = _sizes(f)
    weights = [t.rms_um for t in f.empirical.terms] if f.empirical is not None else [abs(q.value) for q in sizes]
    top = max(zip(weights, sizes, strict=False), key=lambda pair: pair[0], default=(0.0, None))[1]
    return (top.ci95[1] - top.ci95[0]) / (2 * 1.96) / abs(top.value) if top and top.value else 0.0


def _sizes(f: Finding) -> list[FoundParameter]:
    inner = {p.name for t in terms_of(f) for p in t.nonlinear()}
    return [q for q in f.parameters if q.name not in inner]


WORDS: dict[str, str] = {
    "unchanged": "still there, its size unchanged",
    "larger": "still there, larger than it was",
    "smaller": "still there, smaller than it was",
    "gone": "gone",
    "reversed": "turned round",
    "moved": "still there, but not where it was (another phase or shape)",
    "undecided": "this recording cannot tell",
}


def _sentence(h: FindingComparison) -> str:
    name = h.effect.replace("_", " ")
    text = f"{h.component}: {name}: {WORDS[h.state]}"
    if h.parameters:
        q = next((q for q in h.parameters if q["name"] == "amplitude"), h.parameters[0])  # of a wave: its amplitude
        low, high = q["now_ci95"]
        text += f" ({q['name']} {q['then']:.3g} -> {q['now']:.3g} {q['unit']}, 95 % {low:.3g} to {high:.3g}"
        text += f"; test of no change p = {h.p:.2g})"
    return text


def larger_residuals(held: list[FindingComparison]) -> list[str]:
    """A sentence for each response whose residual, with the earlier findings fitted, has increased."""
    left = {h.component: h for h in held if h.left is not None and h.left_then is not None}
    return [
        f"{c}: the residual is {h.left:.3g} {h.unit} rms, {h.left_then:.3g} in the earlier recording: diagnose "
        "this recording again"
        for c, h in left.items()
        if (h.left or 0.0) > MORE_LEFT * (h.left_then or 0.0)
    ]


def _not_judged(r: ResponseDiagnosis, f: Finding, why: str) -> FindingComparison:
    return FindingComparison(
        r.component, f.effect, "not judged", f"{r.component}: {f.effect.replace('_', ' ')}: not judged: {why}"
    )
