"""The page a pipeline run ends with: its input, its model, and the held-out figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from errpipe.reporting import page, run_figures, svg

MOST_INPUTS, BINS = 9, 12  # inputs in a figure; means along each
LONG = 3 * 86400.0  # s; a longer recording is mostly pauses and is drawn by row number


@dataclass(frozen=True)
class Response:
    """One response on held-out rows: held-out in the choice and the fit of the model that predicts it.

    deviation, predicted: shape (rows,), in `unit`; groups: label of the left-out group per row;
    inputs: label with unit -> values, shape (rows,), the most important first; time: s, where a thermal run is drawn
    against it; band: half the width of the 90 % interval by left-out group; plane: axis -> mm, where the response is a
    map over two axes; meaning: the component in words.
    """

    component: str
    unit: str
    deviation: np.ndarray
    predicted: np.ndarray
    groups: Sequence[str]
    inputs: Mapping[str, np.ndarray]
    rms_before: float
    rms_after: float
    noise_floor: float | None
    terms: Sequence[Mapping[str, Any]] = ()
    table: Sequence[Mapping[str, Any]] = ()
    scheme: str = ""
    notes: Sequence[str] = ()
    time: np.ndarray | None = None
    band: Mapping[str, float] = field(default_factory=dict)
    plane: Mapping[str, np.ndarray] = field(default_factory=dict)
    meaning: str = ""

    @property
    def decimals(self) -> int:
        """Decimals of a table of this response: three significant digits of the largest residual."""
        largest = max((row["rms_after"] for row in self.table), default=self.rms_after)
        return max(0, 2 - math.floor(math.log10(largest))) if 0 < largest < math.inf else 0


@dataclass(frozen=True)
class Table:
    """An additional table: rows start with a label, the rest are numbers (None: a dash)."""

    heading: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""


@dataclass(frozen=True)
class RunReport:
    """Content of the page. `sources`, `removed`, `validity`, `exported`: rows of plain values."""

    title: str
    machine: str
    version: str
    fingerprint: str
    set_up: Sequence[str] = ()  # date, serial number, operator, instrument, where the recording has them
    sources: Sequence[Mapping[str, Any]] = ()
    removed: Sequence[Mapping[str, Any]] = ()
    responses: Sequence[Response] = ()
    validity: Sequence[Mapping[str, Any]] = ()
    exported: Sequence[Mapping[str, Any]] = ()
    extra_figures: Sequence[tuple[str, str, str]] = ()  # heading, SVG, caption
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    next_step: str = ""
    warning: str = ""  # what must be checked at the machine before anything is loaded
    refusal: str = ""  # why a gate refused the export; empty where it did not
    consequences: Sequence[str] = ()  # what the exported correction does, one sentence an axis


def render(report: RunReport) -> str:
    """The whole page as HTML text."""
    blocks = [
        {
            "response": r,
            "before_after": before_after(r),
            "groups": by_group(r) if len(r.table) > 1 else "",
            "residuals": residuals(r),
            "time": run_figures.against_time(r.time, r.deviation, r.predicted, r.groups, r.band, r.component, r.unit)
            if r.time is not None
            else "",
            "plane": _over_plane(r) if r.plane else "",
        }
        for r in report.responses
    ]
    return page.render("run.html.j2", {"title": report.title or "errpipe run", "report": report, "blocks": blocks})


def _over_plane(r: Response) -> str:
    (a, x), (b, y) = r.plane.items()
    panels = {f"{r.component} uncompensated": r.deviation, "residual, held out": r.deviation - r.predicted}
    return run_figures.plane((x, y), (a, b), panels, r.unit)


def before_after(r: Response) -> str:
    """Deviation and residual over the most important input."""
    label, x = next(iter(r.inputs.items()), ("row", np.arange(r.deviation.size, dtype=float)))
    if label.endswith(" in s") and np.ptp(x) > LONG:
        label, x = "row, in order of time", np.arange(r.deviation.size, dtype=float)
    label, x = svg.in_hours(label, x)
    rows = svg.thin(r.deviation.size)
    with svg.figure(7.2, 3.2) as (canvas, axes):
        axes.plot(x[rows], r.deviation[rows], ".", ms=3, color=svg.BEFORE, label="uncompensated", alpha=0.75)
        left = r.deviation - r.predicted
        axes.plot(x[rows], left[rows], ".", ms=3, color=svg.AFTER, label="residual, held out", alpha=0.75)
        if r.noise_floor:
            axes.axhspan(-r.noise_floor, r.noise_floor, color=svg.FLOOR, alpha=0.18, lw=0, label="noise floor, ±1 rms")
        axes.set(xlabel=label, ylabel=f"{r.component} deviation in {r.unit}")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, markerscale=3)
        return svg.to_svg(canvas, f"{r.component} uncompensated and residual on held-out rows")


def by_group(r: Response) -> str:
    """One pair of bars per left-out group."""
    names = [str(row["group"]) for row in r.table]
    height = max(1.6, 0.34 * len(names) + 0.9)
    with svg.figure(7.2, min(height, 9.0)) as (canvas, axes):
        y = np.arange(len(names))
        axes.barh(y - 0.19, [row["rms_before"] for row in r.table], 0.36, color=svg.BEFORE, label="uncompensated")
        axes.barh(y + 0.19, [row["rms_after"] for row in r.table], 0.36, color=svg.AFTER, label="residual, held out")
        if r.noise_floor:
            axes.axvline(r.noise_floor, color=svg.FLOOR, ls="--", lw=1, label="noise floor")
        axes.set(yticks=y, yticklabels=names, xlabel=f"rms in {r.unit}", ylabel="held out")
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        return svg.to_svg(canvas, f"{r.component} rms by left-out group")


def residuals(r: Response) -> str:
    """Held-out residual against every input: structure here is missing physics."""
    varied = [(label, x) for label, x in r.inputs.items() if np.unique(x[np.isfinite(x)]).size > 1]
    chosen = [svg.in_hours(label, x) for label, x in varied[:MOST_INPUTS]]
    if not chosen:
        return ""
    columns = min(3, len(chosen))
    lines = -(-len(chosen) // columns)
    left = r.deviation - r.predicted
    rows = svg.thin(left.size, 600)
    with svg.figure(7.2, 2.1 * lines, lines, columns) as (canvas, grid):
        cells = np.atleast_1d(grid).ravel()
        for axes, (label, x) in zip(cells, chosen, strict=False):
            axes.plot(x[rows], left[rows], ".", ms=2.5, color=svg.AFTER, alpha=0.6)
            _trend(axes, x, left)
            axes.set_xlabel(label, fontsize=8)
            axes.tick_params(labelsize=7)
        for axes in cells[len(chosen) :]:
            axes.set_axis_off()
        cells[0].set_ylabel(f"residual in {r.unit}", fontsize=8)
        return svg.to_svg(canvas, f"{r.component} held-out residual against every input")


def _trend(axes: Any, x: np.ndarray, y: np.ndarray) -> None:
    """Means of equal shares of the rows: a flat line means no remaining dependence."""
    good = np.isfinite(x) & np.isfinite(y)
    if good.sum() < 4 * BINS or np.ptp(x[good]) == 0:
        return
    order = np.argsort(x[good], kind="stable")
    parts = np.array_split(order, BINS)
    axes.plot([x[good][p].mean() for p in parts], [y[good][p].mean() for p in parts], color=svg.INK, lw=1.2)
