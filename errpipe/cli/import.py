"""`errpipe import`."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import Literal

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import folded, module_of, print_result
from errpipe.errors import DataError, UsageError


def command(
    context: typer.Context,
    files: list[Path] = typer.Argument(
        metavar="FILE...", help="A folder, zip, CSV, Excel, TDMS, HDF5, MAT, XML, halsampler, ..."
    ),
    out: Path = typer.Option(..., "--out", metavar="FOLDER", help="The recording folder to write."),
    yes: bool = typer.Option(False, "--yes", help="Confirm every assumption without asking."),
    axis: str | None = typer.Option(None, "--axis", metavar="LETTER", help="The axis, such as X."),
    component: str | None = typer.Option(None, "--component", metavar="NAME", help="What was measured, such as EXX."),
    unit: str | None = typer.Option(None, "--unit", metavar="UNIT", help="Of the readings."),
    sign: Literal["actual-minus-commanded", "commanded-minus-actual"] | None = typer.Option(
        None, "--sign", help="What the file's deviations are."
    ),
    resolution: float | None = typer.Option(None, "--resolution", metavar="MM", help="mm (deg) of one encoder count."),
    torque_constant: float | None = typer.Option(
        None, "--torque-constant", metavar="NM/A", help="Torque of one ampere."
    ),
    names: str | None = typer.Option(
        None, "--names", metavar="A,B,...", help="Names of the columns of a file without a header."
    ),
    period: float | None = typer.Option(None, "--period", metavar="S", min=1e-9, help="Time between rows of a log."),
    sheet: str | None = typer.Option(None, "--sheet", metavar="NAME", help="Sheet or group."),
    sets: list[str] = typer.Option(
        [], "--set", metavar="COLUMN.KEY=VALUE", help="Role, unit, axis, ... of a column. Repeatable."
    ),
    title: str = typer.Option("", "--title", metavar="TEXT", help="What was measured."),
    machine: str = typer.Option("", "--machine", metavar="TEXT", help="The machine."),
    overwrite: bool = typer.Option(False, "--overwrite", help="Replace a recording that was changed by hand."),
    json: bool = Json,
) -> None:
    """Convert measurement files to a recording; list all assumptions.

    Nothing is written until you confirm, or give --yes. Deviation is actual minus commanded.
    Files of one layout are runs; a log of another device, without deviations, joins them by date and time.

    \b
    Example:
      errpipe import positions.csv --out recording --yes
      errpipe import log.txt --out recording --names x,x_fb --period 0.001 --yes
    """
    work = module_of("verbs.import_files")
    from errpipe.importing.sheet import ReaderOptions

    stated = {"axis": axis, "component": component, "unit": unit, "sign": sign, "title": title, "machine": machine}
    options = work.options_of(**stated, resolution=resolution, torque_constant=torque_constant, sets=sets)
    reader = ReaderOptions(sheet, tuple(n.strip() for n in names.split(",")) if names else (), period)
    try:
        proposal, shown = work.prepare(files, reader, options)
    except DataError as err:
        raise DataError(f"{err}{_repeat_command(str(err), context)}") from None
    lines = folded([*shown["says"], *(f"  implausible: {text}" for text in shown["checks"])])
    if not yes:
        _confirm(lines, asked=not json)
    done = work.write(proposal, out, options, files, overwrite)
    says = [*(lines if yes else ()), *done["says"]]
    print_result("import", {**work.plain(shown), "folder": str(out)}, says, as_json=json)


def _repeat_command(question: str, context: typer.Context) -> str:
    """The same command with the answer that a question on the axis or the unit names first; else ''."""
    answer = re.search(r"[Dd]eclare it(?: with|:) (--(?:axis|unit) [A-Za-z]\w*)", question)
    if answer is None:
        return ""
    words = ["errpipe", *context.command_path.split()[1:], *map(str, context.params["files"])]
    for option in context.command.params:
        value = context.params.get(str(option.name))
        if option.opts[0].startswith("--") and value not in (None, "", False, [], ()):
            for each in value if isinstance(value, list | tuple) else (value,):
                words += [option.opts[0], *([] if each is True else [str(each)])]
    return f"\nagain, where it is {answer[1].split()[1]}: {shlex.join(words)} {answer[1]}"


def _confirm(lines: list[str], asked: bool) -> None:
    """Show the assumptions and ask. Raises UsageError without confirmation."""
    sys.stderr.write("\n".join(lines) + "\n")
    if not (asked and sys.stdin.isatty() and typer.confirm("Write this recording?", err=True)):
        raise UsageError(
            "nothing was written: check the assumptions, then give --yes (or correct them with --set, --sign, ...)"
        )
