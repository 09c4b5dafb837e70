"""`errpipe synthesis` prints what the synthesis computes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from errpipe import yamlfile
from errpipe.cli.app import main
from errpipe.domain.machine import Machine
from errpipe.kinematics import synthesis as model
from errpipe.kinematics.chain import compile_chain

MACHINES = Path(__file__).parents[3] / "examples" / "machines"
LINEAR = ("cmm", "gantry", "horizontal-centre-ni-1997", "turning-centre", "vertical-centre")


@pytest.mark.parametrize("name", LINEAR)
def test_the_printed_terms_are_the_first_order_deviation(name, capsys):
    file = MACHINES / f"{name}.yaml"
    assert main(["synthesis", str(file), "--json"]) == 0
    outputs = json.loads(capsys.readouterr().out)["result"]["outputs"]
    chain = compile_chain(yamlfile.load(file, Machine))
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1])[None]
        length, offset = rng.uniform(50, 250), rng.normal(0, 40, 3)
        values = rng.normal(0, 10, len(chain.components))
        symbols = dict(zip(chain.axes, q[0], strict=True)) | dict(
            zip(("L", "TX", "TY", "TZ"), (length, *offset), strict=True)
        )
        expected = model.first_order(chain, q, values[None], chain.tip(length, tuple(offset)))[0, :3]
        for k, axis in enumerate("XYZ"):
            total = 0.0
            for term in outputs[f"E_{axis}"]:
                c = chain.index(term["component"])
                arm = term["constant"] + sum(v * symbols[n] for n, v in term["per"].items())
                total += arm * values[c] * (1e-3 if chain.angular[c] else 1.0)
            assert total == pytest.approx(expected[k], abs=1e-6)


def test_the_papers_machine_has_32_components(capsys):
    main(["synthesis", str(MACHINES / "horizontal-centre-ni-1997.yaml")])
    out = capsys.readouterr().out
    assert "32 components" in out and "E_X =" in out and "EBX" in out


def test_a_rotary_axis_is_refused_in_words(capsys):
    assert main(["synthesis", str(MACHINES / "five-axis-table-table.yaml")]) == 2
    assert "has rotary axes" in capsys.readouterr().err
