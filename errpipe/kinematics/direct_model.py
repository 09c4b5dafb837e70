"""Directly measured components as an error model: a curve over its axis each, and its reversal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.components import is_error_motion
from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedTerm, Validity
from errpipe.domain.recording import Recording
from errpipe.errors import VerifyError
from errpipe.kinematics import direct, records
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.errors import positions_of
from errpipe.terms import Line, fitted_term
from errpipe.terms.backlash import Backlash
from errpipe.terms.offset import Offset
from errpipe.terms.profile_driver import ProfileDriver
from errpipe.terms.smooth_curve import SmoothCurve

SEGMENTS = 48  # of the spline that represents a curve; more where the curve has more than 65 points
MAX_SPLINE_ERROR = 0.02  # um, urad: largest difference allowed between the spline and the identified curve


def error_model(
    chain: Chain, recording: Recording, curves: Mapping[str, Any], noise: Mapping[str, float]
) -> ErrorModel:
    """The components of a recording, from the document of an identification. noise: of a reading, by component.

    They count as in the records, along the axes, whatever convention the machine file uses.
    Raises VerifyError if a curve is too rough for the spline.
    """
    columns: list[str] = []
    ranges: dict[str, tuple[float, float]] = {}
    parts = []
    for name in (c for c in recording.components() if is_error_motion(c)):
        axis = direct.axis_of(name)
        column = direct.position_of(recording, name)
        at, value = recording.array(column), recording.array(str(recording.name("error", component=name)))
        seen = at[np.isfinite(at) & np.isfinite(value)]
        ranges[column] = (float(seen.min()), float(seen.max()))
        columns.append(column)
        curve, side = curves["curves"][name], recording.name("direction", axis=axis)
        sign = records.component_sign(chain, name)
        terms = _curve(name, axis, curve, sign)
        if side is not None and name in curves.get("reversal", {}):
            columns.append(side)
            terms += _reversal(axis, curves["reversal"][name], sign)
        reading_noise, curve_error = float(noise[name]), np.asarray(curve["half_width95"]) / 1.96
        parts.append(
            ComponentModel(
                component=name,
                unit=curve["unit"],
                terms=tuple(terms),
                rows=int(seen.size),
                rows_effective=float(seen.size),
                rms_before=float(np.sqrt(np.mean(np.square(curve["value"])))),
                rms_after=reading_noise,
                half_width90=float(1.645 * np.sqrt(reading_noise**2 + np.mean(curve_error**2))),
            )
        )
    return ErrorModel.of(
        recording.manifest,
        columns,
        [n for n, c in recording.manifest.constants.items() if c.role == "axis"],
        title="",
        components=tuple(parts),
        validity=Validity(ranges=ranges),
        notes=("zero, straightedge and square are set-up and are not in this model",),
    )


def _curve(name: str, axis: str, curve: Mapping[str, Any], sign: float) -> list[FittedTerm]:
    """An offset and a spline that reproduce an identified curve times a sign."""
    value = sign * np.asarray(curve["value"], dtype=float)
    at = positions_of(curve)
    segments = max(SEGMENTS, len(at) * 3 // 4)
    term = SmoothCurve(axis=axis, segments=segments, span=(float(at[0]), float(at[-1])))
    basis = np.column_stack([np.ones(len(at)), term._profile().basis(at)])
    coefficients, *_ = np.linalg.lstsq(basis, value, rcond=None)
    worst = float(np.abs(basis @ coefficients - value).max())
    if worst > MAX_SPLINE_ERROR + 1e-3 * float(np.ptp(value)):
        raise VerifyError(f"{name}: a spline of {segments} stretches misses the identified curve by {worst:.3g}")
    unit = curve["unit"]
    return [fitted_term(Offset(), [coefficients[0]], unit), fitted_term(term, coefficients[1:], unit)]


def _reversal(axis: str, reversal: Mapping[str, Any], sign: float) -> list[FittedTerm]:
    """Up minus down as a gap, and its change along the axis; only if significant."""
    value, slope = (sign * v for v in records.reversal_line(reversal))
    unit, out = str(reversal["unit"]), []
    if value:
        out.append(fitted_term(Backlash(axis=axis), [-value], unit, float(reversal["half_width95"])))
    if slope:
        term = ProfileDriver(axis=axis, profile=Line(origin=reversal["middle"]), driver=(d.Direction(axis=axis),))
        out.append(fitted_term(term, [0.5 * slope], f"{unit}/m", 0.5 * float(reversal["per_metre_half_width95"])))
    return out
