"""`errpipe doctor`."""

from __future__ import annotations

from errpipe.cli._arguments import Json
from errpipe.cli.output import print_answer, stage_module


def command(json: bool = Json) -> None:
    """Show versions, compiler, extras, cache folder and threads.

    \b
    Example:
      errpipe doctor
    """
    print_answer("doctor", stage_module("doctor").doctor(), as_json=json)
