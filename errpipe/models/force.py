"""Compliance of machine, tool and workpiece under a cutting force: static push tests and stepped beams.

    deviation(z) = F * (structure(z) + workpiece(z) + tool)                               [um] = [N] * [um/N]

The structure (tool post, spindle and its tilt) comes from push tests as a polynomial in the distance from the chuck,
as a whole or by gauge (`_push_tests`);
workpiece and tool are computed from their geometry (`kinematics.beam`), those of the push tests and those of the cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from errpipe.errors import DataError, VerifyError
from errpipe.models._base import Family, Fitted, Progress, Table, held_out, no_progress
from errpipe.models._force_options import ForceOptions

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import Fold
    from errpipe.fitting.judging import HeldOut
    from errpipe.models._push_tests import Structure

FIGURES = "compliance.json"
POINTS = 129  # of the compliance curve over the travel
SEGMENTS = 40  # of the spline that represents it in the table
MISSED = 0.002  # of the largest compliance: tolerance of the spline


class Force(ForceOptions, Family):
    """Deviation per newton of a cutting force over the position of the cut, from push tests and geometry."""

    documents: ClassVar[tuple[str, ...]] = (FIGURES,)
    solved_by: ClassVar[str] = "push tests and beam elements"

    def fit(self, recording: Recording, progress: Progress = no_progress) -> Fitted:
        """Fit the structure on every row. Raises DataError, VerifyError."""

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

    def validate_fold(self, recording: Recording, fold: Fold) -> Mapping[str, HeldOut]:
        """The structure from one side, validated on the deflections of the other; zero is that of each run."""

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
    """Compliance of the cut along the axis, um/N, with its parts; one position if no axis moves."""

    from errpipe.drivers.motion import position
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
                f"push tests: the {name} would be {value.min():.3g} um/N, opposite to the force. Check "
                "the sign of force and deviation, `sign`, and what was pushed in the tests."
            )
    bodies = {"structure": structure, "workpiece": work, "tool": tool}
    bodies |= {f"{n}_gauged": v for n, v in gauged.items() if n != push.WHOLE}
    return {"position": at, TOTAL: total} | {f"{n}_{TOTAL}": v for n, v in bodies.items()}


def _error_model(
    options: Force, recording: Recording, parts: Mapping[str, Structure]
) -> tuple[ErrorModel, dict[str, list[float]]]:
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
    model = ErrorModel.of(
        recording.manifest,
        columns,
        components=(part,),
        validity=Validity(ranges=ranges),
        notes=("a force reading that is missing counts as 0 N: no force correction is made",),
    )
    return model, {n: [round(float(v), 9) for v in values] for n, values in curve.items()}


def _terms(options: Force, at: np.ndarray, gain: np.ndarray) -> tuple[Any, ...]:
    """Force times a level, and force times a curve over the axis, um per N."""

    from errpipe.terms import Curve, fitted_term
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
    return tuple(fitted_term(term, each, "um/N") for term, each in zip(terms, values, strict=True))
