"""How long a diagnosis of 20 000 rows takes, and how much memory: each shape in a fresh process.

The aims are absolute: 30 s and 1000 MB on two cores.
"""

from __future__ import annotations

import sys

from tests.unit.diagnosis import long

SECONDS, MEGABYTES = 30.0, 1000.0


def main() -> int:
    missed = False
    for shape in long.SHAPES:
        took = long.measured(shape)
        missed |= took["seconds"] > SECONDS or took["peak_mb"] > MEGABYTES
        print(
            f"  {shape:28} {took['seconds']:6.1f} s  {took['cpu_seconds']:6.1f} s CPU  {took['peak_mb']:5d} MB  "
            f"{long.ROWS} rows x {took['columns']} columns: {', '.join(took['named'])}"
        )
    print(f"  wanted: below {SECONDS:g} s and {MEGABYTES:g} MB")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
