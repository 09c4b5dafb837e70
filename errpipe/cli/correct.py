"""`errpipe correct`."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from errpipe.cli._arguments import At, Json, input_values
from errpipe.cli.output import folded, module_of, print_answer, short_value


def command(
    program: Path = typer.Argument(metavar="PROGRAM", help="An NC program (RS-274, the LinuxCNC dialect)."),
    table: Path = typer.Option(..., "--table", metavar="TABLE", help="A compensation table (.ect or its JSON twin)."),
    out: Path | None = typer.Option(None, "--out", metavar="FILE", help="Where to write; default: standard output."),
    at: list[str] = At,
    offset: list[str] = typer.Option(
        [], "--offset", metavar="G54=X,Y,Z", help="Zero of the part in machine coordinates, mm. Repeatable."
    ),
    tool: list[str] = typer.Option([], "--tool", metavar="H1=LENGTH", help="Length of a tool, mm. Repeatable."),
    start: str | None = typer.Option(
        None, "--start", metavar="X,Y,Z", help="Position at the start, machine coordinates, mm."
    ),
    chord_error: float = typer.Option(
        0.001, "--chord-error", min=1e-6, metavar="MM", help="Maximum distance of a segment from its arc."
    ),
    longest: float = typer.Option(25.0, "--longest", min=0.01, metavar="MM", help="Longest straight segment."),
    again: bool = typer.Option(False, "--again", help="Also accept a program that is already corrected."),
    json: bool = Json,
) -> None:
    """Rewrite an NC program so that the uncorrected machine cuts the part.

    An unsupported block is refused with its line, and nothing is written. Directions of travel
    and references latched at the start of a run are those of a run's first cycle. A comment at the program's head
    names the table.

    \b
    Example:
      errpipe correct part.ngc --table table.ect --start 0,0,0 --out corrected.ngc
    """
    done = module_of("verbs.correct").correct(
        program,
        table,
        out,
        input_values(at),
        offsets=offset,
        tools=tool,
        start=start,
        chord_error=chord_error,
        longest=longest,
        again=again,
    )
    if json or "program" not in done:
        print_answer("correct", done, as_json=json)
    else:  # to the byte as with --out: a folded block would be two motions
        sys.stdout.write(done.pop("program"))
        print("\n".join(folded(f"{key}: {short_value(value)}" for key, value in done.items())), file=sys.stderr)
