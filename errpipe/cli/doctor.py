"""`errpipe doctor`."""

from __future__ import annotations

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(json: bool = Json) -> None:
    """Show versions, compiler, extras, cache folder and threads.

    \b
    Example:
      errpipe doctor
    """
    print_answer("doctor", module_of("verbs.doctor").doctor(), as_json=json)
