"""Every rule of the sensor guard: no fault on healthy readings, a fault on its own example, limits that widen."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.drivers.evaluation import drive
from errpipe.guard import detect, learn
from errpipe.guard.description import SensorGuard
from errpipe.guard.rules import RULES
from tests.unit.guard import simulated_sensors

NAME = "T_bearing"


@pytest.fixture(scope="module")
def guards() -> dict[str, SensorGuard]:
    """Learnt with the other sensors, and alone, from ten runs."""
    healthy = simulated_sensors.machine(10, seed=1)
    return {"compared": learn.learn(healthy), "alone": learn.limits(healthy, (NAME,))}


@pytest.mark.parametrize("way", ["compared", "alone"])
@pytest.mark.parametrize("kind", RULES.tags)
def test_a_rule_flags_its_example_and_no_healthy_reading(guards: dict[str, SensorGuard], kind: str, way: str) -> None:
    guard = guards[way]
    flag = detect.flags(guard, kind)[guard.names().index(NAME)]
    day = simulated_sensors.machine(1, seed=8)
    assert not drive(flag, day).any()
    faulty = RULES[kind].example(day.time(), day.array(NAME))
    flagged = drive(flag, day.with_columns({NAME: faulty}, {}))
    half = day.time() < np.median(day.time())
    assert not flagged[half].any(), "flagged before the reading is faulty"
    assert flagged[-1] == 1.0


@pytest.mark.parametrize("kind", RULES.tags)
def test_a_widened_rule_flags_fewer_rows(guards: dict[str, SensorGuard], kind: str) -> None:
    day = simulated_sensors.machine(1, seed=8)
    faulty = day.with_columns({NAME: RULES[kind].example(day.time(), day.array(NAME))}, {})
    own, wide = (drive(detect.flags(g, kind)[0], faulty) for g in (guards["alone"], guards["alone"].widened(1e3)))
    assert own.sum() > wide.sum()


@pytest.mark.parametrize("kind", RULES.tags)
def test_a_rule_says_what_it_detects_and_survives_its_file(guards: dict[str, SensorGuard], kind: str) -> None:
    assert RULES[kind].symptom and RULES[kind].nodes > 0
    guard = guards["alone"]
    again = SensorGuard.model_validate_json(guard.model_dump_json())
    assert again.sensors[0].rule(kind) == guard.sensors[0].rule(kind) is not None
