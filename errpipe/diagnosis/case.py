"""State of one response under diagnosis: before the search (`SetUp`) and after it (`Case`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from errpipe.diagnosis import admit, hypotheses
from errpipe.diagnosis import decompose as parts
from errpipe.diagnosis.evidence import ActiveSet, Data, Scene
from errpipe.diagnosis.gains import Nuisance
from errpipe.diagnosis.left_out import LeftOut
from errpipe.diagnosis.prepare import Pair
from errpipe.diagnosis.recalibration import OFF
from errpipe.diagnosis.search import Explanation, Search
from errpipe.diagnosis.shapes import Shape
from errpipe.domain.recording import Recording


@dataclass
class SetUp:
    """One response before the search."""

    recording: Recording  # conditioned
    pair: Pair
    library: hypotheses.Library
    decomposition: parts.Decomposition
    simulated: np.ndarray
    y: np.ndarray
    run: np.ndarray
    data: Data
    prior: np.ndarray  # log prior odds of each hypothesis
    nuisance: ActiveSet
    nuisances: list[Nuisance]  # what each column represents
    recal: np.ndarray  # the nuisances' columns before whitening
    sizes: np.ndarray  # rms of the signal part of each; a coefficient divided by it is gain - 1
    noise_estimate: float  # noise from second differences
    free_shapes: list[Shape]  # unnamed shapes
    places: list[np.ndarray]  # their columns in the library's table
    session: np.ndarray | None  # session of each row, if each session has its own datum
    in_own_noise: bool = False  # was the colour of the noise fitted?
    plain: bool = False  # noise of the default colour, non-linear parameters on their grid?
    taken_back: bool = False  # were names withdrawn because noise alone is more likely?
    of_a_twin: bool = False  # is the reference a simulation whose gains are 1? A finding may be a gain of its parts
    over_noise: float = np.inf  # log Bayes factor of the explanation over drifting noise with nothing missing

    def judged(self) -> LeftOut:
        """How held-out rows are predicted."""
        return LeftOut(self.library, self.recording, self.pair.rows, self.y, self.recal, self.session, self.free_shapes)


@dataclass
class Case(SetUp):
    """One response once it is explained."""

    search: Search = None  # type: ignore[assignment]
    explanation: Explanation = None  # type: ignore[assignment]
    sigma: float = 0.0
    remainder: admit.AdmittedShapes = None  # type: ignore[assignment]
    held: Any = None  # figures of the hold-out (`holdout.HeldOut`), once computed

    def chosen(self) -> list[tuple[int, float]]:
        """Accepted hypotheses with their sizes."""
        return self.explanation.chosen()


def residual(case: Case, chosen: list[tuple[int, float]] | None = None) -> np.ndarray:
    """Residual of the explanation, on the selected rows."""
    return residual_of_chosen(case, case.search, case.chosen() if chosen is None else chosen)


def residual_of_chosen(made: SetUp, search: Search, chosen: list[tuple[int, float]]) -> np.ndarray:
    """Residual of chosen hypotheses in a search, on the selected rows."""
    return made.y - made.judged().columns([i for i, _ in chosen]) @ search.scene(chosen).coefficients()


def own_datums(case: Case, chosen: list[tuple[int, float]]) -> np.ndarray | None:
    """Fitted datums of single runs with these hypotheses, on the selected rows; None if all runs share one datum."""
    own = [j for j, n in enumerate(case.nuisances) if n.kind == "session datum"]
    if not own:
        return None
    return case.recal[:, own] @ case.search.scene(chosen).coefficients()[own]


def needs_recalibration(case: Case) -> bool:
    """Do datum or gains differ significantly from those of the simulation?"""
    if case.pair.reversed:
        return True
    full = case.search.active(case.chosen())
    kept = np.ones(full.index.size, dtype=bool)
    kept[: len(case.nuisances)] = [n.kind == "noise" for n in case.nuisances]
    scene = Scene(case.search.data, ActiveSet(full.index[kept], full.sd[kept]), case.search.noise)
    datum, gains = (case.nuisance.index[own] for own in np.array([(n.is_datum, n.is_gain) for n in case.nuisances]).T)
    sets = [datum, gains[:1], np.r_[datum, gains[:1]], np.r_[datum, gains]]
    sets += [np.r_[datum, g] for g in gains[1:]]
    scored = scene.gains(sets, [np.ones(s.size) for s in sets], case.search.rows)
    return bool(scored.max() > OFF + np.log(len(sets)))  # log of the number of sets: multiple comparisons
