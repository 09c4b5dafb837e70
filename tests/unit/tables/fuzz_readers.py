"""Damaged tables through the Python and the C reader: `python -m tests.unit.tables.fuzz_readers 1000000`.

A finding is anything but a refusal in words: another exception, a table that does not write the bytes it was read from,
two readers that disagree. Findings are printed as hexadecimal; the file that shows one is kept as a seed under
`tests/unit/targets/c/seeds`.
"""

from __future__ import annotations

import ctypes
import random
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from errpipe.errors import VerifyError
from errpipe.tables import ect
from tests.unit.tables import refused
from tests.unit.tables.made import everything, ten_um_too_long
from tests.unit.targets.c import test_c_runtime as c

SEEDS = 24  # random tables besides the two small ones


def sound() -> list[bytes]:
    """Tables to damage: small ones often, so that damage hits every kind of field."""
    small = [ect.dumps(refused.sound())] * SEEDS + [ect.dumps(ten_um_too_long())] * SEEDS
    return small + [ect.dumps(everything(s)) for s in range(300, 300 + SEEDS)]


def finding(data: bytes, by_c: Callable[[bytes], bool] | None) -> str:
    """What is wrong with how a file is read; empty if nothing is."""
    try:
        table = ect.loads(data)
        taken = True
    except VerifyError as err:
        taken = False
        if "\n" in str(err) or not str(err):
            return f"refused, but not in words: {str(err)[:80]!r}"
    except Exception as err:
        return f"{type(err).__name__}: {err}"
    if taken and ect.dumps(table) != data:
        return "read, but writes other bytes"
    if by_c is not None and by_c(data) != taken:
        return f"Python {'takes' if taken else 'refuses'} it, C does not agree"
    return ""


def run(count: int, seed: int, by_c: Callable[[bytes], bool] | None) -> tuple[int, list[tuple[str, bytes]]]:
    """(tables accepted, findings) of so many damaged tables."""
    r, bases = random.Random(seed), sound()
    taken, pair = 0, []
    for _ in range(count):
        data = c.damaged(r, r.choice(bases))
        if output := finding(data, by_c):
            pair.append((output, data))
        taken += by_c(data) if by_c is not None else 0
    return taken, pair


def c_reader(folder: Path) -> Callable[[bytes], bool]:
    """Whether the C runtime takes a file; one work area for all."""
    library = ctypes.CDLL(str(c.build(folder)))
    where = ctypes.c_uint32()
    return lambda data: library.load(data, ctypes.c_size_t(len(data)), ctypes.byref(where)) == 0


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as folder:
        taken, result = run(count, seed, c_reader(Path(folder)))
    print(f"{count} executions of both readers, {taken} tables taken, {len(result)} findings")
    for output, data in result[:20]:
        print(output, data.hex())
    return 1 if result else 0


if __name__ == "__main__":
    sys.exit(main())
