"""Exact against first order on random machines, derivatives against differences, compensation in closed loop."""

from __future__ import annotations

import numpy as np
import pytest
from machines import corrected, random_chain, ready, volume_points
from numpy.testing import assert_allclose

from errpipe.kinematics import polynomials
from errpipe.kinematics import synthesis as s
from errpipe.kinematics.errors import MachineErrors
from errpipe.simulation import metrology

CHAINS = 600


def random_errors(rng, chain, n, angle=150.0, shift=80.0):
    size = np.where(chain.angular, angle, shift)
    return rng.normal(0, 1, (n, len(chain.components))) * size


def test_exact_and_first_order_agree_within_the_second_order_bound():
    """Any serial chain, two to six axes, tilted axes, work- and tool-carrying, errors on carriage or guideway."""
    rng, tightest = np.random.default_rng(20), 0.0
    for _ in range(CHAINS):
        chain = random_chain(rng)
        q = rng.uniform(-400, 400, (4, len(chain.axes)))
        comps = random_errors(rng, chain, 4)
        gap = np.linalg.norm((s.exact(chain, q, comps) - s.first_order(chain, q, comps))[:, :3], axis=1)
        bound = s.second_order_bound(chain, q, comps)
        assert (gap <= bound * (1 + 1e-9) + 1e-7).all()
        tightest = max(tightest, float((gap / bound).max()))
    assert tightest > 0.2  # the bound is no empty promise


def test_remainder_falls_with_the_square_of_the_errors():
    rng = np.random.default_rng(3)
    for _ in range(20):
        chain = random_chain(rng)
        q, comps = rng.uniform(-300, 300, (5, len(chain.axes))), None
        comps = random_errors(rng, chain, 5)
        large, small = s.remainder(chain, q, comps)["rms_um"], s.remainder(chain, q, comps / 10)["rms_um"]
        assert_allclose(small, large / 100, rtol=0.05, atol=1e-6)


def test_jacobian_is_the_derivative_of_the_exact_deviation():
    rng = np.random.default_rng(4)
    for _ in range(40):
        chain = random_chain(rng)
        q = rng.uniform(-300, 300, (1, len(chain.axes)))
        jac = s.jacobian(chain, q)[0]
        for c in range(len(chain.components)):
            step = np.zeros(len(chain.components))
            step[c] = 1.0
            slope = (s.exact(chain, q, step)[0] - s.exact(chain, q, -step)[0]) / 2
            assert_allclose(slope, jac[:, c], atol=2e-6)


def test_polynomials_are_the_jacobian_in_letters():
    rng = np.random.default_rng(5)
    for _ in range(40):
        chain = random_chain(rng)
        q, length, offset = rng.uniform(-300, 300, len(chain.axes)), 137.0, (3.0, -40.0, 7.0)
        values = dict(zip(chain.axes, q, strict=True)) | {"tool_length": length}
        values |= {
            f"{f} {a}": getattr(np, f)(np.radians(v))
            for a, v in zip(chain.axes, q, strict=True)
            for f in ("sin", "cos")
        }
        values |= {f"tool_offset_{d}": v for d, v in zip("XYZ", offset, strict=True)}
        jac = s.jacobian(chain, q, chain.tip(length, offset))[0]
        result = np.zeros_like(jac)
        for (output, component), letters in polynomials.jacobian(chain, "workpiece").items():
            row = ("E_X", "E_Y", "E_Z", "E_A", "E_B", "E_C").index(output)
            result[row, chain.index(component)] = sum(
                v * np.prod([values[n] for n in key]) for key, v in letters.items()
            )
        assert_allclose(result, jac, atol=1e-9)


def test_no_errors_no_deviation():
    chain = ready("five-axis-table-table")
    q = volume_points(chain, [3] * 5)
    assert_allclose(s.exact(chain, q, np.zeros(43)), 0.0, atol=1e-9)


def test_renamed_axes_give_the_same_numbers():
    """X Y Z turned into Y Z X: deviations turn along."""
    from machines import READY
    from ruamel.yaml import YAML

    from errpipe.domain.machine import Machine
    from errpipe.kinematics.chain import compile_chain

    plain = YAML(typ="safe", pure=True).load(next(p for p in READY if p.stem == "gantry").read_text())
    plain["spindle"] |= {"growth": False, "tilt": False}
    new = dict(zip("XYZABC", "YZXBCA", strict=True))
    turned = plain | {"chain": [new.get(n, n) for n in plain["chain"]], "datum_axes": ["Y", "Z", "X"]}
    roll = lambda v: [v[2], v[0], v[1]]  # noqa: E731
    turned["axes"] = {new[a]: v | {"reference": roll(v["reference"])} for a, v in plain["axes"].items()}
    turned["spindle"] = {"position": roll(plain["spindle"]["position"])}
    turned["tool"] = {"length": 200, "direction": [-1, 0, 0]}
    one, two = (compile_chain(Machine.model_validate(m)) for m in (plain, turned))
    rng = np.random.default_rng(0)
    comps = rng.normal(0, 20, (6, 21))
    renamed = ["".join(new.get(c, c) for c in n[:-1]) + new[n[-1]] for n in one.components]
    q = rng.uniform(0, 800, (6, 3))
    swapped = np.zeros_like(comps)
    for c, name in enumerate(renamed):
        swapped[:, two.index(name)] = comps[:, c]
    got = s.exact(two, q[:, [2, 0, 1]], swapped)
    assert_allclose(got[:, [1, 2, 0, 4, 5, 3]], s.exact(one, q, comps), atol=1e-7)


def residual(chain, errors, q, command, tip=None) -> np.ndarray:
    """Distance of the tool, sent to `command`, from where it should be at q, um."""
    actual = s.actual_pose(chain, command, errors.at(command), tip)[:, 0]
    return np.linalg.norm(actual - s.ideal_pose(chain, q, tip)[:, 0], axis=1) * 1e3


@pytest.mark.parametrize(
    "name",
    ["vertical-centre", "horizontal-centre-ni-1997", "gantry", "five-axis-table-table", "five-axis-head-head", "cmm"],
)
def test_closed_loop_reduces_the_error_at_least_twentyfold(name):
    """Commands corrected with the first-order model, exact transforms as truth, errors known without noise."""
    chain = ready(name)
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 5))
    rng = np.random.default_rng(1)
    inner = chain.travel + np.ptp(chain.travel, axis=1)[:, None] * np.array([0.01, -0.01])
    q = rng.uniform(inner[:, 0], inner[:, 1], (500, len(chain.axes)))
    before = residual(chain, errors, q, q)
    command = corrected(chain, q, s.first_order(chain, q, errors.at(q)))
    after = residual(chain, errors, q, command)
    assert np.sqrt(np.mean(before**2)) > 20 * np.sqrt(np.mean(after**2))
    assert before.max() > 20 * after.max()


def test_orientation_is_corrected_too_where_axes_allow():
    chain = ready("five-axis-head-head")
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 5))
    q = np.random.default_rng(1).uniform(chain.travel[:, 0] * 0.9, chain.travel[:, 1] * 0.9, (200, 5))
    q[:, 3] = np.sign(q[:, 3]) * (20 + 0.5 * np.abs(q[:, 3]))  # away from the pole of the head
    command = corrected(chain, q, s.first_order(chain, q, errors.at(q)), orientation=True)
    tool = np.array(chain.machine.tool.direction)
    ideal = np.einsum("k,nkj->nj", tool, s.ideal_pose(chain, q)[:, 1:])
    before, after = (
        np.linalg.norm(np.einsum("k,nkj->nj", tool, s.actual_pose(chain, c, errors.at(c))[:, 1:]) - ideal, axis=1)
        for c in (q, command)
    )
    assert np.sqrt(np.mean(after**2)) < 0.1 * np.sqrt(np.mean(before**2))
    assert residual(chain, errors, q, command).max() < 0.2 * residual(chain, errors, q, q).max()
