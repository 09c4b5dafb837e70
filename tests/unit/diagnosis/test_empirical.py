"""An equation for what has no name: found where there is one, with its units; nothing in noise of any colour."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.diagnosis import diagnose, prepare
from errpipe.diagnosis.empirical import equation
from errpipe.drivers.library import candidates, unit_over
from errpipe.terms import resolved_times
from tests.unit.diagnosis.machines import axis, mornings


def coloured(rng: np.random.Generator, rows: int, memory: float) -> np.ndarray:
    """AR(1) noise of unit rms."""
    keep = np.exp(-1.0 / memory) if memory > 0 else 0.0
    out = rng.standard_normal(rows)
    for k in range(1, rows):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep**2) * out[k]
    return out


@pytest.mark.parametrize("memory", [0.0, 3.0, 30.0, 100.0])
def test_noise_has_no_equation(memory: float) -> None:
    """528 rows: a memory of 100 leaves some five independent ones."""
    conditioned = prepare.condition(axis(1))
    rows = np.arange(len(conditioned))
    said = 0
    for seed in range(8):
        y = coloured(np.random.default_rng(seed), rows.size, memory)
        said += equation(conditioned, rows, y, "um") is not None
    assert said == 0


def test_a_product_of_columns_is_found_with_its_coefficient() -> None:
    whole = mornings(3, days=12)
    conditioned = prepare.condition(whole)
    room, bearing = conditioned.array("T_room"), conditioned.array("T_bearing")
    rng = np.random.default_rng(0)
    y = 0.8 * (room - room.mean()) * (bearing - bearing.mean()) + coloured(rng, room.size, 10.0)
    fitted = equation(conditioned, np.arange(room.size), y, "um")
    assert fitted is not None and "whole runs" in fitted.scheme
    top = max(fitted.terms, key=lambda t: t.rms_um)
    assert "T_room" in top.column and "T_bearing" in top.column and top.unit == "um/K2"
    assert top.ci95[0] < 0.8 < top.ci95[1] or abs(top.coefficient - 0.8) < 0.08
    assert len(fitted.terms) <= 3 and fitted.share > 0.5 and fitted.says.startswith("Empirical, no mechanism")


def test_a_square_that_is_present_in_one_run_only_is_not_reported() -> None:
    """Held out by runs: what one of ten days holds predicts none of the others."""
    conditioned = prepare.condition(mornings(4, days=10))
    bearing = conditioned.array("T_bearing")
    one = conditioned.run_codes() == 3
    y = np.where(one, 0.3 * (bearing - bearing.mean()) ** 2, 0.0)
    y = y + coloured(np.random.default_rng(1), y.size, 5.0)
    assert equation(conditioned, np.arange(y.size), y, "um") is None


def test_units_are_those_of_powers_and_products() -> None:
    conditioned = prepare.condition(axis(1))
    every = candidates(conditioned, np.arange(len(conditioned)), resolved_times(conditioned)[1])
    library = {c.name: c.unit for c in every}
    squares = [unit for name, unit in library.items() if name.endswith("^2") and "T_nut" in name and "lag" not in name]
    assert squares == [(("K", 2),)]
    assert unit_over("um", (("K", 2), ("mm", 1))) == "um/(K2 mm)"
    assert unit_over("N", ()) == "N" and unit_over("um", (("mm/s", 1),)) == "um/(mm/s)"


def test_an_unknown_mechanism_is_shown_with_its_equation() -> None:
    """A deviation with the product of two temperatures: no effect of the vocabulary."""
    hidden = lambda c: 0.9 * (c["T_room"] - 20.5) * (c["T_bearing"] - 24.0)  # noqa: E731
    diagnosis, _ = diagnose(mornings(5, hidden=hidden, days=12))
    response = diagnosis.responses[0]
    unknown = [f for f in response.findings if f.effect == "unknown"]
    if not unknown:
        pytest.fail(f"named {[f.effect for f in response.findings]}")
    assert unknown[0].empirical is not None and unknown[0].empirical.share > 0.3
    assert "Empirical, no mechanism" in unknown[0].says
