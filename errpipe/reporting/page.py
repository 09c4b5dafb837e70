"""One self-contained HTML page: template, style sheet and numbers; no network, no clock, equal bytes for equal data."""

from __future__ import annotations

from importlib import resources
from typing import Any


def number(value: float | None, digits: int = 3) -> str:
    """A number for a reader: `digits` significant digits, no exponent for everyday sizes, a dash for nothing."""
    if value is None or value != value:
        return "–"
    text = f"{value:.{digits}g}"
    return f"{float(text):g}" if "e" in text and 1e-3 < abs(value) < 1e6 else text


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
    environment.filters |= {"num": number, "fixed": fixed}
    return environment.get_template(template).render(**data) + "\n"
