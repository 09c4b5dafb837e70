"""Figures as inline SVG: equal data give equal bytes, text stays text, readable on paper and on a phone."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# One colour per meaning in every figure of the project; all differ in lightness, so they survive a grey printer.
BEFORE = "#b07d2b"
AFTER = "#1f5fa8"
FLOOR = "#5d6a75"
ALARM = "#b3261e"
INK = "#20262c"
MAX_POINTS = 900  # more points add megabytes and no information

STYLE: dict[Any, Any] = {  # rcParams of matplotlib
    "svg.hashsalt": "errpipe",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 10.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e6e8",
    "grid.linewidth": 0.7,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "path.simplify": True,
}


@contextmanager
def figure(width: float = 7.2, height: float = 3.0, rows: int = 1, columns: int = 1) -> Iterator[tuple[Figure, Any]]:
    """A figure and its axes (an array of axes where rows or columns exceed 1); sizes in inches."""
    import matplotlib

    matplotlib.use("Agg", force=False)
    from matplotlib.figure import Figure as Canvas

    with matplotlib.rc_context(STYLE):
        canvas = Canvas(figsize=(width, height))
        yield canvas, canvas.subplots(rows, columns)


def to_svg(canvas: Figure, title: str) -> str:
    """Inline SVG text of a figure: no clock, scales with the page, carries `title` for screen readers."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.StringIO()
    with matplotlib.rc_context(STYLE):  # `savefig` would draw all of it twice, once to place it
        FigureCanvasSVG(canvas).print_svg(stream, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    head, rest = text.split(">", 1)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    return f'{head} role="img" aria-label="{_escape(title)}"><title>{_escape(title)}</title>{rest}'


def in_hours(label: str, x: np.ndarray) -> tuple[str, np.ndarray]:
    """Label and values of an axis; a time in s that spans more than two hours in h."""
    if label.endswith(" in s") and np.ptp(x) > 7200.0:
        return label.removesuffix(" in s") + " in h", x / 3600.0
    return label, x


def with_gaps(x: np.ndarray, y: np.ndarray, run: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and y of a line that is not drawn from one run to the next."""
    first = np.flatnonzero(run[1:] != run[:-1]) + 1
    return np.insert(x.astype(float), first, np.nan), np.insert(y.astype(float), first, np.nan)


def thin(n: int, most: int = MAX_POINTS) -> np.ndarray:
    """Row numbers, at most `most` of `n`, evenly spread and always the same."""
    return np.arange(n) if n <= most else np.unique(np.linspace(0, n - 1, most).astype(int))


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
