"""What a simulation may hold under another name; what held-out rows bear out beyond the noise of a row."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from errpipe.diagnosis import decompose, hypotheses, unnamed
from errpipe.diagnosis.prepare import condition

from .machines import axis, spindle


def test_an_effect_takes_the_place_of_the_part_that_stands_in_for_it():
    case = condition(spindle())
    rows = np.arange(len(case))
    library = hypotheses.build(case, "E_Z", rows)
    (first, *_), holding = decompose.decompose(3.0 * (case.array("T_bed") - 20.0), library, case, rows, 0.3)
    drift = next(i for i, h in enumerate(library.hypotheses) if h.drivers == ("T_bed",) and not h.nonlinear[0])
    growth = next(i for i, h in enumerate(library.hypotheses) if h.drivers == ("rpm",))
    assert library.hypotheses[drift].effect in [p.hypothesis.effect for p in first.parts]
    again = holding(first, drift)
    assert again[0].leftover < 0.01 and library.hypotheses[drift].effect in [
        p.hypothesis.effect for p in again[0].parts
    ]
    assert holding(first, growth) == []
    assert decompose.decompose(np.zeros(rows.size), library, case, rows, 0.3)[1] is None


def test_a_simulation_holds_no_effect_that_it_is_as_likely_without():
    """An expansion from a reference temperature of its own: a lead error beside it may take any share of the slope.

    Doubts about that share would play a lead error that is missing, and nothing would be named.
    """
    case = condition(axis())
    rows = np.arange(len(case))
    library = hypotheses.build(case, "EXX", rows)
    simulated = -16e-3 * case.array("x") * (case.array("T_bed") - 20.9)
    (first, *_), holding = decompose.decompose(simulated, library, case, rows, 0.5)
    lead = next(i for i, h in enumerate(library.hypotheses) if h.effect == "scale_error")
    assert [p.hypothesis.effect for p in first.parts] == ["scale_expansion"]
    assert all(p.certainty > 0 for d in holding(first, lead) for p in d.parts)


@pytest.mark.parametrize(("after", "noise", "stands"), [(1.0, 1.0, True), (1.0, 0.2, False), (1.3, 1.0, False)])
def test_names_are_judged_by_what_they_leave_beyond_the_noise_of_a_row(after, noise, stands):
    held = SimpleNamespace(before=1.23, after=after)
    assert unnamed.borne_out(SimpleNamespace(noise_estimate=noise), held) is stands
