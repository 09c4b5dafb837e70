"""What any file of errpipe is, with a text plot for work over ssh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.domain import components
from errpipe.stages import _artefacts
from errpipe.verbs.whatis import controller_curves, whatis

WIDTH, HEIGHT = 64, 12  # characters: fits 80 columns with its labels


def show(file: Path) -> dict[str, Any]:
    """The facts of `whatis`, and a plot where the file holds a curve. Raises DataError for any other file."""
    facts = whatis(file)
    lines = [f"{key}: {_short(value)}" for key, value in facts.items() if key != "says"]
    return {**facts, "says": [*lines, *_plot_of(Path(file), str(facts["kind"]))]}


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k}: {_short(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_short, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _plot_of(file: Path, kind: str) -> list[str]:
    if kind == "recording":
        return _recording(file)
    if kind == "compensation table":
        return _table(file)
    curves = controller_curves(file)[0][1][:2] if kind == "controller file" else []
    return [line for c in curves for line in _correction_plot(c)]


def _correction_plot(curve: Any) -> list[str]:
    """A correction over positions, from both sides."""
    unit, scale = ("arcsec", 3600.0) if components.is_rotary(curve.axis) else ("um", 1e3)
    heading = f"correction of {curve.axis} in {unit} over {curve.over}: + from below, - from above, * both"
    sides = [("+", curve.positions, scale * curve.up), ("-", curve.positions, scale * curve.down)]
    return ["", heading, *plot(sides)]


def _recording(file: Path) -> list[str]:
    from errpipe.formats import manifest_folder

    recording = manifest_folder.read(file)
    out: list[str] = []
    for name in recording.names("error")[:2]:
        component = components.parse(str(recording.manifest.columns[name].component))
        place = recording.name("command", axis=component.axis) or recording.name("position", axis=component.axis)
        place = place or recording.name("time")
        x = recording.array(place) if place else [float(i) for i in range(len(recording))]
        unit = recording.manifest.columns[name].unit
        out += ["", f"{name} in {unit} over {place or 'the row'}", *plot([("*", x, recording.array(name))])]
    return out


def _table(file: Path) -> list[str]:
    from errpipe.stages._plausible import UNBOUNDED
    from errpipe.targets import _sample

    table = _artefacts.read_table(file)
    out: list[str] = []
    for axis in list(_sample.outputs_by_axis(table))[:2]:
        for over in _sample.axes_own_first(table, axis)[:1]:
            if _sample.span(table, over) == UNBOUNDED:
                continue
            places = np.linspace(*_sample.span(table, over), 4 * WIDTH)
            out += _correction_plot(_sample.curve(table, axis, over, places))
    return out


def plot(curves: Sequence[tuple[str, Any, Any]]) -> list[str]:
    """Curves (mark, x, y) as lines of text, at most 80 characters wide; points that coincide are `*`."""
    points = [(mark, np.asarray(x, dtype=float), np.asarray(y, dtype=float)) for mark, x, y in curves]
    points = [(m, x[np.isfinite(x) & np.isfinite(y)], y[np.isfinite(x) & np.isfinite(y)]) for m, x, y in points]
    if not any(x.size for _, x, _ in points):
        return ["(no values)"]
    left, right = (f(np.concatenate([x for _, x, _ in points])) for f in (np.min, np.max))
    low, high = (f(np.concatenate([y for *_, y in points])) for f in (np.min, np.max))
    cells = [[" "] * WIDTH for _ in range(HEIGHT)]
    for mark, x, y in points:
        across = np.clip(((x - left) / ((right - left) or 1.0) * (WIDTH - 1)).round().astype(int), 0, WIDTH - 1)
        down = np.clip(((high - y) / ((high - low) or 1.0) * (HEIGHT - 1)).round().astype(int), 0, HEIGHT - 1)
        for i, j in zip(down, across, strict=True):
            cells[i][j] = mark if cells[i][j] in (" ", mark) else "*"
    labels = {0: f"{high:.4g}", HEIGHT - 1: f"{low:.4g}"}
    lines = [f"{labels.get(i, ''):>10} |{''.join(row).rstrip()}" for i, row in enumerate(cells)]
    foot = f"{left:.5g}"
    return [*lines, " " * 11 + "+" + "-" * WIDTH, " " * 12 + foot + f"{right:.5g}".rjust(WIDTH - len(foot))]
