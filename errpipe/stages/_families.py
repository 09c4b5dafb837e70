"""The kinds of model a pipeline can fit, each judged by its own refit on the rows of a fold.

What `fit`, `fit_season`, `fit_plate`, `diagnose` and `identify_direct` leave in `fit.json` is enough to repeat them
without a held-out group.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold, HoldOut


class Family:
    """One kind of fit, with what it was asked for. judge: fold -> component -> held-out residuals."""

    components: tuple[str, ...]
    holdout: HoldOut
    method: str

    def folds(self, recording: Recording, scheme: HoldOut | None) -> tuple[str, list[Fold]]:
        """The scheme's name and its folds; without a scheme, the family's own."""
        from errpipe.fitting import holdout

        chosen = scheme or self.holdout
        return holdout.name(holdout.resolved(recording, chosen)), holdout.groups(recording, chosen)

    def further(self, recording: Recording, progress: Callable[[float, str], None]) -> dict[str, Any]:
        """Documents that only this family adds to `validation.json`, by key."""
        return {}

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, Any]:
        """Fit on one side of a fold, judge on the other."""
        raise TypeError(f"{type(self).__name__} does not judge")


class Terms(Family):
    """Named terms (`fit`)."""

    def __init__(self, document: Mapping[str, Any]):
        from errpipe.fitting.spec import ModelSpec

        self.spec = ModelSpec.model_validate(document["spec"])
        self.components = tuple(c.component for c in self.spec.components)
        self.holdout, self.method = self.spec.holdout, self.spec.method

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, Any]:
        from errpipe.fitting import judging

        return judging.judge(recording, self.spec, fold)


class Mismatch(Terms):
    """What a simulation leaves out (`diagnose` without a fit before it): terms of recorded less simulated."""

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, Any]:
        from errpipe.fitting import judging
        from errpipe.stages._acceptance import mismatch

        return judging.judge(mismatch(recording, self.spec), self.spec, fold)


class Season(Family):
    """A thermal model for all seasons (`fit_season`); deviations count from the start of each run."""

    def __init__(self, document: Mapping[str, Any]):
        from errpipe.fitting.holdout import HoldOut
        from errpipe.fitting.season_options import SeasonOptions

        self.options = SeasonOptions.model_validate(document["options"])
        self.components = (document["component"],)
        self.holdout = HoldOut(scheme="leave-one-group-out", of=self.options.environment)
        self.method = "season"

    def further(self, recording: Recording, progress: Callable[[float, str], None]) -> dict[str, Any]:
        """Seasons left out whole beside the same rows judged in their own season, and trained on the past alone."""
        from errpipe.validation import champion, seasons

        (component,), fitter = self.components, champion.season(self.options)
        progress(0.3, "seasons left out, beside runs left out")
        out = {"seasons": seasons.table(recording, component, fitter, self.holdout)}
        if any(recording.manifest.columns[n].of == "day" for n in recording.names("group")):
            progress(0.7, "trained on the past alone")
            out["forward"] = seasons.table(recording, component, fitter, "forward:month", in_season=False)
            out["forward_daily"] = seasons.table(recording, component, fitter, "forward:day", in_season=False)
        return out

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, Any]:
        from errpipe.fitting import thermal_season
        from errpipe.fitting.design import response_name
        from errpipe.fitting.validity import distance

        (component,) = self.components
        model = thermal_season.fit(recording, component, self.options, fold.train)
        deviation = recording.array(response_name(recording, component))
        since, _ = thermal_season.since_start(deviation, recording.run_codes(), self.options.datum_rows)
        left = since - model.values(recording)
        return {component: _held_out(fold, since, left, distance(model.validity, recording))}


class Plate(Family):
    """A planar map from hole patterns (`fit_plate`); each plate's shift and rotation is set-up, not machine."""

    def __init__(self, document: Mapping[str, Any]):
        from errpipe.fitting.holdout import HoldOut

        self.modes, self.every = document["modes"], document["every"]
        self.components = ("E_X", "E_Y")
        self.holdout, self.method = HoldOut(scheme="leave-one-run-out"), "planar map"

    def folds(self, recording: Recording, scheme: HoldOut | None) -> tuple[str, list[Fold]]:
        """Without a scheme: every so many holes of each plate sit out while its other holes are fitted."""
        import numpy as np

        from errpipe.fitting.holdout import Fold

        if scheme is not None:
            return super().folds(recording, scheme)
        run, out = recording.run_codes(), []
        for code, label in enumerate(recording.run_labels()):
            own = np.flatnonzero(run == code)
            test = np.zeros(run.size, dtype=bool)
            test[own[:: self.every]] = True
            out.append(Fold(label, (run == code) & ~test, test))
        return f"each plate by itself, every {self.every}th hole", out

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, Any]:
        """A plate's shift and rotation come from its fitted holes, else (a plate never seen) from the judged ones."""
        import numpy as np

        from errpipe.fitting.design import response_name
        from errpipe.kinematics import planar

        model = planar.fit_plate(recording, rows=fold.train, modes=self.modes)
        x, y = (recording.array(str(recording.name("position", axis=a))) for a in "XY")
        deviation = np.column_stack([recording.array(response_name(recording, c)) for c in self.components])
        left = deviation - model.predict(x, y)
        before, after, taken = np.full_like(deviation, np.nan), np.full_like(deviation, np.nan), 0.0
        run, known = recording.run_codes(), np.isfinite(deviation).all(axis=1)
        for code in np.unique(run[fold.test]):
            rows, fitted = fold.test & known & (run == code), fold.train & known & (run == code)
            decide = fitted if fitted.any() else rows
            taken += 0.0 if fitted.any() else 1.5  # of three degrees of freedom a plate, half for each direction
            both = rows | decide
            for source, target in ((deviation, before), (left, after)):
                target[both] = planar.without_setup(x[both], y[both], source[both], decide[both])
        box = model.functions.box
        outside = np.maximum.reduce([box.x[0] - x, x - box.x[1], box.y[0] - y, y - box.y[1], np.zeros_like(x)])
        return {
            c: _held_out(fold, before[:, k], after[:, k], outside, used=taken) for k, c in enumerate(self.components)
        }


class Direct(Family):
    """Components read one by one by laser and level (`identify_direct`); zero, straightedge and beam are set-up."""

    def __init__(self, document: Mapping[str, Any]):
        from errpipe.domain.machine import Machine
        from errpipe.fitting.holdout import HoldOut
        from errpipe.kinematics.chain import compile_chain
        from errpipe.kinematics.direct import Laser

        self.chain = compile_chain(Machine.model_validate(document["machine"]))
        self.lasers = {n: Laser(**beam) for n, beam in document["lasers"].items()}
        self.modes, self.components = document["modes"], tuple(document["components"])
        self.holdout, self.method = HoldOut(scheme="leave-one-run-out"), "direct records"

    def folds(self, recording: Recording, scheme: HoldOut | None) -> tuple[str, list[Fold]]:
        """Without a scheme: whole runs where each way was run twice, else every fifth target."""
        from errpipe.fitting.holdout import Fold
        from errpipe.kinematics import held_out

        if scheme is not None:
            return super().folds(recording, scheme)
        name, found = held_out.folds(recording)
        return name, [Fold(*fold) for fold in found]

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, Any]:
        import numpy as np

        from errpipe.fitting.judging import HeldOut
        from errpipe.kinematics import held_out

        left = held_out.judge(self.chain, recording, fold.train, fold.test, modes=self.modes, lasers=self.lasers)
        return {x.component: HeldOut(fold.label, x.rows, x.before, x.after, np.zeros(len(x.rows)), 0.0) for x in left}


def _held_out(fold: Fold, before: np.ndarray, after: np.ndarray, outside: np.ndarray, used: float = 0.0) -> Any:
    import numpy as np

    from errpipe.fitting.judging import HeldOut

    rows = np.flatnonzero(fold.test & np.isfinite(before) & np.isfinite(after))
    return HeldOut(fold.label, rows, before[rows], after[rows], outside[rows], used)


FAMILIES: dict[str, Callable[[Mapping[str, Any]], Family]] = {
    "terms": Terms,
    "mismatch": Mismatch,
    "season": Season,
    "plate": Plate,
    "direct": Direct,
}


def family_of(folder: Path) -> Family:
    """The family behind a fit stage's folder."""
    from errpipe import jsonfile

    document = jsonfile.read(folder / "fit.json")
    return FAMILIES[document["family"]](document)
