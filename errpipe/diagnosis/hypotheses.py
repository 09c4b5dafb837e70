"""Every effect in every binding as design columns: the textbook form, and departures from it.

A hypothesis has `core` columns (the term's own basis at given non-linear parameters) and `slack` columns:
how real parts depart from the textbook (a lead error that is not quite straight, friction that varies along the
screw, a body not in equilibrium at the start). A slack column's freedom is its standard deviation
relative to the core's size; all columns are scaled to unit rms over the selected rows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from errpipe.diagnosis.coloured import Colour
from errpipe.diagnosis.evidence import ScoredHypotheses, Table
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.fitting.parallel import InTurn, prefetched
from errpipe.kernels import evidence
from errpipe.terms import MANY_STARTS, Signals, Term, search_of
from errpipe.terms import TERMS as ALL_TERMS

TERMS = tuple(kind for kind in ALL_TERMS if kind.reports_as)
PROPORTIONAL = 0.999  # correlation of a position with time from which the two cannot be distinguished
MANY_ROWS = 5000  # from which another thread builds columns; chosen on: at 300 to 1,400 rows that takes 5 % longer
LEVEL = 1.0  # level of a partial thermal effect, over its spread: the reference of its rise is unknown there
TIME_ALONE = -3.0  # log odds of an effect of time alone in that case: position is what the test varies on purpose


@dataclass(frozen=True)
class Hypothesis:
    """One effect, bound to columns, at given non-linear parameters."""

    effect: str
    terms: tuple[Term, ...]
    nonlinear: tuple[tuple[float, ...], ...]
    drivers: tuple[str, ...]
    prior: float = 0.0  # log prior odds against the other hypotheses
    mask: tuple = ()  # ("runs", labels) or ("range", column, low, high): acts only there

    @cached_property
    def key(self) -> tuple:
        """Identity that is common to all points of a grid of non-linear parameters."""
        return (self.effect, self.drivers, tuple(t.model_dump_json() for t in self.terms), self.mask)


class Library:
    """All hypotheses for a response on its rows: columns of unit rms, with their freedoms.

    places[i] are the columns of hypothesis i in the table, the first cores[i] of them the textbook form;
    freedoms[i]: relative standard deviation of each; scales[i]: response units per unit of the basis column.
    table: whitened products; its column `datum` is the constant.
    """

    def __init__(self, made: Iterable[Made], run: np.ndarray, fold: np.ndarray, starts: int = 1):
        """made: each hypothesis with its scaled block and the number of its core columns, in order of creation.

        starts: number of columns that describe a body's state at the start of each session.
        """
        self.starts, self.rows = starts, np.zeros(0, dtype=int)  # rows: indices into the recording, once known
        self.hypotheses: list[Hypothesis] = []
        self.cores: list[int] = []
        self.freedoms: list[np.ndarray] = []
        self.scales: list[np.ndarray] = []
        self._families: dict[tuple, list[int]] = {}
        self._together: ScoredHypotheses | None = None
        self.gain_sd = np.zeros(0)  # of hypotheses whose gain is known to be 1, else NaN; as long as the last `listed`
        blocks = (self._listed(h, block, cores) for h, block, cores in made)
        self.table = Table(run, itertools.chain(blocks, [np.ones((run.size, 1))]), fold)
        *self.places, (self.datum,) = self.table.places

    @property
    def listed(self) -> ScoredHypotheses:
        """All hypotheses, to be scored together."""
        if self._together is None or self._together.every.size != len(self.hypotheses):
            self._together = ScoredHypotheses(self.places, self.freedoms, self.cores)
            known = [h.terms[0].gain_sd for h in self.hypotheses]
            self.gain_sd = np.array([np.nan if sd is None else sd for sd in known], dtype=float)
        return self._together

    def copied(self, h: Hypothesis) -> Made | None:
        """A hypothesis as built for this response, for another one on the same rows; None if it was not."""
        for i in self._families.get(h.key, ()):
            if i < len(self.table.places) - 1 and self.hypotheses[i].nonlinear == h.nonlinear:
                columns = self.table.copied(self.places[i])
                return columns and (h, (columns, self.freedoms[i], self.scales[i]), self.cores[i])
        return None

    def _listed(self, h: Hypothesis, block: Block, cores: int) -> Any:
        """Store a hypothesis; return its columns."""
        columns, freedom, scale = block
        self._families.setdefault(h.key, []).append(len(self.hypotheses))
        self.hypotheses.append(h)
        self.cores.append(cores)
        self.freedoms.append(freedom)
        self.scales.append(scale)
        return columns

    def extend(self, made: list[Made]) -> None:
        """Append hypotheses, each with its scaled block and the number of its core columns."""
        blocks = [self._listed(*one) for one in made]
        edges = np.cumsum([0, *[block.shape[1] for block in blocks]])
        index = self.table.add(np.column_stack(blocks))
        self.places += [index[a:b] for a, b in itertools.pairwise(edges)]

    def truncate(self, hypotheses: int, columns: int) -> None:
        """Return to the first `hypotheses` hypotheses and `columns` columns."""
        for h in self.hypotheses[hypotheses:]:
            self._families[h.key].pop()
        for listed in (self.hypotheses, self.cores, self.freedoms, self.scales, self.places):
            del listed[hypotheses:]
        self.table.truncate(columns)
        self._together = None

    def recolour(self, colour: Colour) -> None:
        """Evaluate everything in noise of another colour; signals (`Data`) must be created again."""
        if colour != self.table.colour:
            self.table.recolour(colour)
            self._together = None

    def block(self, i: int, recording: Recording, rows: np.ndarray) -> np.ndarray:
        """Columns of a hypothesis before whitening, rebuilt (rows, k)."""
        core, slack, rel = columns_of(self.hypotheses[i], recording)
        made = scaled(core[rows], slack[rows], rel)
        assert made is not None
        return made[0]

    def textbook(self, i: int) -> int:
        """Number of its columns that are its own form, with levels of parts, references, rises and initial states."""
        h = self.hypotheses[i]
        starts = {"any reference": 1, "any reference and end": 2, "any rise": 3, "any start": self.starts}
        starts |= {"any start and end": self.starts + 1, "any shape": self.places[i].size}
        level = int(bool(h.mask) and has_level(h, h.mask[0]))
        return min(self.cores[i] * (1 + starts.get(h.terms[0].form, 0)) + level, self.places[i].size)

    def family(self, i: int) -> list[int]:
        """The hypotheses that differ from it only in non-linear parameters."""
        return self._families[self.hypotheses[i].key]


def build(
    recording: Recording,
    component: str,
    rows: np.ndarray,
    raw: Recording | None = None,
    signals: tuple[np.ndarray, ...] = (),
) -> Library:
    """The library for a response; raw: the recording as read, in which sensor faults are visible.

    signals: what is to be explained, on the selected rows; waves of unknown length are searched for in them.
    """
    run = recording.run_codes()[rows]
    motion = motion_columns(recording, rows)
    still = tuple(signal - motion @ (motion.T @ signal) for signal in signals)
    seen = Signals(rows, still, signals[0] if signals else None, motion)
    every = enumerate_all(recording, component, raw or recording, seen)
    count = np.unique(session := sessions(recording)).size
    starts = 1 if count >= MANY_STARTS else count
    with (turn := recording.derived.setdefault(Library, InTurn()))():
        like, turn.left = turn.left, None  # release its memory before more is allocated
        like = like if like and np.array_equal(like.rows, rows) else None
        made = _with_columns(every, recording, rows, like)
        turn.left = library = Library(made, run, folds(run, session[rows])[0], starts)
        library.rows = rows
    return library


def _with_columns(every: Iterable[Hypothesis], recording: Recording, rows: np.ndarray, like: Any) -> Iterator[Made]:
    """Hypotheses whose core columns vary on these rows, one at a time; like: a library on the same rows."""
    taken = slice(None) if rows.size == len(recording) else rows  # a slice copies nothing

    def made(hypothesis: Hypothesis) -> tuple[Hypothesis, Block | None, int]:
        if like is not None and (copied := like.copied(hypothesis)):
            return copied
        core, slack, rel = columns_of(hypothesis, recording)
        return hypothesis, scaled(core[taken], slack[taken], rel, for_table=True), core.shape[1]

    each = (prefetched if rows.size >= MANY_ROWS else map)(made, every)
    return ((hypothesis, block, cores) for hypothesis, block, cores in each if block is not None)


FOLDS = MANY_STARTS  # so that each fold holds out at least one session
BLOCKS = 8  # stretches of the recording that make up one fold


def folds(run: np.ndarray, session: np.ndarray | None = None) -> tuple[np.ndarray, str]:
    """Number of the fold that holds out each row, shape (rows,), and the scheme's name.

    If the machine was restarted often enough (session of each row: see `drivers.sessions`), sessions are held out.
    Else the recording is cut into FOLDS * BLOCKS stretches of neighbouring rows, so that each fold sees every run and
    thermal state, and no row is predicted only from its neighbours. FOLDS in a row go to one fold each, in an order
    drawn for each turn (of equal seed): in a fixed order, a circle of ten stretches would lose the same angles.
    """
    if session is not None:
        codes, inside = np.unique(session, return_inverse=True)
        if codes.size >= MANY_STARTS:
            return inside % FOLDS, f"{codes.size} whole runs in {FOLDS} groups"
    count = min(FOLDS * BLOCKS, max(run.size // 4, FOLDS))
    block = np.arange(run.size) * count // max(run.size, 1)
    draw = np.random.default_rng(FOLDS)
    dealt = np.concatenate([draw.permutation(FOLDS) for _ in range(-(-count // FOLDS))])
    return dealt[block], f"{count} blocks of neighbouring rows in {FOLDS} groups"


Block = tuple[Any, np.ndarray, np.ndarray]  # columns (rows, k) or `Copied`, their freedoms (k,) and scales (k,)
Made = tuple[Hypothesis, Block, int]  # a hypothesis, its scaled block, and the number of its core columns


def scaled(core: np.ndarray, slack: np.ndarray, rel: np.ndarray, for_table: bool = False) -> Block | None:
    """Columns of unit size (for a table: each in one piece), freedoms, scales; None where a core column is constant."""
    if not np.isfinite(core).all() or not np.isfinite(slack).all():
        return None
    rms, spread = rms_and_spread(core)
    if not (rms > 0).all() or (spread < 1e-6 * rms).all():
        return None
    size = np.where(spread > 1e-6 * rms, spread, rms)
    slack_rms = rms_and_spread(slack)[0]
    keep = slack_rms > 1e-12
    kept, scale = slack[:, keep] if not (for_table and keep.all()) else slack, np.r_[size, slack_rms[keep]]
    if for_table:
        block = np.empty((len(core), scale.size), order="F")
        np.divide(core, size, out=block[:, : size.size])
        np.divide(kept, slack_rms[keep], out=block[:, size.size :])
    else:
        block = np.concatenate([core / size, kept / slack_rms[keep]], axis=1)
    return block, np.concatenate([np.ones(size.size), rel[keep]]), scale


def rms_and_spread(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rms and standard deviation of columns (rows, k), shapes (k,)."""
    if columns.shape[1] > 1:
        return evidence.rms_and_spread(np.ascontiguousarray(columns))
    return np.sqrt(np.mean(columns**2, axis=0)), columns.std(axis=0)


def enumerate_all(recording: Recording, component: str, raw: Recording, signals: Signals) -> Iterator[Hypothesis]:
    by_time = time_of_one_pass(recording)
    for kind in TERMS:
        bound = list(kind.hypotheses(recording, raw, component))
        groups: list[tuple[Term, ...]] = [(t,) for t in bound]
        if component == "E_R" and kind.on_both_axes:
            groups += [tuple(bound)] if len(bound) == 2 else both_axes(bound)
        log_odds = np.array([group[0].log_prior_odds() for group in groups])
        for group, log_odd in zip(groups, log_odds, strict=True):
            drivers = tuple(dict.fromkeys(n for t in group for n in t.drivers(recording)))
            points = grid(group[0], recording, signals)
            # an effect's bindings share its odds with all at least as likely, and (half, neighbours agree) its grid
            shared = -np.log(np.sum(log_odds >= log_odd)) - 0.5 * np.log(max(len(points), 1))
            alone = TIME_ALONE if by_time and set(drivers) == by_time else 0.0
            odds = float(log_odd + shared) + alone
            for values in points:
                own = odds + sizes(group[0], values)
                yield Hypothesis(group[0].reports_as, group, (values,) * len(group), drivers, own)
        located = list(kind.estimates(recording, component, signals))
        for term, values in located:
            odds = term.log_prior_odds() - float(np.log(len(located))) + sizes(term, values)
            yield Hypothesis(term.reports_as, (term,), (values,), tuple(term.drivers(recording)), odds)


def time_of_one_pass(recording: Recording) -> set[str]:
    """Name of the time column if a position grows in proportion to it, else nothing: one pass at constant speed."""
    time = recording.name("time")
    places = (recording.array(n) for role in ("position", "command") for n in recording.names(role))
    if time is None or not any(
        np.ptp(x) > 0 and abs(np.corrcoef(x, recording.time())[0, 1]) > PROPORTIONAL for x in places
    ):
        return set()
    return {time}


def sizes(term: Term, values: tuple[float, ...]) -> float:
    """Log prior density of a term's non-linear values relative to typical ones."""
    return sum(search_of(p).log_prior(v, p) for p, v in zip(term.nonlinear(), values, strict=True))


def both_axes(bound: list[Term]) -> list[tuple[Term, Term]]:
    """Pairs of bindings to the two axes of a circle that are otherwise equal."""
    pairs = itertools.combinations([t for t in bound if hasattr(t, "axis")], 2)
    return [(a, b) for a, b in pairs if a.axis != b.axis and a.model_copy(update={"axis": b.axis}) == b]


def motion_columns(recording: Recording, rows: np.ndarray) -> np.ndarray:
    """Orthonormal columns of a datum, the axes' speeds, accelerations and their signs, which would mask waves."""
    columns = [np.ones(rows.size)]
    for name in (*recording.names("velocity"), *recording.names("acceleration")):
        values = recording.array(name)[rows]
        if np.isfinite(values).all() and values.std() > 0:
            columns += [values / values.std(), np.sign(values)]
    left, size, _ = np.linalg.svd(np.column_stack(columns), full_matrices=False)
    return left[:, size > 1e-10 * size[0]]


def grid(term: Term, recording: Recording, signals: Signals) -> list[tuple[float, ...]]:
    """Values of the non-linear parameters to try: all combinations of the values of each parameter."""
    axes = [
        (term.fixed[p.name],) if p.name in term.fixed else search_of(p).values(term, p.name, recording, signals)
        for p in term.nonlinear()
    ]
    return list(itertools.product(*axes))


def columns_of(h: Hypothesis, recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Core columns, slack columns and the slacks' freedoms, on all rows of the recording."""
    bases = [t.basis(recording, *nl) for t, nl in zip(h.terms, h.nonlinear, strict=True)]
    core = np.column_stack(bases)
    slack, rel = [], []
    for term, nl, base in zip(h.terms, h.nonlinear, bases, strict=True):
        for column, freedom in term.slack(recording, base, *nl):
            slack.append(column)
            rel.append(freedom)
    if h.mask:
        inside = mask_of(h.mask, recording)
        core = core * inside[:, None]
        slack = [s * inside for s in slack]
        if has_level(h, h.mask[0]):
            slack, rel = [inside, *slack], [LEVEL, *rel]
    return core, np.column_stack(slack) if slack else np.zeros((len(recording), 0)), np.array(rel)


def has_level(h: Hypothesis, kind: str) -> bool:
    """Does a partial thermal effect need its own level? All rows share the datum; single runs are re-zeroed anyway."""
    return kind != "runs" and h.terms[0].family == "thermal" and not h.terms[0].counts_from_any_reference()


def mask_of(mask: tuple, recording: Recording) -> np.ndarray:
    """1 where a partial effect acts, else 0."""
    if mask[0] == "runs":
        return np.isin(np.array(recording.run_labels())[recording.run_codes()], mask[1]).astype(float)
    values = recording.array(mask[1])
    return ((values >= mask[2]) & (values <= mask[3])).astype(float)
