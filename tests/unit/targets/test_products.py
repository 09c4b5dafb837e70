"""SINUMERIK product tables: the file read line by line, the manual's sentence carried out under every reading of it.

The manual (Function Manual Extended Functions, K3, p. 245 and 249): values of any table can be multiplied by those of
another; the product is added, as an additional value, to the total compensation value of the compensation axis. Its
worked example (p. 252) wants ZdX = Z * beta(X) and selects table 2 in table 1: $AN_CEC_MULT_BY_TABLE[0] = 2. It does
not say whether tables that multiply add their own values too.
"""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.errors import VerifyError
from errpipe.targets import TARGETS, _loss, _sample
from tests.unit.targets import machines

(CEC,) = [t for t in TARGETS if t.name == "sinumerik_cec"]
FILE = "NC_CEC.INI"
# Which tables' own values reach the sum: those that multiply and those that are multiplied by.
READINGS = {
    "all tables add": (True, True),
    "products only": (False, False),
    "the second adds": (False, True),
    "the first adds": (True, False),
}


class Control:
    """A control that reads an INI file of cross-error tables; written from the manual's pages, not from the writer."""

    def __init__(self, text: str):
        self.points: dict[int, dict[int, float]] = {}
        self.facts: dict[str, dict[int, str]] = {}
        for line in text.splitlines():
            line = line.split(";")[0].strip()
            if not line.startswith("$AN_CEC"):
                continue
            name, value = line.split("=")
            name, index = name.rstrip("]").split("[")
            if name == "$AN_CEC":
                table, point = index.split(",")
                self.points.setdefault(int(table), {})[int(point)] = float(value)
            else:
                self.facts.setdefault(name.removeprefix("$AN_CEC_"), {})[int(index)] = value.strip("()")

    def value(self, table: int, at: dict[str, float], direction: int) -> float:
        side = int(self.facts["DIRECTION"][table])
        if side not in (0, direction):
            return 0.0
        low, high, step = (float(self.facts[k][table]) for k in ("MIN", "MAX", "STEP"))
        x = min(max(at[self.facts["INPUT_AXIS"][table]], low), high)
        last = max(self.points[table])
        n = min(int((x - low) / step), last - 1)
        share = (x - low) / step - n
        return self.points[table][n] * (1 - share) + self.points[table][n + 1] * share

    def total(self, axis: str, at: dict[str, float], direction: int, first_adds: bool, second_adds: bool) -> float:
        """Sum for one axis; table numbers count from 1, indices from 0."""
        links = {t: int(v) - 1 for t, v in self.facts["MULT_BY_TABLE"].items() if int(v)}
        total = 0.0
        for t in self.points:
            if self.facts["OUTPUT_AXIS"][t] != axis:
                continue
            own = self.value(t, at, direction)
            adds = first_adds if t in links else second_adds if t in links.values() else True
            total += own if adds else 0.0
            if t in links:
                total += own * self.value(links[t], at, direction)
        return total


def test_the_manuals_own_example():
    """Table 1: sine of the tilt over X1; table 2: linear in Z1; the product alone is Z1 * sin(beta(X1))."""
    text = "\n".join(
        f"$AN_CEC[{t},{n}]={v}" for t, values in enumerate(((0.0, 2e-5), (0.0, 500.0))) for n, v in enumerate(values)
    )
    for t, over in enumerate(("AX1", "AX2")):
        text += f"\n$AN_CEC_INPUT_AXIS[{t}]=({over})\n$AN_CEC_OUTPUT_AXIS[{t}]=(AX1)\n$AN_CEC_STEP[{t}]=500.0"
        text += f"\n$AN_CEC_MIN[{t}]=0.0\n$AN_CEC_MAX[{t}]=500.0\n$AN_CEC_DIRECTION[{t}]=0"
        text += f"\n$AN_CEC_MULT_BY_TABLE[{t}]={2 if t == 0 else 0}"
    control = Control(text)
    assert control.total("AX1", {"AX1": 500.0, "AX2": 300.0}, 1, False, False) == pytest.approx(300.0 * 2e-5)
    assert control.total("AX1", {"AX1": 500.0, "AX2": 300.0}, 1, True, True) == pytest.approx(300.006 + 2e-5)


@pytest.mark.parametrize("reading", READINGS)
def test_a_tilting_axis_is_moved_the_right_way_under_every_reading(reading):
    table = machines.tilting()
    control = Control(CEC.write(table)[FILE])
    rng = np.random.default_rng(3)
    x, z = rng.uniform(0.0, 500.0, 200), rng.uniform(-300.0, 0.0, 200)
    side = np.where(rng.random(200) < 0.5, 1.0, -1.0)
    want = _sample.corrections(table, "X", {"x": x, "z": z}, side)
    # Positive values move the axis in minus: the control subtracts its sum.
    axes = _sample.axes_of(table)
    names = {letter: f"AX{axes.index(letter) + 1}" for letter in axes}
    made = [
        -control.total(names["X"], {names["X"]: a, names["Z"]: b}, int(s), *READINGS[reading])
        for a, b, s in zip(x, z, side, strict=True)
    ]
    assert np.abs(np.array(made) - want).max() * 1e3 < 0.11  # um: the interpolation error that the format states
    assert np.abs(want).max() * 1e3 > 4.0


def test_the_loss_of_a_tilt_is_that_of_rounding():
    """Sums of curves over one axis each leave 1.1 um rms of the tilt, 3.9 um at most."""
    table = machines.tilting()
    files = CEC.write(table)
    (whole,) = _loss.losses(table, CEC.read_back(files))
    read = CEC.read_back(files)
    (sums,) = _loss.losses(table, type(read)(curves=read.curves))
    print(f"\ntilting axis: sums of curves lose {sums.rms:.2f} um rms, with products {whole.rms:.4f}")
    assert sums.rms > 1.0 and sums.largest > 3.9 and whole.rms < 0.05 and whole.largest < 0.11


def test_a_product_takes_four_tables_that_cancel():
    text = CEC.write(machines.tilting())[FILE]
    control = Control(text)
    links = {t: int(v) for t, v in control.facts["MULT_BY_TABLE"].items() if int(v)}
    assert links == {2: 4, 4: 6} and len(control.points) == 6  # X over X, X over Z, four of the product
    assert "two pairs whose own values cancel" in text
    for a, b in ((2, 4), (3, 5)):
        assert all(control.points[a][n] == -v for n, v in control.points[b].items())
    assert max(abs(v) for t in (2, 3) for v in control.points[t].values()) < 0.1  # mm: what one table alone could do


def test_a_file_whose_meaning_depends_on_the_reading_is_refused():
    text = CEC.write(machines.tilting())[FILE]
    lines = [line for line in text.splitlines(keepends=True) if not line.startswith("$AN_CEC[5,50]")]
    value = next(line for line in text.splitlines() if line.startswith("$AN_CEC[5,70]"))
    changed = text.replace(value, "$AN_CEC[5,70]=0.010000")
    with pytest.raises(VerifyError, match="do not cancel"):
        CEC.read_back({FILE: changed})
    with pytest.raises(VerifyError, match="points"):
        CEC.read_back({FILE: "".join(lines)})
    with pytest.raises(VerifyError, match="does not exist"):
        CEC.read_back({FILE: text.replace("MULT_BY_TABLE[2]=4", "MULT_BY_TABLE[2]=9")})


def test_tables_that_are_sums_have_no_products():
    assert "MULT_BY_TABLE[0]=0" in CEC.write(machines.bent())[FILE]
    assert not CEC.read_back(CEC.write(machines.bent())).products


def test_two_outputs_of_one_axis_add_up_in_every_format():
    """10 um and 4 um too long at X = +500: every format moves X by -14 um, and its loss counts both."""
    table = machines.two_outputs()
    for target in TARGETS:
        if "screw" not in target.holds or target.name == "beckhoff_volumetric":  # takes components, not outputs
            continue
        read = target.read_back(target.write(table))
        at = {"X": np.array([0.0, 500.0]), "Y": np.zeros(2), "Z": np.zeros(2)}
        ends = read.correction("X", at, np.ones(2), {"T": np.full(2, 20.0)})
        assert 1e3 * (ends[1] - ends[0]) == pytest.approx(-14.0, abs=target.rounding_um + 0.1)
        (lost,) = _loss.losses(table, read)
        assert lost.table_rms == pytest.approx(14.0 / np.sqrt(12), rel=0.1), target.name
        assert lost.rms < 0.7, target.name  # besides a constant, where the control counts from
