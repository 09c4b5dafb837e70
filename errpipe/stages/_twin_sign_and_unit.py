"""Simulated values that look as if declared with the other sign or in another unit than the measured ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

ROWS = 20  # with fewer rows no warning is given
MIN_CORRELATION = 0.8  # correlation from which on the two are one curve
MIRRORED = (0.8, 1.25)  # minus the slope of measured on simulated of a sign alone; missing physics gives any slope
UNIT = 300.0  # factor between the two from which on a unit is likelier than a simulation so far off (um and mm: 1000)


def warnings(recording: Recording) -> tuple[str, ...]:
    """One sentence for each response whose twin looks like that. Slope and correlation are over all rows with both."""
    out = []
    for component in recording.components():
        names = [recording.name(role, component=component) for role in ("error", "simulated")]
        if None in names:
            continue
        measured, simulated = (recording.array(str(name)) for name in names)
        both = np.isfinite(measured) & np.isfinite(simulated)
        y, s = measured[both], simulated[both]
        if y.size < ROWS or not (np.std(y) > 0.0 and np.std(s) > 0.0):
            continue
        correlation = float(np.corrcoef(y, s)[0, 1])
        slope = correlation * float(np.std(y) / np.std(s))
        if correlation < -MIN_CORRELATION and MIRRORED[0] < -slope < MIRRORED[1]:
            why = "one of them has the other sign (deviation = actual - commanded)"
        elif abs(correlation) > MIN_CORRELATION and not 1.0 / UNIT < abs(slope) < UNIT:
            unit = recording.manifest.columns[str(names[1])].unit
            why = f"one of them is probably not in {unit}"
        else:
            continue
        out.append(f"{component}: measured is {slope:.3g} of simulated (correlation {correlation:.2f}): {why}")
    return tuple(out)
