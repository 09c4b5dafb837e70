"""Where it is recorded whether coolant flows: what flows takes heat by how far it is from the parts."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.models.lagged import Lagged
from errpipe.thermal.arithmetic import since_start

STEP, ROWS = 300.0, 72  # s, six hours a day


def chilled(seed: int, rooms: tuple[float, ...]) -> Recording:
    """A screw without a sensor starts as warm as the room and follows coolant of 20 degC while it flows."""
    rng, frames = np.random.default_rng(seed), []
    for k, room in enumerate(rooms):
        flow = np.repeat(rng.integers(0, 2, 6), ROWS // 6).astype(float)
        air = room + 0.3 * np.cumsum(rng.normal(0, 0.1, ROWS))
        screw = np.full(ROWS, air[0])
        for i in range(1, ROWS):
            screw[i] = screw[i - 1] + STEP * (
                (air[i] - screw[i - 1]) / 20000.0 + flow[i] * (20.0 - screw[i - 1]) / 3000.0
            )
        read = {"T_room": air + rng.normal(0, 0.02, ROWS), "T_coolant": 20.0 + rng.normal(0, 0.1, ROWS)}
        growth = 10.0 * (screw - screw[0]) + rng.normal(0, 0.2, ROWS)
        frames.append(
            pd.DataFrame({"run": f"day{k}", "t": STEP * np.arange(ROWS), "flow": flow, **read, "E_Z": growth})
        )
    frame = pd.concat(frames, ignore_index=True)
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s"), "flow": Column(role="coolant")}
    kinds |= {n: Column(role="temperature", unit="degC") for n in frame if n.startswith("T_")}
    kinds["E_Z"] = Column(role="error", component="E_Z", unit="um")
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), frame)


def test_coolant_that_warmed_in_winter_cools_in_summer() -> None:
    fitted, judged = chilled(1, (14.0, 16.0, 17.0, 21.0, 22.0, 18.0)), chilled(2, (27.0, 25.0, 28.0))
    run = judged.run_codes()
    measured = since_start(judged.array("E_Z"), run, 3)[0]
    predicted = since_start(Lagged(component="E_Z").train(fitted).values(judged), run, 3)[0]
    assert np.std(measured - predicted) < 0.4 * np.std(measured)
