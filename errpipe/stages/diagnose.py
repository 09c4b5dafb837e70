"""A recording beside its simulation in; what the simulation leaves out, located, named, modelled and proved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any


def diagnose(
    recording: Path, out: Path, progress: Callable[[float, str], None] = lambda share, text: None
) -> dict[str, Any]:
    """Diagnose a recording folder into `out`/diagnosis.json. Raises UsageError for input that cannot be used."""
    from errpipe import jsonfile
    from errpipe.diagnosis import diagnose as run
    from errpipe.errors import DataError, UsageError
    from errpipe.formats import manifest_folder

    try:
        document = run(manifest_folder.read(Path(recording)), progress)
    except DataError as err:
        raise UsageError(str(err)) from None
    jsonfile.write(Path(out) / "diagnosis.json", document.document())
    return {"written": str(Path(out) / "diagnosis.json")}
