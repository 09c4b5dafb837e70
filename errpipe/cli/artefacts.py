"""Verbs that read what a run wrote: recordings, models, tables, export folders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from errpipe.cli._arguments import At, input_values
from errpipe.cli.output import Answer, module_of


def predict(
    source: Path = typer.Argument(metavar="MODEL_OR_TABLE", help="An error model or a table (.json, .ect)."),
    recording: Path = typer.Argument(metavar="RECORDING", help="Folder with a recording manifest."),
    out: Path = typer.Option(..., "--out", metavar="FILE", help="A row per recording row (.csv, .parquet)."),
    readings: Path | None = typer.Option(
        None,
        "--readings",
        metavar="FILE",
        help="Deviations read now and then (.csv, .parquet): they correct later rows.",
    ),
) -> Mapping[str, Any]:
    """Predict every response of a recording, as a controller would.

    Row k uses rows up to k of its own run only. Columns: run, time, and per response NAME
    NAME_predicted, NAME_lower, NAME_upper (90 %), NAME_outside (1 where
    the table fades, lacks a reading or is beyond a curve).
    With --readings, a file of columns time (s, the recording's clock), one per response (its unit)
    and, where runs overlap in time, run: a row is corrected by the last reading of its run before it.

    \b
    Example:
      errpipe predict out/axis/fit/error_model.json recording --out predicted.csv
    """
    return module_of("stages.predict").predict(source, recording, out, readings)


def eval(
    table: Path = typer.Argument(metavar="TABLE", help="A compensation table (.ect or its JSON twin)."),
    at: list[str] = At,
) -> Mapping[str, Any]:
    """Evaluate a compensation table at one point.

    \b
    Example:
      errpipe eval out/axis/export/table.ect --at x=100 --at T_nut=25
    """
    return module_of("verbs.evaluate").evaluate(table, input_values(at))


def show(
    file: Path = typer.Argument(metavar="FILE", help="Any file or folder that errpipe reads or writes."),
) -> Mapping[str, Any]:
    """Describe a file, with a plot for the terminal.

    \b
    Example:
      errpipe show recording
      errpipe show out/export/table.ect
    """
    return module_of("verbs.show").show(file)


def whatis(
    file: Path = typer.Argument(metavar="FILE", help="Any file that errpipe reads or writes."),
) -> Mapping[str, Any]:
    """Describe a file: machine, model, validity, cost per cycle.

    \b
    Example:
      errpipe whatis out/axis/export/table.ect
    """
    return module_of("verbs.whatis").whatis(file)


def verify(
    folder: Path = typer.Argument(metavar="DIR", help="A folder that `export` wrote, or a table alone."),
    public_key: Path | None = typer.Option(
        None, "--public-key", metavar="FILE", help="The table must be signed by this key."
    ),
) -> Mapping[str, Any]:
    """Read exported files back and compare them with the model.

    Exit code 6 on the first thing that does not hold.

    \b
    Example:
      errpipe verify out/axis/export
    """
    if public_key is not None:
        module_of("stages.signing").verify_signature(folder if folder.is_file() else folder / "table.ect", public_key)
    return module_of("verbs.verify").verify(folder)


def compare(
    old: Path = typer.Argument(metavar="OLD", help="Table, model, recording, diagnosis, run folder or fleet."),
    new: Path = typer.Argument(metavar="NEW", help="Another one of that kind."),
    max_um: float | None = typer.Option(
        None, "--max-um", min=0.0, metavar="UM", help="Largest difference allowed; beyond it exit 4."
    ),
    figure: Path | None = typer.Option(
        None, "--figure", metavar="FILE", help="Write a figure of the difference (SVG)."
    ),
) -> Answer:
    """Compare two results: what changed, where, and by how many um.

    Tables and models are evaluated on the same states over their common validity range.

    \b
    Example:
      errpipe compare out/champion out/retrain/run --max-um 5
      errpipe compare before.ect out/export/table.ect --figure change.svg
    """
    comparison = module_of("verbs.compare").compare(old, new, max_um, figure)
    says = comparison.pop("says")
    return Answer(comparison, says, 4 if comparison["within"] is False else 0)
