"""Runs whose labels repeat, on another day or in another state of the machine, are separate runs."""

from __future__ import annotations

import itertools
from datetime import datetime, timedelta

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.proposed import Proposal

SAME_TARGET = 1e-3  # of the range of a position: closer ones are one target, as in `measured_points`
FEWEST_COPIED = 8  # rows: fewer may be equal by chance on a coarse gauge
AGAIN = 0.5  # of the targets of a stretch measured before from the same side: one or two targets are a repeated reading


def separate(p: Proposal) -> None:
    """Give a run another label if its targets are measured again, from the same side, after other runs."""
    run = p.first("run")
    names = [n for role in ("command", "position") for n, e in p.entries.items() if e["role"] == role and n in p.data]
    if run is None or run not in p.data or not names:
        return
    label = np.unique(np.asarray(p.data[run], dtype=str), return_inverse=True)[1]
    places = [p.data[n] for n in names[: 1 if p.first("command") else None]]
    places = [np.round(x / max(SAME_TARGET * float(np.ptp(x)), 1e-9)) for x in places]
    places += [p.data[n] for n, e in p.entries.items() if e["role"] == "direction" and n in p.data]
    target = np.unique(np.stack(places, axis=1), axis=0, return_inverse=True)[1].ravel()
    turn = _turns(label, target)
    if not turn.any():
        return
    _refuse_copy(p, run, turn)
    days = _days(p)
    labels = [str(v) for v in p.data[run]]
    dated = days is not None and len({*zip(labels, days, strict=True)}) == len({*zip(labels, turn, strict=True)})
    p.data[run] = [
        f"{day} {v}" if dated else v if t == 0 else f"{v} ({t + 1})"
        for v, t, day in zip(labels, turn.tolist(), days if days is not None else labels, strict=True)
    ]
    p.notes.append(
        f"the runs of {run!r} restart with the same targets: taken as separate runs, "
        f"{', '.join(dict.fromkeys(p.data[run]))}"
    )


def _refuse_copy(p: Proposal, run: str, turn: np.ndarray) -> None:
    """Raise DataError if the rows of the repeated runs are those of the first ones, to the last digit."""
    rows = [*zip(*(map(str, v) for n, v in p.data.items() if n != run), strict=True)]
    first, again = ([row for row, k in zip(rows, turn.tolist(), strict=True) if k == of] for of in (0, 1))
    read = [v for n, v in p.data.items() if p.entries[n]["role"] in ("error", "actual", "position")]
    if first == again and len(first) >= FEWEST_COPIED and min(len(np.unique(v)) for v in read) > 1:
        at = int(np.argmax(turn > 0)) + 1
        raise DataError(
            f"the rows from {at} on repeat those before to the last digit: the same measurement twice? Remove them"
        )


def _turns(label: np.ndarray, target: np.ndarray) -> np.ndarray:
    """How often each row's run was measured before, (rows,): a stretch of rows that repeats its targets is one more.

    A stretch ends where another run follows: rows sorted by target return to a run with other targets.
    """
    turn = np.zeros(label.size, dtype=int)
    edges = np.r_[0, np.flatnonzero(np.diff(label)) + 1, label.size]
    seen: dict[int, tuple[int, set[int]]] = {}
    for first, last in itertools.pairwise(edges):
        here = set(target[first:last].tolist())
        count, before = seen.get(int(label[first]), (0, set()))
        if len(here & before) > AGAIN * len(here):
            count, before = count + 1, set()
        seen[int(label[first])] = (count, before | here)
        turn[first:last] = count
    return turn


def _days(p: Proposal) -> list[str] | None:
    """The date of every row; None if the file has none."""
    time = p.first("time")
    epoch = p.entries[time].get("epoch") if time is not None else None
    if time is None or epoch is None or not np.isfinite(p.data[time]).all():
        return None
    start = datetime.fromisoformat(epoch)
    return [f"{start + timedelta(seconds=float(s)):%Y-%m-%d}" for s in p.canonical(time)]
