"""The simulated year of examples/retraining: promotes after the bearing change, harms none, names the sensor."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

PATH = Path(__file__).parents[3] / "examples" / "retraining" / "year.py"


@pytest.fixture(scope="module")
def example() -> Any:
    spec = spec_from_file_location("retraining_year", PATH)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_year_promotes_when_it_should_and_names_the_sensor(example: Any, tmp_path: Path) -> None:
    report = example.year(tmp_path / "year", seed=3, every=10)
    assert report["worse_promotions"] == 0
    nights = [p["night"] for p in report["promotions"]]
    assert any(example.BEARING < n <= example.BEARING + 60 for n in nights), nights
    assert all(p["um_rms_after"] < p["um_rms_before"] for p in report["promotions"]), report["promotions"]
    assert example.DRIFT <= report["sensors_named"]["T_nut"] <= example.DRIFT + 30


def test_years_without_change_see_no_promotion_that_harms(example: Any) -> None:
    assert sum(example.quiet_year(90 + k) for k in range(3)) == 0
