"""The verbs as a typer application: their arguments, options and help. `app.main` calls it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from errpipe import __version__
from errpipe.cli._names import VERBS
from errpipe.errors import did_you_mean

EXIT_CODES = """
\b
Exit codes:
  0 success                     4 refused by a quality gate
  1 internal error              5 changes pending (plan --exit-code)
  2 usage or configuration      6 verification failed
  3 input data rejected
"""

# click's own errors, whichever copy of click this typer carries
CLICK_USAGE: type[Exception] = typer.BadParameter.__mro__[1]


class _Verbs(TyperGroup):
    """The verbs in the order of VERBS; their files are imported one by one, on demand."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(VERBS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Verbs"):
            formatter.write_dl([(name, first_line(name)) for name in VERBS])

    def get_command(self, ctx: Any, name: str) -> Any:
        return verb(name) if name in VERBS else None


def verb(name: str) -> Any:
    """The click command of one verb."""
    module = import_module(f"errpipe.cli.{name.replace('-', '_')}")
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command(name)(module.command)
    command: Any = typer.main.get_command(single)
    command.name = name
    return command


def first_line(name: str) -> str:
    """The line of a verb in `errpipe --help`."""
    return str(import_module(f"errpipe.cli.{name.replace('-', '_')}").command.__doc__).split("\n")[0]


app = typer.Typer(
    cls=_Verbs,
    subcommand_metavar="VERB ...",
    add_completion=False,
    rich_markup_mode=None,
    epilog=EXIT_CODES,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"errpipe {__version__}")
        raise typer.Exit()


@app.callback(invoke_without_command=True)
def errpipe(
    ctx: typer.Context,
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Show the version."),
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error (anywhere on the line)."),
) -> None:
    """Raw machine-tool measurements in, verified compensation tables out.

    Begin with `errpipe demo`; with a file of your own: `errpipe import FILE --out recording`.
    """
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


def invoke(arguments: list[str]) -> int:
    """Run one command line; returns the exit code."""
    try:
        # not click's own main(): it handles interrupts and closed pipes differently
        command: Any = typer.main.get_command(app)
        with command.make_context("errpipe", arguments) as context:
            command.invoke(context)
    except typer.Exit as end:
        return int(end.exit_code)
    except typer.Abort:
        raise KeyboardInterrupt from None
    return 0


def usage(err: Any) -> str:
    """Click's message on a command line; for an unknown option our own, which does not change with click."""
    if type(err).__name__ == "NoSuchOption":
        known = [name for parameter in err.ctx.command.params for name in parameter.opts] if err.ctx else []
        return f"no option {err.option_name}.{did_you_mean(err.option_name, known)}"
    return str(err.format_message()).replace(": Value error, ", ": ")  # pydantic's own words
