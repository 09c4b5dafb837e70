"""Peak memory of a process: `ru_maxrss` of a child begins with what its parent held when it was started, this does not.

python -m tests.peak_memory FILE ARGUMENTS...    errpipe ARGUMENTS..., its peak in kB written to FILE
"""

from __future__ import annotations

import atexit
import sys
from pathlib import Path


def peak_kb() -> int:
    """Peak resident memory of this process since it was started, kB (Linux: VmHWM)."""
    status = Path("/proc/self/status").read_text("ascii", errors="replace")
    return int(status.split("VmHWM:")[1].split()[0])


if __name__ == "__main__":
    from errpipe.cli.app import main

    out = Path(sys.argv[1])
    atexit.register(lambda: out.write_text(str(peak_kb()), "ascii"))
    sys.exit(main(sys.argv[2:]))
