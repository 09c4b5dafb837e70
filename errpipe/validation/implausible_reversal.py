"""Lost motion of implausible sign: both directions compared at each target."""

from __future__ import annotations

import numpy as np

from errpipe.validation.plausibility_finding import Finding, Response

MIN_TARGETS = 5  # approached from both sides: of an axis up to 2 m (ISO 230-2, 5.3.2)
MIN_READINGS = 8  # of a direction, if targets are not shared; fewer do not show the usual size

SHOWN = 1.0  # um: reporting threshold; an axis with a scale may have a smaller value of either sign


def reversal_of_the_other_sign(r: Response) -> Finding | None:
    """Lost motion stops an axis short; the opposite sign is possible (a scale, an overcompensated control) but rare."""
    if r.direction is None or r.component.kind != "positioning":
        return None
    up, down = r.deviation[r.direction > 0], r.deviation[r.direction < 0]
    if min(up.size, down.size) < MIN_READINGS:
        return None
    lost = _at_shared_targets(r)
    if lost.size >= MIN_TARGETS:
        step, samples = float(np.median(lost)), [lost]
    else:  # the curve of the axis counts as scatter
        step, samples = float(np.median(up) - np.median(down)), [up, down]
    spread = 1.4826 * max(float(np.median(np.abs(v - np.median(v)))) for v in samples)
    if step < max(SHOWN, spread):
        return None
    evidence = f"approached from below the axis stands {step:.3g} um further than from above"
    meant = "the same with the sign or the direction reversed, unless the control already corrects backlash too much"
    return Finding("reversal-sign", r.column, evidence, meant, "ask", of_sign=True)


def _at_shared_targets(r: Response) -> np.ndarray:
    """Mean from below minus mean from above, um, at each target approached from both sides: (targets,)."""
    if r.position is None or r.direction is None:
        return np.empty(0)
    _, target = np.unique(np.round(r.position, 3), return_inverse=True)
    means = []
    for rows in (r.direction > 0, r.direction < 0):
        count = np.bincount(target[rows], minlength=target.max() + 1)
        total = np.bincount(target[rows], r.deviation[rows], minlength=target.max() + 1)
        means.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
    lost = means[0] - means[1]
    return np.asarray(lost[np.isfinite(lost)])
