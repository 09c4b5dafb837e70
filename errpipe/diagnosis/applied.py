"""Findings inserted into the simulation: their own terms, evaluated causally on every row of a recording.

All parameters are estimated together, robustly, on recorded minus simulated, with a datum (one per session if
the Bayesian information criterion prefers it): the linear ones without limits, the non-linear ones within the interval
of their finding. Each finding explains what its equation can; departures from the textbook form stay in the mismatch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter, ValidationError

from errpipe.diagnosis import units
from errpipe.diagnosis.derived import with_motion
from errpipe.diagnosis.hypotheses import mask_of
from errpipe.domain.diagnosis import Diagnosis, Finding, ResponseDiagnosis
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import hold, sessions
from errpipe.errors import DataError
from errpipe.fitting import solve
from errpipe.fitting.spec import AnyTerm
from errpipe.terms import Term

GAIN = "recalibration"
GAIN_SPREAD = 0.5  # prior standard deviation of gain - 1; regularises gains of nearly collinear parts
PLAIN = 0.02  # largest residual, as a share of the signal's rms, at which each of its effects has its own gain
MOST_STEPS = 12  # Gauss-Newton steps for the non-linear parameters, which start at their best values
UNNAMED = "it is not a known effect: there is no equation that would predict it again"
NO_TERM = "its form exists only in the search: no term of an error model is equivalent"
WORSE = "without what could not be put in, the simulation would be worse with it"
DRIVING = ("temperature", "pressure", "humidity", "force", "spindle_speed", "feed", "coolant", "load", "velocity")
Held = Sequence[tuple[Term, tuple[float, ...]]]  # decomposition of a simulated signal, with non-linear parameters


@dataclass(frozen=True)
class Part:
    """One accepted finding: its terms with all parameter values, and its contribution on every row, (rows,)."""

    finding: Finding
    terms: tuple[Term, ...]
    values: tuple[dict[str, float], ...]
    contribution: np.ndarray

    @property
    def of_measuring(self) -> bool:
        """Is it an artefact of the measurement, not an error of the machine?"""
        return any(t.artefact for t in self.terms)


@dataclass(frozen=True)
class Corrected:
    """One response: accepted findings, refused ones with reasons, and the corrected simulation, (rows,).

    gain, offset: recalibration of the simulated signal before the parts are added; mismatch: before any correction.
    """

    component: str
    unit: str
    column: str
    parts: tuple[Part, ...]
    refused: tuple[tuple[str, str], ...]
    simulated: np.ndarray
    mismatch: np.ndarray
    left: np.ndarray
    gain: float = 1.0
    offset: float = 0.0


def corrected(
    recording: Recording, diagnosis: Diagnosis, least: float, held: Sequence[Held] | None = None
) -> list[Corrected]:
    """Correct every diagnosed response of a recording. least: lowest confidence of a finding that is applied.

    held: for each response the decomposition of its simulated signal, so that each effect can have its own gain.
    Raises DataError if the recording lacks a response, its simulation, or enough rows.
    """
    read = causal(recording)
    every = held or [()] * len(diagnosis.responses)
    return [_response(read, recording, r, least, h) for r, h in zip(diagnosis.responses, every, strict=True)]


def causal(recording: Recording) -> Recording:
    """The recording with the motion derived from positions, and gaps of driving columns filled with the last reading.

    A gap at the start of a session is filled with the first reading.
    """
    recording, _ = with_motion(recording)
    session, columns = sessions(recording), {}
    for role in DRIVING:
        for name in recording.names(role):
            values = recording.array(name)
            if not np.isfinite(values).all() and np.isfinite(values).any():
                held = hold(session, values)
                columns[name] = np.where(np.isfinite(held), held, hold(session[::-1], held[::-1])[::-1])
    return replace(recording, frame=recording.frame.assign(**columns), between="inferred")


def terms_of(finding: Finding) -> tuple[Term, ...]:
    """The terms of a finding, () if no error model can express it."""
    try:
        return tuple(TypeAdapter(AnyTerm).validate_python(t) for t in finding.all_terms())
    except ValidationError:
        return ()


def inner_values(finding: Finding, term: Term, recording: Recording, response: str) -> dict[str, float]:
    """Non-linear parameters of a finding in its term's own units. Raises KeyError if one is missing."""
    stated = {p.name: p.value for p in finding.parameters}
    rotary = units.on_rotary_axis(term, recording)
    out = {}
    for p in term.nonlinear():
        known = term.fixed.get(p.name)
        out[p.name] = stated[p.name] / units.reported(p.unit, response, rotary)[1] if known is None else known
    return out


def activity(finding: Finding, recording: Recording) -> np.ndarray:
    """1 on rows where a finding acts, else 0, shape (rows,)."""
    masks: list[tuple] = [("runs", finding.where.runs)] if finding.where.runs else []
    masks += [("range", name, *limits) for name, limits in finding.where.ranges.items()]
    return np.prod([np.ones(len(recording)), *(mask_of(mask, recording) for mask in masks)], axis=0)


@dataclass(frozen=True)
class _Block:
    """A finding to be fitted: its terms, non-linear values with their spans, and where it acts, (rows,)."""

    finding: Finding
    terms: tuple[Term, ...]
    inner: tuple[dict[str, float], ...]
    inside: np.ndarray

    def columns(self, recording: Recording) -> np.ndarray:
        """Design columns, shape (rows, linear parameters)."""
        each = zip(self.terms, self.inner, strict=True)
        blocks = [t.basis(recording, *(v[p.name] for p in t.nonlinear())) for t, v in each]
        return np.column_stack(blocks) * self.inside[:, None]

    def spans(self, recording: Recording, response: str) -> dict[str, tuple[float, float, float]]:
        """Non-linear parameters that have an interval: value, low, high, in the term's own units."""
        parameters = {p.name: p for p in self.finding.parameters}
        out = {}
        for p in self.terms[0].free():
            factor = units.reported(p.unit, response, units.on_rotary_axis(self.terms[0], recording))[1]
            low, high = (v / factor for v in parameters[p.name].ci95)
            if low < self.inner[0][p.name] < high:
                out[p.name] = (self.inner[0][p.name], low, high)
        return out

    def at(self, values: dict[str, float]) -> _Block:
        """A copy with other non-linear values."""
        return replace(self, inner=tuple(v | values for v in self.inner))


def block_of(finding: Finding, recording: Recording, response: str) -> _Block:
    """A finding with its diagnosed parameters. Raises LookupError or DataError if a column that it needs is missing."""
    terms = terms_of(finding)
    if not terms:
        raise LookupError(NO_TERM)
    inner = tuple(inner_values(finding, t, recording, response) for t in terms)
    made = _Block(finding, terms, inner, activity(finding, recording))
    made.columns(recording)
    return made


def _response(read: Recording, recording: Recording, r: ResponseDiagnosis, least: float, held: Held) -> Corrected:
    error = recording.name("error", component=r.component)
    twin = recording.name("simulated", component=r.component)
    if error is None or twin is None:
        what = "recorded" if error is None else "simulated"
        raise DataError(f"{r.component}: the recording has no {what} column for it")
    simulated = recording.array(twin)
    mismatch = recording.array(error) - simulated
    refused, blocks, gains = [], [], None
    for f in r.findings:
        problem = _refusal(f, r, least)
        if not problem and f.effect == GAIN:
            gains = f
        elif not problem:
            try:
                blocks.append(block_of(f, read, r.unit))
            except (LookupError, DataError) as err:
                problem = str(err.args[0]).splitlines()[0] if err.args else NO_TERM
        if problem:
            refused.append((f.effect, problem))
    if not blocks and gains is None:
        return Corrected(r.component, r.unit, twin, (), tuple(refused), simulated, mismatch, mismatch)
    parts, gain, offset = _Solve(read, r.unit, simulated, mismatch, blocks, gains, held).run()
    added = np.sum([p.contribution for p in parts], axis=0) + (gain - 1.0) * simulated + offset
    better, residual = simulated + added, mismatch - added
    size = np.nanstd if all(p.finding.empirical is None for p in parts) else lambda left: np.sqrt(np.nanmean(left**2))
    if size(residual) > size(mismatch):  # the level of an equation is arbitrary where each session has its own datum
        refused += [(p.finding.effect, WORSE) for p in parts]
        return Corrected(r.component, r.unit, twin, (), tuple(refused), simulated, mismatch, mismatch)
    return Corrected(r.component, r.unit, twin, tuple(parts), tuple(refused), better, mismatch, residual, gain, offset)


def _refusal(f: Finding, r: ResponseDiagnosis, least: float) -> str:
    """Why a finding is not inserted into the simulation, '' if it is."""
    if f.effect != GAIN and not f.all_terms():
        return UNNAMED
    alone = f.empirical.share if f.empirical is not None and f is r.findings[0] else 0.0  # held-out rows prove it
    if max(f.group_confidence(), alone) < least:
        return f"its confidence of {f.group_confidence():.2f} is below {least:.2f}"
    if f.effect != GAIN and r.holdout.rms_after_um >= r.holdout.rms_before_um:
        return "held-out rows are no better explained with it"
    return ""


@dataclass
class _Solve:
    """Joint estimate of the parameters of all findings of a response."""

    read: Recording
    unit: str
    simulated: np.ndarray
    mismatch: np.ndarray
    blocks: list[_Block]
    gains: Finding | None
    held: Held

    def run(self) -> tuple[list[Part], float, float]:
        """The parts, and gain and offset of the simulated signal as a whole."""
        own = self._own_parts() if self.gains is not None else []
        extra = [p.contribution for p in own] or ([self.simulated] if self.gains is not None else [])
        beside = np.column_stack([np.zeros((self.simulated.size, 0)), *extra])
        design = self._design(self.blocks, beside)
        rows = np.flatnonzero(np.isfinite(self.mismatch) & np.isfinite(design).all(axis=1))
        if rows.size < 3 * (design.shape[1] + 1):
            raise DataError(f"only {rows.size} rows hold all that the findings read: too few to put them in")
        datum = session_datums(design[rows], self.mismatch[rows], sessions(self.read)[rows])
        self._refine(rows, np.column_stack([beside[rows], datum]))
        design = np.column_stack([self._design(self.blocks, beside)[rows], datum])
        first = design.shape[1] - datum.shape[1] - len(extra)
        known = [solve.Prior(first + k, 0.0, GAIN_SPREAD) for k in range(len(extra))]
        b = solve.robust(design, self.mismatch[rows], priors=known).coefficients
        parts = self._parts(b[:first]) + [_scaled(p, float(g)) for p, g in zip(own, b[first:], strict=False)]
        whole = 1.0 + float(b[first]) if extra and not own else 1.0
        return parts, whole, float(b[-1]) if datum.shape[1] == 1 else 0.0

    def _design(self, blocks: Sequence[_Block], beside: np.ndarray) -> np.ndarray:
        return np.column_stack([*(b.columns(self.read) for b in blocks), beside])

    def _parts(self, gains: np.ndarray) -> list[Part]:
        """The findings with their linear parameters, in the order of the blocks."""
        out, at = [], 0
        for block in self.blocks:
            values, first = [], at
            for term, inner in zip(block.terms, block.inner, strict=True):
                names = [p.name for p in term.linear()]
                values.append(dict(zip(names, gains[at : at + len(names)].tolist(), strict=True)) | inner)
                at += len(names)
            out.append(Part(block.finding, block.terms, tuple(values), block.columns(self.read) @ gains[first:at]))
        return out

    def _refine(self, rows: np.ndarray, beside: np.ndarray) -> None:
        """Optimise the non-linear parameters for the textbook forms, each within the interval of its finding."""
        from scipy.optimize import least_squares

        spans = [(k, n, *v) for k, b in enumerate(self.blocks) for n, v in b.spans(self.read, self.unit).items()]
        if not spans:
            return
        y = self.mismatch[rows]

        def blocks(u: np.ndarray) -> list[_Block]:
            out = list(self.blocks)
            for (k, name, *_), value in zip(spans, u * scale, strict=True):
                out[k] = out[k].at({name: float(value)})
            return out

        def left(u: np.ndarray) -> np.ndarray:
            design = np.column_stack([*(b.columns(self.read)[rows] for b in blocks(u)), beside])
            return y - design @ np.linalg.lstsq(design, y, rcond=None)[0]

        start, low, high = (np.array([s[j] for s in spans]) for j in (2, 3, 4))
        scale = np.maximum(np.abs(start), 1e-12)
        spread = (low / scale, high / scale)
        optimum = least_squares(left, start / scale, bounds=spread, diff_step=1e-4, max_nfev=MOST_STEPS)
        if 2 * optimum.cost < float(np.sum(left(start / scale) ** 2)):
            self.blocks = blocks(optimum.x)

    def _own_parts(self) -> list[Part]:
        """The effects of which the simulated signal is a sum; [] if it cannot be decomposed."""
        assert self.gains is not None
        made = []
        for term, inner in self.held:
            try:
                made.append((term, inner, term.basis(self.read, *inner)))
            except (LookupError, DataError):
                return []
        if not made:
            return []
        design = np.column_stack([*(m[2] for m in made), np.ones(self.simulated.size)])
        rows = np.isfinite(self.simulated) & np.isfinite(design).all(axis=1)
        b = np.linalg.lstsq(design[rows], self.simulated[rows], rcond=None)[0]
        if np.std(self.simulated[rows] - design[rows] @ b) > PLAIN * np.std(self.simulated[rows]):
            return []
        out, at = [], 0
        for term, inner, columns in made:
            coefficients, at = b[at : at + columns.shape[1]], at + columns.shape[1]
            values = dict(zip((p.name for p in term.linear()), coefficients.tolist(), strict=True))
            values |= dict(zip((p.name for p in term.nonlinear()), inner, strict=True))
            out.append(Part(self.gains, (term,), (values,), columns @ coefficients))
        return out


def _scaled(part: Part, gain: float) -> Part:
    (term,), (values,) = part.terms, part.values
    scaled = values | {p.name: gain * values[p.name] for p in term.linear()}
    return replace(part, values=(scaled,), contribution=gain * part.contribution)


def session_datums(design: np.ndarray, y: np.ndarray, session: np.ndarray) -> np.ndarray:
    """Columns of the datum next to a design: one, or one per session if that explains enough more (BIC)."""
    single = np.ones((y.size, 1))
    codes, inside = np.unique(session, return_inverse=True)
    if codes.size < 2 or codes.size > y.size // 10:
        return single
    each_session = np.eye(codes.size)[inside]
    criterion = []
    for columns in (single, each_session):
        whole = np.column_stack([design, columns])
        residual = y - whole @ np.linalg.lstsq(whole, y, rcond=None)[0]
        criterion.append(y.size * np.log(np.mean(residual**2) + 1e-300) + columns.shape[1] * np.log(y.size))
    return single if criterion[0] <= criterion[1] else each_session
