"""The drive gives no more force than it can."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from errpipe.domain.driver import Affine, Clip, Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfSimulatedForce
from errpipe.terms._search import COARSE_RATIO, Listed, Signals, Speeds, geometric, resolved_times

SHARES = (0.3, 0.4, 0.5, 0.58, 0.66, 0.74, 0.82, 0.9, 0.95)  # of the largest force
STEPS = 2.0  # sampling steps: the shortest time of a loop that rows resolve
MAX_TIME = 0.25  # s; a position loop of Kv = 2 /s, the slowest of machines, at twice its bandwidth


@dataclass(frozen=True)
class Loops(Listed):
    """Time in which a loop catches up: 0, as if nothing was made up for, or as long as rows resolve it."""

    bounded: ClassVar[bool] = False

    def values(self, term: Any, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        shortest = STEPS * resolved_times(recording)[0]
        return (0.0, *geometric(shortest, MAX_TIME, COARSE_RATIO)) if shortest < MAX_TIME else (0.0,)


class Saturation(OfSimulatedForce):
    """The drive's current is limited: where the simulation asks for more, the force stays at the limit.

    Equation   force = clip(f + J / T + S / (2 T)^2, -limit, limit) - f   [N], f the simulated force
               J the impulse that was lacking so far, S its integral; T = 0: clip(f, -limit, limit) - f
    Assumes    the same limit both ways; a position loop that is damped critically, and does not wind up
    Typical    limit 0.5..0.95 of the largest simulated force; T 1..50 ms
    Moves      nothing while the force is below the limit; then the loop catches up
    Source     current limit of servo drives; critical damping in the least overshoot of cascaded loops (Weck)
    """

    term: Literal["saturation"] = "saturation"
    searched = (
        Parameter("limit", "N", (10.0, 5000.0), (0.0, 1e6), "largest force of the drive", search=Speeds(shares=SHARES)),
        Parameter("catch_up", "s", (0.001, 0.05), (0.0, 10.0), "time in which its loop catches up", search=Loops()),
    )
    prior_log_odds = -2.0  # most drives are chosen large enough, and most forces are measured from zero

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        force, (limit, catch_up) = recording.array(self.column), nonlinear
        held = responses.limited(sessions(recording), recording.time(), force, limit, catch_up)
        return (held - force)[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        limit, catch_up = self.nonlinear_values(parameters)
        force, share = Input(name=self.column), parameters["share"]
        if catch_up > 0:
            return None
        return (Lowered(Affine(weights=(share, -share), of=(Clip(low=-limit, high=limit, of=force), force))),)
