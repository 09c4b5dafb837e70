"""What an earlier run of the fleet left in a machine's folder."""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path

MACHINES = "machines"  # folder of the machines' outputs, below OUT


def of_earlier(folder: Path, brought_up_to_date: Container[str]) -> str:
    """In words, which outputs in a machine's folder an earlier run made; '' where there are none.

    A machine that fails keeps them: whoever reads its folder alone would take its old table for today's.
    """
    from errpipe.errors import ErrpipeError
    from errpipe.pipeline.lock import read_lock

    try:
        earlier = [name for name in read_lock(folder) if name not in brought_up_to_date and (folder / name).is_dir()]
    except (ErrpipeError, OSError):
        return ""
    return f"; {MACHINES}/{folder.name} holds what an earlier run made: {', '.join(earlier)}" if earlier else ""
