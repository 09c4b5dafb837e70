"""How long a diagnosis of 20 000 and of a million rows takes, and how much memory: each shape in a fresh process.

The aims are absolute.
"""

from __future__ import annotations

import sys

from bench.figure import Figure, main
from tests.unit.diagnosis import long


def figures() -> list[Figure]:
    """Seconds and megabytes of each shape."""
    out = []
    for shape, wanted in long.SHAPES.items():
        took = long.measured(shape)
        what = f"{shape}, {took['rows']} rows x {took['columns']} columns"
        out.append(Figure(what, took["seconds"], "s", aim=wanted.seconds))
        out.append(Figure(f"{what}: peak memory", took["peak_mb"], "MB", aim=wanted.megabytes))
    return out


if __name__ == "__main__":
    sys.exit(main(figures))
