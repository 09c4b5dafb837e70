"""The figure of `errpipe compare`: the difference of each response over the input that it goes with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from errpipe.reporting import svg

if TYPE_CHECKING:
    from errpipe.validation.changes import Change

MAX_PANELS = 12  # of one figure: a page


def draw(changes: Sequence[tuple[str, Change]]) -> str:
    """SVG: mean of new less old in parts of the input's range, and the band from its least to its largest value."""
    shown = [(name, c) for name, c in changes if c.by_bin][:MAX_PANELS]
    with svg.figure(7.2, 2.4 * max(len(shown), 1), max(len(shown), 1)) as (canvas, axes):
        for panel, (name, c) in zip(np.atleast_1d(axes), shown, strict=False):
            at, mean, least, most = np.array(c.by_bin).T
            panel.fill_between(at, least, most, color=svg.FLOOR, alpha=0.25, linewidth=0, label="least to largest")
            panel.plot(at, mean, "o-", color=svg.AFTER, markersize=3, label="mean")
            panel.axhline(0.0, color=svg.INK, linewidth=0.8)
            panel.set_xlabel(c.goes_with)
            panel.set_ylabel(f"{name}: new - old, {c.unit}")
            panel.legend(fontsize=8)
        if not shown:
            axes.text(0.5, 0.5, "no compensation differs", ha="center", va="center")
            axes.set_axis_off()
        return svg.to_svg(canvas, "What changed")
