"""What machine, tool and workpiece give way to a cutting force: static push tests and beams of stepped sections.

    deviation(z) = F * (structure(z) + workpiece(z) + tool)                               [um] = [N] * [um/N]

The structure (tool post, spindle and its tilt) comes from push tests as a polynomial in the distance from the chuck, in
all or by gauge (`_push_tests`);
workpiece and tool are computed from their geometry (`kinematics.beam`), those of the push tests and those of the cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field, model_validator

from errpipe.domain.recording import Frozen
from errpipe.models._base import Family, Fitted, Progress, Table, held_out, no_progress
from errpipe.yamlfile import quantity

if TYPE_CHECKING:
    import numpy as np

    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold
    from errpipe.fitting.judging import HeldOut
    from errpipe.kinematics import beam
    from errpipe.models._push_tests import Structure

FIGURES = "compliance.json"
POINTS = 129  # of the compliance curve over the travel
SEGMENTS = 40  # of the spline that carries it into the table
MISSED = 0.002  # of the largest compliance: how far the spline may be off


class Section(Frozen):
    """A prismatic part of a shaft or tool: round by `diameter`, else rectangular by `width` and `height`."""

    length: float = quantity("mm", "Along the axis.", gt=0)
    diameter: float = quantity("mm", "Outer diameter.", 0.0, ge=0)
    bore: float = quantity("mm", "Inner diameter.", 0.0, ge=0)
    width: float = quantity("mm", "Across the force.", 0.0, ge=0)
    height: float = quantity("mm", "Along the force.", 0.0, ge=0)

    @model_validator(mode="after")
    def _one_shape(self) -> Section:
        if (self.diameter > 0) == (self.width > 0 and self.height > 0) or self.bore >= max(self.diameter, 1e-9):
            raise ValueError("give a diameter (with a smaller bore), or a width and a height")
        return self


class Body(Frozen):
    """A stepped shaft or tool, from its clamped end outwards."""

    sections: tuple[Section, ...] = Field(min_length=1, max_length=100, description="From the clamped end outwards.")
    young: float = quantity("N/mm2", "Young's modulus.", 210e3, gt=0)
    poisson: float = quantity("1", "Poisson's ratio.", 0.3, ge=0, lt=0.5)
    clamp_stiffness: float | None = quantity("N/um", "Radial stiffness of the clamping; none: rigid.", None, gt=0)
    clamp_turning: float | None = quantity("N m/urad", "Its stiffness against tilt; none: rigid.", None, gt=0)
    tailstock: float = quantity("N/um", "Stiffness of a centre at the far end; 0: none.", 0.0, ge=0)

    def at(self, places: np.ndarray | None = None) -> np.ndarray:
        """Compliance at distances from the clamped end (default: the far end), um/N."""
        import numpy as np

        from errpipe.errors import DataError
        from errpipe.kinematics import beam

        parts: list[beam.Stretch] = [beam.Stretch(**s.model_dump()) for s in self.sections]
        support = beam.Support(self.clamp_stiffness, self.clamp_turning, self.tailstock)
        where = np.array([self.length]) if places is None else places
        try:
            return beam.compliance(parts, where, support, self.young, self.poisson)
        except ValueError as err:
            raise DataError(f"push tests: {err}: give `chuck_face` and all sections") from None

    @property
    def length(self) -> float:
        """From the clamped to the far end, mm."""
        return sum(s.length for s in self.sections)


class Force(Family):
    """Deviation per newton of a cutting force over the position of the cut, from push tests and geometry."""

    family: Literal["force"] = Field("force", description="Model family.")
    configuration: Literal["turning", "milling"] = Field(
        "turning", description="turning: the workpiece gives way over the axis of the cut; milling: tool and structure."
    )
    component: str = Field("E_X", description="Component that the force moves, such as E_X, or E_D (twice the radius).")
    force: str = Field(description="Column of the force, in the direction of the deviation.")
    axis: str | None = Field(None, pattern="^[A-Z]$", description="Axis along which the cut moves (turning: Z).")
    chuck_face: float = quantity("mm", "Position of the axis at the clamped end of the workpiece.", 0.0)
    outwards: Literal[1, -1] = Field(1, description="Direction of the axis away from the clamped end.")
    sign: Literal[1, -1] = Field(1, description="Direction of the deviation under a positive force; 1: away from it.")
    workpiece: Body | None = Field(None, description="The workpiece that is cut.")
    tool: Body | None = Field(None, description="The tool that cuts, from its holder outwards.")
    pushed_workpiece: Body | None = Field(None, description="What was pushed on in the tests; default: rigid.")
    pushed_tool: Body | None = Field(None, description="The tool of the tests; default: rigid.")
    gauge_datum: Literal["neighbour", "bed"] = Field(
        "neighbour",
        description="What a gauge at the workpiece reads against, where several gauges were recorded: the spindle "
        "(neighbour), or the bed as the others do.",
    )
    documents: ClassVar[tuple[str, ...]] = (FIGURES,)
    solved_by: ClassVar[str] = "push tests and beam elements"

    @model_validator(mode="after")
    def _complete(self) -> Force:
        if self.configuration == "turning" and self.axis is None:
            raise ValueError("turning needs the axis of the cut (axis: Z)")
        if self.configuration == "milling" and (self.workpiece or self.pushed_workpiece):
            raise ValueError("milling takes the workpiece as rigid: leave it out")
        return self

    def missing_input(self, recording: Recording) -> str:
        """The force, and the position of the axis of the cut."""
        forces, axes = (
            recording.names("force"),
            [recording.manifest.columns[n].axis for n in recording.names("position")],
        )
        if self.force not in forces:
            return f"push tests: no column {self.force!r} of role force (there are: {', '.join(forces) or 'none'})"
        if self.axis is not None and self.axis not in axes:
            return f"push tests: no position of axis {self.axis} (there are: {', '.join(map(str, axes)) or 'none'})"
        return ""

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit the structure on every row. Raises DataError, VerifyError."""
        import numpy as np

        from errpipe.models import _push_tests as push

        parts = push.solve(self, recording, np.ones(len(recording), dtype=bool))
        whole = push.whole(parts)
        model, curve = _error_model(self, recording, parts)
        document = {
            "compliance": 1,
            "configuration": self.configuration,
            "component": self.component,
            **_figures(whole),
            "parts": {name: _figures(part) for name, part in parts.items() if name != push.WHOLE},
            "not_gauged": [name for name in push.GAUGES if push.WHOLE not in parts and name not in parts],
            "curve": curve,
            "without_force": "a missing or old force reading counts as 0 N: no force correction is made",
            "validated": "on static push tests; no public recording of cutting force against part size was found",
        }
        worst = max(curve["um_per_N"])
        return Fitted(model, {FIGURES: document}, {self.component: f"at most {1e3 * worst:.3g} um/kN"})

    def judge(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """The structure from one side, the other side's deflections judged; zero is that of each run."""
        import numpy as np

        from errpipe.models import _push_tests as push

        whole = push.whole(push.solve(self, recording, fold.train))
        pushes = push.read(self, recording)
        structure = np.vander(pushes.lever, len(push.NAMES), increasing=True) @ whole.values
        gives = pushes.force * (structure + pushes.all_known)
        after = pushes.whole - gives * self.sign * push.diameter_factor(self)
        return {self.component: held_out(fold, pushes.whole, after, np.zeros(len(recording)))}

    def tables(self, documents: Mapping[str, Any], validation: Mapping[str, Any]) -> list[Table]:
        """Compliance along the cut, with its parts."""
        curve, missing = documents[FIGURES]["curve"], documents[FIGURES]["not_gauged"]
        columns = [n for n in curve if n.endswith(TOTAL)]
        pick = range(0, len(curve[TOTAL]), max(1, len(curve[TOTAL]) // 8))
        rows = [[curve["position"][k], *(1e3 * curve[n][k] for n in columns)] for k in pick]
        names = [(n.removesuffix(TOTAL).replace("_", " ").strip() or "total") + ", um/kN" for n in columns]
        caption = "A force reading that is missing or old counts as 0 N: then no force correction is made."
        if missing:
            caption += f" No gauge at {' and '.join(missing).replace('_', ' ')}: what gives way there is not corrected."
        return [Table("Compliance", ["position, mm", *names], rows, caption)]


TOTAL = "um_per_N"


def _figures(part: Structure) -> dict[str, Any]:
    """A structure as JSON values."""
    from errpipe.models._push_tests import NAMES

    return {
        "structure_um_per_N": {n: float(v) for n, v in zip(NAMES, part.values, strict=True)},
        "standard_error": {n: float(v) for n, v in zip(NAMES, part.errors, strict=True)},
        "noise_um": part.noise,
    }


def _curve(options: Force, recording: Recording, parts: Mapping[str, Structure]) -> dict[str, np.ndarray]:
    """Compliance of the cut over the axis, um/N, with its parts; one place where no axis moves."""
    import numpy as np

    from errpipe.drivers.motion import position
    from errpipe.errors import DataError
    from errpipe.models import _push_tests as push

    if options.axis is None:
        at = np.zeros(1)
    elif options.workpiece is not None:
        reach = options.chuck_face + options.outwards * np.array([0.0, options.workpiece.length])
        at = np.linspace(reach.min(), reach.max(), POINTS)
    else:
        seen = position(recording, options.axis)
        at = np.linspace(np.nanmin(seen), np.nanmax(seen), POINTS)
    away = np.clip(options.outwards * (at - options.chuck_face), 0.0, None) if options.axis else np.zeros(1)
    powers = np.vander(away * 1e-3, len(push.NAMES), increasing=True)
    gauged = {name: powers @ part.values for name, part in parts.items()}
    structure = np.sum(list(gauged.values()), axis=0)
    work = options.workpiece.at(away) if options.workpiece is not None else np.zeros(len(at))
    tool = np.full(len(at), float(options.tool.at()[0]) if options.tool is not None else 0.0)
    total = structure + work + tool
    pulled = {"compliance": total} if push.WHOLE in gauged else {f"compliance of the {n}": v for n, v in gauged.items()}
    for name, value in pulled.items():
        if value.min() < -3 * push.whole(parts).errors[0]:
            raise DataError(
                f"push tests: the {name} would be {value.min():.3g} um/N: a force pulls what it should push. Check "
                "the sign of force and deviation, `sign`, and what was pushed in the tests."
            )
    bodies = {"structure": structure, "workpiece": work, "tool": tool}
    bodies |= {f"{n}_gauged": v for n, v in gauged.items() if n != push.WHOLE}
    return {"position": at, TOTAL: total} | {f"{n}_{TOTAL}": v for n, v in bodies.items()}


def _error_model(
    options: Force, recording: Recording, parts: Mapping[str, Structure]
) -> tuple[ErrorModel, dict[str, list[float]]]:
    import numpy as np

    from errpipe import __version__
    from errpipe.domain.error_model import ComponentModel, ErrorModel, Validity
    from errpipe.drivers.motion import position_name
    from errpipe.models import _push_tests as push

    curve, pushes, noise = _curve(options, recording, parts), push.read(options, recording), push.whole(parts).noise
    largest = float(np.nanmax(np.abs(pushes.force)))
    columns = [options.force, *([position_name(recording, options.axis)] if options.axis else [])]
    ranges = {options.force: (-largest, largest)}
    if options.axis:
        ranges[columns[1]] = (float(curve["position"][0]), float(curve["position"][-1]))
    gain = curve["um_per_N"] * options.sign * push.diameter_factor(options)
    part = ComponentModel(
        component=options.component,
        terms=_terms(options, curve["position"], gain),
        rows=len(recording),
        rows_effective=float(len(recording)),
        rms_before=float(np.sqrt(np.nanmean(pushes.whole**2))),
        rms_after=noise * push.diameter_factor(options),
        half_width90=1.645 * noise * push.diameter_factor(options),
    )
    manifest = recording.manifest
    model = ErrorModel(
        machine=manifest.machine,
        title=manifest.title,
        version=__version__,
        columns={n: manifest.columns[n].model_dump(mode="json", exclude_none=True) for n in columns},
        components=(part,),
        validity=Validity(ranges=ranges),
        notes=("a force reading that is missing counts as 0 N: no force correction is made",),
    )
    return model, {n: [round(float(v), 9) for v in values] for n, values in curve.items()}


def _terms(options: Force, at: np.ndarray, gain: np.ndarray) -> tuple[Any, ...]:
    """Force times a level, and force times a curve over the axis, um per N."""
    import numpy as np

    from errpipe.domain.error_model import FittedParameter, FittedTerm
    from errpipe.errors import VerifyError
    from errpipe.terms import Curve, plain
    from errpipe.terms.profile_driver import ProfileDriver

    push: dict[str, Any] = {"driver": ({"input": options.force, "unit": "N"},)}
    level = ProfileDriver(**push)
    terms, values = [level], [np.array([gain.mean()])]
    if options.axis and np.ptp(gain) > 0:
        curve = Curve(segments=SEGMENTS, span=(float(at[0]), float(at[-1])))
        basis = np.column_stack([np.ones(len(at)), curve.basis(at)])
        solution, *_ = np.linalg.lstsq(basis, gain, rcond=None)
        worst = float(np.abs(basis @ solution - gain).max())
        if worst > MISSED * np.abs(gain).max():
            raise VerifyError(f"push tests: the table's curve would miss the compliance by {worst:.3g} um/N")
        terms.append(ProfileDriver(axis=options.axis, profile=curve, **push))
        values = [solution[:1], solution[1:]]
    return tuple(
        FittedTerm(
            term=plain(term),
            parameters=tuple(
                FittedParameter(name=p.name, value=float(v), unit="um/N")
                for p, v in zip(term.linear(), each, strict=True)
            ),
        )
        for term, each in zip(terms, values, strict=True)
    )
