"""Every recording of a machine's tests as one set of readings: those at the tool first, then records of components."""

from __future__ import annotations

from collections.abc import Mapping

from errpipe.domain.recording import Recording
from errpipe.kinematics import observations as o
from errpipe.kinematics import protocols, records
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.direct import Laser


def of_tests(
    chain: Chain,
    tests: Mapping[str, Recording],
    lasers: Mapping[str, Laser] | None = None,
    squares: Mapping[str, float] | None = None,
) -> tuple[o.Observations, dict[str, int]]:
    """Readings of tests by name, and how many each test at the tool has, in their order.

    Raises DataError for a test that cannot be read.
    """
    single = {name: r for name, r in tests.items() if records.is_direct(r)}
    parts = {name: protocols.observations(chain, r) for name, r in tests.items() if name not in single}
    counts = {name: len(part) for name, part in parts.items()}
    every = list(parts.values())
    if single:
        every.append(records.observations(chain, single, lasers=lasers, squares=squares))
    return o.concatenate(every), counts
