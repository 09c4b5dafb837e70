"""The look-up table of EPICS ecmc read by ecmc's own header, compiled here; skipped where the header is not at hand.

The encoder adds the value to what it reads; the loop brings that back to the command.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from errpipe.targets import TARGETS, _sample
from tests.unit.targets import machines

HEADER = (
    Path(os.environ.get("ERRPIPE_ECMC", Path(__file__).parents[4] / "shared/controllers/ecmc")) / "ecmcLookupTable.h"
)
pytestmark = [
    pytest.mark.toolchain,
    pytest.mark.skipif(
        not HEADER.is_file(), reason="ecmcLookupTable.h is not at hand (set ERRPIPE_ECMC to its folder)"
    ),
    pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed"),
]
ERROR = """#pragma once
#include <cstdio>
#include <iomanip>
#include <sstream>
#define LOGERR(...) std::fprintf(stderr, __VA_ARGS__)
class ecmcError { public: int setErrorID(const char*, const char*, int, int e) { return e; } };
"""
MAIN = """#include "ecmcLookupTable.h"
int main(int n, char **a) {
    ecmcLookupTable<double, double> table(a[1]);
    std::ofstream out(a[2]);
    out << std::setprecision(17);
    for (double raw; std::cin >> raw;) out << raw + table.getValue(raw) << "\\n";
    return 0;
}
"""


def test_its_own_header_reads_the_file_and_the_loop_goes_less_far(tmp_path):
    (target,) = [t for t in TARGETS if t.controller == "EPICS ecmc"]
    table = machines.wavy_both_directions()
    ((name, text),) = target.write(table).items()
    for file, content in ((name, text), ("ecmcError.h", ERROR), ("main.cpp", MAIN)):
        (tmp_path / file).write_text(content)
    shutil.copy(HEADER, tmp_path)
    subprocess.run(["g++", "-o", "reader", "main.cpp"], cwd=tmp_path, check=True)
    raw = np.linspace(-5.0, 505.0, 333)
    words = "\n".join(map(repr, raw.tolist()))
    subprocess.run(
        ["./reader", name, "out"], cwd=tmp_path, input=words, text=True, check=True, stdout=subprocess.DEVNULL
    )
    measured = np.loadtxt(tmp_path / "out")
    (curve,) = target.read_back({name: text}).curves
    np.testing.assert_allclose(measured - raw, -np.interp(raw, curve.positions, curve.up), atol=1e-12)
    command = np.linspace(0.0, 500.0, 100)
    encoder = np.interp(command, measured, raw)  # where the loop comes to rest
    want = _sample.curve(table, "X", "X", command)
    np.testing.assert_allclose(1e3 * (encoder - command), 500 * (want.up + want.down), atol=0.05)
