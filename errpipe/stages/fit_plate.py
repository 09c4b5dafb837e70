"""A planar error map from measured hole patterns: scale, squareness, straightness and what is smooth besides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording

POINTS = 65  # of a curve over one axis


class FitPlate(Stage):
    """Fit E_X and E_Y over X and Y; the shift and rotation of each plate are set-up and are never compensated."""

    kind: Literal["fit_plate"]
    modes: int = Field(8, ge=1, le=24, description="Waves per axis that the smooth map may hold; it is penalised.")
    plate: str = Field(
        "last", description="Plate that speaks for the machine: the last one, all of them, or the label of a run."
    )
    every: int = Field(10, ge=2, description="Every so many holes sit out when a single plate is validated.")
    measured_twice: tuple[str, str] | None = Field(
        None, description="Runs in which one plate was measured twice: what they differ by is the metrology floor."
    )
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording")}
    gives: ClassVar[tuple[str, ...]] = ("error_model",)
    code_version: ClassVar[int] = 2

    def outputs(self) -> tuple[str, ...]:
        return (_artefacts.MODEL, "fit.json", "plate.json")

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.kinematics import planar

        recording = _artefacts.recording_in(context.needed("recording"))
        context.progress(0.1, "fitting")
        twice = planar.repeated(recording, *self.measured_twice) if self.measured_twice else None
        recording = plates(recording, self.plate)
        found = planar.fit_plate(recording, modes=self.modes)
        model = error_model(found, recording).model_copy(
            update={"title": context.title or recording.manifest.title, "inputs": {"recording": context.fingerprint}}
        )
        figures = {
            name: {"value": f["value"], "ci95": list(f["ci95"]), "unit": f["unit"]}
            for name, f in found.figures().items()
        }
        context.write_json(_artefacts.MODEL, _artefacts.model_json(model))
        context.write_json("fit.json", {"fit": 1, "family": "plate", "modes": self.modes, "every": self.every})
        document = {"plate": 1, "figures": figures, "noise_um": found.noise, "setup": found.setup}
        document["parts"] = parts(found)
        if twice is not None:
            document["measured_twice"] = {"runs": list(self.measured_twice or ()), **twice}
        context.write_json("plate.json", document)
        return {name: f"{f['value']:.3g} {f['unit']}" for name, f in figures.items()}


def plates(recording: Recording, chosen: str) -> Recording:
    """The holes of the chosen plate: machines move and settle, so an old plate speaks for an old machine.

    Raises DataError for a label that is not in the recording.
    """
    from errpipe.errors import DataError, did_you_mean

    labels = recording.run_labels()
    if chosen == "all":
        return recording
    label = labels[-1] if chosen == "last" else chosen
    if label not in labels:
        raise DataError(f"fit_plate: no plate {label!r} (plates: {', '.join(labels)}).{did_you_mean(label, labels)}")
    return recording.take(recording.run_codes() == labels.index(label))


def parts(found: Any) -> list[dict[str, Any]]:
    """What the map is made of, in words, with the range of each part over the pattern, um; largest first."""
    import numpy as np

    box, curves = found.functions.box, found.components(POINTS)
    out = [
        {"component": f"E_{name[1]}", "part": f"curve over {name[2]} ({name})", "range_um": float(np.ptp(curve[1]))}
        for name, curve in curves.items()
        if name != "C0Y"
    ]
    lean = abs(curves["C0Y"]) * 1e-3 * (box.y[1] - box.y[0])
    out.append({"component": "E_X", "part": "squareness (C0Y)", "range_um": float(lean)})
    for name in ("E_X", "E_Y"):
        products = [(over_x, over_y) for component, _, over_x, _, over_y in found.products() if component == name]
        size = float(np.ptp(sum(np.outer(x, y) for x, y in products))) if products else 0.0
        out.append({"component": name, "part": f"{len(products)} products of curves over X and Y", "range_um": size})
    return sorted(out, key=lambda part: (part["component"], -part["range_um"]))


def error_model(found: Any, recording: Recording) -> ErrorModel:
    """The map as curves over X, curves over Y and their products, one component per direction."""
    from errpipe import __version__
    from errpipe.domain import driver as d
    from errpipe.domain.error_model import ComponentModel, ErrorModel, Validity

    names = [str(recording.name("position", axis=a)) for a in "XY"]
    box, c = found.functions.box, found.components(POINTS)
    terms: dict[str, list] = {"E_X": [], "E_Y": []}
    lean = d.Affine(offset=c["C0Y"] * 1e-3 * box.middle[1], weights=(-c["C0Y"] * 1e-3,), of=(d.Input(name=names[1]),))
    for component, over, name in (("E_X", "EXX", 0), ("E_X", "EXY", 1), ("E_Y", "EYX", 0), ("E_Y", "EYY", 1)):
        terms[component].append(_term((_lookup(names[name], *c[over]),)))
    terms["E_X"].append(_term((lean,)))
    for component, x, over_x, y, over_y in found.products():
        terms[component].append(_term((_lookup(names[0], x, over_x), _lookup(names[1], y, over_y))))
    manifest = recording.manifest
    before = _rms_without_setup(recording)
    return ErrorModel(
        machine=manifest.machine,
        title=manifest.title,
        version=__version__,
        columns={n: manifest.columns[n].model_dump(mode="json", exclude_none=True) for n in names},
        components=tuple(
            ComponentModel(
                component=name,
                terms=tuple(terms[name]),
                rows=found.rows,
                rows_effective=float(found.rows),
                rms_before=before[name],
                rms_after=found.noise,
                half_width90=1.645 * found.noise,
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


def _term(factors: tuple):
    from errpipe.domain.error_model import FittedParameter, FittedTerm
    from errpipe.terms import ProfileDriver, plain

    gain = FittedParameter(name="gain", value=1.0, unit="um")
    return FittedTerm(term=plain(ProfileDriver(driver=factors)), parameters=(gain,))


def _rms_without_setup(recording: Recording) -> dict[str, float]:
    """rms of each direction once every plate's best shift and rotation is taken off, um."""
    import numpy as np

    from errpipe.fitting.design import response_name
    from errpipe.kinematics import planar

    x, y = (recording.array(str(recording.name("position", axis=a))) for a in "XY")
    deviation = np.column_stack([recording.array(response_name(recording, c)) for c in ("E_X", "E_Y")])
    run, left = recording.run_codes(), np.full_like(deviation, np.nan)
    for code in np.unique(run):
        rows = (run == code) & np.isfinite(deviation).all(axis=1)
        left[rows] = planar.without_setup(x[rows], y[rows], deviation[rows])
    rms = np.sqrt(np.nanmean(left**2, axis=0))
    return {"E_X": float(rms[0]), "E_Y": float(rms[1])}
