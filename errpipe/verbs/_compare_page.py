"""The figure of `errpipe compare`: the difference of each response over the input that it goes with, and findings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from errpipe.reporting import svg

if TYPE_CHECKING:
    from errpipe.validation.changes import Change

MAX_PANELS = 12  # of one figure: a page


def draw(changes: Sequence[tuple[str, Change]], findings: Sequence[tuple[str, float, float]] = ()) -> str:
    """SVG: mean of new less old in parts of the input's range, and the band from its least to its largest value.

    findings: name, size before and after, um rms: a panel of bars below.
    """
    shown = [(name, c) for name, c in changes if c.by_bin and c.largest > 0.0][:MAX_PANELS]
    panels = max(len(shown) + bool(findings), 1)
    with svg.figure(7.2, 2.4 * panels, panels) as (canvas, axes):
        axes = np.atleast_1d(axes)
        for panel, (name, c) in zip(axes, shown, strict=False):
            at, mean, lowest, highest = np.array(c.by_bin).T
            panel.fill_between(at, lowest, highest, color=svg.FLOOR, alpha=0.25, linewidth=0, label="least to largest")
            panel.plot(at, mean, "o-", color=svg.AFTER, markersize=3, label="mean")
            panel.axhline(0.0, color=svg.INK, linewidth=0.8)
            panel.set_xlabel(c.goes_with)
            panel.set_title(name, fontsize=8, loc="left")
            panel.set_ylabel(f"new - old, {c.unit}")
            panel.legend(fontsize=8)
        if findings:
            names, before, after = zip(*findings, strict=True)
            at = np.arange(len(names))
            axes[-1].barh(at - 0.2, before, 0.4, color=svg.BEFORE, label="old")
            axes[-1].barh(at + 0.2, after, 0.4, color=svg.AFTER, label="new")
            axes[-1].set_yticks(at, names)
            axes[-1].invert_yaxis()
            axes[-1].set_xlabel("size of the finding, um rms")
            axes[-1].legend(fontsize=8)
        elif not shown:
            axes[0].text(0.5, 0.5, "no difference", ha="center", va="center")
            axes[0].set_axis_off()
        return svg.to_svg(canvas, "What changed")
