"""How long a diagnosis of 20 000 rows takes, and how much memory: each shape in a fresh process.

The aims are absolute.
"""

from __future__ import annotations

import sys

from bench.figure import Figure, main
from tests.unit.diagnosis import long

SECONDS, MEGABYTES = 8.0, 1000.0


def figures() -> list[Figure]:
    """Seconds and megabytes of each shape."""
    out = []
    for shape in long.SHAPES:
        took = long.measured(shape)
        what = f"{shape}, {long.ROWS} rows x {took['columns']} columns"
        out.append(Figure(what, took["seconds"], "s", aim=SECONDS))
        out.append(Figure(f"{what}: peak memory", took["peak_mb"], "MB", aim=MEGABYTES))
    return out


if __name__ == "__main__":
    sys.exit(main(figures))
