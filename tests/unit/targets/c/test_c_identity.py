"""Which table the C runtime loads: its identity, the one that is allowed, none without a limit unless it is named."""

from __future__ import annotations

import ctypes
import hashlib
import re
import subprocess

import numpy as np
import pytest

from bench.bench_tables import machine
from errpipe.tables import ect
from errpipe.targets.c_runtime import CRuntime
from tests.unit.tables.made import follower, ten_um_too_long
from tests.unit.targets.c.test_c_runtime import COMPILERS, RUNTIME, STRICT, run

pytestmark = [
    pytest.mark.toolchain,
    pytest.mark.skipif(not COMPILERS, reason="no C compiler (gcc, clang) on this machine"),
]


def test_the_identity_of_a_table_is_its_sha256(tmp_path):
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-shared", "-fPIC"]
    run(COMPILERS[0], *flags, RUNTIME / "ect_identity.c", RUNTIME / "ect.c", "-o", tmp_path / "i.so")
    dll, rng = ctypes.CDLL(str(tmp_path / "i.so")), np.random.default_rng(1)
    for size in (*range(200), 4096, len(ect.dumps(machine(thermal=True)))):
        data = rng.bytes(size)
        right = hashlib.sha256(data).digest()
        own = ctypes.create_string_buffer(32)
        dll.ect_identity(data, ctypes.c_size_t(size), own)
        assert own.raw == right
        assert dll.ect_is_identity(data, ctypes.c_size_t(size), right) == 1
        wrong = bytes([*right[:31], right[31] ^ 1])
        assert dll.ect_is_identity(data, ctypes.c_size_t(size), wrong) == 0


def test_the_example_refuses_another_table_than_the_one_allowed(tmp_path):
    own, other = CRuntime.write(ten_um_too_long()), CRuntime.write(machine())
    allowed = re.search(r"#define ECT_TABLE_IDENTITY .*", own["table.h"])[0]
    other["table.h"] = re.sub(r"#define ECT_TABLE_IDENTITY .*", allowed, other["table.h"])
    for name, text in other.items():
        (tmp_path / name).write_text(text)
    sources = [tmp_path / name for name in ("ect.c", "ect_identity.c", "table.c", "example.c")]
    run(COMPILERS[0], "-std=c99", "-O1", *sources, "-o", tmp_path / "example")
    done = subprocess.run([tmp_path / "example"], capture_output=True, text=True)
    assert done.returncode == 1 and "another table" in done.stdout


ONLY = """#include <stdio.h>
#include "ect_identity.h"
#include "table.h"
static uint64_t work[1u << 16];
int main(void) {
    uint8_t allowed[ECT_IDENTITY_SIZE] = ECT_TABLE_IDENTITY;
    static const ect_real readings[8] = {1000};
    for (int turn = 0; turn < 2; turn++) { /* the table that is allowed, then the same where another one is */
        ect e;
        ect_error error = ect_load_only(&e, ect_table, ECT_TABLE_SIZE, work, sizeof work, allowed);
        ect_cycle(&e, readings, NULL, ECT_ON);
        printf("%s; %u outputs; running %d; moves %d\\n", ect_says(error), (unsigned)e.output_count,
               (int)(e.status & 1u), ect_correction(&e, 0) < 0);
        allowed[31] ^= 1u;
    }
    return 0;
}
"""


def test_a_table_that_is_not_the_one_allowed_is_not_loaded(tmp_path):
    for name, text in {**CRuntime.write(ten_um_too_long()), "only.c": ONLY}.items():
        (tmp_path / name).write_text(text)
    sources = [tmp_path / name for name in ("ect.c", "ect_identity.c", "table.c", "only.c")]
    run(COMPILERS[0], *STRICT, *sources, "-o", tmp_path / "only")
    first, second = run(tmp_path / "only").stdout.splitlines()
    assert first == "sound; 1 outputs; running 1; moves 1"
    assert second == "another table than the one allowed; 0 outputs; running 0; moves 0"


LOADERS = """#include "ect.h"
#include "ect_identity.h"
static uint64_t work[1u << 16];
int load_how(const void *table, size_t size, const uint8_t *named, int any, double *moved) {
    static const ect_real readings[64] = {1000};
    ect e;
    ect_error error = any ? ect_load_any(&e, table, size, work, sizeof work)
        : named ? ect_load_only(&e, table, size, work, sizeof work, named)
        : ect_load(&e, table, size, work, sizeof work);
    ect_cycle(&e, readings, 0, ECT_ON);
    *moved = e.output_count ? e.outputs[0].correction : 0;
    return (int)error;
}
"""


@pytest.mark.parametrize(
    "single", [pytest.param([], id="double"), pytest.param(["-DECT_SINGLE"], id="single", marks=pytest.mark.slow)]
)
def test_a_table_without_a_limit_moves_nothing_unless_it_is_named(tmp_path, single):
    """A correction that follows the position itself, 1 mm per mm: 100 m where nothing limits it, and all at once."""
    (tmp_path / "loaders.c").write_text(LOADERS)
    sources = [RUNTIME / "ect.c", RUNTIME / "ect_identity.c", tmp_path / "loaders.c"]
    run(COMPILERS[0], *STRICT, *single, "-shared", "-fPIC", f"-I{RUNTIME}", *sources, "-o", tmp_path / "l.so")
    how, moved = ctypes.CDLL(str(tmp_path / "l.so")).load_how, ctypes.c_double()
    fast, slow = 10_000.5, 10_000.0
    for magnitude, slew, code in (
        (None, slow, 21),
        (fast, slow, 21),
        (slow, None, 21),
        (slow, fast, 21),
        (slow, slow, 0),
        (20.0, 1e3, 0),
    ):
        data = ect.dumps(follower(magnitude, slew))
        name = hashlib.sha256(data).digest()
        size = ctypes.c_size_t(len(data))
        assert how(data, size, None, 0, ctypes.byref(moved)) == code
        assert abs(moved.value) == (0.0 if code else pytest.approx(slew * 0.001 / 1e3)), "one cycle at the slew"
        assert how(data, size, name, 0, ctypes.byref(moved)) == how(data, size, None, 1, ctypes.byref(moved)) == 0
        assert moved.value < 0.0
