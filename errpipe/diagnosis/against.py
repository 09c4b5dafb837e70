"""Earlier findings on a later recording: is each effect still there, and has its size moved?

Each finding, with the parameters it was found with, is one column on the rows of the later recording; what is judged is
the factor k that it takes there, all findings of a response together, beside a datum:

    recorded - simulated = datum + sum of k_i * contribution_i + rest           k = 1: as it was, 0: gone

Ordinary least squares; the variance of k is the cluster-robust one (Liang and Zeger 1986) over whole sessions where
there are at least `MIN_CLUSTERS`, else over blocks of neighbouring rows, so that correlated rows are not counted as
independent. `changed` is a t test of k = 1 that knows the earlier interval too, at 5 % over all findings (Bonferroni).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from errpipe.diagnosis import units
from errpipe.diagnosis.applied import GAIN, block_of, causal, session_datums, terms_of
from errpipe.domain.diagnosis import Diagnosis, Finding, ResponseDiagnosis
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError
from errpipe.fitting.quantiles import student_quantile, student_tail

LEVEL = 0.05  # chance that any of the unchanged effects is called changed
MIN_CLUSTERS, BLOCKS = 8, 40  # fewer sessions estimate the variance between them badly
UNDECIDED = 0.5  # half width of the interval of k from which the state is `undecided`
NEVER_ACTS = "what drives it never moves in this recording"

State = Literal["unchanged", "larger", "smaller", "gone", "reversed", "undecided", "not judged"]
CHANGED: tuple[State, ...] = ("larger", "smaller", "gone", "reversed")


@dataclass(frozen=True)
class Held:
    """One earlier finding now. k: size now over size then, with its 95 % interval; p: of the test of k = 1.

    parameters: name, unit, value then and its interval, value now (k times then) and its interval.
    """

    component: str
    effect: str
    state: State
    says: str
    k: float | None = None
    ci95: tuple[float, float] | None = None
    p: float | None = None
    parameters: tuple[dict[str, Any], ...] = ()

    @property
    def changed(self) -> bool:
        """True where the factor k differs from 1 significantly."""
        return self.state in CHANGED

    def plain(self) -> dict[str, Any]:
        """Plain data for against.json."""
        return {
            "component": self.component,
            "effect": self.effect,
            "state": self.state,
            "size_now_over_then": self.k,
            "ci95": self.ci95,
            "p": self.p,
            "parameters": list(self.parameters),
            "says": self.says,
        }


def against(recording: Recording, earlier: Diagnosis) -> list[Held]:
    """Every named finding of an earlier diagnosis, judged on a later recording of the same responses.

    Raises DataError where there is no named finding, or the recording holds none of the responses with its twin.
    """
    named = {r.component: [f for f in r.findings if terms_of(f)] for r in earlier.responses}
    count = sum(map(len, named.values()))
    if not count:
        raise DataError("against: the earlier diagnosis names no effect: there is nothing to look for")
    read = causal(recording)
    out: list[Held] = []
    for r in earlier.responses:
        if named[r.component]:
            out += _response(read, r, named[r.component], LEVEL / count)
    if all(h.state == "not judged" for h in out):
        raise DataError("against: no earlier finding can be judged\n" + "\n".join(f"  {h.says}" for h in out))
    return out


def _response(read: Recording, r: ResponseDiagnosis, findings: list[Finding], level: float) -> list[Held]:
    """The findings of one response."""
    error, twin = read.name("error", component=r.component), read.name("simulated", component=r.component)
    if error is None or twin is None:
        return [_not_judged(r, f, "the recording has no recorded or no simulated column for it") for f in findings]
    if read.manifest.columns[error].unit != r.unit:
        return [_not_judged(r, f, f"recorded in {read.manifest.columns[error].unit}, then {r.unit}") for f in findings]
    mismatch = read.array(error) - read.array(twin)
    done: dict[int, Held] = {}
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
        if any(f.effect == GAIN for f in r.findings):  # the simulation's gain was off: it is fitted beside the findings
            design = np.column_stack([design, read.array(twin)[rows]])
        session = sessions(read)[rows]
        whole = np.column_stack([design, session_datums(design, mismatch[rows], session)])
        k_now, sd, degrees = clustered(whole, mismatch[rows], session)
        for j, k in enumerate(columns):
            done[k] = _judged(r, findings[k], float(k_now[j]), float(sd[j]), degrees, level)
    return [done[k] for k in range(len(findings))]


def contribution(f: Finding, read: Recording, unit: str) -> np.ndarray:
    """A finding's contribution, with its own parameters, on every row of another recording, shape (rows,).

    Raises LookupError or DataError where the recording lacks what it reads.
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
    codes, cluster = np.unique(session, return_inverse=True)
    if codes.size < MIN_CLUSTERS:
        cluster = np.arange(y.size) * min(BLOCKS, max(y.size // 4, 2)) // y.size
    count = int(cluster.max()) + 1
    size = np.linalg.norm(design, axis=0)
    scaled = design / np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10)
    b = inverse @ scaled.T @ y
    scores = np.zeros((count, design.shape[1]))
    np.add.at(scores, cluster, scaled * (y - scaled @ b)[:, None])
    spread = inverse @ scores.T @ scores @ inverse * count / (count - 1) * (y.size - 1) / (y.size - design.shape[1])
    return b / size, np.sqrt(np.maximum(np.diag(spread), 0.0)) / size, count - 1


def _judged(r: ResponseDiagnosis, f: Finding, k: float, sd: float, degrees: int, level: float) -> Held:
    """State of one finding from its factor, the factor's standard deviation, and the interval it had."""
    reach = student_quantile(0.975, degrees) * sd
    then = earlier_spread(f)
    p = 2.0 * student_tail(abs(k - 1.0) / max(float(np.hypot(sd, then)), 1e-12), degrees)
    if p >= level:
        state: State = "undecided" if reach > UNDECIDED or k - reach <= 0 else "unchanged"
    elif k - reach <= 0 <= k + reach:
        state = "gone"
    else:
        state = "reversed" if k < 0 else "larger" if k > 1 else "smaller"
    inner = {p.name for t in terms_of(f) for p in t.nonlinear()}
    sizes = tuple(
        {
            "name": q.name,
            "unit": q.unit,
            "then": q.value,
            "then_ci95": q.ci95,
            "now": k * q.value,
            "now_ci95": sorted(((k - reach) * q.value, (k + reach) * q.value)),
        }
        for q in f.parameters
        if q.name not in inner
    )
    held = Held(r.component, f.effect, state, "", k, (k - reach, k + reach), p, sizes)
    return Held(**{**held.__dict__, "says": _says(held)})


def earlier_spread(f: Finding) -> float:
    """Relative standard deviation that a finding's size had, from the interval of its largest linear parameter."""
    inner = {p.name for t in terms_of(f) for p in t.nonlinear()}
    sizes = [q for q in f.parameters if q.name not in inner and q.value != 0]
    if not sizes:
        return 0.0
    top = max(sizes, key=lambda q: abs(q.value))
    return (top.ci95[1] - top.ci95[0]) / (2 * 1.96) / abs(top.value)


WORDS: dict[str, str] = {
    "unchanged": "still there, its size unchanged",
    "larger": "still there, larger than it was",
    "smaller": "still there, smaller than it was",
    "gone": "gone",
    "reversed": "turned round",
    "undecided": "this recording cannot tell",
}


def _says(h: Held) -> str:
    name = h.effect.replace("_", " ")
    text = f"{h.component}: {name}: {WORDS[h.state]}"
    if h.parameters:
        q = h.parameters[0]
        low, high = q["now_ci95"]
        text += f" ({q['name']} {q['then']:.3g} -> {q['now']:.3g} {q['unit']}, 95 % {low:.3g} to {high:.3g}"
        text += f"; test of no change p = {h.p:.2g})"
    return text


def _not_judged(r: ResponseDiagnosis, f: Finding, why: str) -> Held:
    return Held(r.component, f.effect, "not judged", f"{r.component}: {f.effect.replace('_', ' ')}: not judged: {why}")
