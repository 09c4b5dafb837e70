"""The most informative next duty cycle: of those recorded or logged, or, before any was, of spindle speeds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe.domain.recording import Recording
from errpipe.errors import DataError, did_you_mean
from errpipe.fitting import experiment_design as design
from errpipe.fitting import holdout
from errpipe.fitting.noise_floor import noise_floor
from errpipe.formats import manifest_folder
from errpipe.thermal.duty_cycles import DutyCycles

NOISE = 1.0  # um, of a reading, where nothing was measured that shows it
MIN_GAIN = 0.05  # of the uncertainty: smaller gains are not worth another day of eight hours (a judgement)
MIN_TRAVEL = 1.0  # mm or deg; an axis that moves less within a run is stationary
MAX_LINES = 12  # candidates that are printed; the document has all


def has_errors(folder: Path) -> bool:
    """Whether a recording has a temperature and an error."""
    recording = manifest_folder.read(folder)
    return bool(recording.names("temperature") and recording.names("error"))


def from_errors(
    folder: Path, log: Path | None, component: str | None, by: Sequence[str], min_gain: float | None
) -> tuple[dict[str, Any], list[str]]:
    """The next duty cycle of a recording with temperatures and measured errors, and what it is expected to bring.

    log: a recording of temperatures alone: further duty cycles to choose from, further states that count. by: groups
    whose labels name a duty cycle (default: duty_cycle, else run). least: rms, um, that a cycle must take away
    (default: the noise of a reading). Raises DataError if the recording does not say what is requested.
    """
    recording = manifest_folder.read(folder)
    chosen = _component(folder, recording, component)
    if log is not None:
        recording = _joined(recording, manifest_folder.read(log), log)
    cycles = DutyCycles.of(recording, chosen)
    document, lines = _document(
        chosen, cycles, _candidates(recording, cycles, by), _min_gain(recording, cycles, min_gain)
    )
    if axes := _moved(recording, chosen):
        lines.append(
            f"{chosen} was measured at several places of {', '.join(axes)}, and temperatures alone plan: what differs"
            " between places counts as what no run teaches. Plan by the readings of one place."
        )
    unit = recording.manifest.columns[str(recording.name("error", component=chosen))].unit or "um"
    return document | {"unit": unit}, [line.replace("{unit}", unit) for line in lines]


def _document(
    component: str, cycles: DutyCycles, candidates: dict[str, list[int]], min_gain: float
) -> tuple[dict[str, Any], list[str]]:
    """The document and its lines. candidates: runs by label."""
    known = cycles.fit(cycles.measured)
    before, rest = cycles.expected(known), cycles.irreducible(known)
    rows = []
    for label, runs in candidates.items():
        after = cycles.expected(known, runs)
        done = sum(r in cycles.measured for r in runs)
        brings = max(before**2 - after**2, 0.0) ** 0.5
        rows.append({"duty_cycle": label, "runs": len(runs), "measured": done, "after": after, "takes_away": brings})
    rows.sort(key=lambda row: row["after"])
    worth = rows[0]["takes_away"] > min_gain
    document = {
        "plan_day": 2,
        "component": component,
        "runs": len(cycles.runs),
        "measured": len(cycles.measured),
        "unknown_before": before,
        "not_taught": rest,
        "least": min_gain,
        "worth_it": worth,
        "next": rows[0]["duty_cycle"] if worth else None,
        "candidates": rows,
    }
    lines = [
        f"{component}: {len(cycles.measured)} of {len(cycles.runs)} runs measured; expected rms error of a prediction"
        f" over all of them {(before**2 + rest**2) ** 0.5:.3g} {{unit}}:",
        f"{before:.3g} {{unit}} from gains not known well enough, {rest:.3g} that no further run teaches this"
        " plan's few combinations of temperatures (a fit may leave less: `validate`)",
    ]
    for row in rows[:MAX_LINES]:
        lines.append(
            f"{row['duty_cycle']} ({row['measured']} of {row['runs']} runs measured): gains {before:.3g} ->"
            f" {row['after']:.3g}, takes away {row['takes_away']:.3g} {{unit}}"
        )
    if worth:
        return document, [*lines, f"run next: {document['next']}"]
    return document, [
        *lines,
        f"no further duty cycle is worth it: none takes away more than {min_gain:.3g} {{unit}} rms",
    ]


def _component(folder: Path, recording: Recording, component: str | None) -> str:
    present = recording.components()
    if component is None and len(present) == 1:
        return present[0]
    if component not in present:
        value = "several errors" if component is None else f"no error {component!r}"
        hint = "; select it with --component" if component is None else did_you_mean(component, present)
        raise DataError(f"{folder}: the recording has {value} (present: {', '.join(present) or 'none'}){hint}")
    return component


def _moved(recording: Recording, component: str) -> list[str]:
    """Axes that are not stationary in a run in which the error was measured."""
    measured = np.isfinite(recording.array(str(recording.name("error", component=component))))
    run, axes = recording.run_codes()[measured], []
    for name in recording.names("position") or recording.names("command"):
        places = recording.array(name)[measured]
        if any(np.ptp(places[run == r]) > MIN_TRAVEL for r in np.unique(run)):
            axes.append(recording.manifest.columns[name].axis or name)
    return axes


def _joined(recording: Recording, log: Recording, folder: Path) -> Recording:
    """The recording followed by the runs of a log, which must have its temperatures; the log's errors do not count."""
    missing = [n for n in recording.names("temperature") if n not in log.names("temperature")]
    if missing:
        raise DataError(f"{folder}: no temperature {missing[0]!r} (the recording has it)")
    run = recording.name("run")
    if run is None:
        raise DataError("plan-day: a log is joined to a recording with a column of role run")
    shared = [n for n in log.frame.columns if n in recording.frame.columns and n not in recording.names("error")]
    labels = pd.Series([f"{log.run_labels()[k]} (log)" for k in log.run_codes()], dtype=object)
    later = log.frame[shared].assign(**{run: labels})
    for name in recording.names("group"):
        later[name] = later[name].astype(str) if name in later else "log"
    return Recording(recording.manifest, pd.concat([recording.frame, later], ignore_index=True), recording.between)


def _candidates(recording: Recording, cycles: DutyCycles, by: Sequence[str]) -> dict[str, list[int]]:
    """Runs by the label of their duty cycle, in order of appearance."""
    kinds = {recording.manifest.columns[n].of for n in recording.names("group")}
    names = list(by) or ["duty_cycle" if "duty_cycle" in kinds else "run"]
    columns = [holdout.labels(holdout.with_calendar(recording, name), name) for name in names]
    out: dict[str, list[int]] = {}
    for run in cycles.runs:
        first = int(np.flatnonzero(cycles.run == run)[0])
        out.setdefault(" ".join(str(column[first]) for column in columns), []).append(run)
    return out


def _min_gain(recording: Recording, cycles: DutyCycles, min_gain: float | None) -> float:
    """Minimum reduction of the rms by a duty cycle, um: as stated, else the noise of a reading."""
    rows = np.flatnonzero(np.isfinite(cycles.deviation))
    return min_gain if min_gain is not None else noise_floor(recording, rows, cycles.deviation[rows]) or NOISE


def from_speeds(
    recording: Path | None, speed: float | None, hours: float, noise: float, standing: float
) -> tuple[dict[str, Any], list[str]]:
    """The next day after those recorded: speeds, expected uncertainty before and after it, um.

    recording: folder of a recording with spindle speeds; None: nothing was recorded yet. speed: highest, rpm
    (default: the highest recorded). Raises DataError if there is no speed to be had.
    """
    recorded, highest = _recorded(recording) if recording is not None else ([], None)
    top = speed if speed is not None else highest
    if top is None or top <= 0:
        raise DataError("plan-day: no spindle speed was recorded; say the highest one with --speed")
    options = design.DesignOptions(highest_speed=top, hours=hours, noise=noise, standing=standing)
    days = [design.Plan(_stretches(t, v / top, options)) for t, v in recorded]
    proposed = design.propose(days, options)
    used = np.vstack([design.basis(p, options) for p in design.usage(options)])
    before = design.uncertainty(design.information(days, options), used)
    after = design.uncertainty(design.information([*days, proposed], options), used)
    worth = after < (1.0 - MIN_GAIN) * before and before > noise
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
    recording = manifest_folder.read(folder)
    name = recording.name("spindle_speed")
    if name is None:
        raise DataError(f"{folder}: the recording has neither an error with temperatures nor a spindle speed")
    run, t, v = recording.run_codes(), recording.time(), np.nan_to_num(recording.array(name))
    return [(t[run == r] - t[run == r][0], v[run == r]) for r in np.unique(run)], float(np.max(v, initial=0.0))


def _stretches(t: Any, share: Any, options: Any) -> tuple[float, ...]:
    """Mean speed of each stretch of a day; 0 (standing) where nothing was recorded."""
    which = np.minimum((t / options.segment).astype(int), options.segments - 1)
    return tuple(float(np.mean(share[which == k])) if np.any(which == k) else 0.0 for k in range(options.segments))
