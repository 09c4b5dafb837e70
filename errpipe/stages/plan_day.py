"""The most informative next duty cycle, and the expected uncertainty after it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from errpipe.errors import DataError

LEAST_GAIN = 0.05  # of the uncertainty: smaller gains are not worth another day of eight hours (a judgement)


def plan_day(
    recording: Path | None, speed: float | None, hours: float, noise: float, standing: float
) -> tuple[dict[str, Any], list[str]]:
    """The next day after those recorded: speeds, expected uncertainty before and after it, um.

    recording: folder of a recording with spindle speeds; None: nothing was recorded yet. speed: highest, rpm
    (default: the highest recorded). Raises DataError where there is no speed to be had.
    """
    from errpipe.fitting import experiment_design as design

    recorded, highest = _recorded(recording) if recording is not None else ([], None)
    top = speed if speed is not None else highest
    if top is None or top <= 0:
        raise DataError("plan-day: no spindle speed was recorded; say the highest one with --speed")
    options = design.DesignOptions(highest_speed=top, hours=hours, noise=noise, standing=standing)
    days = [design.Plan(_stretches(t, v / top, options)) for t, v in recorded]
    proposed = design.propose(days, options)
    import numpy as np

    used = np.vstack([design.basis(p, options) for p in design.usage(options)])
    before = design.uncertainty(design.information(days, options), used)
    after = design.uncertainty(design.information([*days, proposed], options), used)
    worth = after < (1.0 - LEAST_GAIN) * before and before > noise
    document: dict[str, Any] = {
        "plan_day": 1,
        "days_done": len(days),
        "highest_speed_rpm": top,
        "uncertainty_before_um": before,
        "uncertainty_after_um": after,
        "worth_it": bool(worth),
        "day": proposed.table(options) if worth else [],
    }
    lines = [
        f"{len(days)} days recorded; expected error on other duty cycles {before:.3g} um, after one more {after:.3g} um"
    ]
    if not worth:
        return document, [*lines, "no further day is worth it: the model is as well known as a reading is good"]
    return document, lines + [f"{step['minutes']:5.0f} min at {step['rpm']:.0f} rpm" for step in document["day"]]


def _recorded(folder: Path) -> tuple[list[tuple[Any, Any]], float | None]:
    """Times, s, and speeds, rpm, of every run; and the highest speed."""
    import numpy as np

    from errpipe.formats import manifest_folder

    recording = manifest_folder.read(folder)
    name = recording.name("spindle_speed")
    if name is None:
        raise DataError(f"{folder}: the recording has no column of role spindle_speed")
    run, t, v = recording.run_codes(), recording.time(), np.nan_to_num(recording.array(name))
    return [(t[run == r] - t[run == r][0], v[run == r]) for r in np.unique(run)], float(np.max(v, initial=0.0))


def _stretches(t: Any, share: Any, options: Any) -> tuple[float, ...]:
    """Mean speed of each stretch of a day; 0 (standing) where nothing was recorded."""
    import numpy as np

    which = np.minimum((t / options.segment).astype(int), options.segments - 1)
    return tuple(float(np.mean(share[which == k])) if np.any(which == k) else 0.0 for k in range(options.segments))
