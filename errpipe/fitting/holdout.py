"""Hold-out schemes: splits of a recording into fitted rows and test rows.

Whole runs, days or seasons are held out, never single rows: neighbouring rows share their noise and
their thermal state, so a random split is optimistic. Blocks of one long run exclude a `gap`
around the test block from the fit. Days, months and years need no separate column: they are derived from the
recording's dates.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Literal, NamedTuple, get_args

import numpy as np
import pandas as pd
from pydantic import Field

from errpipe.domain.recording import Column, FrozenModel, Recording
from errpipe.errors import DataError, did_you_mean
from errpipe.yamlfile import quantity

CALENDAR = {"day": 10, "month": 7, "year": 4}  # characters of an ISO 8601 date that name it
HALF_BLOCKS = 3  # of each half, so that a paired test over blocks has six observations
MAX_RUNS = 30  # more folds cost time and do not improve the error estimate


HALVES = "halves"
Scheme = Literal["auto", "leave-one-run-out", "leave-one-group-out", "batches", "blocks", "halves", "forward"]


class Fold(NamedTuple):
    """One split: label of the held-out group, fitted rows, test rows (boolean masks, shape (rows,))."""

    label: str
    train: np.ndarray
    test: np.ndarray


class HoldOut(FrozenModel):
    """The hold-out scheme of a recording.

    `auto`: leave-one-run-out with 3 to 30 runs, ten batches of runs with more, blocks of time
    with fewer.
    """

    scheme: Scheme = Field(
        "auto",
        description="leave-one-group-out holds out a day or season; batches hold out several whole groups at once; "
        "halves of one run (or two runs) predict each other; forward fits only on the past.",
    )
    of: str | None = Field(None, description="Group held out: a column's name or its `of` (day, season, machine).")
    blocks: int = Field(5, ge=2, description="Number of blocks or batches (batches, blocks, and forward without `of`).")
    gap: float = quantity("s", "Rows this close to a test block are not fitted.", 0.0, ge=0)

    @property
    def blocked(self) -> bool:
        """Whether blocks of time are held out instead of labelled groups."""
        return self.scheme == "blocks" or (self.scheme == "forward" and self.of is None)


def groups(recording: Recording, scheme: HoldOut | str = "auto") -> list[Fold]:
    """All folds of a scheme, in order of first appearance; every fold has measured rows on both sides.

    Runs that only log temperatures have no test rows, so they are never held out.

    scheme: a `HoldOut`, or its short form: "leave-one-run-out", "leave-one-group-out:season", "blocks:6",
    "forward:month". Raises DataError if the recording has no such group, no date, or too few groups.
    """
    chosen = resolved(recording, scheme)
    recording = with_calendar(recording, chosen.of)
    seen = measured(recording)
    folds = [fold for fold in _folds(recording, chosen) if seen[fold.test].any() and seen[fold.train].any()]
    if not folds:
        raise DataError(
            f"hold-out {name(chosen)}: the recording has only one group, so nothing can be held out (of one run, "
            "`holdout: {scheme: blocks}` holds out stretches of time)"
        )
    for fold in folds:
        check(fold)
    return folds


def parse(text: str) -> HoldOut:
    """A hold-out from its short form. Raises DataError on an unknown scheme."""
    word, _, detail = text.partition(":")
    known = get_args(HoldOut.model_fields["scheme"].annotation)
    if word not in known:
        raise DataError(f"hold-out: {word!r} is not a scheme (allowed: {', '.join(known)}).{did_you_mean(word, known)}")
    if not detail:
        return HoldOut(scheme=word)
    return HoldOut(scheme=word, blocks=int(detail)) if detail.isdigit() else HoldOut(scheme=word, of=detail)


def name(scheme: HoldOut) -> str:
    """Short form of a scheme, as `groups` reads it."""
    if scheme.scheme in ("batches", "blocks") or (scheme.scheme == "forward" and scheme.of is None):
        return f"{scheme.scheme}:{scheme.blocks}"
    return f"{scheme.scheme}:{scheme.of}" if scheme.of else scheme.scheme


def resolved(recording: Recording, scheme: HoldOut | str = "auto") -> HoldOut:
    """The scheme that `groups` uses: `auto` replaced by its choice for this recording."""
    chosen = parse(scheme) if isinstance(scheme, str) else scheme
    return _automatic(recording, chosen) if chosen.scheme == "auto" else chosen


def check(fold: Fold) -> None:
    """Raise DataError if a row is both fitted and tested, or if one side is empty."""
    both = int(np.count_nonzero(fold.train & fold.test))
    if both:
        raise DataError(f"hold-out {fold.label}: {both} rows are both fitted and tested")
    if not fold.test.any() or not fold.train.any():
        side = "judges" if not fold.test.any() else "fits"
        raise DataError(f"hold-out {fold.label}: no row {side}")


def measured(recording: Recording) -> np.ndarray:
    """Rows with any response, shape (rows,); all if the recording has no response column."""
    names = recording.names("error")
    if not names:
        return np.ones(len(recording), dtype=bool)
    return np.any([np.isfinite(recording.array(name)) for name in names], axis=0)


def labels(recording: Recording, of: str | None) -> np.ndarray:
    """Group label of each row as text, shape (rows,); runs if `of` is None.

    of: a column of role group or run, or the `of` of a group column.
    """
    if of is None or of == "run":
        return np.asarray(recording.run_labels(), dtype=object)[recording.run_codes()]
    for column in (*recording.names("group"), *recording.names("run")):
        if of in (column, recording.manifest.columns[column].of):
            return recording.frame[column].astype(str).to_numpy(dtype=object)
    known = [recording.manifest.columns[c].of or c for c in recording.names("group")]
    raise DataError(f"hold-out: no group {of!r} (present: {', '.join(known) or 'none'}).{did_you_mean(of, known)}")


def with_calendar(recording: Recording, of: str | None) -> Recording:
    """The recording with a group column for a missing day, month or year; else unchanged."""
    if of not in CALENDAR or any(of in (n, recording.manifest.columns[n].of) for n in recording.names("group")):
        return recording
    return recording.with_columns({of: calendar(recording, of)}, {of: Column(role="group", of=of)})


def calendar(recording: Recording, of: str) -> np.ndarray:
    """Day, month or year of each row as text, shape (rows,): from the column of days, else from the time's epoch."""
    length = CALENDAR[of]
    for name in recording.names("group"):
        if recording.manifest.columns[name].of == "day":
            return np.array([str(v)[:length] for v in recording.frame[name]], dtype=object)
    time = recording.name("time")
    epoch = recording.manifest.columns[time].epoch if time else None
    if epoch is None:
        raise DataError(f"hold-out by {of}: the recording has neither a column of days nor an epoch of its time")
    start = datetime.fromisoformat(epoch)  # local days of the shop: neither this host's time zone nor UTC
    days = np.floor(recording.time() / 60.0)
    known = {m: (start + timedelta(minutes=float(m))).isoformat()[:length] for m in np.unique(days)}
    return np.array([known[m] for m in days], dtype=object)


def _automatic(recording: Recording, scheme: HoldOut) -> HoldOut:
    runs = np.unique(recording.run_codes()[measured(recording)]).size
    if runs > MAX_RUNS:
        return scheme.model_copy(update={"scheme": "batches", "blocks": 10})
    if runs >= 3:
        return scheme.model_copy(update={"scheme": "leave-one-run-out"})
    return scheme.model_copy(update={"scheme": "blocks"})


def _folds(recording: Recording, scheme: HoldOut) -> Iterator[Fold]:
    if scheme.scheme == "leave-one-group-out" and scheme.of is None and recording.names("group"):
        scheme = scheme.model_copy(update={"of": recording.names("group")[0]})
    if scheme.scheme == HALVES:
        yield from _halves(recording, scheme.gap)
        return
    if scheme.blocked:
        codes = np.minimum(np.arange(len(recording)) * scheme.blocks // max(len(recording), 1), scheme.blocks - 1)
        order = [(f"block {k + 1} of {scheme.blocks}", k) for k in range(scheme.blocks)]
    else:
        codes, unique = pd.factorize(labels(recording, scheme.of))
        order = [(str(label), k) for k, label in enumerate(unique)]
        if scheme.scheme == "batches":
            batch = np.arange(len(unique)) * min(scheme.blocks, len(unique)) // len(unique)
            ends = [(unique[batch == k][0], unique[batch == k][-1], k) for k in range(int(batch[-1]) + 1)]
            codes, order = batch[codes], [(str(a) if a == b else f"{a} to {b}", k) for a, b, k in ends]
    if len(order) < 2:
        return
    for label, k in order:
        test = codes == k
        train = codes < k if scheme.scheme == "forward" else ~test
        train &= ~_near(recording, test, scheme.gap)
        if train.any() and test.any():
            yield Fold(label, train, test)


def _halves(recording: Recording, gap: float) -> Iterator[Fold]:
    """Blocks of each half of the measured rows, or of each of two runs, predicted only by the other half."""
    seen, run = measured(recording), recording.run_codes()
    place = np.cumsum(seen) - seen
    half = (2 * place >= np.count_nonzero(seen)).astype(int)
    if np.unique(run[seen]).size == 2:
        half = (run != run[seen][0]).astype(int)
    for number in (0, 1):
        own = half == number
        first, last = place[own & seen][[0, -1]]
        block = (place - first) * HALF_BLOCKS // (last - first + 1)
        for k in range(HALF_BLOCKS):
            test = own & (block == k)
            train = ~own & ~_near(recording, test, gap)
            if train.any() and test.any():
                yield Fold(f"block {number * HALF_BLOCKS + k + 1} of {2 * HALF_BLOCKS}", train, test)


def _near(recording: Recording, test: np.ndarray, gap: float) -> np.ndarray:
    """Rows of the test rows' own runs within `gap` seconds of them."""
    near = np.zeros(test.size, dtype=bool)
    if gap <= 0:
        return near
    time, run = recording.time(), recording.run_codes()
    for code in np.unique(run[test]):
        rows = np.flatnonzero(run == code)
        judged = np.sort(time[rows][test[rows]])
        right = np.searchsorted(judged, time[rows])
        before = time[rows] - judged[np.maximum(right - 1, 0)]
        after = judged[np.minimum(right, judged.size - 1)] - time[rows]
        distance = np.minimum(np.where(right > 0, before, np.inf), np.where(right < judged.size, after, np.inf))
        near[rows] = distance <= gap
    return near & ~test
