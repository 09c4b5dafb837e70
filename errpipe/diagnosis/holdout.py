"""Before and after on rows that neither selected nor fitted: the whole search is repeated without each fold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis import admit
from errpipe.diagnosis.evidence import Scene
from errpipe.diagnosis.hypotheses import folds
from errpipe.diagnosis.judge import Case
from errpipe.diagnosis.search import Search


@dataclass(frozen=True)
class HeldOut:
    """rms on rows that sat out; how often the full search's first effect was chosen without them."""

    scheme: str
    before: float
    after: float
    agreement: float


def held_out(case: Case) -> HeldOut:
    """Repeat search and fit without each fold, predict the fold."""
    search, library = case.search, case.library
    _, scheme = folds(case.run)
    first = case.explanation.found[0].hypothesis.effect if case.explanation.found else None
    before, after, same, tried = [], [], 0, 0
    blocks: dict[int, np.ndarray] = {}
    for f, test in enumerate(library.table.rows):
        if test.size == 0:
            continue
        part = Search(library, search.data.hold_out(f), search.nuisance, search.sigma, search.prior,
                      search.threshold, search.threshold_more, search.rows)  # fmt: skip
        if any(found.hypothesis.mask for found in case.explanation.found):
            chosen = part.tune(case.chosen())  # where a partial effect acts cannot be found without its runs
            effects = [library.hypotheses[i].effect for i, _ in chosen]
        else:
            found = part.explain(starts=2).found if first else ()
            chosen = [(x.index, x.size) for x in found]
            effects = [x.hypothesis.effect for x in found]
        rest = admit.remainder(part, library, chosen, case.loose, case.places)
        b = Scene(part.data, rest.active, part.sigma).coefficients()
        for i, _ in chosen:
            if i not in blocks:
                blocks[i] = library.block(i, case.recording, case.pair.rows)
        shaped = [case.loose[k].columns[test] for k in rest.taken]
        columns = np.column_stack([case.recal[test], *[blocks[i][test] for i, _ in chosen], *shaped])
        left = case.y[test] - columns @ b
        before.append(case.y[test])
        after.append(left)
        tried += 1
        same += first is None or first in effects[:1]
    rms = lambda parts: float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))  # noqa: E731
    if case.remainder.shapes:
        drivers = dict.fromkeys(d for shape, _ in case.remainder.shapes for d in shape.drivers)
        scheme += f"; with a data-driven remainder in {', '.join(drivers)}"
    return HeldOut(scheme, rms(before), rms(after), same / max(tried, 1))
