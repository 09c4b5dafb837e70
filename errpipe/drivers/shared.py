"""Several drivers with much in common, evaluated with each common part once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.sessions import sessions


def drive_all(drivers: Sequence[d.Driver], recording: Recording) -> np.ndarray:
    """`drive` of each driver, shape (rows, drivers)."""
    if not drivers:
        return np.empty((len(recording), 0))
    if recording.between != "held":  # what a lag makes of the time between rows then depends on the inputs below it
        return np.column_stack([drive(driver, recording) for driver in drivers])
    values = _Values(recording)
    walked: dict[int, str] = {}  # by identity: the drivers are alive as long as this function runs
    known: dict[d.Driver, str] = {}

    def name(driver: d.Driver) -> str:
        if id(driver) not in walked:
            walked[id(driver)] = driver.name if isinstance(driver, d.Input) else flat(driver)
        return walked[id(driver)]

    def flat(driver: d.Driver) -> str:
        of = getattr(driver, "of", None)
        if isinstance(of, tuple):
            driver = driver.model_copy(update={"of": tuple(d.Input(name=name(child)) for child in of)})
        elif of is not None:
            driver = driver.model_copy(update={"of": d.Input(name=name(of))})
        if driver not in known:
            known[driver] = f"#{len(known)}"
            values[known[driver]] = drive(driver, values)  # type: ignore[arg-type]
        return known[driver]

    return np.column_stack([values.array(name(driver)) for driver in drivers])


class _Values(dict[str, np.ndarray]):
    """Columns by name, beside the runs and times of a recording: as much of one as `drive` looks at."""

    between = "held"
    past = None

    def __init__(self, recording: Recording):
        super().__init__()
        self.recording = recording
        self.derived: dict[Any, np.ndarray] = {"sessions": sessions(recording)}
        self._run = recording.run_codes()
        self._time = recording.time() if recording.name("time") is not None else None

    def __len__(self) -> int:
        return len(self.recording)

    def array(self, name: str) -> np.ndarray:
        if name not in self:
            self[name] = self.recording.array(name)
        return self[name]

    def name(self, role: str) -> str | None:
        return self.recording.name(role)

    def run_codes(self) -> np.ndarray:
        return self._run

    def time(self) -> np.ndarray:
        return self.recording.time() if self._time is None else self._time
