"""Checks of runs and directions against each other: a sign that changes among them, a way back in the wrong order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from errpipe.validation.plausibility_finding import Check, Finding, Response, is_rearranged, noise_of_difference

FEWEST_TARGETS = 10  # shared targets; chance reaches a correlation of -0.8 on ten once in 200 tries
OPPOSITE = -0.8  # correlation of a curve with the mean of the others
ALIKE = 0.6  # correlation of the others among themselves
SMALLEST_UM = 1.0  # um (urad): scatter of a curve about its line below which its sign says nothing


def mixed_sign(r: Response) -> Finding | None:
    """One run, or one direction, whose curve is that of the others with the other sign."""
    if r.position is None or r.component.kind == "force":
        return None
    keys = [("run", r.run)] + ([] if r.direction is None else [("direction", r.direction)])
    for what, key in keys:
        labels = np.unique(key)
        curves = _curves(r, [key == k for k in labels])
        if labels.size < 2 or curves is None:
            continue
        match = np.corrcoef(curves)
        for i, label in enumerate(labels):
            rest = np.delete(np.arange(labels.size), i)
            opposite = match[i, rest].max() < OPPOSITE
            if opposite and all(match[a, b] > ALIKE for a in rest for b in rest):
                name = r.recording.run_labels()[int(label)] if what == "run" else f"{label:+g}"
                evidence = f"{what} {name} has the shape of the others with the other sign"
                evidence += f" (correlation {match[i, rest].mean():.2f})"
                meant = "its deviations are commanded minus actual: turn them"
                if what == "direction":  # a screw worn in the middle looks the same
                    return Finding(
                        "mixed-sign", r.column, evidence, f"{meant}, or lost motion along a worn screw", "ask"
                    )
                return Finding("mixed-sign", r.column, evidence, meant)
    return None


def mirrored_rows(r: Response) -> Finding | None:
    """The way back agrees with the way there only when its readings are taken in the opposite order."""
    if r.position is None or r.direction is None:
        return None
    curves = _curves(r, [r.direction > 0, r.direction < 0])
    if curves is None:
        return None
    straight = float(np.std(curves[0] - curves[1]))
    mirrored = float(np.std(curves[0] - curves[1][::-1]))
    if not is_rearranged(r, straight**2, mirrored**2, curves.shape[1], noise_of_difference(r)):
        return None
    return Finding(
        "mirrored-rows",
        r.column,
        f"both directions agree {straight / max(mirrored, 1e-12):.3g} times better when one is read backwards",
        "readings of the way back that stand in the order of the targets, not of the measurement (or the reverse)",
        "refuse" if r.repeats()[1] else "ask",
    )


def _curves(r: Response, groups: Sequence[np.ndarray]) -> np.ndarray | None:
    """Mean deviation of each group at the targets that all share, less its own line; None where it says nothing."""
    levels = np.round(np.asarray(r.position), 3)
    shared = levels[groups[0]] if groups else levels
    for rows in groups:
        shared = np.intersect1d(shared, levels[rows])
    if shared.size < FEWEST_TARGETS:
        return None
    out = []
    for rows in groups:
        mean = np.array([r.deviation[rows & (levels == x)].mean() for x in shared])
        out.append(mean - np.polyval(np.polyfit(shared, mean, 1), shared))
    curves = np.array(out)
    return curves if curves.std(axis=1).min() > SMALLEST_UM else None


CHECKS: tuple[Check, ...] = (mixed_sign, mirrored_rows)
