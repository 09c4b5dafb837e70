"""One self-contained HTML page: template, style sheet and numbers; no network, no clock, equal bytes for equal data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import resources
from typing import Any

MAX_DECIMALS = 6  # a smaller number is shown with significant digits, four or those of its interval
MAX_DIGITS = 12  # of a number in a table


def number(value: float | None, digits: int = 3) -> str:
    """A number for a reader: `digits` significant digits, no exponent for everyday sizes, a dash for nothing."""
    if value is None or value != value:
        return "–"
    text = f"{value:.{digits}g}"
    return f"{float(text):g}" if "e" in text and 1e-3 < abs(value) < 1e6 else text


def within(value: float, interval: Sequence[float] | None) -> str:
    """A value, or an end of its 95 % interval, with the decimals of two digits of half the interval (GUM, 7.2.6)."""
    half = (interval[1] - interval[0]) / 2 if interval else 0.0
    if not 0 < half < math.inf or not math.isfinite(value):
        return number(value, 4)
    decimals = 1 - math.floor(math.log10(half))
    if 0 <= decimals <= MAX_DECIMALS:
        return fixed(value, decimals)
    before = math.floor(math.log10(abs(value))) + 1 if value else 0
    return number(value, max(4, min(before + decimals, MAX_DIGITS)))


def probability(value: float | None) -> str:
    """A p value; below 1e-6 only that it is."""
    return "< 1e-6" if value is not None and value < 1e-6 else number(value)


def fixed(value: float | None, decimals: int) -> str:
    """A number with the decimals of its column; a dash for nothing."""
    return "–" if value is None or value != value else f"{value:z.{decimals}f}"


def render(template: str, data: dict[str, Any]) -> str:
    """Fill a template of this package. Text is escaped; figures are passed as `Markup`-safe values by the template."""
    import jinja2

    folder = resources.files("errpipe.reporting") / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"num": number, "fixed": fixed, "within": within, "p": probability}
    return environment.get_template(template).render(**data) + "\n"
