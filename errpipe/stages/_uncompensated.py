"""A recording made with a compensation on, as it would be without."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import Recording
from errpipe.domain.table import CompensationTable
from errpipe.drivers import motion
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError
from errpipe.stages import _artefacts
from errpipe.tables import batch, by_component, ect
from errpipe.targets import _sample
from errpipe.targets._whole import WholeTable

SHOWN = 5  # runs that a message names
SAME = 0.5  # um (urad): an error column that differs by less from actual - commanded is that difference (rounded)
PER_UNIT = {"um": 1e3, "urad": 1e6 * np.pi / 180}  # of a deviation, in one mm or deg of position


def uncompensated(
    recording: Recording, path: Path, formats: Sequence[str], since: str | None, *, entered: bool = True
) -> tuple[Recording, dict[str, Any]]:
    """The recording with the deviations of the machine itself, and what was added, in words of `ingest.json`.

    A table subtracts what it predicts, so a measured deviation is the machine's less the table's, which is replayed
    here row by row as a controller does, or less what the files of the named formats make of it. Actual positions
    whose difference to the commanded ones is that deviation change with it.
    since: the first run measured with it; None: all were. entered: whether the numbers of the checklists were, too.
    Raises DataError if the table is of no response, needs an input that is not recorded, or no such run exists.
    """
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
    try:
        taken = _by_files(recording, table, formats, shared, entered) if formats else _by_table(recording, table)
    except DataError as err:
        raise DataError(f"{path}: {err}") from None
    columns: dict[str, np.ndarray] = {}
    for c in shared:
        added = np.where(rows, taken[c], 0.0)
        columns |= _actual(recording, c, measured[c], added)
        columns[measured[c]] = recording.array(measured[c]) + added
    compensated = {
        "table": ect.fingerprint(table),
        **({"formats": list(formats)} if formats else {}),
        "rows": int(rows.sum()),
        "since": since,
        "rms_um": {c: float(np.sqrt(np.nanmean(taken[c][rows] ** 2))) for c in shared},
    }
    return recording.with_columns(columns, {}), compensated


def _by_table(recording: Recording, table: CompensationTable) -> dict[str, np.ndarray]:
    """Component -> deviation that the whole table takes away in each row."""
    columns = {i.name: recording.array(i.name) for i in table.inputs if i.name in recording.frame.columns}
    taken: dict[str, np.ndarray] = batch.evaluate(
        by_component(table), columns, recording.time(), sessions(recording)
    ).deviation
    return taken


def _by_files(
    recording: Recording, table: CompensationTable, formats: Sequence[str], shared: Sequence[str], entered: bool
) -> dict[str, np.ndarray]:
    """Component -> deviation that files of these formats take away, with the numbers of their checklists if entered.

    Raises UsageError for formats that no controller has together, DataError for a component that shares its axis with
    another one: a file holds only their sum.
    """
    from errpipe.stages.targets import chosen, files_in_effect, refuse_incompatible

    parts = chosen(list(dict.fromkeys(formats)))
    refuse_incompatible(parts, "compensated_as")
    read = files_in_effect(table, parts, entered=entered)
    if isinstance(read, WholeTable):
        return _by_table(recording, read.table)
    taken = {}
    for name in shared:
        along = components.parse(name).kind in ("positioning", "angular positioning")
        if not along and any(p.synthesised for p in parts):
            raise DataError(
                f"{name} is corrected by the controller's own kinematics, which are not repeated here: measure with "
                "the compensation switched off"
            )
        output = next((o for o in table.outputs if o.axis and name in [x.component for x in o.terms]), None)
        if output is None:
            raise DataError(f"no axis of the files corrects {name}")
        beside = [x.component for o in _sample.outputs_by_axis(table)[output.axis] for x in o.terms]
        if beside != [name] or output.terms[0].factors:
            raise DataError(
                f"{', '.join(dict.fromkeys(beside))} are corrected by {output.axis} together, and the files of "
                f"{', '.join(formats)} hold their sum: measure with the compensation switched off"
            )
        side = motion.direction(recording, components.parse(name).axis or output.axis)
        own = read.moving(output.axis)
        read_axes = {*own.spans(), *(line.axis for line in own.lines)}
        positions = {over: motion.position(recording, over) for over in read_axes}
        sensors = {line.sensor: recording.array(line.sensor) for line in own.lines}
        correction = own.correction(output.axis, positions, side, sensors)
        unit = output.terms[0].weight * output.factor * _sample.MACHINE_UNITS[output.correction_unit]
        taken[name] = -correction / unit
    return taken


def _actual(recording: Recording, component: str, error: str, added: np.ndarray) -> dict[str, np.ndarray]:
    """The actual positions without the compensation, where they are what the deviation was computed from."""
    parsed = components.parse(component)
    command = recording.name("command", axis=parsed.axis)
    name = recording.name("actual", axis=parsed.axis) or recording.name("position", axis=parsed.axis)
    if parsed.kind not in ("positioning", "angular positioning") or command is None or name is None:
        return {}
    actual, per_unit = recording.array(name), PER_UNIT[parsed.unit]
    gap = np.abs(recording.array(error) - per_unit * (actual - recording.array(command)))
    same = np.isfinite(gap)
    return {name: actual + added / per_unit} if same.any() and gap[same].max() <= SAME else {}
