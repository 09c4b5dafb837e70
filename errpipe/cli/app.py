"""The `errpipe` command: one file per verb in this folder, loaded only when it is asked for.

A new verb is one file with a function `command`, and one word in VERBS. The function's signature is the
verb's arguments (typer), its docstring the help: a first line of at most 70 characters, then a block
that starts with `Example:`. A verb returns nothing; it ends with `print_result`, or raises an ErrpipeError.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from errpipe import __version__
from errpipe.cli.output import print_error
from errpipe.errors import ErrpipeError, UsageError, did_you_mean

VERBS = (
    "check",
    "import",
    "init",
    "plan",
    "run",
    "demo",
    "predict",
    "eval",
    "show",
    "whatis",
    "diagnose",
    "export",
    "verify",
    "targets",
    "compare",
    "compare-targets",
    "correct",
    "measure",
    "place",
    "plan-day",
    "synthesis",
    "retrain",
    "fleet",
    "keygen",
    "sign",
    "verify-signature",
    "promote",
    "rollback",
    "log",
    "terms",
    "formats",
    "explain",
    "doctor",
    "completion",
    "schema",
    "reference",
)

EXIT_CODES = """
\b
Exit codes:
  0 fine                        4 a quality gate said no
  1 internal error              5 changes pending (plan --exit-code)
  2 usage or configuration      6 verification failed
  3 input data rejected
"""

# Failures of the system that name no file: no errors of errpipe.
_OUTSIDE_CAUSES = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENFILE)

# click's own errors, whichever copy of click this typer carries
_CLICK_USAGE: type[Exception] = typer.BadParameter.__mro__[1]


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
    """What `errpipe --help` says of a verb."""
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
    """Raw machine-tool measurements in, verified compensation tables out."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code. The one place where errors become messages."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments
    arguments = [word for word in arguments if word != "--debug"]
    name = next((word for word in arguments if not word.startswith("-")), "")
    as_json = "--json" in arguments
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # looking for plugins reads every installed package's files
    try:
        if name and name not in VERBS:
            raise UsageError(f"no verb {name!r} (errpipe --help lists them).{did_you_mean(name, VERBS)}")
        # not click's own main(): it handles interrupts and closed pipes differently
        command: Any = typer.main.get_command(app)
        with command.make_context("errpipe", arguments) as context:
            command.invoke(context)
        sys.stdout.flush()
        return 0
    except typer.Exit as end:
        return int(end.exit_code)
    except BrokenPipeError:
        return _closed_pipe()
    except (KeyboardInterrupt, typer.Abort):
        return print_error(name, "interrupted; the same command goes on from here", 130, as_json)
    except Exception as err:
        if debug:
            import traceback

            traceback.print_exc()
        return _refusal(name, err, as_json)


def _refusal(name: str, err: Exception, as_json: bool) -> int:
    """The message and exit code of an exception."""
    if isinstance(err, ErrpipeError):
        return print_error(name, str(err), err.exit_code, as_json, err)
    if isinstance(err, _CLICK_USAGE):
        text = _usage(err)
        line = f"errpipe {name}".strip()
        text = f"{line}: {text[0].lower()}{text[1:]}\n({line} --help shows what is possible)"
        return print_error(name, text, 2, as_json)
    if isinstance(err, OSError) and err.strerror and (err.filename is not None or err.errno in _OUTSIDE_CAUSES):
        where = f"{err.filename}: " if err.filename is not None else ""
        return print_error(name, f"{where}{err.strerror.lower()}", 2, as_json)
    if isinstance(err, MemoryError):
        return print_error(name, "out of memory: fewer rows or columns at a time, or a larger machine", 3, as_json)
    text = f"internal error, please report it: {type(err).__name__}: {err}\n(--debug shows where it happened)"
    return print_error(name, text, 1, as_json)


def _usage(err: Any) -> str:
    """What click says of a command line; of an unknown option in our words, which do not change with click."""
    if type(err).__name__ == "NoSuchOption":
        known = [name for parameter in err.ctx.command.params for name in parameter.opts] if err.ctx else []
        return f"no option {err.option_name}.{did_you_mean(err.option_name, known)}"
    return str(err.format_message())


def _closed_pipe() -> int:
    """The reader of our output has closed the pipe (`errpipe ... | head`); this is not an error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 141


if __name__ == "__main__":
    sys.exit(main())
