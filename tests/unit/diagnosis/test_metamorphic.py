"""The same case at another scale, mirrored, shifted, renamed, reordered or thinned gets the same answer."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe.errors import DataError
from tests.unit.diagnosis.metamorphic import CASES, CHANGES, answer, expected_size, pairs
from trials.units import ratio

FAST = {
    ("wave", "columns renamed"),
    ("lost motion", "positions mirrored"),
    ("lag", "temperatures 1e-3"),
    ("friction", "axis C"),
    ("push", "forces 1e-3"),
}


def said(response: dict, size: float, unit: str) -> str:
    """'' where a size of the first finding agrees with `size` to a tenth or covers it; else the output."""
    findings = [f for f in response["findings"] if f["effect"] != "recalibration"]
    if not findings:
        return str(response["verdict"])
    for p in findings[0]["parameters"]:
        factor = ratio(str(p["unit"]), unit) if p["unit"] != unit else 1.0
        if factor is None:
            continue
        low, high = sorted(abs(v * factor) for v in p.get("ci95") or [p["value"], p["value"]])
        if abs(abs(p["value"]) * factor - size) < 0.1 * size or low <= size <= high:
            return ""
    return ", ".join(f"{p['name']} {p['value']:.4g} {p['unit']}" for p in findings[0]["parameters"]) or "no size stated"


def check(case: str, change: str, where: Path) -> None:
    known = CASES[case]()
    changed = CHANGES[change].apply(known)
    try:
        response = answer(changed, where / "recording")
    except DataError as err:
        pytest.fail(f"not read: {err}")
    findings = [f["effect"] for f in response["findings"] if f["effect"] != "recalibration"]
    assert response["verdict"] == "missing_physics" and findings[:1] == [known.effect], (response["verdict"], findings)
    size = expected_size(known, CHANGES[change])
    assert said(response, size, changed.unit) == "", f"{size:.4g} {changed.unit} expected"


# A case with a fast change is checked there: its answer is the same only where the unchanged one is right.
ONLY_KNOWN = [pytest.param(c, marks=pytest.mark.slow if c in dict(FAST) else ()) for c in CASES]


@pytest.mark.parametrize("case", ONLY_KNOWN)
def test_known_answer(case: str, tmp_path: Path) -> None:
    known = CASES[case]()
    response = answer(known, tmp_path / "recording")
    assert [f["effect"] for f in response["findings"][:1]] == [known.effect]
    assert said(response, known.size, known.unit) == ""


def _marks(pair: tuple[str, str]) -> list[pytest.MarkDecorator]:
    return [] if pair in FAST else [pytest.mark.slow]


@pytest.mark.parametrize(("case", "change"), [pytest.param(*p, marks=_marks(p), id=" + ".join(p)) for p in pairs()])
def test_same_answer(case: str, change: str, tmp_path: Path) -> None:
    check(case, change, tmp_path)
