"""An equation for what has no name: found where there is one, with its units; nothing in noise of any colour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.diagnosis import diagnose, prepare
from errpipe.diagnosis.against import against, earlier_spread
from errpipe.diagnosis.empirical import equation
from errpipe.domain.diagnosis import Diagnosis, Empirical, EmpiricalTerm, Finding, FoundParameter
from errpipe.domain.driver import Input
from errpipe.drivers.evaluation import drive
from errpipe.drivers.library import candidates, unit_over
from errpipe.fitting.pursuit import NuisanceColumns
from errpipe.stages._apply_findings import apply_findings, in_words
from errpipe.terms import resolved_times
from tests.unit.diagnosis.machines import axis, mornings, spindle


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


LAWS = {  # of a spindle at changing speed: hidden law, factors, coefficient
    "a threshold": (lambda c: 1e-3 * np.maximum(c["rpm"] - 6500.0, 0.0), ("max(rpm - 6",), 1e-3),
    "a late response": (lambda c: 2e-3 * lag(c["t"], c["rpm"], 500.0), ("lag(rpm, ",), 2e-3),
    "a square times a temperature": (
        lambda c: 3e-8 * c["rpm"] ** 2 * (c["T_room"] - 20.0),
        "(rpm)^2 (T_room - 20)",
        3e-8,
    ),
    "speed times a rise": (lambda c: 4e-4 * c["rpm"] * (c["T_room"] - 20.0), ("rpm", "(T_room - 20)"), 4e-4),
}


def lag(t: np.ndarray, u: np.ndarray, tau: float) -> np.ndarray:
    """First-order lag of an input that is held between rows."""
    y = np.full(t.size, u[0])
    for k in range(1, t.size):
        y[k] = u[k - 1] + (y[k - 1] - u[k - 1]) * np.exp(-(t[k] - t[k - 1]) / tau)
    return y


@pytest.mark.parametrize("law", list(LAWS))
def test_time_constants_thresholds_exponents_and_references_are_fitted(law: str) -> None:
    """Beside a gain of the simulation that is 10 % off."""
    hidden, factors, coefficient = LAWS[law]
    made = spindle(2, hidden=hidden, gain=1.1)
    simulated = made.array("E_Z_sim")
    known = NuisanceColumns(np.column_stack([np.ones(simulated.size), simulated]), np.array([0.0, 0.3 / 0.1]))
    found = equation(made, np.arange(len(made)), made.array("E_Z") - simulated, "um", known)
    assert found is not None
    (term,) = found.terms
    assert all(factor in term.column for factor in factors)
    assert term.coefficient == pytest.approx(coefficient, rel=0.05)
    assert term.ci95[0] < 1.01 * coefficient and term.ci95[1] > 0.99 * coefficient
    shown = drive(term.driver, made)
    assert np.std(shown * term.coefficient) == pytest.approx(term.rms_um)


def test_an_equation_is_put_into_the_simulation_and_found_again_later(tmp_path: Path) -> None:
    """Names that the equation replaces are not looked for beside it."""
    hidden, *_ = LAWS["a square times a temperature"]
    made = spindle(2, hidden=hidden)
    diagnosis, _ = diagnose(made)
    unknown = diagnosis.responses[0].findings[0]
    assert unknown.effect == "unknown" and unknown.empirical is not None
    assert {"rpm", "T_room"} <= set(unknown.drivers)
    assert {t["term"] for t in unknown.all_terms()} == {"profile_driver"}
    document = apply_findings(made, diagnosis, tmp_path)
    (done,) = document["responses"]
    assert done["put_in"][0]["effect"] == "unknown" and not done["put_in"][0]["not_in_patch"]
    assert done["rms_after_um"] < 0.33  # noise of 0.3
    assert "added to the simulation: an empirical equation" in in_words(document)[0]
    (held,) = against(spindle(3, hidden=hidden), diagnosis)
    assert (held.effect, held.state) == ("unknown", "unchanged")
    (held,) = against(spindle(3, hidden=lambda c: 2.0 * hidden(c)), diagnosis)
    assert held.state == "larger" and held.k == pytest.approx(2.0, rel=0.1)


def test_an_equation_of_an_older_file_is_read_and_the_names_beside_it_are_looked_for() -> None:
    """An equation without its columns as operations has no term: only the names can be checked."""
    hidden = lambda c: 4e-4 * c["rpm"]  # noqa: E731
    diagnosis, _ = diagnose(spindle(2, hidden=hidden))
    document = diagnosis.document()
    (response,) = document["responses"]
    named = next(f for f in response["findings"] if f.get("term"))
    term = {"column": "(rpm)^2", "coefficient": 1e-8, "unit": "um/rpm2", "ci95": [0.0, 2e-8], "rms_um": 1.0}
    equation_of_before = {
        "terms": [term],
        "constant": 0.0,
        "unit": "um",
        "share": 0.5,
        "p": 0.01,
        "scheme": "",
        "says": "",
    }
    unknown = {"effect": "unknown", "confidence": 0.5, "empirical": equation_of_before}
    response["findings"] = [{**named, "term": None, "more_terms": [], "parameters": [], **unknown}, named]
    held = against(spindle(3, hidden=hidden), Diagnosis.model_validate(document))
    assert [h.effect for h in held] == [named["effect"]]


def test_the_earlier_spread_of_an_equation_is_that_of_its_largest_contribution() -> None:
    """Coefficients in um/rpm and um/K cannot be compared: the small number may be the large effect."""
    terms = [("um/rpm", 1e-3, 0.01, 8.0), ("um/K", 0.5, 0.9, 0.2)]  # unit, coefficient, relative spread, rms in um
    parts, sizes = [], []
    for unit, value, spread, rms in terms:
        ci95 = (value * (1 - 1.96 * spread), value * (1 + 1.96 * spread))
        parts.append(
            EmpiricalTerm(column="x", coefficient=value, unit=unit, ci95=ci95, rms_um=rms, driver=Input(name="x"))
        )
        sizes.append(FoundParameter(name="gain", value=value, unit=unit, ci95=ci95))
    made = Empirical(terms=tuple(parts), constant=0.0, unit="um", share=0.9, p=0.01, scheme="", says="")
    found = Finding.model_construct(effect="unknown", term=None, more_terms=(), parameters=tuple(sizes), empirical=made)
    assert earlier_spread(found) == pytest.approx(0.01)
