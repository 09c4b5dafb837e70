"""Checklists of a table that counts from the start of the machine, as drift models do."""

from __future__ import annotations

import pytest

from errpipe.domain import driver as d
from errpipe.drivers.lowered import Lowered
from errpipe.stages._checklist import checklist
from errpipe.stages.targets import losses
from errpipe.targets import TARGETS
from tests.unit.targets import machines


def text(name: str, rise: d.Driver) -> str:
    table = machines.compile_(("EXX", [Lowered(rise)]))
    free = tuple(i.model_copy(update={"valid": None, "margin": None}) if i.name == "T" else i for i in table.inputs)
    table = table.model_copy(update={"inputs": free})  # as of a model whose validity range is one of rises
    target = next(t for t in TARGETS if t.name == name)
    files = target.write(table)
    return checklist(target, target.read_back(files), losses(table, target, files), table)


SINCE_START = d.Affine(weights=(2.0, -2.0), of=(d.Input(name="T"), d.First(of=d.Input(name="T"))))


def test_the_zero_is_to_be_set_where_the_table_starts() -> None:
    asked = text("c_runtime", SINCE_START)
    assert "X: the correction is 0 at each start of the table" in asked and "again after a restart while warm" in asked
    assert "at each start of the table" not in text("c_runtime", d.above("T", 20.0))


@pytest.mark.parametrize(("name", "said"), [("sinumerik_temperature", True), ("c_runtime", False)])
def test_a_loss_in_settled_states_alone_is_not_stated_as_none(name: str, said: bool) -> None:
    assert ("- X: not assessed" in text(name, SINCE_START)) is said
