"""The run page: same bytes for the same data, nothing from the network, every number it was given."""

import re
from dataclasses import replace

import numpy as np
import pytest

from errpipe.reporting import page
from errpipe.reporting.run_report import Response, RunReport, render, residuals


@pytest.fixture(scope="module")
def report() -> RunReport:
    rng = np.random.default_rng(0)
    x = np.linspace(0.0, 800.0, 300)
    deviation = 0.03 * x + rng.normal(size=x.size)
    slope = {"name": "k", "value": 30.0, "ci95": (29.0, 31.0), "unit": "um/m"}
    row = {"rows": 150, "rms_before": 12.0, "rms_after": 1.01, "bias": 0.1, "scatter": 0.9, "worst": 3.0}
    response = Response(
        component="EXX",
        unit="um",
        deviation=deviation,
        predicted=0.03 * x,
        groups=["1"] * 150 + ["2"] * 150,
        inputs={"x in mm": x, "T_nut in degC": rng.normal(20.0, 1.0, x.size)},
        rms_before=14.1,
        rms_after=1.01,
        noise_floor=0.98,
        terms=[{"says": "lead <error>", "equation": "k x", "of": "axis X", "parameters": [slope]}],
        table=[{"group": "1", "coverage90": 0.91, **row}, {"group": "2", "coverage90": None, **row}],
        scheme="leave one run out",
    )
    return RunReport(title="X axis", machine="vmc-1", version="0", fingerprint="abc", responses=[response])


def test_equal_data_equal_bytes(report):
    assert render(report) == render(report)


def test_page_needs_no_network_and_carries_no_clock(report):
    text = render(report)
    links = re.findall(r'(?:href|src)="(?!#)([^"]+)"', text)
    assert links == []
    assert "<dc:date>" not in text
    assert "<script" not in text


def test_page_says_the_three_numbers_and_escapes_text(report):
    text = render(report)
    for figure in ("14.1 um", "1.01 um", "0.98 um"):
        assert f"<b>{figure}</b>" in text
    assert "lead &lt;error&gt;" in text
    assert "lead <error>" not in text
    assert "(axis X)" in text and "noise floor 0.98 um" in text


@pytest.mark.parametrize(
    ("value", "text"), [(None, "–"), (float("nan"), "–"), (1234.0, "1230"), (0.00123, "0.00123"), (12.0, "12")]
)
def test_numbers_for_readers(value, text):
    assert page.number(value) == text


def test_on_a_narrow_screen_figures_fit_and_tables_scroll(report):
    text = render(report)
    assert "figure svg { width: 100%;" in text and ".wide { overflow-x: auto;" in text
    (narrow,) = re.findall(r"@media screen and [(]max-width: 46rem[)] [{](.*)[}]", text)
    assert "min-width" not in narrow, "a figure wider than the screen is cut at its edge"
    assert "figure:focus svg { width: 44rem; }" in narrow, "a tap enlarges a figure"
    assert text.count("<table>") == text.count('<div class="wide"><table>')
    assert "<figure>" not in text, "without tabindex a figure cannot be focused by a tap"


def test_a_column_has_equal_decimals(report):
    """0.41 stood below 0.413, and -0.00216 beside 0.065."""
    text = render(report)
    assert report.responses[0].decimals == 2
    for cell in ("12.00", "1.01", "0.10", "0.90", "3.00"):
        assert f">{cell}</td>" in text, cell
    assert page.fixed(-0.0004, 2) == "0.00" and page.fixed(None, 2) == "–"


def test_the_words_are_those_of_the_glossary(report):
    text = render(report)
    assert "EXX uncompensated, rms" in text and "residual, rms on held-out rows" in text


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (-0.06487, (-0.1302, 0.00049), "-0.065"),
        (5.8143, (5.0990, 6.5300), "5.81"),
        (1234.56, (1200.0, 1270.0), "1235"),
        (12.0, None, "12"),
        (3.0, (3.0, 3.0), "3"),
        (1.23456789, (1.23456784, 1.23456794), "1.23456789"),
        (212346.0, (212225.0, 212465.0), "212350"),
        (float("nan"), (0.0, 1.0), "–"),
    ],
)
def test_a_parameter_has_the_decimals_that_its_interval_supports(value, interval, text):
    assert page.within(value, interval) == text


def test_a_p_value_is_not_given_beyond_what_a_test_can_tell():
    assert page.probability(1.34e-133) == "< 1e-6" and page.probability(0.0123) == "0.0123"
    assert page.probability(None) == "–"


def test_an_input_that_does_not_vary_has_no_figure(report):
    (response,) = report.responses
    constant = np.zeros(response.deviation.size)
    assert residuals(replace(response, inputs={"y in mm": constant, "z in mm": constant * np.nan})) == ""
    both = residuals(replace(response, inputs={"y in mm": constant, **response.inputs}))
    assert "y in mm" not in both and "T_nut in degC" in both


def test_what_must_be_checked_first_stands_before_the_figures(report):
    text = render(replace(report, warning="The sign was assumed."))
    assert text.index("The sign was assumed.") < text.index('class="figures"')


def test_a_residual_above_the_uncompensated_rms_is_marked(report):
    worse = replace(report.responses[0], rms_after=20.0)
    assert '<b class="bad">20 um</b>' in render(replace(report, responses=[worse]))
