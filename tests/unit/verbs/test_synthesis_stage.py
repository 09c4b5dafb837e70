"""`errpipe synthesis` prints what the synthesis computes, for linear and rotary axes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from errpipe import yamlfile
from errpipe.cli.app import main
from errpipe.domain.machine import Machine
from errpipe.kinematics import synthesis as model
from errpipe.kinematics.chain import compile_chain

MACHINES = sorted((Path(__file__).parents[3] / "examples" / "machines").glob("*.yaml"))
PAPER = next(p for p in MACHINES if "ni-1997" in p.stem)


@pytest.mark.parametrize("file", MACHINES, ids=lambda p: p.stem)
def test_the_printed_expressions_are_the_first_order_deviation(file, capsys):
    """Every summand of every arm; a line holds as many."""
    assert main(["synthesis", str(file), "--json"]) == 0
    outputs = json.loads(capsys.readouterr().out)["result"]["outputs"]
    chain = compile_chain(yamlfile.load(file, Machine))
    rng = np.random.default_rng(1)
    for _ in range(4):
        q = rng.uniform(chain.travel[:, 0], chain.travel[:, 1])[None]
        length, offset = rng.uniform(50, 250), rng.normal(0, 40, 3)
        values = rng.normal(0, 10, len(chain.components))
        known = {"L": length} | dict(zip(("TX", "TY", "TZ"), offset, strict=True))
        for name, place in zip(chain.axes, q[0], strict=True):
            known[name] = place if chain.machine.axes[name].kind == "linear" else math.radians(place)
        expected = model.first_order(chain, q, values[None], chain.tip(length, tuple(offset)))[0, :3]
        for k, axis in enumerate("XYZ"):
            total = 0.0
            for term in outputs[f"E_{axis}"]:
                c = chain.index(term["component"])
                arm = sum(part["coefficient"] * math.prod(_value(n, known) for n in part["of"]) for part in term["arm"])
                assert len(term["arm"]) == 1 + term["expression"][1:].replace("e-", "").count(" + ") + term[
                    "expression"
                ].count(" - ")
                total += arm * values[c] * (1e-3 if chain.angular[c] else 1.0)
            assert total == pytest.approx(expected[k], abs=1e-6)


def _value(name: str, known: dict) -> float:
    function, _, axis = name.rpartition(" ")
    return getattr(math, function)(known[axis]) if function else known[axis]


def test_the_papers_machine_has_32_components(capsys):
    assert main(["synthesis", str(PAPER)]) == 0
    out = capsys.readouterr().out
    assert "32 components" in out and "E_X =" in out and "+ (L + TZ - 140) EBX" in out


def test_a_five_axis_machine_is_printed_with_its_sines(capsys):
    assert main(["synthesis", str(next(p for p in MACHINES if "table-table" in p.stem))]) == 0
    out = capsys.readouterr().out
    assert "43 components" in out and "sin(" in out and "cos(" in out
    assert "sin(C)*sin(C)" not in out and "sin(A)*sin(A)" not in out
