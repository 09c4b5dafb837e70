"""What a refused export says of the group that spoilt it."""

from __future__ import annotations

import pytest

from errpipe.errors import GateError
from errpipe.models.terms import Terms
from errpipe.simulation import spindle_drift
from errpipe.validation.gate import pass_gate


def refusal(after: list[float]) -> str:
    recording, _ = spindle_drift.simulate(1, days=spindle_drift.DAYS[:2])
    model = Terms.model_validate({"components": [{"component": "E_Z", "terms": [{"term": "offset"}]}]})
    groups = [{"label": f"day {n}", "rms_before": 50.0, "rms_after": a} for n, a in enumerate(after, 1)]
    judged = {"component": "E_Z", "unit": "um", "gain": 0.0, "rms_before": 50.0, "rms_after": 60.0, "rms_at_gain": 50.0}
    judged |= {"p_value": 1.0, "runs": len(after), "groups": groups}
    with pytest.raises(GateError) as refused:
        pass_gate(model.fit(recording).model, [{"scheme": "leave-one-run-out", "components": [judged]}])
    return str(refused.value)


def test_a_single_run_that_is_worse_is_named() -> None:
    """One day with its sign reversed: the model of the others doubles its deviation."""
    assert "E_Z is worse in day 3 alone (50 -> 105 um)" in refusal([50.0, 4.0, 105.0, 3.0])


@pytest.mark.parametrize("after", [[70.0, 80.0, 3.0, 4.0], [50.0, 50.0, 50.0], [3.0, 90.0]])
def test_none_is_named_where_several_are_worse_or_none_or_few_were_held_out(after: list[float]) -> None:
    assert "alone" not in refusal(after)
