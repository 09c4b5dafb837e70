"""The proof of a volumetric table: in the workpiece's frame, below its bound, and a failed run where it is not."""

from __future__ import annotations

from pathlib import Path

import pytest
from ruamel.yaml import YAML

from errpipe.domain.machine import Machine
from errpipe.errors import VerifyError
from errpipe.kinematics.chain import compile_chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.simulation import metrology
from errpipe.stages import _artefacts
from errpipe.stages.export_volumetric import bound, compile_machine, largest_difference, verify_bound
from errpipe.tables import ect

READY = sorted((Path(__file__).parents[3] / "examples" / "machines").glob("*.yaml"))
REVERSAL = {"EXX": (3.0, 2.0, 100.0)}


@pytest.mark.parametrize("path", READY, ids=lambda p: p.stem)
def test_every_ready_machine_is_proved_within_its_bound(path):
    chain = compile_chain(Machine.model_validate(YAML(typ="safe", pure=True).load(path.read_text())))
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 3), nodes=33)
    table = compile_machine(chain, errors, "0" * 64, "", 0.01, REVERSAL, chain.machine.linear_axes())
    worst, allowed = largest_difference(chain, errors, table, REVERSAL), bound(chain, table)
    assert 0 < worst <= allowed + 2e-3 and allowed < 1.0
    verify_bound(worst, allowed)


def test_a_table_with_one_wrong_weight_fails_the_run():
    chain = compile_chain(Machine.model_validate(YAML(typ="safe", pure=True).load(READY[1].read_text())))
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 3), nodes=33)
    table = compile_machine(chain, errors, "0" * 64, "", 0.01, {}, chain.machine.linear_axes())
    outputs = list(table.outputs)
    terms = list(outputs[0].terms)
    terms[0] = terms[0].model_copy(update={"weight": -terms[0].weight})
    outputs[0] = outputs[0].model_copy(update={"terms": tuple(terms)})
    wrong = table.model_copy(update={"outputs": tuple(outputs)})
    with pytest.raises(VerifyError, match="Nothing was exported"):
        verify_bound(largest_difference(chain, errors, wrong), bound(chain, wrong))


def test_a_table_whose_file_says_something_else_is_not_exported(tmp_path, monkeypatch):
    chain = compile_chain(Machine.model_validate(YAML(typ="safe", pure=True).load(READY[1].read_text())))
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 3), nodes=33)
    table = compile_machine(chain, errors, "5e" * 32, "", 0.01, {}, chain.machine.linear_axes())
    _artefacts.write_table(tmp_path, table)
    assert (
        _artefacts.read_table(tmp_path / _artefacts.TABLE) == _artefacts.read_table(tmp_path / _artefacts.TWIN) == table
    )
    wrong = ect.dumps(table.model_copy(update={"title": "another"}))
    monkeypatch.setattr(ect, "dumps", lambda _: wrong)
    with pytest.raises(VerifyError, match="read back from its file is not the table"):
        _artefacts.write_table(tmp_path, table)
