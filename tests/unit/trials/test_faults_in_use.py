"""The trial of faults in use: its machines, and the sign of what it judges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trials import faults_in_use, shop_floor


@pytest.mark.parametrize("kind", shop_floor.KINDS)
def test_heat_that_a_body_gives_its_neighbour_has_not_vanished(kind: str) -> None:
    m = shop_floor.machine(kind, 3)
    np.testing.assert_array_equal(m.joints, m.joints.T)
    assert all(share.sum() == pytest.approx(1.0) for share in m.sensors.values())


def test_a_day_counts_from_its_start() -> None:
    day, _ = shop_floor.unseen(shop_floor.machine("grinder", 3), 3)
    assert day.t[0] == 0.0 and day.deviation[0] == 0.0 and np.abs(day.deviation).max() > 2.0


@pytest.mark.slow
def test_a_table_without_a_fault_helps_and_one_of_the_other_sign_doubles(tmp_path: Path) -> None:
    use = faults_in_use.prepare("grinder", 3, tmp_path)
    whole = faults_in_use.Course(use.clean, np.arange(len(use.clean)))
    sound = use.outcome(whole)
    assert sound.left < 0.1 * sound.none
    use.truth = -use.truth
    assert use.outcome(whole).left > 1.8 * sound.none
    lost = faults_in_use.Course(np.full_like(use.clean, np.nan), np.arange(len(use.clean)))
    assert use.outcome(lost).left == pytest.approx(sound.none, rel=0.01)
