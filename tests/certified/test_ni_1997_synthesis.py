"""The volumetric equations of Ni (1997), pp. 720-721, term by term against the synthesis of this machine.

Every line below is one printed term: sign, component, its factor as printed. The test evaluates printed and
derived factors on random machines of the paper's chain and lists every term in which print and derivation
differ. Three do: one sign, two subscripts.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe import yamlfile
from errpipe.domain.machine import Machine
from errpipe.kinematics.chain import compile_chain
from errpipe.kinematics.synthesis import jacobian

EXAMPLE = Path(__file__).parents[2] / "examples/machines/horizontal-centre-ni-1997.yaml"
# Paper symbol -> (component, sign). delta_yx: deviation in y of the x axis; alpha beta gamma: about x y z.
SYMBOLS = {f"d{d}{a}": (f"E{d.upper()}{a.upper()}", 1) for d in "xyz" for a in "xyz"}
SYMBOLS |= {f"e{d}{a}": (f"E{t}{a.upper()}", 1) for d, t in zip("abg", "ABC", strict=True) for a in "xyz"}
SYMBOLS |= {f"Dzx_{d}": (f"{d.upper()}0X", 1) for d in "xyz"} | {f"Dxy_{d}": (f"{d.upper()}0Y", 1) for d in "xyz"}
SYMBOLS |= {f"DS_{d}": (f"{d.upper()}0S", 1) for d in "xyz"} | {"eas": ("A0S", 1), "ebs": ("B0S", 1)}
# z is the datum: x leans towards z by S_xz about +y; y leans towards x by S_xy about +z and to z by S_yz about -x.
SYMBOLS |= {"Sxy": ("C0Y", 1), "Sxz": ("B0X", 1), "Syz": ("A0Y", -1)}

PRINTED = {
    "x": """
        + Dzx_x * 1 | + Dxy_x * 1 | + DS_x * 1 | + dxx * 1 | + dxy * 1 | - dxz * 1 | + ebs * L
        + ebx * Tz + L + Oxy_z | + eby * Tz + L | - ebz * Tz + L + Ozx_z + Oxy_z - z
        - egx * Ty + Oxy_y + y | + egy * Ty | + egz * Ty + Oxy_y + y + Ozx_y | - Sxy * y""",
    "y": """
        + Dzx_y * 1 | + Dxy_y * 1 | + DS_y * 1 | + dyx * 1 | + dyy * 1 | - dyz * 1 | - eas * L
        - eax * Tz + L + Oxy_z | - eay * Tz + L | + eaz * Tz + L + Oxy_z + Ozx_z - z
        + egx * Tx + Oxy_x | + egy * Tx | - egz * Tx + Oxy_x + x + Ozx_x""",
    "z": """
        + Dzx_z * 1 | + Dxy_z * 1 | + DS_z * 1 | + dzy * 1 | + dzx * 1 | - dzz * 1
        + eax * Ty + Oxy_y + y | + eay * Ty | - eaz * Ty + y + Oxy_y + Ozx_y
        - ebx * Tx + Oxy_x | - eby * Tx | + ebz * Tx + Oxy_x + x + Ozx_x | - Srr * x | - Srr * y""",
}
DIFFERENCES = [
    "dWx: printed +(Ty) egy, derived -(Ty) egy",
    "dWz: printed -(x) Srr: no such component; derived -(x) Sxz",
    "dWz: printed -(y) Srr: no such component; derived -(y) Syz",
]


def machine(numbers: dict[str, float]) -> Machine:
    """The paper's chain with given offsets Ozx, Oxy, T."""
    ozx, oxy, t = (
        np.array([numbers[f"{o}{c}"] for c in names]) for o, names in (("Ozx_", "xyz"), ("Oxy_", "xyz"), ("T", "xyz"))
    )
    return Machine.model_validate(
        {
            "machine": 1,
            "name": "ni",
            "chain": ["workpiece", "Z'", "bed", "X", "Y", "spindle", "tool"],
            "datum_axes": ["Z", "X", "Y"],
            "axes": {
                "X": {"kind": "linear", "travel": [-1000, 1000], "reference": tuple(ozx), "drifts": True},
                "Y": {"kind": "linear", "travel": [-1000, 1000], "reference": tuple(ozx + oxy), "drifts": True},
                "Z": {"kind": "linear", "travel": [-1000, 1000], "direction": [0, 0, -1], "errors_of": "carriage"},
            },
            "spindle": {"position": tuple(ozx + oxy + t), "growth": True, "tilt": True},
            "tool": {"length": numbers["L"], "direction": [0, 0, 1]},
        }
    )


@pytest.fixture(scope="module")
def cases() -> list[tuple[dict[str, float], np.ndarray, tuple[str, ...]]]:
    rng = np.random.default_rng(1997)
    out = []
    for _ in range(8):
        names = [f"{o}{c}" for o in ("Ozx_", "Oxy_", "T") for c in "xyz"] + ["x", "y", "z"]
        numbers = dict(zip(names, rng.uniform(-500, 500, len(names)), strict=True)) | {"L": rng.uniform(50, 300)}
        chain = compile_chain(machine(numbers))
        jac = jacobian(chain, [[numbers["x"], numbers["y"], numbers["z"]]])[0]
        out.append((numbers, jac, chain.components))
    return out


def terms(row: str) -> list[tuple[int, str, str]]:
    """(sign, symbol, factor) of every printed term of one equation."""
    pieces = [p.strip() for line in PRINTED[row].splitlines() for p in line.split("|") if p.strip()]
    return [(1 if p[0] == "+" else -1, *map(str.strip, p[1:].split("*", 1))) for p in pieces]


def derived(cases, row: str, symbol: str) -> np.ndarray:
    """Factor of a symbol in an equation, mm per unit of the symbol (mm or rad), for every case."""
    name, sign = SYMBOLS[symbol]
    return np.array([sign * jac["xyz".index(row), comps.index(name)] for _, jac, comps in cases]) * scale(symbol)


def scale(symbol: str) -> float:
    """um/urad to mm/rad where the symbol is an angle."""
    return 1e3 if symbol[0] in "eS" else 1.0


def factor(cases, text: str) -> np.ndarray:
    return np.array([eval(text, {"__builtins__": {}}, dict(numbers)) for numbers, _, _ in cases])


def differences(cases) -> list[str]:
    """Every printed term that the derivation does not give, in words."""
    out = []
    for row in "xyz":
        named = {symbol for _, symbol, _ in terms(row)}
        missing = [s for s in SYMBOLS if s not in named and not np.allclose(derived(cases, row, s), 0.0, atol=1e-9)]
        for sign, symbol, text in terms(row):
            mark, printed = "+-"[sign < 0], sign * factor(cases, text)
            if symbol not in SYMBOLS:
                right = next((s for s in missing if np.allclose(derived(cases, row, s), printed)), None)
                out.append(
                    f"dW{row}: printed {mark}({text}) {symbol}: no such component; derived {mark}({text}) {right}"
                )
                missing = [s for s in missing if s != right]
            elif np.allclose(derived(cases, row, symbol), -printed):
                out.append(f"dW{row}: printed {mark}({text}) {symbol}, derived {'-+'[sign < 0]}({text}) {symbol}")
            elif not np.allclose(derived(cases, row, symbol), printed):
                out.append(f"dW{row}: printed {mark}({text}) {symbol}, derived another factor")
        out += [f"dW{row}: {symbol} is derived, not printed" for symbol in missing]
    return out


def test_print_and_derivation_differ_in_three_terms(cases):
    assert differences(cases) == DIFFERENCES


def test_the_example_s_notes_name_the_same_differences():
    """What `errpipe synthesis` prints below the equations."""
    notes = yamlfile.load(EXAMPLE, Machine).notes
    assert [note for note in notes if note.startswith("dW")] == DIFFERENCES
    assert sum(len(terms(row)) for row in "xyz") - len(DIFFERENCES) == 38 and "38" in notes[0]


def test_forty_one_terms_are_printed():
    assert [len(terms(row)) for row in "xyz"] == [14, 13, 14]


def test_thirty_two_components(cases):
    assert len(cases[0][2]) == 32
    assert {SYMBOLS[s][0] for s in SYMBOLS} == set(cases[0][2])


@pytest.mark.parametrize("broken", ["x", "y", "z"])
def test_a_wrong_sign_would_be_listed(cases, broken, monkeypatch):
    monkeypatch.setitem(PRINTED, broken, PRINTED[broken].replace("+ Dzx", "- Dzx", 1))
    assert any(f"dW{broken}: printed -(1) Dzx_{broken}" in line for line in differences(cases))
