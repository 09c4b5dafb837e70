"""Deviations measured with an active table: its correction is removed, as if it had been off."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from errpipe.errors import DataError
from errpipe.stages import _artefacts

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

SHOWN = 5  # runs that a message names


def uncompensated(recording: Recording, path: Path, since: str | None) -> tuple[Recording, dict[str, Any]]:
    """The recording with the deviations of the machine itself, and what was added, in words of `ingest.json`.

    A table subtracts what it predicts, so a measured deviation is the machine's less the table's, which is replayed
    here row by row as a controller does. since: the first run measured with it; None: all were.
    Raises DataError if the table is of no response, needs an input that is not recorded, or no such run exists.
    """
    from errpipe.drivers.sessions import sessions
    from errpipe.tables import batch, by_component, ect

    table = _artefacts.read_table(path)
    labels = recording.run_labels()
    if since is not None and since not in labels:
        names = ", ".join(labels[:SHOWN]) + (" ..." if len(labels) > SHOWN else "")
        raise DataError(f"compensated_since: no run {since!r} (there are {names})")
    rows = recording.run_codes() >= (labels.index(since) if since is not None else 0)
    measured = {c: str(recording.name("error", component=c)) for c in recording.components()}
    shared = [c.name for c in table.components if c.name in measured]
    if not shared:
        raise DataError(
            f"{path}: it corrects {', '.join(c.name for c in table.components)}, none of which was recorded"
        )
    columns = {i.name: recording.array(i.name) for i in table.inputs if i.name in recording.frame.columns}
    try:
        taken = batch.evaluate(by_component(table), columns, recording.time(), sessions(recording)).deviation
    except DataError as err:
        raise DataError(f"{path}: {err}") from None
    machine = {measured[c]: recording.array(measured[c]) + np.where(rows, taken[c], 0.0) for c in shared}
    said = {
        "table": ect.fingerprint(table),
        "rows": int(rows.sum()),
        "since": since,
        "rms_um": {c: float(np.sqrt(np.nanmean(taken[c][rows] ** 2))) for c in shared},
    }
    return recording.with_columns(machine, {}), said
