"""`errpipe demo`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    out: Path = typer.Option(Path("out/demo"), "--out", metavar="DIR", help="Folder for the outputs."),
    json: bool = Json,
) -> None:
    """Run the main job on a simulated ball-screw axis; no files needed.

    \b
    Example:
      errpipe demo
      errpipe demo --out out/demo
    """
    from errpipe.cli.progress import Watcher
    from errpipe.cli.say import answer, work

    answer("demo", work("demo").demo(out, Watcher(str(out)).talk()), as_json=json)
