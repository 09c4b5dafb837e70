"""The error model of a machine in symbols: what each component does to the tool point, for any chain of axes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from errpipe import yamlfile
from errpipe.domain.machine import Machine
from errpipe.kinematics import polynomials
from errpipe.kinematics.chain import compile_chain
from errpipe.kinematics.polynomials import Polynomial

ZERO = 1e-9  # mm: arms below are rounding
SHORT = {"tool_length": "L", "tool_offset_X": "TX", "tool_offset_Y": "TY", "tool_offset_Z": "TZ"}


def synthesis(machine: Path) -> tuple[dict[str, Any], list[str]]:
    """The document and its lines. Per component an arm: a sum of products of positions, tool, sines and cosines, mm.

    A displacement's factor has no unit. Each term's `expression` is plain arithmetic: Python and sympy read it.
    """
    chain = compile_chain(yamlfile.load(machine, Machine))
    outputs: dict[str, list[dict[str, Any]]] = {f"E_{axis}": [] for axis in "XYZ"}
    for (output, component), letters in polynomials.jacobian(chain, "workpiece").items():
        if output in outputs:
            scale = 1e3 if chain.angular[chain.index(component)] else 1.0  # um per urad at 1 mm is 1e-3: arms in mm
            arm = {key: v * scale for key, v in _sin2_replaced(letters).items() if abs(v * scale) > ZERO}
            if arm:
                parts = [{"coefficient": v, "of": [SHORT.get(n, n) for n in key]} for key, v in arm.items()]
                outputs[output].append({"component": component, "arm": parts, "expression": _expression(parts)})
    for terms in outputs.values():
        terms.sort(key=lambda term: chain.index(term["component"]))
    count = sum(map(len, outputs.values()))
    document: dict[str, Any] = {
        "synthesis": 2,
        "machine": chain.machine.name,
        "components": len(chain.components),
        "terms": count,
        "outputs": outputs,
        "notes": list(chain.machine.notes),
    }
    lines = [f"{chain.machine.name}: {len(chain.components)} components, {count} terms; um, urad x arm in mm / 1000"]
    for name, terms in outputs.items():
        lines += [f"{name} =", *(f"  {_text(term)}" for term in terms)]
    lines += [f"note: {note}" for note in chain.machine.notes]
    return document, lines


def _sin2_replaced(letters: Polynomial) -> Polynomial:
    """The same with sin^2 written as 1 - cos^2, so that equal arms read alike."""
    out = Polynomial()
    waiting = list(letters.items())
    while waiting:
        key, value = waiting.pop()
        twice = next(
            (n for n, times in Counter(key).items() if polynomials.function_of(n)[0] == "sin" and times > 1), None
        )
        if twice is None:
            out[key] = out.get(key, 0.0) + value
            continue
        rest = list(key)
        rest.remove(twice)
        rest.remove(twice)
        cosine = twice.replace("sin", "cos")
        waiting += [(tuple(sorted(rest)), value), (tuple(sorted((*rest, cosine, cosine))), -value)]
    return Polynomial(sorted(out.items(), key=lambda item: (not item[0], len(item[0]), item[0])))


def _expression(parts: list[dict[str, Any]]) -> str:
    """A sum of products, such as `L*cos(B) - 120`."""
    text = ""
    for part in parts:
        value, named = part["coefficient"], [(n, *polynomials.function_of(n)) for n in part["of"]]
        names = [f"{function}({axis})" if function else name for name, function, axis in named]
        size = [] if names and abs(abs(value) - 1.0) < ZERO else [f"{abs(value):g}"]
        text += f" {'-' if value < 0 else '+'} " + "*".join(size + names)
    text = text.removeprefix(" + ")
    return f"-{text.removeprefix(' - ')}" if text.startswith(" - ") else text


def _text(term: dict[str, Any]) -> str:
    """One term as a line, such as `+ (L + Z - 120) EBX`."""
    arm, component = term["expression"], term["component"]
    if len(term["arm"]) > 1:
        return f"+ ({arm}) {component}"
    sign, size = ("-", arm[1:]) if arm.startswith("-") else ("+", arm)
    return f"{sign} {component}" if size == "1" else f"{sign} {size} {component}"
