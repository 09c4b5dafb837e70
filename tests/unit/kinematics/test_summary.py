"""The document of an identification: complete, plain, and the same machine when read back."""

from __future__ import annotations

import numpy as np
import protocols_played as played
import pytest
from machines import ready, volume_points
from numpy.testing import assert_allclose

from errpipe import jsonfile
from errpipe.errors import VerifyError
from errpipe.kinematics import identify, protocols, summary, synthesis
from errpipe.simulation import metrology


@pytest.fixture(scope="module")
def found():
    chain = ready("cmm")
    protocol, runs = played.cloud(chain)
    recording = metrology.simulate_runs(chain, metrology.smooth_machine(chain, 1), protocol, runs[:1], 1)
    test = protocols.observations(chain, recording)
    return chain, test, identify.identify(identify.Parametrisation.of(chain, modes=8), test)


def test_the_document_is_plain_and_read_back_it_is_the_same_machine(found, tmp_path):
    chain, test, result = found
    written = summary.document(result, test)
    jsonfile.write(tmp_path / "m.json", written)
    again = summary.errors(chain, jsonfile.read(tmp_path / "m.json"))
    q = volume_points(chain, [5, 5, 5])
    assert_allclose(synthesis.first_order(chain, q, again.at(q))[:, :3], result.predict(q)[0], atol=0.15)


def test_a_component_compensated_in_part_is_read_back_in_part(found):
    chain, test, result = found
    written = summary.document(result, test)
    full, part = summary.errors(chain, written), summary.errors(chain, written, {"EXX": 0.25, "C0Y": 0.5})
    q = volume_points(chain, [3, 3, 3])
    factors = np.array([{"EXX": 0.25, "C0Y": 0.5}.get(c, 0.0) for c in chain.components])
    assert_allclose(part.at(q), full.at(q) * factors, atol=1e-12)
    assert np.abs(part.at(q)).max(axis=0)[factors > 0.0].min() > 0.1


def test_it_names_what_one_tool_cannot_see_and_what_would_show_it(found):
    _, test, result = found
    written = summary.document(result, test)
    assert any("ECZ" in u["components"] for u in written["unseen"])
    assert any("ECZ" in e["shows"] for e in written["would_show"])
    assert written["rank"] < written["parameters"]
    assert {"C0Y", "A0Z", "B0Z"} == {row["component"] for row in written["constants"]}
    assert len(written["curves"]) == 18
    assert written["volumetric"]["beyond_first_order"]["largest_um"] < 0.5


def test_another_machines_document_is_refused(found):
    _, test, result = found
    written = summary.document(result, test, extra=False)
    with pytest.raises(VerifyError, match="not of 'gantry'"):
        summary.errors(ready("gantry"), written)
    with pytest.raises(VerifyError, match="version 1"):
        summary.errors(ready("cmm"), written | {"identification": 2})


def test_equal_readings_give_equal_bytes(found):
    chain, test, result = found
    again = identify.identify(result.model, test)
    assert jsonfile.dumps(summary.document(result, test)) == jsonfile.dumps(summary.document(again, test))
    assert np.isfinite(result.residual).all() and chain.machine.name == "cmm"
