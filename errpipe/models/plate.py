"""A planar error map from measured hole patterns: scale, squareness, straightness and the remaining smooth part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe.errors import DataError, did_you_mean
from errpipe.models._base import Family, Fitted, Progress, Table, held_out, no_progress

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold, HoldOut
    from errpipe.fitting.judging import HeldOut

POINTS = 65  # of a curve over one axis
FIGURES = "plate.json"
DIRECTIONS = ("E_X", "E_Y")


class Plate(Family):
    """Fit E_X and E_Y over X and Y; the shift and rotation of each plate are set-up and are never compensated."""

    family: Literal["plate"] = Field("plate", description="Model family.")
    modes: int = Field(8, ge=1, le=24, description="Waves per axis that the smooth map may hold; it is penalised.")
    plate: str = Field(
        "last",
        description="Plate that gives the errors of the machine: the last one, all of them, or the label of a run.",
    )
    every: int = Field(10, ge=2, description="With one plate only: every n-th of its holes is held out in turn.")
    measured_twice: tuple[str, str] | None = Field(
        None, description="Runs in which one plate was measured twice: their difference is the noise floor."
    )
    documents: ClassVar[tuple[str, ...]] = (FIGURES,)
    default_scheme: ClassVar[str] = "leave-one-run-out"
    solved_by: ClassVar[str] = "planar map"
    one_map: ClassVar[bool] = True  # the set-up of a plate is fitted to both directions

    @property
    def responses(self) -> tuple[str, ...]:
        """Both directions of the plane."""
        return DIRECTIONS

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit the chosen plates. Raises DataError for a label that is not in the recording."""
        from errpipe.kinematics import planar

        twice = planar.repeated(recording, *self.measured_twice) if self.measured_twice else None
        recording = chosen_plates(recording, self.plate)
        fitted = planar.fit_plate(recording, modes=self.modes)
        figures: dict[str, dict[str, Any]] = {name: _plain(f) for name, f in fitted.figures().items()}
        document: dict[str, Any] = {"plate": 1, "figures": figures, "noise_um": fitted.noise, "setup": fitted.setup}
        document["parts"] = _parts(fitted)
        if twice is not None:
            document["measured_twice"] = {"runs": list(self.measured_twice or ()), **twice}
        summary = {name: f"{f['value']:.3g} {f['unit']}" for name, f in figures.items()}
        return Fitted(_error_model(fitted, recording), {FIGURES: document}, summary)

    def folds(self, recording: Recording, scheme: HoldOut | str | None) -> tuple[str, list[Fold]]:
        """Without a scheme whole plates are held out; of a single plate, every n-th hole in turn.

        The first of two measurements of one plate shares the holes' own noise with the second: it neither predicts
        the second nor counts as a further observation.
        """

        from errpipe.fitting.holdout import Fold

        labels, run = recording.run_labels(), recording.run_codes()
        codes = [labels.index(label) for label in self.measured_twice or () if label in labels]
        twice, first = np.isin(run, codes), np.isin(run, codes[:1] if len(codes) == 2 else [])
        if scheme is not None or np.unique(run[~first]).size > 1:
            name, folds = super().folds(recording, scheme)
            kept = [f._replace(train=f.train & ~twice) if (f.test & twice).any() else f for f in folds]
            return name, [f for f in kept if f.train.any() and not first[f.test].all()]
        number = np.where(first, -1, np.arange(len(recording)) % self.every)
        out = [
            Fold(f"hole {k + 1}, {k + 1 + self.every} ...", (number != k) & ~first, number == k)
            for k in range(self.every)
        ]
        return f"one plate, every {self.every}th hole in turn", out

    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """A plate's shift and rotation come from its fitted holes, or from the test holes if none was fitted."""

        from errpipe.fitting.design import response_name
        from errpipe.kinematics import planar

        model = planar.fit_plate(recording, rows=fold.train & self._chosen_rows(recording, fold), modes=self.modes)
        x, y = (recording.array(str(recording.name("position", axis=a))) for a in "XY")
        deviation = np.column_stack([recording.array(response_name(recording, c)) for c in DIRECTIONS])
        residual = deviation - model.predict(x, y)
        before, after, used = np.full_like(deviation, np.nan), np.full_like(deviation, np.nan), 0.0
        run, known = recording.run_codes(), np.isfinite(deviation).all(axis=1)
        for code in np.unique(run[fold.test]):
            rows, fitted = fold.test & known & (run == code), fold.train & known & (run == code)
            setup_rows = fitted if fitted.any() else rows
            used += 0.0 if fitted.any() else 1.5  # of three degrees of freedom per plate, half for each direction
            chosen = rows | setup_rows
            for source, target in ((deviation, before), (residual, after)):
                target[chosen] = planar.without_setup(x[chosen], y[chosen], source[chosen], setup_rows[chosen])
        box = model.functions.box
        outside = np.maximum.reduce([box.x[0] - x, x - box.x[1], box.y[0] - y, y - box.y[1], np.zeros_like(x)])
        return {c: held_out(fold, before[:, k], after[:, k], outside, used=used) for k, c in enumerate(DIRECTIONS)}

    def _chosen_rows(self, recording: Recording, fold: Fold) -> np.ndarray:
        """Rows of the plate selected by option `plate`; if it is held out, or `last`, of the one before the held-out.

        Nothing is before the first one: the last one predicts it. Two plates that predicted each other would count
        twice: the inner product of both maps is the same either way.
        """
        run = recording.run_codes()
        if self.plate == "all":
            return np.ones(run.size, dtype=bool)
        labels, present = recording.run_labels(), np.unique(run[fold.train])
        named = labels.index(self.plate) if self.plate in labels else -1
        before = present[present < run[fold.test].min()]
        return run == (named if named in present else (before if before.size else present)[-1])

    def tables(self, documents: Mapping[str, Any], validation: Mapping[str, Any]) -> list[Table]:
        """Scale and squareness with intervals; the residual with the repeatability of measuring a plate twice."""
        document = documents[FIGURES]
        rows = [[f"{name} in {f['unit']}", f["value"], *f["ci95"]] for name, f in document["figures"].items()]
        caption = "The straight line through the whole map; intervals are 95 %."
        out = [Table("Scale and squareness", ["figure", "value", "from", "to"], rows, caption)]
        rows = [[f"{p['component']}: {p['part']}", p["range_um"]] for p in document["parts"]]
        out.append(Table("Components of the map", ["part", "range, um"], rows, "Largest minus smallest, over the map."))
        twice = document.get("measured_twice")
        return [*out, _floor(twice, validation)] if twice else out


def _plain(figure: Mapping[str, Any]) -> dict[str, Any]:
    return {"value": figure["value"], "ci95": list(figure["ci95"]), "unit": figure["unit"]}


def chosen_plates(recording: Recording, chosen: str) -> Recording:
    """The holes of the selected plate: machines are moved and settle, so an old plate does not show the present state.

    Raises DataError for a label that is not in the recording.
    """
    labels = recording.run_labels()
    if chosen == "all":
        return recording
    label = labels[-1] if chosen == "last" else chosen
    if label not in labels:
        raise DataError(f"plate: no plate {label!r} (plates: {', '.join(labels)}).{did_you_mean(label, labels)}")
    return recording.take(recording.run_codes() == labels.index(label))


def _parts(fitted: Any) -> list[dict[str, Any]]:
    """The components of the map, with the range of each over the pattern, um; largest first."""
    box, curves = fitted.functions.box, fitted.components(POINTS)
    out = [
        {"component": f"E_{name[1]}", "part": f"curve over {name[2]} ({name})", "range_um": float(np.ptp(curve[1]))}
        for name, curve in curves.items()
        if name != "C0Y"
    ]
    lean = abs(curves["C0Y"]) * 1e-3 * (box.y[1] - box.y[0])
    out.append({"component": "E_X", "part": "squareness (C0Y)", "range_um": float(lean)})
    for name in ("E_X", "E_Y"):
        products = [(over_x, over_y) for component, _, over_x, _, over_y in fitted.products() if component == name]
        size = float(np.ptp(sum(np.outer(x, y) for x, y in products))) if products else 0.0
        out.append({"component": name, "part": f"{len(products)} products of curves over X and Y", "range_um": size})
    return sorted(out, key=lambda part: (part["component"], -part["range_um"]))


def _error_model(fitted: Any, recording: Recording) -> ErrorModel:
    """The map as curves over X, curves over Y and their products, one component per direction."""
    from errpipe.domain import driver as d
    from errpipe.domain.error_model import ComponentModel, ErrorModel, Validity
    from errpipe.terms import fitted_term
    from errpipe.terms.profile_driver import ProfileDriver

    names = [str(recording.name("position", axis=a)) for a in "XY"]
    box, c = fitted.functions.box, fitted.components(POINTS)
    terms: dict[str, list[tuple[d.Driver, ...]]] = {"E_X": [], "E_Y": []}
    lean = d.Affine(offset=c["C0Y"] * 1e-3 * box.middle[1], weights=(-c["C0Y"] * 1e-3,), of=(d.Input(name=names[1]),))
    for component, over, name in (("E_X", "EXX", 0), ("E_X", "EXY", 1), ("E_Y", "EYX", 0), ("E_Y", "EYY", 1)):
        terms[component].append((_lookup(names[name], *c[over]),))
    terms["E_X"].append((lean,))
    for component, x, over_x, y, over_y in fitted.products():
        terms[component].append((_lookup(names[0], x, over_x), _lookup(names[1], y, over_y)))
    before = _rms_without_setup(recording)
    return ErrorModel.of(
        recording.manifest,
        names,
        components=tuple(
            ComponentModel(
                component=name,
                terms=tuple(fitted_term(ProfileDriver(driver=drivers), [1.0], "um") for drivers in terms[name]),
                rows=fitted.rows,
                rows_effective=float(fitted.rows),
                rms_before=before[name],
                rms_after=fitted.noise,
                half_width90=1.645 * fitted.noise,
            )
            for name in terms
        ),
        validity=Validity(ranges={names[0]: box.x, names[1]: box.y}),
        notes=("shift and rotation of each plate are set-up and are not in this model",),
    )


def _lookup(name: str, positions: Any, values: Any):
    from errpipe.domain import driver as d

    step = float(positions[1] - positions[0])
    return d.Lookup(of=d.Input(name=name), start=float(positions[0]), step=step, values=tuple(map(float, values)))


def _rms_without_setup(recording: Recording) -> dict[str, float]:
    """rms of each direction after removing every plate's best shift and rotation, um."""

    from errpipe.fitting.design import response_name
    from errpipe.kinematics import planar

    x, y = (recording.array(str(recording.name("position", axis=a))) for a in "XY")
    deviation = np.column_stack([recording.array(response_name(recording, c)) for c in ("E_X", "E_Y")])
    run, residual = recording.run_codes(), np.full_like(deviation, np.nan)
    for code in np.unique(run):
        rows = (run == code) & np.isfinite(deviation).all(axis=1)
        residual[rows] = planar.without_setup(x[rows], y[rows], deviation[rows])
    rms = np.sqrt(np.nanmean(residual**2, axis=0))
    return {"E_X": float(rms[0]), "E_Y": float(rms[1])}


def _floor(twice: Mapping[str, Any], validation: Mapping[str, Any]) -> Table:
    """The metrology floor of a plate measured twice, with the residual of the map on held-out holes."""

    def rms(key: str) -> float:
        values = [c[key] for c in validation["components"]]
        return float((sum(v * v for v in values) / len(values)) ** 0.5)

    first, second = twice["runs"]
    rows = [
        ["shift and rotation alone, held-out holes", rms("rms_before")],
        ["the map, held-out holes", rms("rms_after")],
        [f"{second} minus {first}, hole by hole", twice["difference"]],
        ["one measurement's share of that", twice["floor"]],
        ["the same, without a smooth drift between the two", twice["smooth"]],
    ]
    caption = (
        f"um rms of one coordinate. One plate, measured as {first} and as {second}: {twice['holes']} holes in common, "
        "each minus its own shift and rotation. One measurement's share limits the validation of any map."
    )
    return Table("Residual and metrology floor", ["", "um rms"], rows, caption)
