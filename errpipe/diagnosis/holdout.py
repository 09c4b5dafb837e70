"""Nested hold-out: search and fit are repeated without each fold and validated on it."""

from __future__ import annotations

import copy
from collections import Counter
from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis import admit
from errpipe.diagnosis.case import Case
from errpipe.diagnosis.evidence import ActiveSet
from errpipe.diagnosis.hypotheses import folds
from errpipe.diagnosis.left_out import ZEROED, LeftOut, supported_by_held_out
from errpipe.diagnosis.search import Search
from errpipe.drivers.sessions import sessions
from errpipe.fitting.statistics import rms
from errpipe.terms import NEVER

AGAIN = 0.5  # share of the folds in which a weak name, or one that competes with shapes, must be selected again
KEPT = 0.5  # share of the log Bayes factor that held-out rows must confirm: of 33 right names 32 retain 0.89 or more,
# one has less than 0.5 anyway; of false ones on nulls 2 of 4 retain none (first 12201, 13101, second 12202, 13102)
EXTRAPOLATED = 0.1  # share of the blocks in which names may extrapolate: one to three of 40 in twins 603 to 605
BETTER = 0.95  # threshold: rms on held-out rows, over that of the other explanation


@dataclass(frozen=True)
class HeldOut:
    """rms on held-out rows; for each finding, the share of the folds in which its effect was selected.

    named: whitened residual rms of the findings; shaped: of findings and shapes over inputs together; names: as
    `after`, of the findings alone; bare, textbook: as `named`, without findings, and with their textbook forms only;
    often: effects selected in at least half of the folds; again: was the search repeated? Not for partial effects;
    trimmed: `before` and `after` without the blocks in which names do most harm (`_without_worst_blocks`).
    """

    scheme: str
    before: float
    after: float
    agreement: tuple[float, ...]
    named: float
    shaped: float
    names: float
    bare: float
    textbook: float
    often: tuple[str, ...] = ()
    again: bool = True
    trimmed: tuple[float, float] = (np.inf, np.inf)

    def shape_share(self) -> float:
        """Share of the held-out variance that shapes over inputs predict beyond the names; negative if they do harm."""
        return 1.0 - (self.shaped / self.named) ** 2 if self.named > 0 else 0.0

    def departure_share(self) -> float:
        """Share of the held-out variance that departures from the textbook forms predict beyond these."""
        return (self.textbook**2 - self.named**2) / max(self.bare**2, 1e-300)

    def textbook_share(self) -> float:
        """Share of the names' held-out prediction that their textbook forms alone provide."""
        return (self.bare**2 - self.textbook**2) / max(self.bare**2 - self.named**2, 1e-300)

    def confirms(self, gain: float, rows: float) -> bool:
        """Do folds select a name again, or do names improve held-out rows beyond recalibration as the gain predicts?"""
        brought = rows * float(np.log(max(self.bare, 1e-300) / max(self.named, 1e-300)))
        return (self.again and max(self.agreement, default=0.0) >= AGAIN) or brought >= KEPT * gain

    def predicts_whole_runs(self) -> bool:
        """Do names predict whole held-out runs? Noise does not, however slow it is."""
        return "whole runs" in self.scheme and self.names < BETTER * self.before


def held_out(case: Case) -> HeldOut:
    """Repeat search and fit without each fold, and predict the fold.

    Whether unnamed shapes predict held-out rows is decided within the fitted rows, fold by fold.
    """
    search, library = case.search, case.library
    _, scheme = folds(case.run, sessions(case.recording)[case.pair.rows])
    judged = case.judged()
    if judged.session is not None:
        scheme += f"; the datum of each from its first {ZEROED} rows, which do not count"
    effects = [f.hypothesis.effect for f in case.explanation.accepted]
    in_part = any(finding.hypothesis.mask for finding in case.explanation.accepted)
    if not in_part:  # partial effects were selected on all rows: the fold's search excludes them
        search = copy.copy(search)
        search.prior = np.where([bool(h.mask) for h in library.hypotheses], NEVER, search.prior)
    before, after, named, alone, with_inputs, same, shaped = [], [], [], [], [], [], 0
    bare, textbook, found = [], [], Counter[str]()
    for f, test in enumerate(library.table.rows):
        if test.size == 0:
            continue
        part = _without_fold(search, f)
        if in_part:
            chosen = part.tune(case.chosen())  # the range of a partial effect cannot be searched without its runs
        else:
            chosen = [(x.index, x.size) for x in part.explain(starts=2).accepted] if effects else []
            chosen = supported_by_held_out(part, chosen, judged)
        names = [i for i, _ in chosen]
        remainder = admit.remainder(part, chosen, case.free_shapes, case.places)
        ways = [(part.active(chosen), judged.columns(names)), _textbook(part, chosen, judged)]
        if remainder.taken:
            ways.append((remainder.active, judged.columns(names, remainder.taken)))
        bare.append(judged.whitened(part.data, part.active([]), part.noise, judged.columns([]), f))
        textbook.append(judged.whitened(part.data, ways[1][0], part.noise, ways[1][1], f))
        known = [judged.mean_square(part.data, active, part.noise, columns) for active, columns in ways]
        way = int(np.argmin(known))
        shaped += way == 2
        before.append(judged.zeroed(case.y[test], test))
        by_name = int(np.argmin(known[:2]))
        after.append(judged.left(part.data, ways[way][0], part.noise, ways[way][1], f))
        alone.append(judged.left(part.data, ways[by_name][0], part.noise, ways[by_name][1], f))
        named.append(judged.whitened(part.data, ways[by_name][0], part.noise, ways[by_name][1], f))
        of_inputs = admit.remainder(part, chosen, case.free_shapes, case.places, inputs=True)
        columns = judged.columns(names, of_inputs.taken)
        with_inputs.append(judged.whitened(part.data, of_inputs.active, part.noise, columns, f))
        again = {library.hypotheses[i].effect for i in names}
        same.append([effect in again for effect in effects])
        found.update(again)
        del part  # frees its products before those of the next fold are formed
    whole = np.concatenate
    if case.remainder.shapes and shaped:
        drivers = dict.fromkeys(d for shape, _ in case.remainder.shapes for d in shape.drivers)
        scheme += f"; with a data-driven remainder in {', '.join(drivers)}"
    return HeldOut(
        scheme, rms(whole(before)), rms(whole(after)), tuple(np.mean(same, axis=0).tolist()), rms(whole(named)),
        rms(whole(with_inputs)), rms(whole(alone)), rms(whole(bare)), rms(whole(textbook)),
        tuple(sorted(e for e, count in found.items() if count >= AGAIN * len(same))), not in_part,
        _without_worst_blocks(case, whole(before), whole(after)),
    )  # fmt: skip


def _without_worst_blocks(case: Case, before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """rms of both without the blocks, a tenth at most, in which names do most harm (one-sided trimmed mean).

    The rows that separate two columns of a form (the first motion, a rest) may all be in one block: without it, they
    are not separated, and extrapolate. In the other nine tenths, a wrong name predicts no better than before.
    """
    table = case.library.table
    starts = np.array([first for first, _, _ in table.stretches])
    if before.size != table.n:
        return rms(before), rms(after)
    order = np.argsort(np.concatenate(table.rows))
    squares = np.array([np.add.reduceat(values[order] ** 2, starts) for values in (before, after)])
    harm = squares[1] - squares[0]
    kept = (harm <= 0.0) | (harm < np.sort(harm)[-max(int(EXTRAPOLATED * harm.size), 1)])
    root = np.sqrt(squares[:, kept].sum(axis=1) / np.diff(np.r_[starts, table.n])[kept].sum())
    return float(root[0]), float(root[1])


def _without_fold(search: Search, fold: int) -> Search:
    """The same search with one fold held out."""
    data, known = search.data.hold_out(fold), (search.nuisance, search.sigma, search.prior)
    part = Search(search.library, data, *known, search.threshold, search.threshold_more, search.rows)
    part.weighed = search.weighed
    return part


def _textbook(part: Search, chosen: list[tuple[int, float]], judged: LeftOut) -> tuple[ActiveSet, np.ndarray]:
    """Nuisances and textbook forms only, without the departures a part may have: their columns.

    Offsets of single runs cannot be predicted for a held-out run.
    """
    active, first = part.nuisance, part.nuisance.index.size
    kept = [*range(first)]
    for i, size in chosen:
        whole = part.active([(i, size)])
        count = part.library.textbook(i)
        core = slice(part.nuisance.index.size, part.nuisance.index.size + count)
        active = active.plus(whole.index[core], whole.sd[core])
        kept += range(first, first + count)
        first += part.library.places[i].size
    return active, judged.columns([i for i, _ in chosen])[:, kept]
