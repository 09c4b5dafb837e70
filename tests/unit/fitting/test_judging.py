"""Half widths of held-out errors, ordered once for all groups, and ends of the box without few rows beyond a gap."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

from errpipe.fitting import judging
from errpipe.fitting.validity import FEW, GAP, covered


def groups(seed: int) -> list[judging.HeldOut]:
    """Groups of different sizes, with ties, some rows outside the box or (every third seed) nearly all."""
    rng = np.random.default_rng(seed)
    out = []
    for n in rng.integers(3, 200, 5):
        outside = np.maximum(rng.normal(size=n) + (2.0 if seed % 3 == 0 else -0.5), 0.0)
        out.append(judging.HeldOut("run", np.arange(n), np.zeros(n), rng.normal(size=n).round(1), outside, 0.0))
    return out


@pytest.mark.parametrize("seed", range(12))
def test_leaving_each_group_out_gives_the_half_width_of_the_others_alone(seed: int) -> None:
    folds = groups(seed)
    alone = [judging.half_width90([*folds[:k], *folds[k + 1 :]]) for k in range(len(folds))]
    assert judging.half_widths90_without_each(folds) == alone


def test_errors_are_ordered_once_for_all_groups() -> None:
    with mock.patch.object(judging.np, "argsort", side_effect=np.argsort) as ordering:
        judging.half_widths90_without_each(groups(1))
    assert ordering.call_count == 1


@pytest.mark.parametrize("seed", range(20))
def test_the_box_ends_where_counting_the_rows_beyond_a_gap_one_by_one_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=int(rng.integers(1, 900)))
    values[: seed % 7] += 10.0 ** rng.uniform(-1, 2) * rng.choice([-1, 1])

    def beyond(ordered: np.ndarray) -> int:
        few = int(FEW * ordered.size)
        for count in range(few, 0, -1):
            main = ordered[count : ordered.size - few]
            if main[0] - ordered[count - 1] > GAP * max(main[-1] - main[0], 1e-300):
                return count
        return 0

    ordered = np.sort(values)
    assert covered(values) == (ordered[beyond(ordered)], ordered[ordered.size - 1 - beyond(-ordered[::-1])])
