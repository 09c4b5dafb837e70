"""What only a fleet shows: one recording under two names, and a machine whose deviations have the other sign."""

from __future__ import annotations

import numpy as np

from errpipe.verbs._fleet_report import _copies
from errpipe.verbs._fleet_types import _mirrored


def test_the_same_readings_under_several_names_are_found() -> None:
    rows = [{"name": n, "readings": r} for n, r in (("a", "1"), ("b", "2"), ("c", "1"), ("d", ""), ("e", ""))]
    assert _copies([*rows, {"name": "failed"}]) == [["a", "c"]]


def test_a_machine_of_the_other_sign_is_found_and_others_are_not() -> None:
    rng = np.random.default_rng(2)
    names, covariances = [f"m{k}" for k in range(8)], [0.01 * np.eye(3)] * 8
    values = np.array([8.0, -5.0, 3.0]) + 0.4 * rng.standard_normal((8, 3))
    assert _mirrored(names, list(values), covariances) == []
    values[2] *= -1.0
    assert _mirrored(names, list(values), covariances) == ["m2"]
    values[2] = 3.0 * np.array([8.0, -5.0, 3.0])  # far away, and not by its sign
    assert _mirrored(names, list(values), covariances) == []
    assert _mirrored(names[:4], list(-values[:4]), covariances[:4]) == []


def test_machines_that_differ_more_than_they_have_in_common_have_no_sign() -> None:
    rng = np.random.default_rng(3)
    values = 0.5 + rng.standard_normal((9, 3))
    values[0] *= -1.0
    assert _mirrored([str(k) for k in range(9)], list(values), [0.01 * np.eye(3)] * 9) == []
