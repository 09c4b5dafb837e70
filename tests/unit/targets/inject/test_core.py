"""The core of feedback interception: every edge, every index, every stop, counted by somebody else."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from errpipe.targets import TARGETS
from tests.unit.targets import machines

pytestmark = [pytest.mark.toolchain, pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")]
(TARGET,) = [t for t in TARGETS if "quadrature" in t.limits]
EDGES = 10_000_000
WARNINGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("inject")
    for name, text in TARGET.write(machines.long_with_lost_motion()).items():
        (made / name).write_text(text)
    return made


def played(folder, edges: int, seed: int) -> dict[str, int]:
    if not (folder / "harness").exists():
        command = [
            "gcc",
            *WARNINGS,
            "-I.",
            str(Path(__file__).with_name("harness.c")),
            "feedback_inject.c",
            "-o",
            "harness",
        ]
        subprocess.run(command, cwd=folder, check=True)
    words = subprocess.run([folder / "harness", str(edges), str(seed)], capture_output=True, text=True, check=True)
    pairs = words.stdout.split()
    return {k: int(v) for k, v in zip(pairs[::2], pairs[1::2], strict=True)}


def test_ten_million_edges(folder, capsys):
    """Output minus input is what was injected, after every period; no illegal transition; the index where it was."""
    solved = played(folder, EDGES, 1)
    with capsys.disabled():
        print("\nfeedback interception: " + ", ".join(f"{k} {v}" for k, v in solved.items()))
    assert solved["edges"] == EDGES and solved["injections"] > 10_000 and solved["indices"] > 1_000
    nothing = ("illegal", "wrong", "fast", "early", "shifted", "thawed", "jumps", "core_illegal", "difference")
    assert {k: solved[k] for k in nothing} == dict.fromkeys(nothing, 0)


@pytest.mark.parametrize(
    ("old", "new", "caught"),
    [
        ("if (moved != 0u) {\n            e->waiting++;", "if (0) {\n            e->waiting++;", "illegal"),
        ("if (enabled && e->injected != goal", "if ((enabled || 1) && e->injected != goal", "thawed"),
        ("goal = e->found ? e->aim : 0;", "goal = e->aim;", "early"),
        ("e->since >= e->gap", "1", "fast"),
        ("e->injected += step;", "e->injected += 2 * step;", "wrong"),
        ("(z ? INJECT_Z : 0u)", "(e->found && z ? INJECT_Z : 0u)", "shifted"),
    ],
)
def test_each_rule_broken_by_itself_is_seen(folder, tmp_path, old, new, caught):
    source = (folder / "feedback_inject.c").read_text()
    assert source.count(old) == 1
    (tmp_path / "feedback_inject.c").write_text(source.replace(old, new))
    shutil.copy(folder / "feedback_inject.h", tmp_path)
    assert played(tmp_path, 1_000_000, 2)[caught] > 0


@pytest.fixture(scope="module")
def core(folder):
    subprocess.run(["gcc", *WARNINGS, "-shared", "-fPIC", "feedback_inject.c", "-o", "core.so"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "core.so"))


class Side(ctypes.Structure):
    _fields_ = (("furthest", ctypes.c_int32), ("side", ctypes.c_int8))


def turned(core, counts, threshold) -> int:
    """How often the direction turned."""
    side = Side(0, 0)
    core.inject_travel.restype = ctypes.c_int8
    values = np.array([core.inject_travel(ctypes.byref(side), int(c), threshold) for c in counts])
    return int(np.count_nonzero(np.diff(values[values != 0])))


def test_an_encoder_at_rest_does_not_turn_the_direction(core):
    """Lost motion of 6 counts that swings to and fro with noise: a threshold of one count turns all the time."""
    rng = np.random.default_rng(3)
    rest = 100 + np.round(3 * np.sin(np.arange(20_000) / 50.0) + rng.integers(-1, 2, 20_000)).astype(int)
    counts = np.concatenate((np.arange(100), rest))
    assert core.inject_side_fits(10, 6) and not core.inject_side_fits(9, 6)
    assert turned(core, counts, 1) > 1000
    assert turned(core, counts, 10) == 0
    assert turned(core, np.concatenate((counts, np.arange(100, 50, -1), np.arange(50, 100))), 10) == 2


def test_more_edges_than_a_period_can_pass_are_refused(core):
    """20 kHz steps pass 18000 counts a second, so that every tenth step is left for injection."""
    core.inject_fits.argtypes = (ctypes.c_uint32, ctypes.c_uint32)
    assert core.inject_fits(18_000, 50_000) and not core.inject_fits(18_001, 50_000)
    assert not core.inject_fits(4_000_000_000, 4_000_000_000)


def test_skipped_phases_are_counted_and_the_output_stays_legal(folder, core):
    state = ctypes.create_string_buffer(64)
    core.inject_start(state, 10)
    out = [core.inject_step(state, w, 1) & 3 for w in (0, 1, 2, 1, 3, 0, 3)]  # A and B at once, again and again
    illegal = ctypes.c_uint32.from_buffer(state, 12).value
    assert illegal == 4
    assert all(bin(a ^ b).count("1") <= 1 for a, b in pairwise(out))


@pytest.mark.skipif(shutil.which("arm-none-eabi-gcc") is None, reason="no compiler for Cortex-M")
def test_it_compiles_freestanding_for_a_microcontroller(folder):
    flags = ["-std=c99", "-ffreestanding", "-mcpu=cortex-m0", "-mthumb", "-Os", "-Wall", "-Werror", "-c"]
    subprocess.run(["arm-none-eabi-gcc", *flags, "feedback_inject.c", "-o", "m0.o"], cwd=folder, check=True)
