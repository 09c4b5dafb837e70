"""The chart of ISO 230-2: mean deviation in both directions with bands of 2 s; A, R, E and B marked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from errpipe.reporting import svg

DIRECTIONS = (("up", svg.AFTER, "from below"), ("down", svg.BEFORE, "from above"))


def chart(figures: Mapping[str, Any], after: Mapping[str, Any] | None = None) -> str:
    """The figure as SVG text. figures, after: `validation.iso230_2.Report` as plain values, before and after."""
    panels = [("measured", figures)] + ([] if after is None else [("predicted after compensation, held out", after)])
    length = "deg" if figures["unit"] == "urad" else "mm"
    with svg.figure(7.2, 3.3 * len(panels), rows=len(panels)) as (canvas, subplots):
        for axes, (heading, report) in zip(np.atleast_1d(subplots), panels, strict=True):
            _panel(axes, report)
            axes.set_title(_heading(heading, report), fontsize=10, loc="left")
            axes.set_ylabel(f"deviation in {report['unit']}")
        axes.set_xlabel(f"position of {figures['axis']} in {length}")
        return svg.to_svg(canvas, f"ISO 230-2 chart of {figures['component']}")


def _heading(heading: str, report: Mapping[str, Any]) -> str:
    known = [f"{name} {report[name]:.3g}" for name in ("A", "R", "E", "B") if report.get(name) is not None]
    return f"{heading}: {', '.join(known)} {report['unit']}" if known else heading


def _panel(axes: Any, report: Mapping[str, Any]) -> None:
    lowest, highest = [], []
    for name, colour, label in DIRECTIONS:
        side = report.get(name)
        if side is None:
            continue
        x, mean, s = (np.asarray(side[key], dtype=float) for key in ("targets", "mean", "s"))
        axes.fill_between(x, mean - 2 * s, mean + 2 * s, color=colour, alpha=0.2, lw=0, label=f"±2s {label}")
        axes.plot(x, mean, "o-", color=colour, ms=3, lw=1.3, label=f"mean {label}")
        lowest.append(float(np.min(mean - 2 * s)))
        highest.append(float(np.max(mean + 2 * s)))
    if report.get("A") is not None and lowest:
        for value in (min(lowest), max(highest)):
            axes.axhline(value, color=svg.INK, lw=0.8, ls="--")
        axes.annotate(
            "",
            xy=(1.01, max(highest)),
            xytext=(1.01, min(lowest)),
            xycoords=("axes fraction", "data"),
            arrowprops={"arrowstyle": "<->", "color": svg.INK},
            annotation_clip=False,
        )
        axes.text(1.02, (max(highest) + min(lowest)) / 2, "A", transform=axes.get_yaxis_transform(), va="center")
    reversal = report.get("B_i")
    if reversal is not None and report.get("up") is not None:
        k = int(np.argmax(np.abs(reversal)))
        x = report["targets"][k]
        ends = [report[name]["mean"][k] for name in ("up", "down")]
        axes.plot([x, x], ends, color=svg.ALARM, lw=2)
        axes.annotate("B", (x, float(np.mean(ends))), color=svg.ALARM, xytext=(4, 0), textcoords="offset points")
    axes.axhline(0.0, color=svg.FLOOR, lw=0.6)
    axes.legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.1))
