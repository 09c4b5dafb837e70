"""The error model of a machine in symbols: what each component does to the tool point, for any chain of linear axes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from errpipe.kinematics.chain import Chain

ZERO = 1e-9  # mm: arms below are rounding
TOOL = ("L", "TX", "TY", "TZ")  # length along the tool, offsets beside it


def synthesis(machine: Path) -> tuple[dict[str, Any], list[str]]:
    """The document and its lines. Raises UsageError for a machine with rotary axes, whose model is no polynomial."""
    from errpipe import yamlfile
    from errpipe.domain.machine import Machine
    from errpipe.errors import UsageError
    from errpipe.kinematics.chain import compile_chain

    chain = compile_chain(yamlfile.load(machine, Machine))
    if chain.machine.rotary_axes():
        raise UsageError(
            f"synthesis: {chain.machine.name} has rotary axes; its model holds sines of their angles and is evaluated "
            "as numbers only"
        )
    outputs = {f"E_{axis}": _terms(chain, k) for k, axis in enumerate("XYZ")}
    count = sum(map(len, outputs.values()))
    document: dict[str, Any] = {
        "synthesis": 1,
        "machine": chain.machine.name,
        "components": len(chain.components),
        "terms": count,
        "outputs": outputs,
    }
    lines = [f"{chain.machine.name}: {len(chain.components)} components, {count} terms; um, urad x arm in mm / 1000"]
    for name, terms in outputs.items():
        lines.append(f"{name} =")
        lines += [f"  {_text(term)}" for term in terms]
    return document, lines


def _terms(chain: Chain, k: int) -> list[dict[str, Any]]:
    """Per component that acts on direction k: a constant arm and one per symbol, mm; displacements: factor 1.

    The Jacobian of a chain of linear axes is affine in positions and tool, so its value at one place and its steps
    along each symbol are all of it.
    """
    import numpy as np

    from errpipe.kinematics import synthesis as model

    still = np.zeros((1, len(chain.axes)))
    base = model.jacobian(chain, still, chain.tip(0.0, (0.0, 0.0, 0.0)))[0, k]
    steps = {}
    for a, axis in enumerate(chain.axes):
        q = still.copy()
        q[0, a] = 1.0
        steps[axis] = model.jacobian(chain, q, chain.tip(0.0, (0.0, 0.0, 0.0)))[0, k] - base
    tips = [(1.0, (0.0, 0.0, 0.0)), *((0.0, tuple(row)) for row in np.eye(3))]
    for name, (length, offset) in zip(TOOL, tips, strict=True):
        steps[name] = model.jacobian(chain, still, chain.tip(length, offset))[0, k] - base
    out = []
    for c, component in enumerate(chain.components):
        scale = 1e3 if chain.angular[c] else 1.0  # um per urad at 1 mm is 1e-3: arms in mm
        per = {n: float(v[c] * scale) for n, v in steps.items() if abs(v[c] * scale) > ZERO}
        constant = float(base[c] * scale)
        if per or abs(constant) > ZERO:
            out.append({"component": component, "constant": constant if abs(constant) > ZERO else 0.0, "per": per})
    return out


def _text(term: dict[str, Any]) -> str:
    """One term as a line, such as `+ (L + Z - 120) EBX`."""
    parts = [_signed(v, n) for n, v in term["per"].items()]
    if not parts:
        return f"{_signed(term['constant'], term['component'])}".strip()
    if term["constant"]:
        parts.append(_signed(term["constant"], ""))
    return f"+ ({' '.join(parts).removeprefix('+ ')}) {term['component']}"


def _signed(value: float, name: str) -> str:
    size = "" if abs(abs(value) - 1.0) < ZERO and name else f"{abs(value):g} " if name else f"{abs(value):g}"
    return f"{'-' if value < 0 else '+'} {size}{name}"
