"""Figures and chart of ISO 230-2 for the report: as measured, and as the held-out residuals would measure them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.reporting.iso230_chart import chart
from errpipe.reporting.run_report import Table
from errpipe.validation import iso230_2

MEANING = {
    "A": "bidirectional accuracy of positioning",
    "R": "bidirectional repeatability of positioning",
    "E": "bidirectional systematic positioning error",
    "B": "reversal error",
    "M": "mean bidirectional positioning error (its range)",
}
CAPTION = "Mean deviation of each direction with bands of 2 s. A spans the bands, B is the largest reversal."


def table_and_chart(
    recording: Recording, validation: Mapping[str, Any], rows: Path
) -> tuple[list[Table], list[tuple[str, str, str]]]:
    """The table of figures, and heading, SVG and caption of the chart; both empty where the validation has none.

    rows: file of the held-out rows.
    """
    figures = validation.get("iso230_2")
    if not figures:
        return [], []
    after = _after(recording, figures["component"], rows)
    shown = [name for name in MEANING if figures.get(name) is not None]
    table = Table(
        "ISO 230-2 figures",
        ["figure", f"measured, {figures['unit']}", f"predicted after compensation, {figures['unit']}"],
        [[f"{name}: {MEANING[name]}", figures[name], after.get(name)] for name in shown],
        "".join(f"{note}. " for note in figures["notes"]),
    )
    return ([table] if shown else []), [("ISO 230-2 chart", chart(figures, after or None), CAPTION)]


def _after(recording: Recording, component: str, rows: Path) -> dict[str, Any]:
    """The figures of the residuals on held-out rows; empty where these do not suffice."""
    held_out = pd.read_parquet(rows)
    held_out = held_out[held_out["component"] == component]
    residual = np.full(len(recording), np.nan)
    residual[held_out["row"].to_numpy()] = held_out["after"].to_numpy()
    column = recording.names("error", component=component)[0]
    try:
        return iso230_2.figures(recording.with_columns({column: residual}, {}), component=component).model_dump()
    except DataError:
        return {}
