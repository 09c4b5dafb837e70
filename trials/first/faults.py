"""A sensor that the simulation trusts goes wrong: stuck, dead or stepped for a while."""

from __future__ import annotations

import numpy as np

from .case import Array, Column, Contribution


def sensor_fault(
    rng: np.random.Generator, columns: dict[str, Column], t: Array, sensors: tuple[str, ...]
) -> dict[str, Contribution]:
    """The machine follows the true temperature, the simulation the display; between them lies the mismatch.

    The simulation holds `thermal_drift` on that sensor as the carrier.
    """
    usable = [s for s in sensors if s in columns]
    if not usable:
        return {}
    name = str(rng.choice(usable))
    true = columns[name].values
    span = t[-1] - t[0]
    width = rng.uniform(0.12, 0.4) * span
    start = t[0] + rng.uniform(0.15, 0.95 - width / span) * span
    inside = (t >= start) & (t < start + width)
    if inside.sum() < 8:
        return {}
    kind = str(rng.choice(["stuck", "dead", "stepped", "empty"]))
    accepted = true.copy()
    first = int(np.argmax(inside))
    if kind in ("stuck", "empty"):
        accepted[inside] = true[first]
    elif kind == "dead":
        accepted[inside] = 0.0
    else:
        accepted[inside] = true[inside] + rng.choice([-1, 1]) * rng.uniform(2, 6)
    shown = np.where(inside, np.nan, true) if kind == "empty" else accepted
    k = rng.uniform(0.5, 3.0) * rng.choice([-1, 1])
    place = [float(np.round(t[inside][0], 1)), float(np.round(t[inside][-1], 1))]
    carrier = Contribution("thermal_drift", k * (accepted - accepted[0]), (name,))
    return {
        "sensor_fault": Contribution(
            "sensor_fault",
            k * (true - accepted),
            (name,),
            active=inside,
            where={"ranges": {"t": place}},
            carrier=carrier,
            display=(name, shown),
        )
    }
