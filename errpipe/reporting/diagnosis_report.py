"""The page of a diagnosis: the mismatch on one screen, what was found, who lost, what is left, what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from errpipe.domain.diagnosis import Diagnosis, Finding, ResponseDiagnosis
from errpipe.reporting import page, svg

VERDICTS = {
    "no_mismatch": "recording and simulation agree",
    "recalibrate": "the simulation needs other gains, no other physics",
    "missing_physics": "physics is missing",
    "unexplained": "something is there that has no name here",
}
LAGS = 40


@dataclass(frozen=True)
class Trace:
    """A response's rows for the figures, all of shape (rows,): mismatch before and after, in time order.

    carried: name of a finding -> its contribution on each row.
    """

    before: np.ndarray
    after: np.ndarray
    run: np.ndarray
    carried: Mapping[str, np.ndarray] = field(default_factory=dict)


def render(diagnosis: Diagnosis, traces: Sequence[Trace], *, machine: str = "", version: str = "") -> str:
    """The whole page as HTML text; equal input gives equal bytes."""
    blocks = [_block(r, t) for r, t in zip(diagnosis.responses, traces, strict=True)]
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
                return f"Measure next: {f.would_separate}."
    if any(r.verdict == "missing_physics" for r in diagnosis.responses):
        return "Next: add the findings to the error model, fit it, and diagnose again."
    if any(r.verdict == "unexplained" for r in diagnosis.responses):
        return "Next: look at the machine where and when the residual is largest; the data alone do not name the cause."
    return "Nothing more to do for this recording."


def _block(r: ResponseDiagnosis, trace: Trace) -> dict[str, Any]:
    return {
        "d": r,
        "verdict": VERDICTS[r.verdict],
        "findings": [_finding(f) for f in r.findings],
        "overview": _overview(r, trace),
        "rivals": _rivals(r),
        "located": _located(r),
        "left": _left(r, trace),
    }


def _finding(f: Finding) -> dict[str, Any]:
    where = [f"runs {', '.join(f.where.runs)}"] if f.where.runs else []
    where += [f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in f.where.ranges.items()]
    others = " or ".join(e.replace("_", " ") for e in f.indistinguishable_from)
    return {"d": f, "name": f.effect.replace("_", " "), "where": "; ".join(where) or "everywhere", "others": others}


def _overview(r: ResponseDiagnosis, trace: Trace) -> str:
    rows = svg.thin(trace.before.size)
    with svg.figure(7.2, 4.2, rows=2) as (canvas, axes):
        axes[0].plot(rows, trace.before[rows], ".", ms=2.5, color=svg.BEFORE, label="before")
        for name, values in trace.carried.items():
            axes[0].plot(rows, values[rows], "-", lw=1.0, color=svg.INK, label=name.replace("_", " "))
        axes[0].legend(loc="upper right", fontsize=8)
        axes[1].plot(rows, trace.after[rows], ".", ms=2.5, color=svg.AFTER, label="after")
        axes[1].sharey(axes[0])
        axes[1].legend(loc="upper right", fontsize=8)
        for a in axes:
            a.set_ylabel(f"{r.component} ({r.unit})")
            for edge in np.flatnonzero(np.diff(trace.run)) + 1 if np.unique(trace.run).size <= 12 else ():
                a.axvline(edge, color=svg.FLOOR, lw=0.4)
        axes[1].set_xlabel("row")
        return svg.to_svg(canvas, f"Mismatch of {r.component} before and after")


def _rivals(r: ResponseDiagnosis) -> str:
    named = [f for f in r.findings if f.rivals]
    if not named:
        return ""
    rivals = named[0].rivals
    with svg.figure(7.2, 0.6 + 0.28 * len(rivals)) as (canvas, axes):
        place = np.arange(len(rivals))[::-1]
        axes.barh(place, [max(v.lost_by, 0.0) + 0.5 for v in rivals], color=svg.FLOOR, height=0.6)
        axes.set_yticks(place, [v.effect.replace("_", " ") for v in rivals])
        axes.set_xscale("log")
        axes.axvline(4.0, color=svg.ALARM, lw=1.0)
        axes.set_xlabel(f"explains less than {named[0].effect.replace('_', ' ')} by (log Bayes factor)")
        return svg.to_svg(canvas, "Rivals of the first finding")


def _located(r: ResponseDiagnosis) -> str:
    parts = r.regimes[:24]
    if not parts:
        return ""
    with svg.figure(7.2, 0.8 + 0.24 * len(parts)) as (canvas, axes):
        place = np.arange(len(parts))[::-1]
        axes.barh(place + 0.2, [p.rms_before_um for p in parts], height=0.36, color=svg.BEFORE, label="before")
        axes.barh(place - 0.2, [p.rms_after_um for p in parts], height=0.36, color=svg.AFTER, label="after")
        axes.axvline(r.noise_floor_um, color=svg.FLOOR, lw=1.0, label="noise floor")
        axes.set_yticks(place, [p.what for p in parts], fontsize=8)
        axes.set_xlabel(f"rms ({r.unit})")
        axes.legend(fontsize=8)
        return svg.to_svg(canvas, f"Where the mismatch of {r.component} sits")


def _left(r: ResponseDiagnosis, trace: Trace) -> str:
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
        return svg.to_svg(canvas, f"What is left of {r.component}")
