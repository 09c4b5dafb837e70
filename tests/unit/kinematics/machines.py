"""Machines for the tests: the ready files, and random ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from errpipe.domain.machine import Machine
from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain, combinations, compile_chain

READY = sorted((Path(__file__).parents[3] / "examples" / "machines").glob("*.yaml"))


def ready(name: str) -> Chain:
    """A compiled machine of examples/machines."""
    path = next(p for p in READY if p.stem == name)
    return compile_chain(Machine.model_validate(YAML(typ="safe", pure=True).load(path.read_text())))


def random_chain(rng: np.random.Generator) -> Chain:
    """Any serial chain: two to six axes in any order and direction, on either side of the bed."""
    linear = list(rng.permutation(["X", "Y", "Z"])[: rng.integers(1, 4)])
    rotary = list(rng.permutation(["A", "B", "C"])[: rng.integers(0 if len(linear) > 1 else 1, 4)])
    names = list(rng.permutation(linear + rotary))
    bed = int(rng.integers(0, len(names) + 1))
    links = [f"{n}'" for n in names[:bed]] + ["bed"] + names[bed:]
    spindle = int(rng.integers(0, len(links) + 1))
    links.insert(spindle, "spindle")
    axes = {}
    for name in names:
        tilted = rng.random() < 0.3
        axes[str(name)] = {
            "kind": "linear" if name in "XYZ" else "rotary",
            "travel": [-400, 400] if name in "XYZ" else [-180, 180],
            "reference": tuple(rng.uniform(-500, 500, 3)),
            "reference_on": str(rng.choice(["carriage", "guideway"])),
            "errors_of": str(rng.choice(["tool_side", "carriage"])),
            "direction": tuple(rng.normal(size=3)) if tilted else None,
            "drifts": bool(rng.random() < 0.5),
        }
    machine = Machine.model_validate(
        {
            "machine": 1,
            "name": "random",
            "left_handed": True,
            "chain": ["workpiece", *map(str, links), "tool"],
            "axes": axes,
            "spindle": {"position": tuple(rng.uniform(-500, 500, 3)), "growth": True, "tilt": True},
            "tool": {"length": float(rng.uniform(0, 300)), "direction": tuple(rng.normal(size=3))},
        }
    )
    return compile_chain(machine)


def corrected(
    chain: Chain, q: np.ndarray, deviation: np.ndarray, tip: np.ndarray | None = None, orientation: bool = False
) -> np.ndarray:
    """Commanded axes that undo a deviation (n, 6) at commanded q: q - d, shape (n, axes).

    Position alone moves the linear axes; with `orientation` all axes keep the point and the tool's direction (its
    turn about itself is free).
    The correction is minus the deviation, turned into axis motions.
    """
    jac = synthesis.motion_jacobian(chain, q, tip)
    if not orientation:
        linear = [i for i, a in enumerate(chain.axes) if chain.machine.axes[a].kind == "linear"]
        step = np.einsum("nai,ni->na", np.linalg.pinv(jac[:, :3][:, :, linear]), deviation[:, :3] * 1e-3)
        out = q.copy()
        out[:, linear] -= step
        return out
    pose = synthesis.ideal_pose(chain, q, tip)
    tool = np.einsum("k,nkj->nj", np.asarray(chain.machine.tool.direction), pose[:, 1:])
    swing = np.cross(np.moveaxis(jac[:, 3:], 1, 2), tool[:, None, :])  # how each axis moves the tool's direction, deg
    wanted = np.concatenate([deviation[:, :3] * 1e-3, np.degrees(np.cross(deviation[:, 3:] * 1e-6, tool))], axis=1)
    solve = np.linalg.pinv(np.concatenate([jac[:, :3], np.moveaxis(swing, 1, 2)], axis=1), rcond=1e-6)
    return q - np.einsum("nai,ni->na", solve, wanted)


def volume_points(chain: Chain, per_axis: Sequence[int], margin: float = 0.02) -> np.ndarray:
    """A lattice of poses over the travel of every axis, shape (n, axes)."""
    low, high = chain.travel.T
    edge = (high - low) * margin
    grids = [
        np.linspace(lo + e, hi - e, n) if n > 1 else np.array([(lo + hi) / 2])
        for lo, hi, e, n in zip(low, high, edge, per_axis, strict=True)
    ]
    return combinations(grids)
