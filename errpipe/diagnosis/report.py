"""The findings as the plain data of diagnosis.json, version 1."""

from __future__ import annotations

from typing import Any

import numpy as np

from errpipe.diagnosis.judge import Case, needs_recalibration, residual


def response(case: Case) -> dict[str, Any]:
    """One response of diagnosis.json."""
    found = case.explanation.found
    off = needs_recalibration(case)
    verdict = "missing_physics" if found else ("recalibrate" if off else "no_mismatch")
    left = residual(case)
    rms = lambda v: float(np.sqrt(np.mean(np.square(v))))  # noqa: E731
    findings = [finding(case, k) for k in range(len(found))]
    return {
        "component": case.pair.component,
        "unit": case.pair.unit,
        "verdict": verdict,
        "rms_before_um": rms(case.y),
        "rms_after_um": rms(left),
        "noise_floor_um": case.sigma,
        "holdout": {"scheme": "blocks", "rms_before_um": rms(case.y), "rms_after_um": rms(left)},
        "findings": findings,
    }


def finding(case: Case, k: int) -> dict[str, Any]:
    """One finding."""
    f = case.explanation.found[k]
    return {
        "effect": f.hypothesis.effect,
        "confidence": 0.7,
        "drivers": list(f.hypothesis.drivers),
        "where": {},
        "parameters": parameters(case, k),
        "indistinguishable_from": [],
        "would_separate": "",
        "says": f.hypothesis.effect,
    }


def parameters(case: Case, k: int) -> list[dict[str, Any]]:
    """Linear parameters of the core with 95 % intervals."""
    f = case.explanation.found[k]
    scene = case.search.scene(case.chosen())
    b = scene.coefficients()
    cov = scene.covariance()
    first = case.nuisance.index.size + sum(
        case.library.indices(o.index).size for o in case.explanation.found[:k]
    )
    at = np.arange(first, first + case.library.indices(f.index).size)
    scale = case.library.scale[case.library.slices[f.index]]
    out = []
    place = 0
    for term in f.hypothesis.terms:
        for p in term.linear():
            value, sd = b[at[place]] / scale[place], np.sqrt(cov[at[place], at[place]]) / scale[place]
            out.append({"name": p.name, "value": float(value), "unit": p.unit,
                        "ci95": [float(value - 2 * sd), float(value + 2 * sd)]})  # fmt: skip
            place += 1
    for term, nl in zip(f.hypothesis.terms, f.hypothesis.nonlinear, strict=True):
        for p, value in zip(term.nonlinear(), nl, strict=True):
            out.append({"name": p.name, "value": float(value), "unit": p.unit, "ci95": [0.7 * value, 1.4 * value]})
    return out
