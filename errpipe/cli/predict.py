"""`errpipe predict`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    source: Path = typer.Argument(metavar="MODEL_OR_TABLE", help="An error model or a table (.json, .ect)."),
    recording: Path = typer.Argument(metavar="RECORDING", help="Folder with a recording manifest."),
    out: Path = typer.Option(..., "--out", metavar="FILE", help="A row per recording row (.csv, .parquet)."),
    readings: Path | None = typer.Option(
        None,
        "--readings",
        metavar="FILE",
        help="Deviations read now and then (.csv, .parquet): they correct later rows.",
    ),
    json: bool = Json,
) -> None:
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
    print_answer("predict", module_of("stages.predict").predict(source, recording, out, readings), as_json=json)
