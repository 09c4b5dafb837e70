"""The page of a diagnosis: mismatch, findings, alternatives, residual, what to measure next."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from errpipe.domain.diagnosis import ChangePoint, Diagnosis, Finding, ResponseDiagnosis, Rival
from errpipe.reporting import page, svg

VERDICTS = {
    "no_mismatch": "recording and simulation agree",
    "recalibrate": "the simulation needs other gains, no other physics",
    "missing_physics": "physics is missing",
    "unexplained": "something is there that has no name here",
}
LAGS = 40  # rows of an autocorrelation figure
MAX_SHAPES = 4  # findings drawn; the others are in the table only
# One colour for each finding; they differ in lightness too, and every line is labelled.
FINDINGS = ("#b3261e", "#1f5fa8", "#2e7d4f", "#7b3fa0", "#20262c")
UNNAMED = "a shape without a name"
HOW = ("level", "by run", "by direction", "Ljung-Box")


@dataclass(frozen=True)
class Trace:
    """A response's rows for the figures, all of shape (rows,): mismatch before and after, in time order.

    contributions: name of a finding -> its contribution on each row; inputs: column -> its value on each row;
    clock: the column with the time in s, '' if there is none; units: column -> its unit.
    """

    before: np.ndarray
    after: np.ndarray
    run: np.ndarray
    contributions: Mapping[str, np.ndarray] = field(default_factory=dict)
    inputs: Mapping[str, np.ndarray] = field(default_factory=dict)
    clock: str = ""
    units: Mapping[str, str] = field(default_factory=dict)

    def colours(self) -> dict[str, str]:
        """Name of a finding -> its colour in every figure of the response."""
        return dict(zip(self.contributions, itertools.cycle(FINDINGS), strict=False))

    def label(self, column: str) -> str:
        unit = self.units.get(column, "")
        return f"{column} in {unit}" if unit else column


def render(
    diagnosis: Diagnosis,
    traces: Sequence[Trace],
    *,
    machine: str = "",
    version: str = "",
    equations: Mapping[str, str] | None = None,
) -> str:
    """The whole page as HTML text; equal input gives equal bytes. equations: id of a term -> its equation."""
    blocks = [_block(r, t, equations or {}) for r, t in zip(diagnosis.responses, traces, strict=True)]
    data = {
        "title": diagnosis.recording or "Diagnosis",
        "machine": machine,
        "version": version,
        "responses": blocks,
        "notes": diagnosis.notes,
        "next_step": _next(diagnosis),
    }
    return page.render("diagnosis.html.j2", data)


def _next(diagnosis: Diagnosis) -> str:
    for r in diagnosis.responses:
        for f in r.findings:
            if f.would_separate and f.indistinguishable_from:
                return f"Next, to decide: {f.would_separate}."
    if any(r.verdict == "missing_physics" for r in diagnosis.responses):
        return (
            "Next: errpipe diagnose RECORDING --out DIR --apply FOLDER writes the simulation with what it lacks, as "
            "equations to add (patch.py, patch.fmu), and diagnoses again."
        )
    if any(r.verdict == "unexplained" for r in diagnosis.responses):
        return "Next: look at the machine where and when the residual is largest; the data alone do not name the cause."
    return "Nothing more to do for this recording."


def _block(r: ResponseDiagnosis, trace: Trace, equations: Mapping[str, str]) -> dict[str, Any]:
    return {
        "d": r,
        "verdict": VERDICTS[r.verdict],
        "findings": [_finding(f, equations) for f in r.findings],
        "overview": _overview(r, trace),
        "shape": _shape(r, trace),
        "rivals": [_rivals_of(f) for f in [f for f in r.findings if f.rivals][:2]],
        "located": _located(r),
        "largest_share": _largest_share(r) + _between_runs(r),
        "changes": [_change(c, r.unit) for c in r.changes],
        "tests": (tests := _tests(r)),
        "split": [how for how in ("by run", "by direction") if any(t["cells"][how] for t in tests)],
        "residual": _residual(r, trace),
    }


def _finding(f: Finding, equations: Mapping[str, str]) -> dict[str, Any]:
    where = [f"runs {', '.join(f.where.runs)}"] if f.where.runs else []
    where += [f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in f.where.ranges.items()]
    shown = f.parameters
    if f.effect == "recalibration":  # only parameters whose interval excludes 0
        shown = tuple(p for p in f.parameters if not p.ci95[0] <= 0 <= p.ci95[1])
    return {
        "d": f,
        "name": f.effect.replace("_", " "),
        "where": "; ".join(where) or "everywhere",
        "others": _listed(f.indistinguishable_from),
        "doubts": _doubts(f),
        "equations": list(dict.fromkeys(e for t in f.all_terms() if (e := equations.get(str(t["term"]))))),
        "parameters": shown,
        "hidden": len(f.parameters) - len(shown),
    }


def _listed(effects: Sequence[str]) -> str:
    return " or ".join(e.replace("_", " ") for e in effects)


def _doubts(f: Finding) -> str:
    """What else it may be: effects nearly as likely, and effects of the same form, which fit the data less well."""
    lost = {v.effect: v.lost_by for v in reversed(f.rivals)}
    alike = [e for e in f.indistinguishable_from if lost.get(e, 0.0) >= Rival.CLOSE]
    close = [e for e in f.indistinguishable_from if e not in alike]
    says = f" These data cannot distinguish it from {_listed(close)}." if close else ""
    if alike:
        least = page.number(min(lost[e] for e in alike))
        says += f" {_listed(alike).capitalize()} has nearly the same form, but fits worse (log Bayes factor {least})."
    return says


def _change(c: ChangePoint, unit: str) -> str:
    what = "mean" if c.what == "level" else "spread"
    return f"at {c.column} = {c.at:.5g} its {what} changes from {c.before_um:.3g} to {c.after_um:.3g} {unit}"


def _largest_share(r: ResponseDiagnosis) -> str:
    """The part of the recording with the largest share of the mismatch for its size."""
    rows = max((p.rows for p in r.regimes), default=0)
    shared = [p for p in r.regimes if p.share is not None]
    if not shared:
        return "No part of the recording has a mismatch above the noise."
    total = max(r.significance.rows if r.significance else rows, 1)
    top = max(shared, key=lambda p: (p.share or 0.0) - p.rows / total)
    if (top.share or 0.0) < 1.25 * top.rows / total:
        return "It is spread evenly over the recording: no part has much more than its share of rows."
    share, part = f"{top.share:.0%}", f"{top.rows / total:.0%}"
    return f"Most for its size: {top.what}, with {share} of the energy beyond the noise in {part} of the rows."


def _between_runs(r: ResponseDiagnosis) -> str:
    if r.between_runs is None or r.between_runs < 0.3:
        return ""
    return f" {r.between_runs:.0%} of it is one offset per run."


def _tests(r: ResponseDiagnosis) -> list[dict[str, Any]]:
    """One line per input: level, by run, by direction; the strongest first."""
    if r.whiteness is None:
        return []
    lines: dict[str, dict[str, Any]] = {}
    for t in r.whiteness.tests:
        how = "by direction" if t.how.startswith("by direction") else t.how
        line = lines.setdefault(t.against, {"against": t.against, "cells": dict.fromkeys(HOW)})
        known = line["cells"][how]
        if known is None or t.p < known.p:
            line["cells"][how] = t
    for line in lines.values():
        line["p"] = min(t.p for t in line["cells"].values() if t is not None)
        line["alarm"] = line["p"] * len(r.whiteness.tests) < 0.01
    return sorted(lines.values(), key=lambda line: line["p"])


def _overview(r: ResponseDiagnosis, trace: Trace) -> str:
    """Mismatch against time, the contribution of each finding in its own colour, and the residual."""
    rows = svg.thin(trace.before.size)
    label, x = _clock(trace)
    with svg.figure(7.2, 4.2, rows=2) as (canvas, axes):
        axes[0].plot(x[rows], trace.before[rows], ".", ms=2.5, color=svg.FLOOR, label="recorded minus simulated")
        for name, colour in trace.colours().items():
            values = trace.contributions[name]
            line, text = svg.with_gaps(x[rows], values[rows], trace.run[rows]), _finding_label(name, values, r.unit)
            axes[0].plot(*line, lw=1.4, color=colour, label=text)
        axes[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=8, markerscale=3)
        axes[1].plot(x[rows], trace.after[rows], ".", ms=2.5, color=svg.AFTER, label="after")
        axes[1].sharey(axes[0])
        axes[1].legend(loc="upper right", fontsize=8)
        for a in axes:
            a.set_ylabel(f"{r.component} ({r.unit})")
            for edge in np.flatnonzero(np.diff(trace.run)) + 1 if np.unique(trace.run).size <= 12 else ():
                a.axvline(x[edge], color=svg.FLOOR, lw=0.4)
            for c in r.changes if a is axes[0] else ():
                if c.column in trace.inputs:
                    place = int(np.argmax(trace.inputs[c.column] >= c.at))
                    a.axvline(x[place], color=svg.ALARM, lw=1.2, ls="--")
        axes[1].set_xlabel(label)
        return svg.to_svg(canvas, f"Mismatch of {r.component} against time, with the contribution of each finding")


def _finding_label(name: str, values: np.ndarray, unit: str) -> str:
    """A finding's name and the rms of what it contributes."""
    text = UNNAMED if name == "unknown" else name.replace("_", " ")
    return f"{text}, {float(np.std(values)):.3g} {unit} rms"


def _clock(trace: Trace) -> tuple[str, np.ndarray]:
    """Label and values of the horizontal axis: time in s, runs that overlap one after the other; without it the row."""
    t = trace.inputs.get(trace.clock)
    if t is None or not np.isfinite(t).all() or not np.ptp(t):
        return "row", np.arange(trace.before.size, dtype=float)
    back = np.flatnonzero(np.diff(t) < 0)
    if not back.size:
        return svg.in_hours(f"{trace.clock} in s", t)
    forward = np.diff(t)
    pause = float(np.median(forward[forward > 0])) if (forward > 0).any() else 1.0
    shift = np.zeros(t.size)
    shift[back + 1] = pause - forward[back]
    return f"{trace.clock} in s, runs one after the other", t + np.cumsum(shift)


def _shape(r: ResponseDiagnosis, trace: Trace) -> str:
    """Each finding in its colour against its driver, over what is recorded once the other findings are taken away."""
    own = [f for f in r.findings if f.effect in trace.contributions]
    drawn = [(f, x) for f in own for x in [_against(f, trace)] if x][:MAX_SHAPES]
    if not drawn:
        return ""
    rows, colours = svg.thin(trace.before.size), trace.colours()
    across = min(len(drawn), 2)
    down = -(-len(drawn) // across)
    with svg.figure(7.2, 2.8 * down, rows=down, columns=across) as (canvas, axes):
        every = np.atleast_1d(axes).ravel()
        for a, (f, name) in zip(every, drawn, strict=False):
            x, fitted = trace.inputs[name][rows], trace.contributions[f.effect][rows]
            text = _finding_label(f.effect, trace.contributions[f.effect], r.unit)
            a.plot(x, trace.after[rows] + fitted, ".", ms=2.5, color=svg.FLOOR, label="recorded, the others removed")
            a.plot(x, fitted, ".", ms=2.0, color=colours[f.effect], label=text)
            a.set_xlabel(trace.label(name))
            a.set_ylabel(f"{r.component} ({r.unit})")
            a.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8, markerscale=3)
        for a in every[len(drawn) :]:
            a.set_visible(False)
        return svg.to_svg(canvas, f"Contribution of each finding to {r.component}, against its driver")


def _against(f: Finding, trace: Trace) -> str:
    """The driver with most different values; a direction is shown along the axis, a lag along time."""
    own = [n for n in f.drivers if n in trace.inputs]
    many = [n for n in own if np.unique(trace.inputs[n]).size > 2]
    if not many:
        return next((n for n in trace.inputs if np.unique(trace.inputs[n]).size > 2), "")
    return max(many, key=lambda n: np.unique(trace.inputs[n]).size)


def _rivals_of(f: Finding) -> str:
    with svg.figure(7.2, 0.7 + 0.24 * len(f.rivals)) as (canvas, axes):
        place = np.arange(len(f.rivals))[::-1]
        lost = [max(v.lost_by, 0.0) for v in f.rivals]
        axes.barh(place, lost, color=svg.FLOOR, height=0.6)
        axes.set_yticks(place, [v.effect.replace("_", " ") for v in f.rivals], fontsize=8)
        axes.set_xscale("symlog", linthresh=1.0)
        axes.set_xlim(0.0, 3 * max(*lost, 20.0))
        for y, v, end in zip(place, f.rivals, lost, strict=True):
            beside = {"xytext": (4, 0), "textcoords": "offset points", "va": "center", "fontsize": 8}
            axes.annotate(page.number(v.lost_by), (end, y), **beside)
        axes.axvline(Rival.CLOSE, color=svg.ALARM, lw=1.0)
        axes.set_xlabel(f"explains less than {f.effect.replace('_', ' ')} by (log Bayes factor)")
        return svg.to_svg(canvas, f"Rivals of {f.effect.replace('_', ' ')}")


def _located(r: ResponseDiagnosis) -> str:
    parts = r.regimes[:24]
    if not parts:
        return ""
    with svg.figure(7.2, 0.9 + 0.19 * len(parts)) as (canvas, axes):
        place = np.arange(len(parts))[::-1]
        before, after = [p.rms_before_um for p in parts], [p.rms_after_um for p in parts]
        axes.hlines(place, after, before, color=svg.FLOOR, lw=0.8)
        axes.plot(before, place, "o", ms=4, color=svg.BEFORE, label="before")
        axes.plot(after, place, "o", ms=4, color=svg.AFTER, label="after")
        axes.axvline(r.noise_floor_um, color=svg.FLOOR, lw=1.0, ls=":", label="noise floor")
        axes.set_yticks(place, [p.what for p in parts], fontsize=8)
        axes.set_ylim(-0.7, len(parts) - 0.3)
        most = max(*before, *after, r.noise_floor_um)
        axes.set_xlim(0, 1.18 * most)
        for y, p in zip(place, parts, strict=True):
            if p.share is not None:
                axes.text(1.17 * most, y, f"{p.share:.0%}", va="center", ha="right", fontsize=8)
        axes.set_xlabel(f"rms ({r.unit}); right: share of the mismatch's energy beyond the noise")
        canvas.legend(loc="outside upper right", ncols=3, fontsize=8)
        return svg.to_svg(canvas, f"Mismatch of {r.component} by part of the recording")


def _residual(r: ResponseDiagnosis, trace: Trace) -> str:
    left = trace.after - trace.after.mean()
    power = float(left @ left) or 1.0
    lags = np.arange(1, min(LAGS, left.size // 3) + 1)
    rho = np.array([float(left[k:] @ left[:-k]) / power for k in lags])
    with svg.figure(7.2, 2.6, columns=2) as (canvas, axes):
        axes[0].hist(trace.after, bins=40, color=svg.AFTER)
        axes[0].set_xlabel(f"residual ({r.unit})")
        axes[1].bar(lags, rho, color=svg.AFTER, width=0.8)
        band = 2.0 / np.sqrt(left.size)
        axes[1].axhspan(-band, band, color=svg.FLOOR, alpha=0.25, lw=0)
        axes[1].set_xlabel("rows apart")
        axes[1].set_ylabel("autocorrelation")
        return svg.to_svg(canvas, f"Residual of {r.component}")
