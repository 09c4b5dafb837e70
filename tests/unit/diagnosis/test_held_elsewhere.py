"""What a simulation may hold under another name; what held-out rows bear out beyond the noise of a row."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from errpipe.diagnosis import decompose, hypotheses, unnamed
from errpipe.diagnosis.prepare import condition

from .machines import spindle


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


@pytest.mark.parametrize(("after", "noise", "stands"), [(1.0, 1.0, True), (1.0, 0.2, False), (1.3, 1.0, False)])
def test_names_are_judged_by_what_they_leave_beyond_the_noise_of_a_row(after, noise, stands):
    held = SimpleNamespace(before=1.23, after=after)
    assert unnamed.borne_out(SimpleNamespace(noise_estimate=noise), held) is stands
