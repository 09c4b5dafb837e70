"""Blocks read in bulk give the bytes, and the refusals, that they give one by one."""

import random
import re

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.ncprogram import writer
from errpipe.ncprogram.modal import Setup
from errpipe.ncprogram.writer import rounded
from tests.nc import correct

SETUP = Setup(
    offsets={"G54": (100.0, 50.0, -200.0), "G55": (300.0, 50.0, -200.5)}, tools={1: 80.0}, start=(0.0, 0.0, 0.0)
)


def bent(points, tool_length):
    """A machine with squareness, scale, bow and a table that ends at X = 2000; mm."""
    x, y, z = points.T
    dx = np.where(x > 2000.0, np.nan, 4e-5 * x + 3e-5 * y + 2e-5 * tool_length * x / 500)
    return np.column_stack([dx, 5e-3 * np.sin(x / 150), -3e-5 * z + 1e-8 * x * y])


FAULTS = ["G1 X1 X2", "G2 X5", "G1 X1(", "G41", "X1e5", "G1 X2 Q1", "G1 X999999", "G2 X10 I1 J0", "G1 G0 X1", "%X1"]
FAULTS += ["G90 G91 X1", "G3 X1 Y1 R0.1", "G56 X1", "X5000", "G1 X1.2.3", "G1 X1 N5", "X1 A1 A2", "/X1", "X1 (a(b)"]
FAULTS += ["G1 X--1", "G1 X.", "G1.5 X1", "G-1 X1", "G4 X1", "M98 X1", "X\u0661", "X1 \x07", "(a) ) X1", "X1 I1"]
MODES = ["G90", "G91", "G20", "G21", "G17", "G18", "G19", "G54", "G55", "G43 H1", "G49", "G90.1", "G91.1", "G80", "G94"]
OTHER = [
    "",
    "(note)",
    "; note ",
    "M8",
    "F300",
    "S1000 M3",
    "T1 M6",
    "G4 P1",
    "N5",
    "%",
    "  ",
    "G61",
    "G64 P0.01",
    "G0",
    "G3",
]
STRAIGHT = ["G0", "G1", "G01", "G00", "G1.0"]
ARCS = ["arc", "circle"]


def number(r):
    """A number as programs write it: signs, points, zeros and decimals of all sorts."""
    value = r.choice([r.uniform(-9, 9), r.uniform(-90, 90), float(r.randint(-50, 50)), r.uniform(-1e-4, 1e-4)])
    text = f"{value:.{r.choice([0, 1, 3, 3, 4, 5, 7])}f}"
    text = re.sub(r"^(-?)0\.", r"\1.", text) if r.random() < 0.2 and "." in text and text[-1] != "." else text
    text = text + "." if "." not in text and r.random() < 0.3 else text
    return "+" + text if text[0] != "-" and r.random() < 0.1 else text


def motion(r, kinds):
    """A straight move or an arc, with words in any order, a line number, a feed, a comment or none of them."""
    words = [axis + number(r) for axis in r.choice(["X", "XY", "XYZ", "YZ", "Z", "XA", "ABC", "XYZAB", "C"])]
    kind = r.choice(kinds)
    if kind == "arc":
        words = [
            f"G{r.choice([2, 3])}",
            *(axis + number(r) for axis in "XY"),
            f"R{r.choice(['', '-'])}{r.uniform(30, 300):.3f}",
        ]
    elif kind == "circle":
        words = [f"G{r.choice([2, 3])}", f"X{0 if r.random() < 0.2 else r.uniform(0, 0.01):.4f}"]
        words += [f"I{number(r)}", r.choice(["", f"J{number(r)}", f"K{number(r)}", "P2", "P1"])]
    else:
        words.append(kind)
    words += [r.choice(["", "", "F100", "F.5", "S900", "M8", "G90", "G21", "G17"])]
    r.shuffle(words)
    words = [
        r.choice(["", "", "N10", "n20", "N7.5"]),
        *words,
        *(r.choice(["", "", "", "(c 1)", "; c ", "(a) ; b", "(a)(b)"]),),
    ]
    line = r.choice(["", " ", " ", "  ", "\t"]).join(w for w in words if w)
    return line.lower() if r.random() < 0.05 else line


def program(seed):
    """Some hundred blocks; three in four programs have nothing that is always refused."""
    r = random.Random(seed)
    lines = ["G90 G21 G54 G0 X0 Y0 Z0" + r.choice(["", " A0 B0", " A0 B0 C0"])]
    for _ in range(r.randint(1, 80)):
        sort = r.random()
        kinds = STRAIGHT + ARCS if re.search("[gG]0*[23](?![0-9])|[rRiI]", lines[-1]) else STRAIGHT + ARCS + [""] * 9
        lines.append(motion(r, kinds) if sort < 0.9 else r.choice(MODES if sort < 0.94 else OTHER))
        if r.random() < 0.3:
            lines.append(f"G90 G1 X{r.uniform(0, 200):.3f} Y{r.uniform(0, 200):.2f}")
    if r.random() < 0.25:
        lines.insert(r.randrange(1, len(lines) + 1), r.choice(FAULTS))
    return r.choice(["\n", "\n", "\r\n"]).join(lines) + r.choice(["\n", ""])


def outcome(text, limits, **how):
    """The corrected program and what was done, or the refusal."""
    try:
        return correct(text, bent, SETUP, **limits, **how)
    except DataError as err:
        return str(err)


def without_refusals(text, limits):
    """The program without the blocks that are refused, so that what follows them is looked at too."""
    while isinstance(refusal := outcome(text, limits), str):
        lines = text.split("\n")
        del lines[int(re.match(r"line (\d+)", refusal)[1]) - 1]
        text = "\n".join(lines)
    return text


@pytest.mark.parametrize("seed", [*range(30), *(pytest.param(s, marks=pytest.mark.slow) for s in range(30, 60))])
def test_bulk_and_single_blocks_give_the_same(seed, monkeypatch):
    r, text = random.Random(-seed - 1), program(seed)
    limits = {"longest": r.choice([25.0, 5.0, 1.0]), "chord_error": r.choice([0.001, 0.05])}
    monkeypatch.setattr(writer, "MAX_POINTS", r.choice([8000, 300, 7]))
    single = outcome(text, limits, bulk=False)
    assert outcome(text, limits) == single
    text = without_refusals(text, limits)
    assert outcome(text, limits) == outcome(text, limits, bulk=False)


def test_chunks_do_not_show():
    """A program in one piece, and in pieces of single lines."""
    from errpipe.ncprogram.correct import rewrite

    for seed in range(10):
        text = without_refusals(program(seed), {})
        parts: list[bytes] = []
        done = rewrite((line for line in text.encode().splitlines(keepends=True)), parts.append, bent, SETUP)
        assert (b"".join(parts).decode(), done) == correct(text, bent, SETUP)


def test_most_of_a_plain_program_is_read_in_bulk(monkeypatch):
    """Without this the comparison above would compare nothing."""
    from errpipe.ncprogram import correct as module

    parsed = []
    monkeypatch.setattr(module, "parse", lambda n, source: parsed.append(source) or parse(n, source))
    from errpipe.ncprogram.blocks import parse

    lines = [
        "G90 G21 G54 G17",
        "G0 X0 Y0 Z0 A0",
        "N1 G01 X1.5 F100 (c)",
        "g3 x3 i.75",
        "g1 y2",
        "X4",
        "G2 X9 R9 ; c",
        "G1 A5 X90",
        "M2",
    ]
    correct("\r\n".join(lines), bent, SETUP)
    assert parsed == ["G90 G21 G54 G17", "M2"]


def test_angles_are_rounded_as_python_writes_them():
    rng = np.random.default_rng(4)
    values = np.concatenate(
        [rng.uniform(-400, 400, 5000), np.round(rng.uniform(-400, 400, 5000), 5), [-1e-9, 2.5, 0.0]]
    )
    assert rounded(values, 4).tolist() == [round(v, 4) + 0.0 for v in values.tolist()]


def test_a_place_that_cannot_be_written_is_refused():
    """Increments add up without end; numbers of more than 15 digits have no decimals in double precision."""
    text = "G91\n" + "G0 X99999\n" * 10_200 + "G90 G0 Y1\n"
    with pytest.raises(DataError, match="line 10202: a place beyond any machine"):
        correct(text, lambda points, length: 1e-4 * points, SETUP)
