"""What a new machine borrows from its type, through `errpipe fleet`."""

from __future__ import annotations

from trials import pooled


def test_a_machine_with_two_runs_is_better_off_with_its_type() -> None:
    ((_, (nothing, own, together)),) = pooled.of_fleets(seed=1, fleets=1, first=3)
    assert together < 0.5 * own and together < 0.5 * nothing
