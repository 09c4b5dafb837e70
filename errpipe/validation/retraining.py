"""Champion against challenger on runs that neither was fitted on; the test may be repeated after every run.

Every new run is scored once, by a model fitted on the runs before it (forward chaining), against the champion and no
compensation. The evidence is an e-process (Ville 1939; Waudby-Smith and Ramdas 2024, betting): each run multiplies a
stake by 1 + bet * score, where the score lies between -1 and 1 and has a mean of at most zero if the challenger is no
better. However often it is evaluated, the probability that the evidence ever reaches 1 / alpha is then at most alpha.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from errpipe.domain.error_model import Validity
from errpipe.domain.recording import Recording
from errpipe.fitting.holdout import Fold, measured
from errpipe.fitting.judging import HeldOut, NothingJudged
from errpipe.fitting.statistics import student_tail
from errpipe.fitting.validity import as_in_a_table, box, extended, fading
from errpipe.models import Family

EVIDENCE = "evidence"  # the gate that is not failed while it does not hold: more runs are needed
ALPHA = 0.05  # probability of ever promoting a challenger that is no better than the champion
# Shares of the stake; their mean does not require an assumed size of the gain
STAKE_SHARES = (0.1, 0.25, 0.5, 0.75, 0.9)
BATCHES = 10  # largest number of fits for the new runs of one evaluation
TOLERANCE = 1.02  # a group may be this much worse than no compensation: rounding of small groups, not a real loss
MIN_COVERAGE = 0.8  # of the 90 % interval; ISO/IEC Guide 98-3 asks for the stated one, ten groups scatter by 0.1
NO_BOX = Validity()
LEAST_RUNS = 3  # of a group, needed for a paired test


@dataclass(frozen=True)
class RunScore:
    """One new run and component: mean squares (um2) of the response, and of the residuals of champion and challenger.

    content: digest of the run's readings, which identifies a copy.
    """

    key: str
    run: str
    component: str
    groups: Mapping[str, str]
    nothing: float
    champion: float
    challenger: float
    rows: int
    content: str = ""

    @property
    def score(self) -> float:
        """Between -1 (the challenger is far worse) and 1 (its residual is zero)."""
        total = self.champion + self.challenger
        return (self.champion - self.challenger) / total if total > 0 else 0.0


@dataclass(frozen=True)
class Gate:
    """One condition of a promotion: whether it is met, and the reason as a sentence."""

    name: str
    passed: bool
    says: str


@dataclass(frozen=True)
class Decision:
    """promote: every gate is met. e_value: evidence for the challenger; needed: 1 / alpha."""

    promote: bool
    e_value: float
    needed: float
    gates: tuple[Gate, ...] = field(default_factory=tuple)


def run_keys(recording: Recording) -> list[str]:
    """Identity of each run across recordings: its label, its groups and its first time; in order of appearance."""
    run, time = recording.run_codes(), recording.time()
    names = recording.names("group")
    out = []
    for code, label in enumerate(recording.run_labels()):
        first = int(np.argmax(run == code))
        groups = [f"{name}={recording.frame[name].iloc[first]}" for name in names]
        out.append("|".join([label, *groups, f"{time[first]:.3f}"]))
    return out


def run_contents(recording: Recording) -> list[str]:
    """Digest of each run's numbers, time counted from its first row, in order of appearance: copies share one."""
    run, time = recording.run_codes(), recording.time()
    names = [n for n, c in recording.manifest.columns.items() if c.role not in ("run", "group", "time", "ignore")]
    columns = [recording.array(n) for n in names if n in recording.frame.columns]
    out = []
    for code in range(len(recording.run_labels())):
        rows = np.flatnonzero(run == code)
        digest = hashlib.sha256(np.round(time[rows] - time[rows[0]], 3).tobytes())
        for values in columns:
            digest.update(values[rows].tobytes())
        out.append(digest.hexdigest())
    return out


def runs_among(recording: Recording, keys: Iterable[str], contents: Iterable[str]) -> frozenset[str]:
    """Keys of the runs that are among `keys`, or whose readings are among `contents` under any name."""
    known, read = frozenset(keys), frozenset(contents)
    both = zip(run_keys(recording), run_contents(recording), strict=True)
    return frozenset(key for key, content in both if key in known or content in read)


def reused_names(old: Recording, new: Recording) -> list[str]:
    """Labels of runs with known name, groups and time but other readings: another run with an old name."""
    before = dict(zip(run_keys(old), run_contents(old), strict=True))
    now = zip(new.run_labels(), run_keys(new), run_contents(new), strict=True)
    return [label for label, key, content in now if before.get(key, content) != content]


def score_new_runs(
    recording: Recording,
    family: Family,
    champion: Mapping[str, np.ndarray],
    known: frozenset[str],
    scored: frozenset[str],
    validity: Validity = NO_BOX,
) -> list[RunScore]:
    """Score every run that is neither known to the champion nor already scored, in order of appearance.

    champion: component -> its prediction, (rows,), from its table. known: keys of the runs of its fit;
    scored: of runs scored earlier (`runs_among`). Each batch of new runs is predicted by a fit on the known
    runs and the new ones before it; of runs with equal readings only the first is scored, because a challenger fitted
    on a run has a smaller residual in its copy. validity: of the champion; a challenger's table fades beyond it. Raises
    DataError, NotIdentifiable as the family does.
    """
    keys, run, contents = run_keys(recording), recording.run_codes(), run_contents(recording)
    first = [c for c, digest in enumerate(contents) if contents.index(digest) == c]
    seen = measured(recording)
    has_rows = [bool(seen[run == code].any()) for code in range(len(keys))]
    new = [c for c in first if keys[c] not in known | scored and has_rows[c]]
    train = np.isin(run, [c for c, key in enumerate(keys) if key in known or key in scored])
    ends = fading(validity, recording)
    out: list[RunScore] = []
    for batch in np.array_split(np.array(new, dtype=int), min(BATCHES, len(new)) or 1):
        if batch.size == 0:
            continue
        test = np.isin(run, batch)
        if not (train & seen).any():  # nothing before them: these runs fit the first model and are not scored
            train = train | test
            continue
        with suppress(NothingJudged):  # a sensor failed in all of them: no evidence for either
            own = extended(box(recording, [*ends], train), ends, recording)
            held, left = as_in_a_table(recording, own)
            for component, judged in family.validate_fold(held, Fold("new runs", train, test)).items():
                after = judged.before + left[judged.rows] * (judged.after - judged.before)
                judged = replace(judged, after=after)
                out += _scores(recording, component, judged, champion[component], keys, contents)
        train = train | test
    return out


def _scores(
    recording: Recording,
    component: str,
    left: HeldOut,
    prediction: np.ndarray,
    keys: Sequence[str],
    contents: Sequence[str],
) -> list[RunScore]:
    run, labels = recording.run_codes(), recording.run_labels()
    residual = champion_residual(recording, component, left, prediction)
    out = []
    for code in dict.fromkeys(run[left.rows].tolist()):
        of_run = run[left.rows] == code
        first = int(left.rows[of_run][0])
        groups = {name: str(recording.frame[name].iloc[first]) for name in recording.names("group")}
        nothing, champion, challenger = (float(np.mean(v[of_run] ** 2)) for v in (left.before, residual, left.after))
        squares = nothing, champion, challenger
        out.append(RunScore(keys[code], labels[code], component, groups, *squares, int(of_run.sum()), contents[code]))
    return out


def champion_residual(recording: Recording, component: str, left: HeldOut, prediction: np.ndarray) -> np.ndarray:
    """Residual of the champion on the test rows, um, (n,), with the same datum as the challenger's figures.

    If the family counts from the start of each run, so does the champion; if it fits a shift of each run,
    the champion's residual is reduced by its mean per run.
    """
    name = str(recording.name("error", component=component))
    raw = recording.array(name) - prediction
    measured_rows = recording.array(name)[left.rows]
    run = recording.run_codes()[left.rows]
    out = raw[left.rows].copy()
    if np.allclose(left.before, measured_rows, rtol=0, atol=1e-9):
        return out
    for code in np.unique(run):
        of_run = run == code
        shift = measured_rows[of_run] - left.before[of_run]
        constant = float(np.ptp(shift)) < 1e-6
        from_start = constant and np.isclose(shift[0], measured_rows[of_run][0])
        zero = out[of_run][0] if from_start else np.mean(out[of_run])
        out[of_run] -= zero
    return out


def e_value(scores: Sequence[float]) -> float:
    """Evidence after these scores (in order): the mean over the bets of the stake's product; 1 for none."""
    stakes = np.outer(STAKE_SHARES, np.clip(np.asarray(scores, dtype=float), -1.0, 1.0))
    logs = np.log1p(stakes).sum(axis=1)
    highest = float(logs.max())
    return float(np.exp(min(highest, 700.0)) * np.mean(np.exp(logs - highest)))


def per_run(scores: Sequence[RunScore]) -> list[float]:
    """One score per run: the mean over its components."""
    by_run: dict[str, list[float]] = {}
    for s in scores:
        by_run.setdefault(s.key, []).append(s.score)
    return [float(np.mean(v)) for v in by_run.values()]


def decide(scores: Sequence[RunScore], others: Sequence[Gate] = (), *, alpha: float = ALPHA) -> Decision:
    """The decision on a promotion: evidence over all scored runs, no group worse, and the other gates."""
    needed = 1.0 / alpha
    value = e_value(per_run(scores))
    runs = len({s.key for s in scores})
    evidence = Gate(
        EVIDENCE,
        value >= needed,
        f"e-value {value:.3g} over {runs} new run{'' if runs == 1 else 's'}, {needed:.3g} needed (alpha {alpha:g})",
    )
    gates = (evidence, *_no_group_worse(scores), *others)
    return Decision(all(g.passed for g in gates), value, needed, gates)


def by_group(scores: Sequence[RunScore]) -> dict[tuple[str, str, str], list[RunScore]]:
    """(component, grouping, label) -> its runs; the grouping "all" contains every run."""
    out: dict[tuple[str, str, str], list[RunScore]] = {}
    for s in scores:
        for grouping, label in (("all", "new runs"), *s.groups.items()):
            out.setdefault((s.component, grouping, label), []).append(s)
    return out


def _no_group_worse(scores: Sequence[RunScore]) -> list[Gate]:
    groups = by_group(scores)
    level = 0.05 / max(len(groups), 1)  # Bonferroni: at most 5 % false alarms over all groups
    out = []
    for (component, grouping, label), runs in groups.items():
        where = f"{component}, {label}" if grouping == "all" else f"{component}, {grouping} {label}"
        nothing, champion, challenger = (rms(runs, name) for name in ("nothing", "champion", "challenger"))
        figures = f"{nothing:.3g} uncompensated, {champion:.3g} champion, {challenger:.3g} challenger, um rms"
        if challenger > TOLERANCE * nothing:
            out.append(Gate(where, False, f"worse than no compensation: {figures}"))
        elif significantly_worse([s.score for s in runs], level):
            out.append(Gate(where, False, f"worse than the champion: {figures}"))
        else:
            out.append(Gate(where, True, figures))
    return out


def significantly_worse(scores: Sequence[float], level: float) -> bool:
    """One-sided paired t test over runs: is the mean score below zero? Not evaluated with few runs."""
    if len(scores) < LEAST_RUNS or np.mean(scores) >= 0:
        return False
    spread = float(np.std(scores, ddof=1)) / np.sqrt(len(scores))
    if spread == 0.0:
        return True
    return bool(student_tail(-np.mean(scores) / spread, len(scores) - 1) < level)


def rms(scores: Sequence[RunScore], name: str) -> float:
    """Root mean square over the rows of several runs, um. name: nothing, champion or challenger."""
    rows = np.array([s.rows for s in scores], dtype=float)
    squares = np.array([getattr(s, name) for s in scores])
    return float(np.sqrt(np.sum(rows * squares) / max(rows.sum(), 1.0)))
