"""`errpipe targets`."""

from __future__ import annotations

from errpipe.cli._arguments import Json


def command(json: bool = Json) -> None:
    """List the controller formats, their limits and how well proved each is.

    \b
    Example:
      errpipe targets
      errpipe targets --json
    """
    from errpipe.cli.output import print_answer, stage_module

    print_answer("targets", stage_module("targets").targets(), as_json=json)
