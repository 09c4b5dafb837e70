"""Quantities with their unit, and the conversion to the unit of a field."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from errpipe.yamlfile import Options, convert, parse
from tests.unit.yamlfile.written_models import Line, Model, problems


@pytest.mark.parametrize(
    "text, unit, value",
    [
        ("20 um", "um", 20.0),
        ("0.02 mm", "um", 20.0),
        ("20um", "mm", 0.02),
        ("68 degF", "degC", 20.0),
        ("293.15 K", "degC", 20.0),
        ("9 delta_degF", "K", 5.0),
        ("-1e3 mm/s", "m/s", -1.0),
        ("2 h", "s", 7200.0),
        ("1.1 inch", "mm", 27.94),
        ("3 bogus", "bogus", 3.0),
        ("1 bar", "hPa", 1000.0),
        ("5 %", "1", 0.05),
        ("0.1 m", "mm", 100.0),
        ("0.3 m", "mm", 300.0),
    ],
)
def test_quantities_are_rounded_once(text: str, unit: str, value: float) -> None:
    assert convert(text, unit) == value


@pytest.mark.parametrize(
    "text, unit, message",
    [
        ("5 mn", "um", "found unit 'mn' .*Did you mean m.$"),
        ("5 s", "um", "found unit 's' .allowed: nm, um"),
        ("5 degC", "K", "found unit 'degC' .allowed: K, delta_degC"),
        ("5 N", "um/m/K", "found unit 'N' .allowed: um/m/K"),
        ("five um", "um", "a number with its unit"),
        ("1e308 m", "um", "is not a finite number of um"),
    ],
)
def test_a_unit_of_another_dimension_is_refused(text: str, unit: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        convert(text, unit)


@settings(deadline=None)
@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e9, max_value=1e9))
def test_a_unit_that_is_the_fields_own_changes_no_bit(number: float) -> None:
    assert convert(f"{number!r} um", "um") == number


def test_quantities_in_fields() -> None:
    text = "version: 1\nterms:\n  - {kind: step, height: 0.02 mm, sides: [1, 2 cm]}\n  - {kind: line, slope: 3}"
    model = parse(text).validate(Model)
    assert model.terms[0].height == 20.0 and model.terms[0].sides == (1.0, 20.0) and model.terms[1].slope == 3.0
    assert problems("version: 1\nterms: [{kind: step, height: 5 s}]") == [
        "f.yaml:2:30  terms[0].height: found unit 's' (allowed: nm, um, mm, cm, m, km, inch)."
    ]
    assert problems("version: 1\nterms: [{kind: step, height: -0.5 m, sides: [1, low]}]") == [
        "f.yaml:2:49  terms[0].sides[1]: found the text 'low' (a number is needed)"
    ]


class Late(Options):
    """No `kind`: distinguished from the other members of a union by that."""

    tau: tuple[float, ...] = Field(min_length=1, json_schema_extra={"unit": "s"})
    above: float = Field(0.0, json_schema_extra={"unit": "of the input"})


class Mixed(Options):
    factors: tuple[Late | Line, ...] = Field((), min_length=1)


def test_quantities_in_lists_of_a_model_without_a_kind() -> None:
    model = parse("factors: [{tau: [60 s, 50 min, 2]}, {kind: line}]").validate(Mixed)
    assert model.factors[0] == Late(tau=(60.0, 3000.0, 2.0))
    assert "f.yaml:1:18  factors[0].tau[0]: found unit 'mm' (allowed: us, ms, s, min, h, d)." in problems(
        "factors: [{tau: [1 mm]}]", Mixed
    )


def test_a_unit_that_points_elsewhere_is_none_to_convert_to() -> None:
    class Above(Options):
        above: float = Field(0.0, ge=0, json_schema_extra={"unit": "of the input"})

    assert problems("above: 20 degC", Above) == ["f.yaml:1:8  above: found the text '20 degC' (a number is needed)"]
    assert problems("above: -1", Above) == ["f.yaml:1:8  above: -1 is not at least 0"]


@pytest.mark.parametrize("entry", ["{kind: line, slope: a}", "{kind: line, slop: 1}", "{kind: line, slope: -1}", "7"])
def test_a_list_whose_entry_is_wrong_is_not_called_short_as_well(entry: str) -> None:
    class Lines(Options):
        lines: tuple[Line, ...] = Field(min_length=1)

    (only,) = problems(f"lines: [{entry}]", Lines)
    assert "lines[0]" in only
    assert problems("lines: []", Lines) == ["f.yaml:1:8  lines: has 0 entries (at least 1 needed)"]
