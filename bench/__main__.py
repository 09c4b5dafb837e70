"""All benches one after the other, each in its own process: `make bench`, or `python -m bench [NAME...]`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def main(names: list[str]) -> int:
    """Run the benches named (all without names); 1 where one of them missed its aim or failed."""
    found = sorted(path.stem for path in HERE.glob("bench_*.py"))
    code = 0
    for name in [f"bench_{name}" for name in names] or found:
        print(f"== {name.removeprefix('bench_')}", flush=True)
        code |= subprocess.run([sys.executable, "-m", f"bench.{name}"], check=False).returncode != 0
    return int(code)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
