"""Figures of held-out rows: a warm-up against time with its prediction, a plane before and after, what readings buy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.reporting import svg

GAP = 20.0  # median steps of time: a longer pause breaks the line
FLOOR_ROW = "noise floor"  # row of a grid that does not compete
PANELS = 3  # groups drawn: the one that is predicted worst, then those with most rows


def against_time(
    time: np.ndarray,
    deviation: np.ndarray,
    predicted: np.ndarray,
    groups: Sequence[str],
    band: Mapping[str, float],
    component: str,
    unit: str,
) -> str:
    """Left-out groups over time as SVG text: what was measured, what was predicted, and the band of 90 %.

    time in s; deviation, predicted, band in `unit`; one row each, shape (rows,). band: half of its
    width by group, where it is known.
    """
    labels = np.asarray(groups)
    chosen = _worth_seeing(labels, deviation - predicted)
    with svg.figure(7.2, 2.3 * len(chosen) + 0.3, rows=len(chosen)) as (canvas, subplots):
        for axes, label in zip(np.atleast_1d(subplots), chosen, strict=True):
            (own,) = np.nonzero((labels == label) & np.isfinite(time) & np.isfinite(deviation) & np.isfinite(predicted))
            own = own[np.argsort(time[own], kind="stable")]
            own = own[svg.thin(own.size)]
            hours, y = (time[own] - time[own[:1]]) / 3600.0, predicted[own].copy()
            steps = np.diff(hours)
            if steps.size:
                y[1:][steps > GAP * np.median(steps)] = np.nan
            if label in band:
                axes.fill_between(
                    hours, y - band[label], y + band[label], color=svg.AFTER, alpha=0.18, lw=0, label="90 % band"
                )
            axes.plot(hours, deviation[own], ".", ms=3, color=svg.BEFORE, label="measured")
            axes.plot(hours, y, "-", lw=1.4, color=svg.AFTER, label="predicted, held out")
            axes.set_title(f"left out: {label}", loc="left", fontsize=9)
            axes.set_ylabel(f"{component} in {unit}")
        np.atleast_1d(subplots)[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8)
        np.atleast_1d(subplots)[-1].set_xlabel("time since the first row shown, in h")
        return svg.to_svg(canvas, f"{component} against time, held out")


def _worth_seeing(labels: np.ndarray, left: np.ndarray) -> list[str]:
    names = list(dict.fromkeys(labels.tolist()))
    rms = {n: float(np.sqrt(np.nanmean(left[labels == n] ** 2))) for n in names}
    rows = {n: int(np.count_nonzero(labels == n)) for n in names}
    worst = max(names, key=lambda n: rms[n])
    rest = sorted((n for n in names if n != worst), key=lambda n: -rows[n])
    return [worst, *rest[: PANELS - 1]]


def plane(
    places: tuple[np.ndarray, np.ndarray], axes_named: tuple[str, str], panels: dict[str, np.ndarray], unit: str
) -> str:
    """Values at points of a plane as SVG text, all panels in one scale of colours that is 0 in its middle.

    places: the two coordinates in mm, shape (rows,); panels: heading -> values (rows,) in `unit`; readings at one place
    are averaged.
    """
    at, back = np.unique(np.round(np.column_stack(places), 3), axis=0, return_inverse=True)
    count = np.bincount(back)
    means = {name: np.bincount(back, weights=np.nan_to_num(v)) / count for name, v in panels.items()}
    top = max(float(np.abs(v).max()) for v in means.values()) or 1.0
    spacing = np.sqrt(np.prod(np.ptp(at, axis=0)) / max(len(at), 1))
    size = max(9.0, (3.0 * 72 * spacing / max(np.ptp(at[:, 0]), 1e-9)) ** 2 * 0.6)
    with svg.figure(7.2, 3.4, columns=len(panels)) as (canvas, subplots):
        for axes, (name, values) in zip(np.atleast_1d(subplots), means.items(), strict=True):
            drawn = axes.scatter(at[:, 0], at[:, 1], c=values, s=size, marker="s", cmap="PuOr", vmin=-top, vmax=top)
            rms = np.sqrt(np.mean(panels[name][np.isfinite(panels[name])] ** 2))
            axes.set_title(f"{name}: {rms:.3g} {unit} rms", loc="left", fontsize=9)
            axes.set_xlabel(f"{axes_named[0]} in mm")
            axes.set_ylabel(f"{axes_named[1]} in mm")
            axes.set_aspect("equal", adjustable="datalim")
            axes.grid(visible=False)
        canvas.colorbar(drawn, ax=list(np.atleast_1d(subplots)), label=unit, shrink=0.7)
        return svg.to_svg(canvas, f"{', '.join(panels)} over {' and '.join(axes_named)}")


def by_readings(levels: Sequence[Mapping[str, Any]], component: str, unit: str) -> str:
    """Residual of each held-out group against readings per shift, with the model and with readings only; SVG text.

    levels: `readings.levels` of a component of `validation.json`; at most `PANELS` groups, the worst first.
    """
    groups = sorted(levels[0]["groups"], key=lambda g: -g["rms"])[:PANELS]
    places = np.arange(len(levels))
    with svg.figure(7.2, 3.0, columns=len(groups)) as (canvas, subplots):
        cells = np.atleast_1d(subplots)
        for axes, group in zip(cells, groups, strict=True):
            own = [next(g for g in level["groups"] if g["label"] == group["label"]) for level in levels]
            axes.plot(places, [g["rms_readings_alone"] for g in own], "s--", color=svg.BEFORE, label="readings alone")
            axes.plot(places, [g["rms"] for g in own], "o-", color=svg.AFTER, label="model and readings")
            axes.set_title(f"left out: {group['label']}", loc="left", fontsize=9)
            axes.set(xticks=places, xticklabels=[str(level["per_shift"]) for level in levels])
            axes.set_xlabel("readings per shift")
            axes.set_ylim(bottom=0)
        cells[0].set_ylabel(f"{component}, rms in {unit}")
        cells[0].legend(fontsize=8)
        return svg.to_svg(canvas, f"{component} against readings per shift, held out")


def grid(
    columns: Sequence[str], rows: Sequence[str], values: Any, remarks: Sequence[str], best: str, title: str
) -> str:
    """Figures of rows by columns as SVG text: shaded by their share of the first row, the least of a column bold.

    values: (rows, columns), None if there is none. best: the row that is used, framed.
    """
    table = np.array([[np.nan if v is None else float(v) for v in row] for row in values])
    share = np.log10(np.clip(table / np.where(table[:1] > 0, table[:1], 1.0), 1e-2, 10.0))
    share[[k for k, name in enumerate(rows) if name == FLOOR_ROW]] = np.nan
    with svg.figure(7.2, 0.32 * len(rows) + 1.2) as (canvas, axes):
        axes.imshow(share, cmap="PuOr_r", vmin=-2.5, vmax=2.5, aspect="auto")
        compared = [k for k, name in enumerate(rows) if k and name not in (best, FLOOR_ROW)]
        for j in range(table.shape[1]):
            least = min(compared, key=lambda k: np.nan_to_num(table[k, j], nan=np.inf), default=-1)
            for i in range(table.shape[0]):
                text = "–" if np.isnan(table[i, j]) else f"{table[i, j]:.3g}"
                weight = "bold" if i == least else "normal"
                axes.text(j, i, text, ha="center", va="center", fontsize=8, color=svg.INK, weight=weight)
        frame = list(rows).index(best)
        axes.add_patch(_frame(frame, table.shape[1]))
        for i, remark in enumerate(remarks):
            axes.text(table.shape[1] - 0.45, i, remark, ha="left", va="center", fontsize=8, color=svg.INK)
        axes.set(xticks=range(len(columns)), yticks=range(len(rows)), xlim=(-0.5, table.shape[1] + 0.6))
        axes.set_xticklabels([c.replace(" ", "\n") for c in columns], fontsize=8)
        axes.set_yticklabels(rows, fontsize=8)
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.grid(visible=False)
        for side in axes.spines.values():
            side.set_visible(False)
        return svg.to_svg(canvas, title)


def _frame(row: int, width: int) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((-0.5, row - 0.5), width, 1.0, fill=False, lw=1.6, edgecolor=svg.AFTER)
